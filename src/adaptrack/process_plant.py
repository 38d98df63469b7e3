"""A simulator in another process as a stepped plant: lines of JSON over its standard input and output.

The protocol is in docs/plants.md: the process greets with a line, then answers every line that it is sent with one, and
ends when its input does.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import signal
import subprocess
import tempfile
import time
import weakref
from collections.abc import Mapping, Sequence
from typing import IO, Any, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from adaptrack.errors import ContractError, InvalidInput, real
from adaptrack.plant import SteppedPlant

Array = NDArray[np.float64]

PROTOCOL = 1
"""The version of the protocol."""
_GREETING = "adaptrack_plant"
_NUMBERS = ("mass", "engine_power", "traction_limit", "brake_limit", "longest_step")
_LONGEST_LINE = 1 << 20
_GRACE = 2.0
"""s, that a process has to end by itself, and again after it was asked to."""


class ProcessPlant(SteppedPlant):
    """A vehicle that a process simulates, started by a command and ended with this object.

    command: program and arguments; timeout: s, for every answer; start_timeout: s, for the greeting; the other options
    are those of `subprocess.Popen` (``cwd``, ``env``). Mass, powertrain, longest step and name are those of the
    greeting where it has them. Use it in a ``with`` block, or call `close`; the process ends in any case with this
    object, with the interpreter, and after any error. POSIX systems.

    Raises
    ------
    InvalidInput
        When the command cannot be started, or a time is not positive.
    ContractError
        Here, in `reset` and in `step`: when the process ends, is too late or says something else than the protocol
        asks, with what it wrote to its standard error.
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
        self._name, self._heard = os.path.basename(command[0]), b""
        # lives as long as the process
        self._said: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115
        try:
            self._process = subprocess.Popen(
                self.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._said, bufsize=0,
                start_new_session=True, **options,
            )  # fmt: skip
        except (OSError, ValueError, TypeError) as error:
            self._said.close()
            raise InvalidInput(f"ProcessPlant: {' '.join(command)}: cannot be started: {error}.") from error
        self.close = weakref.finalize(self, _end, self._process, self._said)
        """End the process; a second time does nothing."""
        self._take_greeting(float(start_timeout))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def name(self) -> str:
        return self._name

    def reset(self, motion: Array) -> None:
        started = self._ask({"do": "reset", "motion": np.asarray(motion, dtype=np.float64).tolist()})
        if not np.allclose(started, motion, rtol=1e-6, atol=1e-6):
            self._refuse(f"reset answered with the motion {started.tolist()}, it was asked for {list(motion)}")

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
        if hello.get(_GREETING) != PROTOCOL:
            self._refuse(f'the first line must be a greeting, {{"{_GREETING}": {PROTOCOL}}}, it is {_short(hello)}')
        if "name" in hello:
            self._name = str(hello["name"])
        for name in _NUMBERS:
            value = hello.get(name, getattr(self, name))
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < math.inf:
                self._refuse(f"{name} = {value!r} of its greeting must be a positive number")
            setattr(self, name, float(value))

    def _ask(self, what: dict[str, Any]) -> Array:
        """The motion (6,) that is answered."""
        if not self.close.alive:
            raise ContractError(f"Plant {self.name!r}: its process has been ended: make a new ProcessPlant.")
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(what).encode() + b"\n")
        except OSError:
            self._refuse(f"the process ended{self._exit()} before {what['do']}")
        answer = self._line(self.timeout, f"the answer to {what['do']}")
        motion = answer.get("motion")
        if not isinstance(motion, list) or len(motion) != 6 or not all(_is_number(value) for value in motion):
            self._refuse(f'{what["do"]} must be answered with {{"motion": [six numbers]}}, not {_short(answer)}')
        return np.array(motion, dtype=np.float64)

    def _line(self, within: float, what: str) -> Mapping[str, Any]:
        """The object of the next line, which is `what`, within a time (s)."""
        assert self._process.stdout is not None
        end, out = time.monotonic() + within, self._process.stdout.fileno()
        while b"\n" not in self._heard:
            if not select.select([out], [], [], max(0.0, end - time.monotonic()))[0]:
                self._refuse(
                    f"{what} did not come within {within:g} s: give it more time with timeout=, start_timeout="
                )
            more = os.read(out, 1 << 16)
            if not more:
                self._refuse(f"the process ended{self._exit()} before {what}")
            self._heard += more
            if len(self._heard) > _LONGEST_LINE:
                self._refuse(f"{what} is longer than {_LONGEST_LINE} characters: {_short(self._heard)}")
        line, self._heard = self._heard.split(b"\n", 1)
        try:
            found = json.loads(line)
        except ValueError:
            found = None
        if not isinstance(found, dict):
            self._refuse(f"{what} is no JSON object but {_short(line)}; what is no answer belongs on standard error")
        if "error" in found:
            self._refuse(f"instead of {what} it reports: {found['error']}")
        return found

    def _exit(self) -> str:
        try:
            return f" with exit status {self._process.wait(_GRACE)}"
        except subprocess.TimeoutExpired:
            return ""

    def _refuse(self, why: str) -> NoReturn:
        """End the process and say why, with the end of what it wrote to standard error."""
        self._said.seek(max(0, self._said.seek(0, os.SEEK_END) - 2000))
        told = self._said.read().decode("utf-8", "replace").strip()
        name = self.name
        self.close()
        raise ContractError(f"Plant {name!r}: {why}." + (f" Its standard error ends with:\n{told}" if told else ""))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _short(said: Any) -> str:
    text = repr(said)
    return text if len(text) < 200 else f"{text[:200]}..."


def _end(process: subprocess.Popen[bytes], said: IO[bytes]) -> None:
    """End a process and all that it started: by the end of its input, by a request, by force."""
    assert process.stdin is not None
    assert process.stdout is not None
    with contextlib.suppress(OSError):
        process.stdin.close()
    if not _ends(process):
        _signal(process, signal.SIGTERM)
        _ends(process)
    _signal(process, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    said.close()


def _ends(process: subprocess.Popen[bytes]) -> bool:
    """Whether it ends soon; its number is kept until somebody waits for it."""
    end = time.monotonic() + _GRACE
    while process.returncode is None:
        if os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
            return True
        if time.monotonic() > end:
            return False
        time.sleep(0.005)
    return True


def _signal(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    """To the process and to what it started, as long as its number is its own."""
    if process.returncode is None:
        with contextlib.suppress(OSError):
            os.killpg(process.pid, number)
