"""Attacks on whole commands: hostile files, disks, signals and processes.

An attack yields the faults of its trials; "" is a trial in which everything holds that must hold. A command may refuse
with a sentence, and nothing else: a traceback or a strange exit code is "crashed", the timeout is "hung", and a file
that is not whole, or a result with different bits, is "wrong".
"""

from __future__ import annotations

import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

Faults = Iterator[str]
TIMEOUT = 300.0
"""s, after which a command counts as hung."""
MEMORY = 6 << 30
"""Bytes of address space of a command: a bomb ends the command, not the machine."""
REFUSED = 2
ANSWERS = (0, 1, REFUSED, 3)
"""Exit codes of a command that was not interrupted."""


class Ended(NamedTuple):
    """How a command ended; code: None after `TIMEOUT`."""

    code: int | None
    output: str
    errors: str

    def fault(self, codes: tuple[int, ...] = ANSWERS) -> str:
        """What does not hold of it."""
        last = (self.errors.strip() or "nothing on standard error").splitlines()[-1][-200:]
        if self.code is None:
            return f"hung: {last}"
        crashed = self.code not in codes or ("Traceback" in self.errors and "/adaptrack/" in self.errors)
        return f"crashed: exit code {self.code}: {last}" if crashed else ""


def adaptrack(*words: object) -> list[str]:
    """A command line of ours."""
    return [sys.executable, "-m", "adaptrack", *map(str, words)]


def _prepare_child() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # also where a shell's background jobs ignore it
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def execute(command: list[str], folder: Path, stop: signal.Signals | None = None, after: float = 0.0) -> Ended:
    """Run a command in a folder; stop: the signal that it gets after some seconds."""
    process = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace",
        stdin=subprocess.DEVNULL, start_new_session=True, preexec_fn=_prepare_child,
    )  # fmt: skip
    try:
        if stop is not None:
            try:
                process.wait(after)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, stop)
        output, errors = process.communicate(timeout=TIMEOUT)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        output, errors = process.communicate()
        return Ended(None, output, errors)
    return Ended(process.returncode, output, errors)


# -- hostile files ----------------------------------------------------------------------------------------------------
def _give_files(folder: Path, files: Iterator[Path], *commands: tuple[str, ...]) -> Faults:
    """Commands, each with every file as its last argument."""
    for file in files:
        for command in commands:
            fault = execute(adaptrack(*command, file.name), folder).fault()
            yield fault and f"{fault} ({command[0]} {file.name})"


def _write_logs(folder: Path) -> Iterator[Path]:
    """Logs that are bombs, damaged, or tables of something else."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = ("time", "x", "y", "yaw", "speed", "yaw_rate", "command")

    def parquet(name: str, columns: dict[str, pa.Array], repetitions: int = 1) -> Path:
        table = pa.table(columns)
        with pq.ParquetWriter(folder / name, table.schema, compression="zstd") as writer:
            for _ in range(repetitions):
                writer.write_table(table)
        return folder / name

    constant = pa.array([1.0]).take(pa.array([0] * 1_000_000))
    yield parquet("rows.parquet", dict.fromkeys(names, constant), 200)  # 11 GB in memory, 100 kB on the disk
    yield parquet("columns.parquet", {f"c{i}": pa.array([1.0, 2.0]) for i in range(20_000)})
    yield parquet("texts.parquet", {name: pa.array(["a" * 1_000_000] * 50) for name in names})
    yield parquet("lists.parquet", {name: pa.array([[1.0], [2.0, None], None]) for name in names})
    yield parquet("missing.parquet", {name: pa.nulls(50) for name in names})
    yield parquet("empty.parquet", {name: pa.array([], pa.float64()) for name in names})
    whole = parquet("whole.parquet", {name: pa.array([0.1 * i for i in range(300)]) for name in names}).read_bytes()
    for cut in (4, 100, len(whole) // 2, len(whole) - 4):
        (folder / f"cut-{cut}.parquet").write_bytes(whole[:cut])
        yield folder / f"cut-{cut}.parquet"
    header = ",".join(names) + "\n"
    texts = {
        "nothing.csv": "", "names.csv": header, "one.csv": header + "0,0,0,0,0,0,0\n", "zeros.csv": "\0" * 5000,
        "same.csv": header + "1,1,1,1,1,1,1\n" * 500, "nan.csv": header + "nan,inf,-inf,1e999,,x,NaN\n" * 500,
        "wide.csv": header + "1," * 200_000 + "\n", "long.csv": header + "7" * 20_000_000 + "\n",
        "twice.csv": "time,time,x,x,y\n" + "1,2,3,4,5\n" * 300, "backwards.csv": header + "".join(
            f"{-i},{i},0,0,10,0,0\n" for i in range(400)),
        "huge.csv": header + "".join(f"{i * 0.05},{1e300 * (-1) ** i},1e308,1e9,1e200,1e99,1e50\n" for i in range(400)),
        "words.csv": header + "a,b,c,d,e,f,g\n" * 400, "binary.csv": header + "\x01\x02\x7f\x1b[31m" * 1000,
    }  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text)
        yield folder / name


def attack_logs(folder: Path, rng: random.Random) -> Faults:
    """Parquet bombs, damaged and foreign tables as logs of `check-loop`, `shadow` and `identify`."""
    shadow, identify = ("shadow", "--vehicle", "midsize-sedan"), ("identify", "--car", "midsize-sedan")
    return _give_files(folder, _write_logs(folder), ("check-loop",), shadow, identify)


_XODR = """<?xml version="1.0"?>{doctype}
<OpenDRIVE><road id="1" length="100" junction="-1"><planView>{plan}</planView>
<lanes><laneSection s="0"><right><lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
</right></laneSection></lanes>{more}</road></OpenDRIVE>"""
_LINE = '<geometry s="{s}" x="{s}" y="0" hdg="0" length="{length}"><line/></geometry>'


def _write_roads(folder: Path) -> Iterator[Path]:
    """Roads in OpenDRIVE and CommonRoad's XML that grow, nest, or name what lies elsewhere."""
    entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12))
    doctypes = {
        "laughs": f'<!DOCTYPE OpenDRIVE [<!ENTITY e0 "lol">{entities}]>',
        "quadratic": f'<!DOCTYPE OpenDRIVE [<!ENTITY e11 "{"a" * 100_000}">]>',
        "elsewhere": '<!DOCTYPE OpenDRIVE [<!ENTITY e11 SYSTEM "file:///etc/passwd">]>',
    }
    line = _LINE.format(s=0, length=100)
    cases = {name: _XODR.format(doctype=text, plan=line, more="<userData>" + "&e11;" * 2_000 + "</userData>")
             for name, text in doctypes.items()}  # fmt: skip
    cases["attribute"] = _XODR.format(doctype=doctypes["laughs"], plan=line, more='<userData code="&e11;"/>')
    cases["nested"] = _XODR.format(doctype="", plan=line, more="<a>" * 200_000 + "</a>" * 200_000)
    cases["pieces"] = _XODR.format(
        doctype="", plan="".join(_LINE.format(s=i, length=1) for i in range(100_000)), more=""
    )
    cases["endless"] = _XODR.format(doctype="", plan=_LINE.format(s=0, length=1e308), more="")
    cases["far"] = _XODR.format(doctype="", plan=_LINE.format(s=0, length=5e8), more="").replace('"100"', '"5e8"')
    cases["torn"] = cases["pieces"][:100_000]
    for name, text in cases.items():
        for ending, tag in ((".xodr", "OpenDRIVE"), (".xml", "commonRoad")):
            file = folder / f"{name}{ending}"
            file.write_text(text.replace("OpenDRIVE", tag))
            yield file


def attack_roads(folder: Path, rng: random.Random) -> Faults:
    """XML bombs and endless roads for `road check` and `drive`."""
    return _give_files(folder, _write_roads(folder), ("road", "check"), ("drive", "--out", "out"))


# -- disks ------------------------------------------------------------------------------------------------------------
_TUNE = ("tune", "town", "--controller", "stanley", "--runs", 100, "--length", 200, "--noise-seeds", 1, "--speed", 8)
_CAMPAIGN = """
vehicle = "paper"\nplant = "dual-track"\ntyre = "magic-formula"\nprofile = "paper"\ncontroller = "as-written"
scenario = "step"\nduration = 4.0\nseed = 1\nchunk = 3
[operating_points]
kind = "grid"\nspeed = [8.0, 15.0, 25.0]\ny_ref = [-2.0, 1.0, 3.0]\nfriction = [0.6, 0.9]\nwind = [-5.0, 5.0]
[failure]\ndistance = 1000.0\nsideslip = inf
[swarm]\nparticles = 10\ngenerations = 12
[library]\nsize = 16\nseed = 1
"""
_WRITERS: dict[str, tuple[object, ...]] = {
    "tune": (*_TUNE, "--out", "disk/tuning.toml"),
    "campaign": ("campaign", "small.toml", "--out", "disk/campaign", "--workers", 1),
    "drive": ("drive", "town", "--length", 200, "--out", "disk/drive"),
    "simulate": ("simulate", "lane-change", "--out", "disk/run"),
    "car": ("car", "--mass", 1450, "--wheelbase", 2.65, "--out", "disk/car.toml"),
    "export c": ("export", "c", "--vehicle", "midsize-sedan", "--out", "disk/c"),
}
"""Commands that write below `disk`."""
_ON_DISK = 'mount -t tmpfs -o "$0" none disk && shift 0 && "$@"; code=$?; find disk -name "*.tmp" >&2; exit $code'


def attack_disks(folder: Path, rng: random.Random) -> Faults:
    """Disks that are full, nearly full or read-only: commands refuse, and no temporary file stays."""
    (folder / "disk").mkdir()
    (folder / "small.toml").write_text(_CAMPAIGN)
    mounted = ["unshare", "--mount", "sh", "-c", _ON_DISK]
    if execute([*mounted, "size=4k", "true"], folder).code != 0:
        print("attack_disks: not run, as this user may not mount a tmpfs", file=sys.stderr)
        return
    for name, words in _WRITERS.items():
        for options in ("size=4k", "size=32k", "size=1m,nr_inodes=3", "size=1m,ro"):
            ended = execute([*mounted, options, *adaptrack(*words)], folder)
            fault = ended.fault((REFUSED,) if "ro" in options.split(",") else ANSWERS)
            if not fault and ".tmp" in ended.errors:
                fault = "wrong: a temporary file stays"
            yield fault and f"{fault} ({name}, {options})"


# -- signals and processes --------------------------------------------------------------------------------------------
def attack_ctrl_c(folder: Path, rng: random.Random) -> Faults:
    """Ctrl-C at random times: exit code 130 without a traceback, or the command had ended; no temporary file stays."""
    (folder / "disk").mkdir()
    (folder / "small.toml").write_text(_CAMPAIGN)
    for name, words in _WRITERS.items():
        begun = time.monotonic()
        execute(adaptrack(*words), folder)
        whole = time.monotonic() - begun
        for _ in range(5):
            shutil.rmtree(folder / "disk")
            (folder / "disk").mkdir()
            ended = execute(adaptrack(*words), folder, signal.SIGINT, rng.uniform(0.0, whole))
            starting = "/adaptrack/" not in ended.errors  # Python itself is interrupted before a line of ours has run
            fault = ended.fault((*ANSWERS, 130, *((1, -signal.SIGINT) if starting else ())))
            if not fault and any((folder / "disk").rglob("*.tmp")):
                fault = "wrong: a temporary file stays"
            yield fault and f"{fault} ({name})"


def attack_killed_campaign(folder: Path, rng: random.Random) -> Faults:
    """`campaign`, killed again and again and resumed: the data set has the bits of one that was left alone."""
    (folder / "small.toml").write_text(_CAMPAIGN)
    begun = time.monotonic()
    execute(adaptrack("campaign", "small.toml", "--out", "whole", "--workers", 1), folder)
    whole, expected = time.monotonic() - begun, (folder / "whole" / "dataset.parquet").read_bytes()
    words = adaptrack("campaign", "small.toml", "--out", "killed", "--workers", 2, "--resume")
    for _ in range(20):
        execute(words, folder, signal.SIGKILL, rng.uniform(0.3, 1.0) * whole)
        dataset = folder / "killed" / "dataset.parquet"
        if dataset.exists() or rng.random() < 0.2:
            fault = execute(words, folder).fault((0,))
            yield fault or ("" if dataset.read_bytes() == expected else "wrong: other bits")
            shutil.rmtree(folder / "killed")
        else:
            yield ""


ATTACKS: dict[str, Callable[[Path, random.Random], Faults]] = {
    name.removeprefix("attack_").replace("_", "-"): function
    for name, function in list(globals().items())
    if re.match("attack_", name)
}
"""Every attack by its name on the command line."""


def attack(names: list[str], seed: int) -> dict[str, list[str]]:
    """The faults of attacks by name, printed as they come; with the count of trials in front."""
    faults: dict[str, list[str]] = {}
    for name in names or ATTACKS:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            trials = []
            for fault in ATTACKS[name](Path(folder), random.Random(f"{seed} {name}")):
                trials.append(fault)
                if fault:
                    print(f"{name}: {fault}", flush=True)
        faults[name] = [fault for fault in trials if fault]
        counts = ", ".join(f"{sum(f.startswith(kind) for f in trials)} {kind}" for kind in ("wrong", "crashed", "hung"))
        print(f"{len(trials):6,} trials of {name}: {counts}", flush=True)
    return faults
