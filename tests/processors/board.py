"""Exported trackers on microcontrollers that QEMU emulates: the same bits, code, memory, stack, counted instructions.

``python -m processors.board`` in ``tests`` prints the numbers of docs/install.md.
"""

import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adaptrack import MPC, DualTrack, Learning, SpeedControl, load_road, load_vehicle, plan_speed, published_mpc
from adaptrack.control.qp import ActiveSet
from adaptrack.core.controllers.mpc import MPC_ANSWER
from adaptrack.core.tracker.signals import TRACKER_SAMPLE as CALL
from adaptrack.export.c_library import export_c
from adaptrack.export.kernel_sources import EXACT_OPTIONS
from adaptrack.export.recorded_drive import record_drive
from adaptrack.export.tracking import speed_part
from adaptrack.scenario.profile import load_profile
from programs import try_program

HERE = Path(__file__).parent
TOOLS = ("arm-none-eabi-gcc", "qemu-system-arm", "gcc")
WORDS, FLOATS = 16, 9
"""of an answer, of which the first ones are floats"""
CONSTANTS = ("adaptrack_constants", "CONSTANTS")
HEADERS = {
    "math.h": '#define NAN __builtin_nanf("")\n#define HUGE_VAL __builtin_huge_val()\n',
    "string.h": "#include <stddef.h>\nvoid *memcpy(void *, const void *, size_t);\n",
}
"""What the sources take of C's library, which is not there."""


@dataclass(frozen=True)
class Board:
    """A board of QEMU's: compiler options, and addresses of code, of RAM, of the samples and of a timer."""

    machine: str
    options: tuple[str, ...]
    code: int
    ram: int
    samples: int
    timer: int


BOARDS = {
    "cortex-m7": Board(
        "mps2-an500", ("-mcpu=cortex-m7", "-mfpu=fpv5-d16", "-mfloat-abi=hard"), 0, 0x20000000, 0x60000000, 0x40000000
    ),
    "cortex-m33": Board(
        "mps2-an505", ("-mcpu=cortex-m33+nofp", "-mfloat-abi=soft"), 0x10000000, 0x38200000, 0x80000000, 0x50000000
    ),
}


def missing(tools=TOOLS):
    """The first of what it takes that is not there; None: nothing."""
    return next(filter(None, (try_program(tool)[1] for tool in tools)), None)


@dataclass(frozen=True)
class Ran:
    """What a run on a board gave."""

    differ: int
    """calls whose answers are not those of this processor, any NaN being one"""
    instructions: np.ndarray
    """of each call"""
    iterations: np.ndarray
    """of the QP in its last step"""
    once: tuple[int, int, int]
    """instructions of init, path, follow"""
    stack: int
    """bytes"""
    code: int
    """bytes in flash without the constants and what the program itself has"""
    constants: int
    memory: int
    path: int


class Program:
    """An export of a controller with samples, and the program that drives it.

    samples: (calls, numbers of a sample, or the first of them); way: road and plan.
    """

    def __init__(self, controller, samples, way, folder, speed=None):
        self.folder, self.count = folder, len(samples)
        self.made = export_c(controller, folder / "made", road=way[0], plan=way[1], speed=speed)
        samples = np.asarray(samples)
        rows = np.full((self.count, len(CALL)), np.nan)
        rows[:, : samples.shape[1]] = samples
        np.concatenate([np.array([self.count], np.int64), rows.ravel().view(np.int64)]).tofile(folder / "samples")
        answer = f"controller_mpc_answer[{MPC_ANSWER.qp_iterations}]"
        plans = [f"-DQP_ITERATIONS={answer}"] if controller.has_horizons else []
        self.given = ["-std=gnu11", *EXACT_OPTIONS, "-ffunction-sections", "-fdata-sections", *plans,
                      *[f"-I{self.made.folder}/{folder}" for folder in (".", "include", "src")], str(HERE / "board.c"),
                      *map(str, sorted((self.made.folder / "src").glob("*.c")))]  # fmt: skip

    def here(self, compiler="gcc", under=()):
        """Drive on this machine, under another program where one is given: answers (calls, WORDS)."""
        _do([compiler, "-g", "-O1", *self.given, "-DHOST", "-o", "here.exe"], self.folder)
        _do([*under, str(self.folder / "here.exe"), "samples", "told"], self.folder)
        return np.fromfile(self.folder / "told", np.int64).reshape(-1, WORDS)

    def on(self, target):
        """Drive on a board and here.

        Raises
        ------
        RuntimeError
            When it does not end well.
        """
        expected, board, folder = self.here(), BOARDS[target], self.folder
        for name, text in HEADERS.items():
            (folder / name).write_text(text)
        _do(["arm-none-eabi-gcc", *board.options, "-Os", *self.given, f"-I{folder}", "-ffreestanding", "-nostdlib",
             "-fno-tree-loop-distribute-patterns", f"-DTIMER={board.timer:#x}", f"-DSAMPLES={board.samples:#x}",
             f"-DANSWERS={board.samples + (1 << 23):#x}", "-lgcc",
             f"-Wl,--gc-sections,--defsym=CODE={board.code:#x},--defsym=RAM={board.ram:#x},-T,{HERE / 'board.ld'}",
             "-Wl,-Map=map", "-o", "program"], folder)  # fmt: skip
        _do(["qemu-system-arm", "-machine", board.machine, "-nographic", "-monitor", "none", "-serial", "none",
             "-icount", "shift=6", "-semihosting-config", "enable=on,target=native", "-kernel", "program",
             "-device", f"loader,file=samples,addr={board.samples:#x},force-raw=on"], folder)  # fmt: skip
        answers = np.fromfile(folder / "answers", np.int64).reshape(-1, WORDS)
        counts = np.fromfile(folder / "counts", np.int64)
        calls = counts[: 2 * self.count].reshape(self.count, 2)
        instructions, once = ((column * 5 + 4) // 8 for column in (calls[:, 0], counts[-4:-1]))
        return Ran(
            differing(expected, answers), instructions, calls[:, 1].copy().view(float), tuple(once.tolist()),
            int(counts[-1]), _code(folder / "program"), self.made.constants_size, self.made.memory_size,
            _sizes(folder / "program")["path"],
        )  # fmt: skip


def differing(first, there):
    """How many answers differ."""
    if first.shape != there.shape:
        raise RuntimeError(f"{len(there)} answers of {len(first)}")
    numbers = first[:, :FLOATS].copy().view(float), there[:, :FLOATS].copy().view(float)
    unlike = first != there
    unlike[:, :FLOATS] &= ~(np.isnan(numbers[0]) & np.isnan(numbers[1]))
    return int(unlike.any(axis=1).sum())


def _sizes(program):
    """Bytes of the symbols of a program."""
    symbols = subprocess.run(
        ["arm-none-eabi-nm", "-S", str(program)], capture_output=True, text=True, check=True
    ).stdout
    rows = [row.split() for row in symbols.splitlines()]
    return {row[3]: int(row[1], 16) for row in rows if len(row) == 4}


def _code(program):
    """Bytes in flash without the tracker's constants and the recorded path."""
    listing = subprocess.run(
        ["arm-none-eabi-size", "-A", str(program)], capture_output=True, text=True, check=True
    ).stdout
    sections = {row.split()[0]: int(row.split()[1]) for row in listing.splitlines() if row.startswith(".")}
    data = sum(size for name, size in _sizes(program).items() if name.startswith(("adaptrack_recorded", *CONSTANTS)))
    return sum(sections.get(section, 0) for section in (".text", ".rodata", ".exidx")) - data


def _do(command, folder):
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=1200)
    if process.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {process.returncode}: {process.stderr}")


def driven(controller, road, plan, vehicle, rng, disturbed, speed=None):
    """10,560 calls of one period: 22 drives of the recorded path, measured ever worse where they are to be disturbed.

    speed: the speed control of the drives, which then have a stop and hills.
    """
    step = controller.period / 0.05
    pilot = MPC(vehicle, profile="road", learning=None) if speed is None else controller
    part = None if speed is None else speed_part(speed, controller, plan)
    record = record_drive(pilot, DualTrack(vehicle), road, plan, load_profile("road"), speed=part)
    rows, begun = [], 0.0
    for wild in np.linspace(0.0, 3.0, 22):
        calls = record.samples[: record.driven_calls : max(1, round(step))].copy()
        calls[:, CALL.motion_time] = np.nan
        calls[:, :2] += begun
        begun += calls[-1, 1] - calls[0, 1] + 10.0
        if disturbed:
            for columns, part in ((slice(2, 4), 1.0), (slice(4, 5), 0.1), (slice(6, 7), 0.3)):
                calls[:, columns] += rng.normal(size=calls[:, columns].shape) * wild * part
            calls[:, 5] *= 1.0 + 0.3 * np.sin(np.arange(len(calls)) / 9.0)
        rows.append(calls)
    return np.concatenate(rows)


def main():
    """Print what an informed, a learning and the paper's MPC take on a Cortex-M7."""
    vehicle, road = load_vehicle("midsize-sedan"), load_road("country")
    plan = plan_speed(road, vehicle)
    controllers = {
        "informed": MPC(vehicle, profile="road", learning=None),
        "informed, speed control": MPC(vehicle, profile="road", learning=None),
        "informed, 8 changes at most": MPC(vehicle, profile="road", learning=None, solver=ActiveSet(8)),
        "learning": MPC(vehicle, profile="road", learning=Learning()),
        "learning, speed control": MPC(vehicle, profile="road", learning=Learning()),
        "paper": published_mpc(vehicle),
    }
    for name, controller in controllers.items():
        speed = SpeedControl(vehicle, (0.6, 0.9)) if "speed control" in name else None
        for disturbed in (False, True):
            calls = driven(controller, road, plan, vehicle, np.random.default_rng(0), disturbed, speed)
            with tempfile.TemporaryDirectory() as folder:
                built_program = Program(controller, calls, (road, plan), Path(folder), speed)
                ran = built_program.on("cortex-m7")
            is_many = ran.iterations >= 3
            slope = (
                np.polyfit(ran.iterations[is_many], ran.instructions[is_many], 1)[0] if is_many.sum() > 99 else np.nan
            )
            print(
                f"{name}, {'disturbed' if disturbed else 'as measured'}: {ran.differ} of {len(calls)} differ; "
                f"instructions {ran.instructions.mean():.0f}, p99 {np.percentile(ran.instructions, 99):.0f}, worst "
                f"{ran.instructions.max()}; changes {ran.iterations.max():.0f}, each {slope:.0f}; code {ran.code}, "
                f"constants {ran.constants}, memory {ran.memory}, stack {ran.stack}, path {ran.path}; instructions of "
                f"init, path, follow: {ran.once}"
            )


if __name__ == "__main__":
    main()
