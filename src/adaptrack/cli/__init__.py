"""Command line: `main` runs one command and reports every error as one message and an exit code.

Exit codes:

- 0: done;
- 1: a loop is unstable, a car cannot drive a road, or the criteria of a standard are not met;
- 2: an error, with one sentence on standard error;
- 3: a run failed, an identification is inconsistent, learned values are implausible, or inputs contradict each other;
- 130: interrupted by Ctrl-C;
- 141: the reader of standard output has closed the pipe (`adaptrack ... | head -1`).

This module imports only the standard library, so that Ctrl-C works from the start. Each command imports its modules
when it runs; `adaptrack --help` loads no numerics.
"""

from __future__ import annotations

import errno
import gc
import os
import re
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from adaptrack.base.errors import AdaptrackError, InvalidInput, StorageError

DONE, ERROR, INTERRUPTED, PIPE_CLOSED = 0, 2, 130, 141

COLLECT_AFTER = 50_000
"""Threshold of the garbage collector; the default of 700 objects costs a tenth of the time of a short command."""

REPEAT = 0.5
"""Time between repetitions of an unanswered Ctrl-C (s)."""

_NO_OUTPUT = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)
"""Error numbers of the system if standard output cannot be written."""


_progress_note = ""


def note_progress(text: str) -> None:
    """Set the note that Ctrl-C prints: the results that are already written, and how to continue."""
    global _progress_note
    _progress_note = text


def main() -> int:
    """Run the command line and return the exit code."""
    gc.set_threshold(COLLECT_AFTER)
    _prepare_output()
    note_progress("Nothing was written.")
    with _noting_ctrl_c() as pressed:
        try:
            _check_surroundings()
            _check_pairs()
            code = _run()
        except BaseException as error:
            # An import that Ctrl-C hits may end in any exception, not only in KeyboardInterrupt.
            code = INTERRUPTED if pressed else _reported(error)
    if code == INTERRUPTED:
        print(f"adaptrack: interrupted. {_progress_note}", file=sys.stderr)
    return code


def _run() -> int:
    from adaptrack.cli.app import app

    code = app(standalone_mode=False)
    sys.stdout.flush()
    return code if isinstance(code, int) else DONE


def _reported(error: BaseException) -> int:
    """Print the message of an error and return its exit code; raise unexpected errors again."""
    if isinstance(error, AdaptrackError):
        print(f"adaptrack: {_name_options(str(error))}", file=sys.stderr)
        return ERROR
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED
    if isinstance(error, BrokenPipeError | SystemExit):  # typer and rich end with the latter when a pipe is closed
        _give_up_output()
        return PIPE_CLOSED
    if isinstance(error, OSError) and error.errno in _NO_OUTPUT and error.filename is None:
        _give_up_output()
        print(f"adaptrack: standard output cannot be written: {error.strerror}.", file=sys.stderr)
        return ERROR
    show: Any = getattr(error, "show", None)  # of typer's complaints about the command line
    if show is None:
        raise error
    show()
    return int(getattr(error, "exit_code", ERROR))


def _name_options(message: str) -> str:
    """Return a message without the Python function at its start, and with the option in place of its argument."""
    import adaptrack

    name, mark, problem = message.partition(": ")
    if not mark or name in sys.argv or name not in dir(adaptrack):
        return message
    argument = problem.partition(" = ")[0]
    option = f"--{argument.replace('_', '-')}"
    return problem.replace(argument, option, 1) if option in sys.argv else problem


def _prepare_output() -> None:
    """Make all text printable, and replace a closed standard error (`2>&-`) by the null device."""
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, ValueError):
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]


def _check_surroundings() -> None:
    """Refuse a closed standard output (`>&-`) before any work, and let pictures need no window system."""
    if sys.stdout is None:
        raise StorageError("standard output is closed, so nothing can be printed: send it to a file, or to /dev/null.")
    os.environ.pop("MPLBACKEND", None)  # a window system; pictures are written to files


def _check_pairs() -> None:
    """Refuse LOW:HIGH and S:SECONDS as two words: no command takes a number that is not the value of an option."""
    if pair := re.search(r"(--assumed-friction|--stop)[ =]([\d.]+) ([\d.]+)(?= |$)", " ".join(sys.argv)):
        option, first, second = pair.groups()
        raise InvalidInput(f"{option} {first} {second}: write one word with a colon, {option} {first}:{second}.")


def _give_up_output() -> None:
    """Redirect standard output to the null device, because the interpreter flushes its buffer at exit."""
    with suppress(OSError, ValueError), open(os.devnull, "w", encoding="utf-8") as nowhere:
        os.dup2(nowhere.fileno(), sys.stdout.fileno())


@contextmanager
def _noting_ctrl_c() -> Iterator[list[int]]:
    """Yield a list that records each Ctrl-C, which also raises KeyboardInterrupt as usual.

    Callbacks from compiled code and finalizers suppress exceptions. A Ctrl-C during an import or a compilation, or a
    suppressed one, is therefore repeated until it interrupts the command.
    """
    pressed: list[int] = []
    swallowed: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        pressed.append(number)
        signal.setitimer(signal.ITIMER_REAL, REPEAT, REPEAT)
        signal.default_int_handler(number, frame)

    def repeat(number: int, frame: FrameType | None) -> None:
        if swallowed or _importing(frame):
            swallowed.clear()
            raise KeyboardInterrupt

    def report(unraisable: Any) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            swallowed.append(signal.SIGINT)
        else:
            report_before(unraisable)

    main_thread = threading.current_thread() is threading.main_thread()
    if not main_thread or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield pressed
        return
    signal.signal(signal.SIGINT, note)
    before = signal.signal(signal.SIGALRM, repeat)
    report_before, sys.unraisablehook = sys.unraisablehook, report
    try:
        yield pressed
    finally:
        sys.unraisablehook = report_before
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _importing(frame: FrameType | None) -> bool:
    """Whether the call stack contains an import."""
    while frame is not None:
        name = frame.f_code.co_filename
        if "importlib._bootstrap" in name:
            return True
        frame = frame.f_back
    return False
