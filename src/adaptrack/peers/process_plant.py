"""A simulator in another process as a stepped plant: lines of JSON over its standard input and output.

The protocol is in docs/plants.md: the process greets with a line, then answers every line that it is sent with one, and
ends when its input does.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import os
import selectors
import signal
import subprocess
import sys
import termios
import time
import weakref
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import real
from adaptrack.base.errors import ContractError, InvalidInput
from adaptrack.cars.plant import SteppedPlant

Array = NDArray[np.float64]

PROTOCOL = 1
"""The version of the protocol."""
_GREETING = "adaptrack_plant"
_NUMBERS = ("mass", "engine_power", "traction_limit", "brake_limit", "longest_step")
_LONGEST_LINE = 1 << 20
_AT_ONCE = 1 << 16
"""Bytes that are read in one go: what a pipe holds."""
_KEPT = 2000
"""Bytes of standard error that are kept: the last."""
_GRACE = 2.0
"""s, that a process has to end by itself, and again after a request to end."""


class ProcessPlant(SteppedPlant):
    """A vehicle that a process simulates, started by a command and ended with this object.

    command: program and arguments; timeout: s, to read a line, and to answer it; start_timeout: s, for the greeting;
    the other options are those of `subprocess.Popen` (``cwd``, ``env``). Mass, powertrain, longest step and name are
    those of the greeting where it has them. Use it in a ``with`` block, or call `close`; the process and those of its
    group that it started end in any case with this object, with the interpreter, and after any error. POSIX systems.

    Raises
    ------
    InvalidInput
        When the command cannot be started, or a time is not positive.
    ContractError
        Here, in `reset`, in `step` and in `close`: when the process ends, is too late, says something else than the
        protocol asks or says it unasked, with the end of what it wrote to its standard error.
    """

    def __init__(
        self, command: Sequence[str], timeout: float = 10.0, start_timeout: float = 60.0, **options: Any
    ) -> None:
        if isinstance(command, str) or not command or not all(isinstance(part, str) for part in command):
            raise InvalidInput(
                f"ProcessPlant: command = {command!r}: must be a list of texts, ['simulator', '--road']."
            )
        for name, value in (("timeout", timeout), ("start_timeout", start_timeout)):
            if not 0.0 < real("ProcessPlant", name, value) < math.inf:
                raise InvalidInput(f"ProcessPlant: {name} = {value!r} s: must be positive and finite.")
        self.command, self.timeout = list(command), float(timeout)
        self._name = os.path.basename(command[0])
        try:
            self._process = _Simulator(self.command, **options)
        except (OSError, ValueError, TypeError) as error:
            raise InvalidInput(f"ProcessPlant: {' '.join(command)}: cannot be started: {error}.") from error
        self._end = weakref.finalize(self, self._process.end)
        self._take_greeting(float(start_timeout))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self._end()

    def close(self) -> None:
        """End the process; a second time does nothing.

        Raises
        ------
        ContractError
            When it had answered more often than there were requests: what was driven may be answers to other lines.
        """
        said = self._end()
        if said and b'"motion"' in said:
            raise ContractError(f"Plant {self.name!r}: {_unasked(said)}: what was driven may be wrong.")

    @property
    def name(self) -> str:
        return self._name

    def reset(self, motion: Array) -> None:
        started = self._ask({"do": "reset", "motion": np.asarray(motion, dtype=np.float64).tolist()})
        if not np.allclose(started, motion, rtol=1e-6, atol=1e-6):
            self._refuse(
                f"reset answered with the motion {started.tolist()}; {np.asarray(motion).tolist()} was requested"
            )

    def step(self, dt: float, steering: float, acceleration: float, environment: Array) -> Array:
        return self._ask(
            {
                "do": "step", "dt": float(dt), "steering": float(steering), "acceleration": float(acceleration),
                "environment": np.asarray(environment, dtype=np.float64).tolist(),
            }
        )  # fmt: skip

    # -- what is said ---------------------------------------------------------------------------------------------
    def _take_greeting(self, within: float) -> None:
        hello = self._line(within, "its greeting")
        version = hello.get(_GREETING)
        if not isinstance(version, float) or version != PROTOCOL:
            self._refuse(f'the first line must be a greeting, {{"{_GREETING}": {PROTOCOL}}}, it is {_short(hello)}')
        if "name" in hello:
            self._name = str(hello["name"])
        for name in _NUMBERS:
            value = hello.get(name, float(getattr(self, name)))
            if not isinstance(value, float) or not 0.0 < value < math.inf:
                self._refuse(f"{name} = {value!r} of its greeting must be a positive number")
            setattr(self, name, value)

    def _ask(self, what: dict[str, Any]) -> Array:
        """The motion (6,) that is answered."""
        if not self._end.alive:
            raise ContractError(f"Plant {self.name!r}: its process has been ended: make a new ProcessPlant.")
        try:
            self._tell(what)
            answer = self._line(self.timeout, f"the answer to {what['do']}")
            if self._process.unread() > 1:  # a line's end may stay: JSON ends before it
                self._refuse(f"before it had read {what['do']} {_unasked(answer)}")
        except BaseException:  # Ctrl-C, too: an answer that nobody waited for would be taken for the next
            self._end()
            raise
        motion = answer.get("motion")
        if not isinstance(motion, list) or len(motion) != 6 or not all(isinstance(value, float) for value in motion):
            self._refuse(f'{what["do"]} must be answered with {{"motion": [six numbers]}}, not {_short(answer)}')
        return np.array(motion, dtype=np.float64)

    def _tell(self, what: dict[str, Any]) -> None:
        self._process.attend(0.0)
        if self._process.heard:
            self._refuse(f"before {what['do']} {_unasked(bytes(self._process.heard))}")
        try:
            if not self._process.send(json.dumps(what).encode() + b"\n", self.timeout):
                self._refuse(f"the process did not read {what['do']} within {self.timeout:g} s")
        except OSError:
            self._refuse(f"the process ended{self._exit()} before {what['do']}")

    def _line(self, within: float, what: str) -> Mapping[str, Any]:
        """The object of the next line, which is `what`, within a time (s); its numbers are float."""
        process, end = self._process, time.monotonic() + within
        while b"\n" not in process.heard:
            if len(process.heard) > _LONGEST_LINE:
                self._refuse(f"{what} is longer than {_LONGEST_LINE} characters: {_short(bytes(process.heard))}")
            if process.silent:
                self._refuse(f"the process ended{self._exit()} before {what}")
            left = end - time.monotonic()
            if left < 0.0:
                self._refuse(
                    f"{what} did not come within {within:g} s: give it more time with timeout=, start_timeout="
                )
            process.attend(left)
        line, _, process.heard = process.heard.partition(b"\n")
        try:
            found = json.loads(line, parse_int=float)  # one kind of number, as in JSON: 10**400 is infinite as 1e400 is
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict):
            self._refuse(
                f"{what} is no JSON object but {_short(bytes(line))}; what is no answer belongs on standard error"
            )
        if "error" in found:
            self._refuse(f"instead of {what} it reports: {found['error']}")
        return found

    def _exit(self) -> str:
        status = self._process.status()
        return "" if status is None else f" with exit status {status}"

    def _refuse(self, why: str) -> NoReturn:
        """End the process and say why, with the end of what it wrote to standard error."""
        self._process.attend(0.0)
        errors = self._process.errors.decode("utf-8", "replace").strip()
        self._end()
        raise ContractError(
            f"Plant {self.name!r}: {why}." + (f" Its standard error ends with:\n{errors}" if errors else "")
        )


def _short(said: Any) -> str:
    text = repr(said)
    return text if len(text) < 200 else f"{text[:200]}..."


def _unasked(said: Any) -> str:
    return f"it said {_short(said)} unasked; every line is answered with one"


class _Simulator(subprocess.Popen[bytes]):
    """A process to which lines are written and that is listened to; nothing here waits for it longer than is said."""

    def __init__(self, command: Sequence[str], **options: Any) -> None:
        pipe = subprocess.PIPE
        super().__init__(
            command, stdin=pipe, stdout=pipe, stderr=pipe, bufsize=0, start_new_session=True, **options
        )  # fmt: skip
        assert self.stdin is not None
        assert self.stdout is not None
        assert self.stderr is not None
        self.heard, self.errors = bytearray(), bytearray()
        """what was read of its output and is not yet a line that was taken; the end of its standard error"""
        self.silent = False
        """whether its output has ended"""
        self._pipes = self.stdin, self.stdout, self.stderr
        self._reading = selectors.PollSelector()
        for stream in self._pipes:
            os.set_blocking(stream.fileno(), False)
        for stream in self._pipes[1:]:
            self._reading.register(stream, selectors.EVENT_READ)

    def attend(self, seconds: float) -> None:
        """Read what there is, or what comes first within a time (s); what is too long for a line is dropped."""
        for key, _ in self._reading.select(max(0.0, seconds)):
            if key.fileobj is self.stdin:
                continue
            more = os.read(key.fd, _AT_ONCE)
            if key.fileobj is self.stderr:
                self.errors = (self.errors + more)[-_KEPT:]
            else:
                self.heard += more[: _LONGEST_LINE + 1 - len(self.heard)]
                self.silent = not more
            if not more:
                self._reading.unregister(key.fileobj)

    def send(self, line: bytes, within: float) -> bool:
        """Write a line; whether the process has taken it within a time (s)."""
        end = time.monotonic() + within
        while line:
            try:
                line = line[os.write(self._pipes[0].fileno(), line) :]
            except BlockingIOError:
                left = end - time.monotonic()
                if left < 0.0:
                    return False
                self._reading.register(self._pipes[0], selectors.EVENT_WRITE)
                self.attend(left)
                self._reading.unregister(self._pipes[0])
        return True

    def unread(self) -> int:
        """How many bytes of what was sent the process has not read yet."""
        return int.from_bytes(fcntl.ioctl(self._pipes[0], termios.FIONREAD, bytes(4)), sys.byteorder)

    def status(self) -> int | None:
        """The exit status, if it ends soon; its number stays its own until somebody waits for it."""
        end = time.monotonic() + _GRACE
        while True:
            try:
                found = os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            except ChildProcessError:  # somebody has
                return self.poll()
            if found is not None:
                return found.si_status if found.si_code == os.CLD_EXITED else -found.si_status
            if time.monotonic() > end:
                return None
            self.attend(0.005)  # it may have to write before it ends

    def end(self) -> bytes:
        """End it and the group that it started: by the end of its input, by a request, by force. What it said last."""
        self._pipes[0].close()
        if self.status() is None:
            self._signal(signal.SIGTERM)
            self.status()
        self.attend(0.0)
        self._signal(signal.SIGKILL)
        self.wait()
        self._reading.close()
        for pipe in self._pipes:
            pipe.close()
        return bytes(self.heard)

    def _signal(self, number: signal.Signals) -> None:
        """To its group, as long as its number is its own."""
        if self.returncode is None:
            with contextlib.suppress(OSError):
                os.killpg(self.pid, number)
