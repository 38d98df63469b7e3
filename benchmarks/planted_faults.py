"""Which of the faults in `planted_faults.toml` do the default tests find?

    python benchmarks/planted_faults.py CHECKOUT --out FOLDER [--only N ...] [--against OTHER/found.json]

CHECKOUT: a checkout of this repository, of any age; its tests run on copies of it, in the Python that runs this.

1. In one copy a marker stands before each line that is to be changed, in compiled kernels too: one run of the default
   tests says which of them execute it (`tests.json`). What a wider fixture or a cached function did once counts for
   every test that uses it.
2. Each fault is planted alone, and those tests run until one fails that passes without the fault (`found.json`). A test
   that runs for `--limit` seconds longer than before has found it, too.
3. A table: faults by room and how many were found; `--against`: beside those of another checkout.

Both files are written as results come; a run that was interrupted goes on where it was.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import json
import os
import queue
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

PACKAGE = Path("src/adaptrack")
BUILT = "src/adaptrack/core/built"
MOST_MEMORY = 10 << 30
"""bytes that a test run may hold: a fault may ask for any number"""
FOUND = ("failed", "timeout", "crash")

MARKS = '''\
"""Byte i of memory that processes share, at an address of its own: line i has been executed."""

import ctypes
import os

ADDRESS, SIZE = 0x2000_0000_0000, 4096
_READ_WRITE, _SHARED, _FIXED, _ANONYMOUS = 3, 1, 16, 32

_library = ctypes.CDLL(None, use_errno=True)
_library.mmap.restype = ctypes.c_void_p
_library.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]
_file = os.open(os.environ["PLANTED_MARKS"], os.O_RDWR) if "PLANTED_MARKS" in os.environ else -1
_found = _library.mmap(ADDRESS, SIZE, _READ_WRITE, _SHARED | _FIXED | (_ANONYMOUS if _file < 0 else 0), _file, 0)
if _found != ADDRESS:
    raise OSError(ctypes.get_errno(), "no memory at the address of the marks")
if _file >= 0:
    os.close(_file)
MARKS = (ctypes.c_ubyte * SIZE).from_address(ADDRESS)


def mark(i):
    MARKS[i] = 1
'''

KERNEL_MARKS = '''\
"""`mark` in kernels."""

from planted_marks import mark as in_python

from .kernel import primitive


@primitive
def mark(i):
    in_python(i)
'''
MARK_IN_C = """
/* A store to a constant address. */
static inline void mark1(int64_t i) {
    ((volatile unsigned char *)(intptr_t)0x200000000000)[i] = 1;
}
"""
MARK_FOR_THE_TRANSLATOR = """
PRIMITIVES["mark"] = ("mark1", NOTHING)
"""

WATCHING = '''\
"""A plugin of pytest: which marks each test sets, itself or by what was made once for it and others."""

import contextlib
import ctypes
import functools
import json
import os
import time
from pathlib import Path

import pytest

WORKER = os.environ.get("PYTEST_XDIST_WORKER", "main")
TREE, OUT = os.environ["PLANTED_TREE"], Path(os.environ["PLANTED_OUT"])
_shared = OUT / f"{WORKER}.marks"
_shared.write_bytes(bytes(4096))
os.environ["PLANTED_MARKS"] = str(_shared)  # child processes find it there

from planted_marks import ADDRESS, MARKS, SIZE

made = {}  # by the name of a wider fixture or of a cached function of the tests: the marks it set
used = set()  # those names in the present test
reports = []


def taken():
    found = {i for i, byte in enumerate(bytes(MARKS)) if byte} if any(bytes(MARKS)) else set()
    ctypes.memset(ADDRESS, 0, SIZE)
    return found


def put(marks):
    for i in marks:
        MARKS[i] = 1


@contextlib.contextmanager
def watched(found):
    before = taken()
    try:
        yield
    finally:
        now = taken()
        found |= now
        put(before | now)


def remembering(function, cached):
    """A cached function that sets the marks of its first call whenever it is called."""
    code = getattr(function, "__code__", None)
    if code is None or not code.co_filename.startswith(TREE):
        return cached
    of_tests = code.co_filename.startswith(TREE + "/tests")
    name, known = f"{function.__module__}.{function.__qualname__}", {}

    @functools.wraps(cached)
    def call(*arguments, **named):
        marks, misses, key = set(), cached.cache_info().misses, functools._make_key(arguments, named, False)
        try:
            with watched(marks):
                return cached(*arguments, **named)
        finally:
            if cached.cache_info().misses > misses:
                known[key] = marks
            put(known.get(key, ()))
            if of_tests:
                used.add(name)
                made.setdefault(name, set()).update(known.get(key, ()))

    call.cache_info, call.cache_clear, call.cache_parameters = (
        cached.cache_info, cached.cache_clear, cached.cache_parameters
    )
    return call


_lru_cache = functools.lru_cache


def lru_cache(maxsize=128, typed=False):
    if callable(maxsize):
        return remembering(maxsize, _lru_cache(maxsize))
    return lambda function: remembering(function, _lru_cache(maxsize, typed)(function))


functools.lru_cache, functools.cache = lru_cache, lru_cache(maxsize=None)


def _name(fixture):
    return f"{fixture.baseid}::{fixture.argname}"


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef, request):
    if fixturedef.scope == "function":
        return (yield)
    with watched(made.setdefault(_name(fixturedef), set())):
        return (yield)


def pytest_runtest_logreport(report):
    reports.append(report)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    taken()
    used.clear()
    reports.clear()
    try:
        return (yield)
    finally:
        marks = taken()
        fixtures = getattr(item, "_fixtureinfo", None)
        for each in fixtures.name2fixturedefs.values() if fixtures else ():
            if each[-1].scope != "function":
                used.add(_name(each[-1]))
        line = {
            "test": item.nodeid, "marks": sorted(marks), "used": sorted(used),
            "seconds": round(sum(each.duration for each in reports), 3),
            "failed": any(each.failed for each in reports),
        }
        with (OUT / f"{WORKER}.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\\n")


def pytest_sessionfinish(session):
    (OUT / f"{WORKER}.made.json").write_text(json.dumps({name: sorted(marks) for name, marks in made.items()}))
'''

CHOOSING = '''\
"""A plugin of pytest: only the tests of a list, in its order; what happens is written to a file at once."""

import json
import os
from pathlib import Path

import pytest

OUT = Path(os.environ["PLANTED_OUT"])
PLACES = {name: i for i, name in enumerate(json.loads(Path(__file__).with_name("chosen.json").read_text()))}


def say(**what):
    with (OUT / "events.jsonl").open("a") as file:
        file.write(json.dumps(what) + "\\n")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    items[:] = sorted((item for item in items if item.nodeid in PLACES), key=lambda item: PLACES[item.nodeid])
    say(event="collected", count=len(items))


def pytest_collectreport(report):
    if report.failed:
        say(event="failed", test=report.nodeid, said=str(report.longrepr)[-300:])


def pytest_runtest_logstart(nodeid):
    say(event="began", test=nodeid)


def pytest_runtest_logreport(report):
    if report.failed:
        crash = getattr(report.longrepr, "reprcrash", None)
        say(event="failed", test=report.nodeid, said=str(crash.message if crash else report.longrepr)[:300])
    if report.when == "teardown":
        say(event="ended", test=report.nodeid)
'''


# -- the faults -------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Fault:
    """A line of a file of the package (its path in there) and what takes its place."""

    number: int
    file: str
    before: str
    after: str
    kind: str

    @property
    def key(self) -> str:
        """It is the same line, wherever it stands in the list."""
        return f"{self.file}: {self.before}"

    @property
    def room(self) -> str:
        """The folder of its file, that of a kernel with the next; a file of no folder by its own name."""
        parts = Path(self.file).with_suffix("").parts
        return " ".join(parts[: 2 if parts[0] == "core" else 1])

    def line(self, tree: Path) -> int | None:
        """Where its line stands in a checkout, from 0; None unless it is there once."""
        path = tree / PACKAGE / self.file
        lines = [line.strip() for line in path.read_text().splitlines()] if path.exists() else []
        return lines.index(self.before) if lines.count(self.before) == 1 else None

    def plant(self, tree: Path) -> None:
        """Change the line."""
        path, at = tree / PACKAGE / self.file, self.line(tree)
        assert at is not None
        lines = path.read_text().splitlines()
        lines[at] = lines[at].replace(self.before, self.after)
        _write_source(path, lines)


def read_faults() -> list[Fault]:
    """All of them, numbered from 1."""
    rows = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())["fault"]
    return [Fault(number, **row) for number, row in enumerate(rows, 1)]


def _write_source(path: Path, lines: Sequence[str]) -> None:
    """Write a source file that must compile; its byte code is forgotten, which a change within a second would keep."""
    source = "\n".join(lines) + "\n"
    compile(source, str(path), "exec")
    path.write_text(source)
    for kept in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        kept.unlink()


def _statement(source: str, line: int) -> int:
    """Where the statement begins that a line (both from 0) belongs to."""
    nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.stmt)]
    return max(node.lineno for node in nodes if node.lineno <= line + 1 <= (node.end_lineno or 0)) - 1


def mark_lines(tree: Path, faults: Sequence[Fault]) -> None:
    """Put a marker before the statement of each fault's line."""
    by_file = defaultdict(list)
    for fault in faults:
        by_file[fault.file].append(fault)
    for name, here in by_file.items():
        path, kernel = tree / PACKAGE / name, name.startswith("core/")
        source = path.read_text()
        lines = source.splitlines()
        at = {_statement(source, fault.line(tree) or 0): fault for fault in here}
        for line in sorted(at, reverse=True):
            indent = lines[line][: len(lines[line]) - len(lines[line].lstrip())]
            how = "" if kernel else "import planted_marks; planted_marks."
            lines.insert(line, f"{indent}{how}mark({at[line].number})")
        if kernel:
            first = next(
                node.lineno - 1 for node in ast.parse(source).body
                if isinstance(node, ast.Import | ast.ImportFrom) and getattr(node, "module", "") != "__future__"
            )  # fmt: skip
            lines.insert(first, "from adaptrack.core.planted_marks import mark")
        _write_source(path, lines)


# -- running tests ----------------------------------------------------------------------------------------------------
class Slot:
    """A place for one copy of the checkout at a time."""

    def __init__(self, checkout: Path, folder: Path) -> None:
        self.checkout, self.folder, self.tree = checkout, folder, folder / "tree"

    def copy(self) -> None:
        """The checkout as it is, without what git ignores."""
        shutil.rmtree(self.tree, ignore_errors=True)
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=self.checkout, capture_output=True, text=True, check=True,
        ).stdout  # fmt: skip
        for name in filter(None, listed.split("\0")):
            if (self.checkout / name).is_file():
                (self.tree / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(self.checkout / name, self.tree / name)
        if (self.checkout / BUILT).is_dir():
            shutil.copytree(self.checkout / BUILT, self.tree / BUILT)

    def compile(self, environment: Mapping[str, str]) -> None:
        """Make the library of the copy's kernels, unless that of the checkout is theirs."""
        done = subprocess.run(
            [sys.executable, "-m", "adaptrack.core.build"], cwd=self.tree, env=environment, capture_output=True,
            text=True,
        )  # fmt: skip
        if done.returncode != 0:
            raise SystemExit(f"the kernels of {self.tree} cannot be compiled:\n{done.stderr}")

    def start(self, plugin: str, source: str, *arguments: str, chosen: Sequence[str] = ()) -> subprocess.Popen[bytes]:
        """Start pytest in the copy, with a plugin and the tests chosen for it; `out` is emptied for what it writes."""
        plugins, out = self.folder / "plugins", self.out
        for each in (plugins, out):
            shutil.rmtree(each, ignore_errors=True)
            each.mkdir(parents=True)
        (plugins / f"{plugin}.py").write_text(source)
        (plugins / "planted_marks.py").write_text(MARKS)
        (plugins / "chosen.json").write_text(json.dumps(chosen))
        environment = {
            **os.environ, "PYTHONPATH": os.pathsep.join([str(self.tree / "src"), str(plugins)]),
            "PLANTED_TREE": str(self.tree), "PLANTED_OUT": str(out),
        }  # fmt: skip
        environment.pop("PLANTED_MARKS", None)
        self.compile(environment)
        command = [sys.executable, "-P", "-m", "pytest", "-q", "-p", plugin, "-p", "no:cacheprovider", *arguments]
        with (self.folder / "pytest.log").open("wb") as log:
            process = subprocess.Popen(
                command, cwd=self.tree, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                start_new_session=True,
            )  # fmt: skip
        resource.prlimit(process.pid, resource.RLIMIT_DATA, (MOST_MEMORY, MOST_MEMORY))
        return process

    @property
    def out(self) -> Path:
        """Where plugins write."""
        return self.folder / "out"


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process and what it has started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    """The complete lines of a file of JSON lines."""
    text = path.read_text() if path.exists() else ""
    for line in text[: text.rfind("\n") + 1].splitlines():
        yield json.loads(line)


def _write(path: Path, content: Any) -> None:
    path.with_suffix(".new").write_text(json.dumps(content, indent=1, ensure_ascii=False))
    path.with_suffix(".new").replace(path)


# -- which tests execute a line ---------------------------------------------------------------------------------------
def tests_of(slot: Slot, faults: Sequence[Fault], processes: int) -> dict[str, Any]:
    """By fault the default tests that execute its line; seconds of all tests; those that failed with the markers."""
    slot.copy()
    mark_lines(slot.tree, faults)
    (slot.tree / PACKAGE / "core/planted_marks.py").write_text(KERNEL_MARKS)
    head = slot.tree / PACKAGE / "core/build/head.h"
    before, end, after = head.read_text().rpartition("#endif")
    head.write_text(before + MARK_IN_C + end + after)
    with (slot.tree / PACKAGE / "core/build/translate.py").open("a") as translator:
        translator.write(MARK_FOR_THE_TRANSLATOR)
    begun = time.monotonic()
    process = slot.start("planted_watching", WATCHING, "-n", str(processes), "--dist", "worksteal")
    try:
        code = process.wait()
    finally:
        _end(process)
    if code not in (0, 1):
        raise SystemExit(f"the marked tests ended with {code}: see {slot.folder / 'pytest.log'}")
    made: dict[str, set[int]] = defaultdict(set)
    for path in slot.out.glob("*.made.json"):
        for name, marks in json.loads(path.read_text()).items():
            made[name] |= set(marks)
    rows = [row for path in sorted(slot.out.glob("*.jsonl")) for row in _lines(path)]
    by_fault: dict[int, list[str]] = defaultdict(list)
    for row in rows:
        for number in set(row["marks"]).union(*(made[name] for name in row["used"])):
            by_fault[number].append(row["test"])
    return {
        "wall seconds": round(time.monotonic() - begun),
        "failed": sorted(row["test"] for row in rows if row["failed"]),
        "seconds": {row["test"]: row["seconds"] for row in rows},
        "tests": {fault.key: by_fault[fault.number] for fault in faults},
    }


def with_tests_of(slot: Slot, faults: Sequence[Fault], file: Path, processes: int) -> dict[str, Any]:
    """What `tests_of` says of all faults, from a file as far as it is there."""
    known = json.loads(file.read_text()) if file.exists() else {"tests": {}, "seconds": {}, "failed": []}
    missing = [fault for fault in faults if fault.key not in known["tests"]]
    if missing:
        print(f"running the default tests with {len(missing)} marked lines: see {slot.folder / 'pytest.log'}")
        new = tests_of(slot, missing, processes)
        known = {
            **new, "failed": sorted({*known["failed"], *new["failed"]}),
            "seconds": known["seconds"] | new["seconds"], "tests": known["tests"] | new["tests"],
        }  # fmt: skip
        _write(file, known)
    return known


# -- does a test find a fault? ----------------------------------------------------------------------------------------
class Outcome(NamedTuple):
    """How a run of chosen tests ended: "passed", one of `FOUND` or "nothing ran"; at which test, and what it said."""

    verdict: str
    test: str | None
    said: str
    passed: list[str]


class Interrupted(Exception):
    """The whole script is to end."""


def run_chosen(
    slot: Slot, tests: Sequence[str], seconds: Mapping[str, float], limit: float, stop: threading.Event
) -> Outcome:
    """Run tests in the slot's copy up to the first that fails or takes `limit` (s) longer than it took."""
    files = list(dict.fromkeys(test.split("::")[0] for test in tests))
    process = slot.start("planted_choosing", CHOOSING, "-x", *files, chosen=tests)
    at, since, seen, events = None, time.monotonic(), 0, []
    try:
        while process.poll() is None:
            if stop.wait(0.3):
                raise Interrupted
            events = list(_lines(slot.out / "events.jsonl"))
            if len(events) > seen:
                seen, since = len(events), time.monotonic()
                at = events[-1]["test"] if events[-1]["event"] == "began" else None
            if time.monotonic() - since > limit + seconds.get(at or "", 0.0):
                return Outcome("timeout", at, f"no end within {limit:g} s more than before", _passed(events))
    finally:
        _end(process)
    return _outcome(process.returncode, list(_lines(slot.out / "events.jsonl")))


def _passed(events: Sequence[Mapping[str, Any]]) -> list[str]:
    failed = {event["test"] for event in events if event["event"] == "failed"}
    return [event["test"] for event in events if event["event"] == "ended" and event["test"] not in failed]


def _outcome(code: int, events: Sequence[Mapping[str, Any]]) -> Outcome:
    passed = _passed(events)
    for event in events:
        if event["event"] == "failed":
            return Outcome("failed", event["test"], event["said"], passed)
    if code == 0:
        return Outcome("passed", None, "", passed)
    if code == 5:
        return Outcome("nothing ran", None, "none of the tests is there", passed)
    began = [event["test"] for event in events if event["event"] == "began"]
    return Outcome("crash", began[-1] if began else None, f"pytest ended with {code}", passed)


def in_order(tests: Sequence[str], seconds: Mapping[str, float]) -> list[str]:
    """The tests by file, since they share what is made once for a file, the file that takes least time first."""
    total: Counter[str] = Counter()
    for test in tests:
        total[test.split("::")[0]] += seconds.get(test, 0.0)  # type: ignore[assignment]
    return sorted(tests, key=lambda test: (total[test.split("::")[0]], test.split("::")[0]))


def judge(fault: Fault, slot: Slot, known: Mapping[str, Any], limit: float, stop: threading.Event) -> dict[str, Any]:
    """Plant a fault and run the tests that execute its line. A test counts that passes without the fault."""
    seconds, failed = known["seconds"], set(known["failed"])
    tests = in_order([test for test in known["tests"][fault.key] if test not in failed], seconds)
    about = {"number": fault.number, "room": fault.room, "kind": fault.kind, "after": fault.after, "tests": len(tests)}
    begun, unsure = time.monotonic(), []
    while tests:
        slot.copy()
        fault.plant(slot.tree)
        outcome = run_chosen(slot, tests, seconds, limit, stop)
        if outcome.verdict not in FOUND:
            break
        about |= {"test": outcome.test, "said": outcome.said}
        if outcome.test is None or "::" not in outcome.test:  # it does not import, or ends before the first test
            return {**about, "verdict": outcome.verdict, "seconds": round(time.monotonic() - begun), "unsure": unsure}
        slot.copy()
        if run_chosen(slot, [outcome.test], seconds, limit, stop).verdict == "passed":
            return {**about, "verdict": outcome.verdict, "seconds": round(time.monotonic() - begun), "unsure": unsure}
        unsure.append(outcome.test)
        tests = [test for test in tests if test != outcome.test and test not in outcome.passed]
    verdict = "not found" if about["tests"] else "no test executes it"
    spent = round(time.monotonic() - begun)
    return {**about, "test": None, "said": "", "verdict": verdict, "seconds": spent, "unsure": unsure}


def judge_all(
    faults: Sequence[Fault], slots: Sequence[Slot], known: Mapping[str, Any], file: Path, limit: float
) -> dict[str, Any]:
    """The verdicts on faults by their keys; what is in the file is not tried again."""
    found: dict[str, Any] = json.loads(file.read_text()) if file.exists() else {}
    waiting = [fault for fault in faults if found.get(fault.key, {}).get("after") != fault.after]
    free: queue.Queue[Slot] = queue.Queue()
    for slot in slots:
        free.put(slot)
    stop, lock = threading.Event(), threading.Lock()

    def one(fault: Fault) -> None:
        if stop.is_set():
            return
        slot = free.get()
        try:
            verdict = judge(fault, slot, known, limit, stop)
        finally:
            free.put(slot)
        with lock:
            found[fault.key] = verdict
            _write(file, found)
            print(f"{fault.number:2d} {fault.file}: {verdict['verdict']} ({verdict['seconds']} s, of "
                  f"{verdict['tests']} tests) {verdict['test'] or ''}", flush=True)  # fmt: skip

    with ThreadPoolExecutor(len(slots)) as pool:
        try:
            for done in [pool.submit(one, fault) for fault in waiting]:
                done.result()
        except BaseException:
            stop.set()
            raise
    return found


# -- the table --------------------------------------------------------------------------------------------------------
def table(faults: Sequence[Fault], *sides: Mapping[str, Any]) -> str:
    """Faults and how many were found, by room and in all; then each fault."""
    rooms: dict[str, list[Fault]] = defaultdict(list)
    for fault in faults:
        rooms[fault.room].append(fault)

    def found(here: Sequence[Fault], side: Mapping[str, Any]) -> int:
        return sum(side.get(fault.key, {}).get("verdict") in FOUND for fault in here)

    lines = [f"{'room':28s} faults" + "  found" * len(sides)]
    for room, here in [*rooms.items(), ("all", list(faults))]:
        lines.append(f"{room:28s} {len(here):6d}" + "".join(f"{found(here, side):7d}" for side in sides))
    lines.append("")
    for fault in faults:
        lines.append(f"{fault.number:2d} {fault.file}: {fault.kind}")
        for side in sides:
            it = side.get(fault.key, {"verdict": "not tried", "tests": 0, "test": None})
            lines.append(f"   {it['verdict']}, {it['tests']} tests{': ' + it['test'] if it['test'] else ''}")
    return "\n".join(lines)


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder of results, copies")
    parser.add_argument("--only", type=int, nargs="+", metavar="N", help="numbers of faults")
    parser.add_argument("--against", type=Path, help="found.json of another checkout, for the table")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--limit", type=float, default=600.0, help="s that a test may take longer than it took")
    options = parser.parse_args()
    for each in (signal.SIGINT, signal.SIGTERM):  # the first would stay ignored in the background, in tests too
        signal.signal(each, signal.default_int_handler)
    checkout, out = options.checkout.resolve(), options.out.resolve()
    chosen = [fault for fault in read_faults() if not options.only or fault.number in options.only]
    faults = [fault for fault in chosen if fault.line(checkout) is not None]
    for fault in chosen:
        if fault not in faults:
            print(f"{fault.number:2d} {fault.file}: the line is not there once: {fault.before}")
    slots = [Slot(checkout, out / f"slot-{i}") for i in range(options.processes)]
    for slot in slots:
        slot.folder.mkdir(parents=True, exist_ok=True)
    known = with_tests_of(slots[0], faults, out / "tests.json", options.processes)
    found = judge_all(faults, slots, known, out / "found.json", options.limit)
    others = [json.loads(options.against.read_text())] if options.against else []
    print(table(chosen, found, *others))


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        raise SystemExit("Interrupted; the same command goes on.") from None
