"""Progress reports of long computations: a progress bar in a notebook, elsewhere a log record at intervals."""

from __future__ import annotations

import functools
import html
import logging
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any, ParamSpec, TypeVar

FIRST_PAUSE = 2.0
"""s, from the start of a computation to its first report."""
NEXT_PAUSE = 5.0
"""s, shortest time between later reports; it grows with the computation time."""
LONGEST_PAUSE = 60.0
"""s, longest time between reports."""

_log = logging.getLogger("adaptrack")
ProgressCall = Callable[[str, int, int], None]
"""Function that a computation calls with (stage, steps done, steps in all)."""
_P = ParamSpec("_P")
_R = TypeVar("_R")


def reports_progress(label: str) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Decorator for functions with an argument `progress`: a call without this argument reports on the terminal.

    The function must call `progress` with (stage, steps done, steps in all) or (steps done, steps in all). Inside
    another computation that shows its progress, the function reports nothing. label: name of the computation in the
    report.
    """

    def decorate(function: Callable[_P, _R]) -> Callable[_P, _R]:
        @functools.wraps(function)
        def wrapped(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            if kwargs.get("progress") is not None:
                return function(*args, **kwargs)
            with shown_progress(TrackedWork(label), _show) as update:
                kwargs["progress"] = update
                return function(*args, **kwargs)

        return wrapped

    return decorate


class TrackedWork:
    """Progress of a long computation, with an estimate of the time left.

    A computation consists of `total` parts, each with its own number of steps. A computation of one part may have
    several stages. Each stage counts its steps from 0, and the time left is then that of the current stage.

    Parameters
    ----------
    label
        Name of the computation in reports.
    total
        Number of parts.
    """

    def __init__(self, label: str, total: int = 1) -> None:
        self.label, self.total, self.finished, self.share = label, total, 0, 0.0
        self.stage = label
        self.start_time = self.update_time = time.monotonic()

    def update(self, *status: Any) -> None:
        """Take a report of the computation: (stage, steps done, steps in all) or (steps done, steps in all)."""
        *stage, step, steps = status
        self.update_time = time.monotonic()
        share = (self.finished + (step / steps if steps else 1.0)) / self.total
        if self.total == 1 and (share < self.share or share == 0.0):
            self.start_time = self.update_time
        self.stage, self.share = str(stage[0]) if stage else self.label, share
        if self.total > 1 and step == steps:
            self.finished += 1

    def time_left(self) -> float | None:
        """Return the estimated time to the end (s), or None if it is unknown or the estimate has already elapsed."""
        if not 0.0 < self.share < 1.0:
            return None
        estimate = (self.update_time - self.start_time) * (1.0 - self.share) / self.share
        left = estimate - (time.monotonic() - self.update_time)
        return left if left > 0.0 else None

    def status_line(self) -> str:
        """Return a line for the user: label and stage, completed share, time left."""
        name = self.label if self.stage == self.label else f"{self.label}, {self.stage}"
        left = self.time_left()
        elapsed = f"{time.monotonic() - self.start_time:.0f} s so far"
        share = f" {100.0 * self.share:.0f} %," if 0.0 < self.share < 1.0 else ""
        return f"{name}:{share} {elapsed if left is None else f'about {duration(left)} left'}"


def duration(seconds: float) -> str:
    """Return a time (s) in words, in s, min or h."""
    if seconds < 90.0:
        return f"{math.ceil(seconds)} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


_running_work: list[TrackedWork] = []
"""Nested computations that are running, outermost first. Only the first one reports its progress."""


Update = Callable[..., None]
"""Function that takes the progress, see `TrackedWork.update`."""


@contextmanager
def shown_progress(
    work: TrackedWork, show: Callable[[TrackedWork], AbstractContextManager[Update]]
) -> Iterator[Update]:
    """Show the progress of the `with` block, unless it is part of other work; yields the function that takes it."""
    _running_work.append(work)
    try:
        with show(work) if _running_work[0] is work else nullcontext(work.update) as update:
            yield update
    finally:
        _running_work.remove(work)


@contextmanager
def reported(
    work: TrackedWork, report: Callable[[TrackedWork], object], interval: float | None = None
) -> Iterator[Update]:
    """Report the progress of the `with` block from a thread; yields the function that takes the progress.

    report: called with the work, first after `FIRST_PAUSE`, then at intervals; interval: time between calls (s), with a
    last one at the end. If None, it grows from `NEXT_PAUSE` to `LONGEST_PAUSE`.
    """
    end, start_time = threading.Event(), time.monotonic()

    def report_until_end() -> None:
        pause, is_reported = FIRST_PAUSE, False
        while not end.wait(pause):
            report(work)
            growing = min(max(NEXT_PAUSE, 0.1 * (time.monotonic() - start_time)), LONGEST_PAUSE)
            pause, is_reported = growing if interval is None else interval, True
        if is_reported and interval is not None:
            work.share = 1.0
            report(work)

    thread = threading.Thread(target=report_until_end, daemon=True)
    thread.start()
    try:
        yield work.update
    finally:
        end.set()
        thread.join()


def _show(work: TrackedWork) -> AbstractContextManager[Update]:
    """Show a bar in a notebook; elsewhere log WARNINGs, which Python prints to standard error by default."""
    if _is_notebook():
        return reported(work, _notebook_bar(), interval=1.0)
    return reported(work, lambda work: _log.warning("adaptrack: %s", work.status_line()))


def _notebook_bar() -> Callable[[TrackedWork], None]:
    """Return a function that draws and updates a progress bar below the notebook cell."""
    from IPython.display import HTML, display

    handles: list[Any] = []

    def report(work: TrackedWork) -> None:
        bar = HTML(f'<progress value="{work.share:.3f}" max="1"></progress> {html.escape(work.status_line())}')
        if handles:
            handles[0].update(bar)
        else:
            handles.append(display(bar, display_id=True))

    return report


def _is_notebook() -> bool:
    """Whether the code runs in a notebook cell: IPython was imported and has a kernel."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return getattr(shell, "kernel", None) is not None
