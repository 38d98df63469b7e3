"""How far long work is, and what it says of itself: a bar in a notebook, elsewhere a log record now and then."""

from __future__ import annotations

import functools
import html
import logging
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ParamSpec, TypeVar

FIRST_PAUSE, NEXT_PAUSE, LONGEST_PAUSE = 2.0, 5.0, 60.0
"""s, until the first word, until the next, and at most, in work of hours."""

_log = logging.getLogger("adaptrack")
ProgressCall = Callable[[str, int, int], None]
"""What long work calls: its stage, the steps done, the steps in all."""
_P = ParamSpec("_P")
_R = TypeVar("_R")


def tells(label: str) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """A decorator of a function with an argument `progress`: where that is left out, the work says how far it is.

    label: what is done. `progress` is called with (stage, done, of) or (done, of). Where something else is on show
    already, such as the bar of a command, nothing is said.
    """

    def decorate(function: Callable[_P, _R]) -> Callable[_P, _R]:
        @functools.wraps(function)
        def wrapped(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            if kwargs.get("progress") is not None:
                return function(*args, **kwargs)
            with _telling(label) as update:
                kwargs["progress"] = update
                return function(*args, **kwargs)

        return wrapped

    return decorate


class TrackedWork:
    """How far long work is, and how long it will take.

    label: what is done; total: its pieces, each of which goes from 0 to its steps. A single piece may have stages, one
    after the other, each of which counts from 0: the time left is that of the stage.
    """

    def __init__(self, label: str, total: int = 1) -> None:
        self.label, self.total, self.finished, self.share = label, total, 0, 0.0
        self.stage = label
        self.begun = self.at = time.monotonic()

    def update(self, *reported: Any) -> None:
        """reported: (stage, steps done, steps in all) or (steps done, steps in all)."""
        *stage, step, steps = reported
        self.at = time.monotonic()
        share = (self.finished + (step / steps if steps else 1.0)) / self.total
        if self.total == 1 and (share < self.share or share == 0.0):
            self.begun = self.at
        self.stage, self.share = str(stage[0]) if stage else self.label, share
        if self.total > 1 and step == steps:
            self.finished += 1

    def left(self) -> float | None:
        """s until the end, at the speed so far; None where that is not known, or was too little."""
        if not 0.0 < self.share < 1.0:
            return None
        left = (self.at - self.begun) * (1.0 - self.share) / self.share - (time.monotonic() - self.at)
        return left if left > 0.0 else None

    def line(self) -> str:
        """For people: what is done, the share of it, the time left."""
        name = self.label if self.stage == self.label else f"{self.label}, {self.stage}"
        left = self.left()
        duration_text = (
            f"{time.monotonic() - self.begun:.0f} s so far" if left is None else f"about {duration(left)} left"
        )
        share = f" {100.0 * self.share:.0f} %," if 0.0 < self.share < 1.0 else ""
        return f"{name}:{share} {duration_text}"


def duration(seconds: float) -> str:
    """A time as one says it."""
    if seconds < 90.0:
        return f"{math.ceil(seconds)} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


_visible_work: list[TrackedWork] = []
"""The work whose progress is on show: what it calls says nothing of its own."""


@contextmanager
def showing(work: TrackedWork) -> Iterator[bool]:
    """Put the progress of some work on show; yields whether it is the only one, to be shown."""
    _visible_work.append(work)
    try:
        yield _visible_work[0] is work
    finally:
        _visible_work.remove(work)


@contextmanager
def _telling(label: str) -> Iterator[Callable[..., None]]:
    work, over = TrackedWork(label), threading.Event()
    with showing(work) as alone:
        if not alone:
            yield work.update
            return
        say = _bar if _is_notebook() else _record
        teller = threading.Thread(target=_tell, args=(work, over, say()), daemon=True)
        teller.start()
        try:
            yield work.update
        finally:
            over.set()
            teller.join()


def now_and_then(over: threading.Event, say: Callable[[], None], *, every: float | None = None) -> bool:
    """Call `say` after a first pause, then after ever longer ones, until `over` is set; whether it was called.

    every: s, of each pause after the first, where they shall be equal.
    """
    pause, begun, is_announced = FIRST_PAUSE, time.monotonic(), False
    while not over.wait(pause):
        say()
        is_announced = True
        pause = min(max(NEXT_PAUSE, 0.1 * (time.monotonic() - begun)), LONGEST_PAUSE) if every is None else every
    return is_announced


def _tell(work: TrackedWork, over: threading.Event, say: Callable[[TrackedWork, bool], None]) -> None:
    """In a thread: nothing of short work, then a word now and then; a last one at the end."""
    if now_and_then(over, lambda: say(work, False), every=1.0 if _is_notebook() else None):
        say(work, True)


def _record() -> Callable[[TrackedWork, bool], None]:
    """Log records of level WARNING: without any configuration Python shows them on standard error, everywhere."""

    def say(work: TrackedWork, ended: bool) -> None:
        if not ended:
            _log.warning("adaptrack: %s", work.line())

    return say


def _bar() -> Callable[[TrackedWork, bool], None]:
    """A bar below the cell that moves."""
    from IPython.display import HTML, display

    handles: list[Any] = []

    def say(work: TrackedWork, ended: bool) -> None:
        share = 1.0 if ended else work.share
        bar = HTML(f'<progress value="{share:.3f}" max="1"></progress> {html.escape(work.line())}')
        if handles:
            handles[0].update(bar)
        else:
            handles.append(display(bar, display_id=True))

    return say


def _is_notebook() -> bool:
    """Whether a cell of a notebook runs: IPython with a kernel, which nothing here loads by itself."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return getattr(shell, "kernel", None) is not None
