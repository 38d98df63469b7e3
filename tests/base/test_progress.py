"""Long work says how far it is, where nobody asked for it; short work says nothing."""

import logging
import re
import sys
import time
import types

import pytest

from adaptrack.base import progress
from adaptrack.base.progress import reports_progress


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(progress, "FIRST_PAUSE", 0.02)
    monkeypatch.setattr(progress, "NEXT_PAUSE", 0.02)


@reports_progress("search")
def work(seconds, progress=None):
    """What takes so long."""
    progress("swarm", 1, 4)
    time.sleep(seconds)
    progress(2, 4)
    return seconds


def test_work_that_nobody_follows_leaves_log_records_with_its_share(caplog):
    with caplog.at_level(logging.WARNING, logger="adaptrack"):
        assert work(0.3) == 0.3
    assert any(re.fullmatch(r"adaptrack: search, swarm: 25 %, (about|\d+) .*", message) for message in caplog.messages)


def test_work_within_work_that_is_on_show_says_nothing_of_its_own(caplog):
    @reports_progress("chain")
    def chain(progress=None):
        progress("search", 0, 1)
        work(0.2)

    chain()
    assert caplog.messages
    assert all(message.startswith("adaptrack: chain, search: ") for message in caplog.messages)


def test_short_work_and_work_that_is_followed_leave_no_records(caplog):
    work(0.0)  # short work
    assert not caplog.messages
    reports = []
    work(0.1, progress=lambda *report: reports.append(report))
    assert reports == [("swarm", 1, 4), (2, 4)]
    assert not caplog.messages


def test_a_notebook_has_a_bar_that_ends_full(monkeypatch, caplog):
    bars = []

    class Handle:
        def update(self, html):
            bars.append(html)

    def display(html, display_id):
        bars.append(html)
        return Handle()

    ipython = types.ModuleType("IPython")
    ipython.get_ipython = lambda: types.SimpleNamespace(kernel=object())
    ipython.display = types.ModuleType("IPython.display")
    ipython.display.display, ipython.display.HTML = display, str
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", ipython.display)
    work(0.3)
    assert '<progress value="0.250" max="1"></progress> search, swarm: 25 %' in bars[0]
    assert 'value="1.000"' in bars[-1]
    assert not caplog.messages
