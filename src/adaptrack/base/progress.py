"""What long work says of itself where nobody asked for it: a bar in a notebook, elsewhere a log record now and then."""

from __future__ import annotations

import functools
import html
import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ParamSpec, TypeVar

FIRST, NEXT, RAREST = 2.0, 5.0, 60.0
"""s, until the first word, until the next, and at most, in work of hours."""

_log = logging.getLogger("adaptrack")
P = ParamSpec("P")
R = TypeVar("R")


def tells(label: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A decorator of a function with an argument `progress`: where that is left out, the work says how far it is.

    label: what is done, until the function says more. `progress` is called with (what, done, of) or (done, of).
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(function)
        def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
            if kwargs.get("progress") is not None:
                return function(*args, **kwargs)
            with _telling(label) as update:
                kwargs["progress"] = update
                return function(*args, **kwargs)

        return wrapped

    return decorate


class _State:
    """How far the work is."""

    def __init__(self, label: str) -> None:
        self.label, self.share, self.begun = label, 0.0, time.monotonic()
        self.stage = label

    def update(self, *told: Any) -> None:
        """told: (what, done, of) or (done, of)."""
        *what, done, of = told
        self.stage = str(what[0]) if what else self.label
        self.share = done / of if of else 1.0

    def line(self) -> str:
        """For people."""
        name = self.label if self.stage == self.label else f"{self.label}: {self.stage}"
        share = f", {100.0 * self.share:.0f} %" if 0.0 < self.share < 1.0 else ""
        return f"{name}{share}, {time.monotonic() - self.begun:.0f} s so far"


@contextmanager
def _telling(label: str) -> Iterator[Callable[..., None]]:
    state, over = _State(label), threading.Event()
    say = _bar if _in_notebook() else _record
    teller = threading.Thread(target=_tell, args=(state, over, say()), daemon=True)
    teller.start()
    try:
        yield state.update
    finally:
        over.set()
        teller.join()


def now_and_then(over: threading.Event, say: Callable[[], None], *, every: float | None = None) -> bool:
    """Call `say` after a first pause, then after ever longer ones, until `over` is set; whether it was called.

    every: s, of each pause after the first, where they shall be equal.
    """
    pause, begun, said = FIRST, time.monotonic(), False
    while not over.wait(pause):
        say()
        said = True
        pause = min(max(NEXT, 0.1 * (time.monotonic() - begun)), RAREST) if every is None else every
    return said


def _tell(state: _State, over: threading.Event, say: Callable[[_State, bool], None]) -> None:
    """In a thread: nothing of short work, then a word now and then; a last one at the end."""
    if now_and_then(over, lambda: say(state, False), every=1.0 if _in_notebook() else None):
        say(state, True)


def _record() -> Callable[[_State, bool], None]:
    """Log records of level WARNING: without any configuration Python shows them on standard error, everywhere."""

    def say(state: _State, ended: bool) -> None:
        if not ended:
            _log.warning("adaptrack: %s", state.line())

    return say


def _bar() -> Callable[[_State, bool], None]:
    """A bar below the cell that moves."""
    from IPython.display import HTML, display

    handles: list[Any] = []

    def say(state: _State, ended: bool) -> None:
        share = 1.0 if ended else state.share
        shown = HTML(f'<progress value="{share:.3f}" max="1"></progress> {html.escape(state.line())}')
        if handles:
            handles[0].update(shown)
        else:
            handles.append(display(shown, display_id=True))

    return say


def _in_notebook() -> bool:
    """Whether a cell of a notebook runs: IPython with a kernel, which nothing here loads by itself."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return getattr(shell, "kernel", None) is not None
