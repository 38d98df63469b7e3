"""Many runs at once, compiled and vectorised."""

from __future__ import annotations

import math
import os
import queue
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import Hint, checked
from adaptrack.base.errors import InvalidInput, MissingExtra
from adaptrack.cars.plant import DualTrack, Plant, SingleTrack
from adaptrack.control.controllers import MPC, CompiledController, CompiledScheduler, Controller
from adaptrack.control.speed_control import SpeedControl
from adaptrack.core import guard as guard_kernel
from adaptrack.core import period as period_kernel
from adaptrack.core import rollout
from adaptrack.core.controllers import mpc as kernel
from adaptrack.core.kernel import Resident
from adaptrack.core.plants.contract import SLOTS, vehicle_batch
from adaptrack.core.schedule import no_schedule
from adaptrack.drive.failure import Failure
from adaptrack.drive.world import Driver, KnownAs, World, reason_of
from adaptrack.road.road_ahead import pack_roads
from adaptrack.scenario import RoadDrive, Scenario, Signals
from adaptrack.scenario.profile import Profile

Array = NDArray[np.float64]
BatchPlant = Annotated[Plant, Hint("simulate(...) drives a stepped one")]


@dataclass(frozen=True, eq=False)
class BatchResult:
    """Measures of `rollout_batch`, one entry per run; arrays of shape (runs,)."""

    mse: Array
    """m^2, mean over the control instants of (Y - y_ref)^2; inf when the run has failed"""
    mean_squared_move: Array
    """rad^2, mean of the squared changes of the command"""
    max_abs_error: Array
    """Largest |error| (m)."""
    failed: NDArray[np.object_]
    """why a run failed (`failure.Reason`), None where it did not"""
    failed_at: Array
    """s, NaN where it did not"""
    steps: NDArray[np.int64]
    """control steps done"""
    qp_capped: NDArray[np.int64]
    """steps whose QP stopped at its cap"""
    qp_failed: NDArray[np.int64]
    """steps whose QP had no solution (infeasible, not finite, not convex)"""
    held: NDArray[np.int64]
    """steps without a new answer: the last plan was followed, or the angle held"""
    limited: NDArray[np.int64]
    """steps at a limit"""
    qp_iterations: NDArray[np.int64]
    """of the QP solver, in all steps"""
    scheduler: dict[str, NDArray[np.int64]]
    """Counters of the scheduler by name, see `core.guard.COUNTS`; empty without one."""

    def cost(self, move_weight: float = 0.0) -> Array:
        """J = mean e^2 + move_weight * mean (change of command)^2, the cost that tuning minimises; inf when failed."""
        return self.mse + move_weight * self.mean_squared_move


@checked
def rollout_batch(
    plant: BatchPlant,
    controller: Controller,
    scenarios: Scenario | RoadDrive | Sequence[Scenario | RoadDrive],
    tunings: ArrayLike | None = None,
    *,
    scenario_indices: ArrayLike | None = None,
    profile: str | Profile = "paper",
    driver: Driver | None = None,
    seeds: ArrayLike = 0,
    known_as: KnownAs = None,
    failure: Failure | None = None,
    threads: int | None = None,
) -> BatchResult:
    """Drive many runs at once, compiled: run i drives scenario `scenario_indices[i]` with tunings[i] and seeds[i].

    controller: an `MPC`, or any compiled controller; tunings: (runs, entries) of its named tuning entries (Np, Nc, Q, R
    of an MPC, the horizons rounded and clamped to 1 <= Nc <= Np <= longest_horizon and most_moves); without them every
    run has the MPC's scheduler, or the controller's tuning; scenario_indices: (runs,), by default 0, without tunings
    one run for each scenario; seeds: noise seeds, one or one per run; threads: None for all cores. A run's
    result does not depend on the others, nor on the number of threads.

    Raises
    ------
    InvalidInput
        When shapes do not fit, a tuning is not finite, tunings meet a scheduler, or a part needs Python at every step.
    """
    several = [scenarios] if isinstance(scenarios, Scenario | RoadDrive) else scenarios
    batch = Batch(plant, controller, several, profile, driver, failure, known_as)
    if tunings is None:
        scenario_indices = np.arange(len(batch.signals)) if scenario_indices is None else scenario_indices
        tunings = np.repeat(batch.tuning[None], np.size(scenario_indices), axis=0)
    elif batch.scheduler is not None:
        raise InvalidInput("tunings: this MPC has a scheduler, which chooses them; leave them out.")
    checked = batch.checked_tunings(tunings)
    runs = len(checked)
    index = np.zeros(runs, np.int64) if scenario_indices is None else np.array(scenario_indices)
    if index.dtype.kind not in "iu":
        raise InvalidInput("scenario_indices: must be whole numbers.")
    index = index.astype(np.int64)
    if index.shape != (runs,) or (runs and not (index.min() >= 0 and index.max() < len(batch.signals))):
        raise InvalidInput(f"scenario_indices: need {runs} indices into {len(batch.signals)} scenarios.")
    seeded = np.array(seeds, dtype=np.int64)
    if seeded.shape not in ((), (runs,)):
        raise InvalidInput(f"seeds: need one, or one for each of the {runs} runs; got shape {seeded.shape}.")
    batch_result = batch.run(
        index,
        checked,
        np.broadcast_to(seeded, (runs,)).copy(),
        threads or os.cpu_count() or 1,
        scheduler=batch.scheduler,
    )
    return batch_result.measured()


@dataclass(frozen=True, eq=False)
class BatchRuns:
    """Results of `Batch.run`."""

    result: Any
    """(runs,) `core.period.RESULT`"""
    trace: Any
    """`core.period.Trace` of (runs, periods of the longest, ...), NaN behind a run's end; empty unless requested"""
    counts: dict[str, NDArray[np.int64]]
    """Counters of the scheduler, (runs,) by name; empty without one."""
    segments: Array
    """(runs, segments) cost of each segment: sum of squared error plus weight times squared move; inf where a run ended
    early, NaN after that and beyond the end of a shorter run; (runs, 0) unless requested"""

    @property
    def failed(self) -> NDArray[np.bool_]:
        """(runs,) whether the run failed."""
        return np.asarray(self.result["ended"] != 0)

    def measured(self) -> BatchResult:
        """By name, as means."""
        results = self.result
        steps = np.maximum(results["instants"], 1)
        reasons = {int(ended): reason_of(int(ended)) for ended in np.unique(results["ended"])}
        return BatchResult(
            mse=results["squared_error"] / steps,
            mean_squared_move=results["squared_move"] / steps,
            max_abs_error=results["largest_error"].copy(),
            failed=np.array([reasons[ended] for ended in results["ended"].tolist()], dtype=object),
            failed_at=np.where(self.failed, results["ended_at"], np.nan),
            steps=results["instants"].copy(),
            qp_capped=results["capped"].copy(),
            qp_failed=results["unsolved"].copy(),
            held=results["held"].copy(),
            limited=results["limited"].copy(),
            qp_iterations=results["iterations"].copy(),
            scheduler=self.counts,
        )


def sampled(world: World, scenarios: Sequence[Scenario | RoadDrive]) -> tuple[list[Signals], Array]:
    """Scenarios at the control instants, and as kernels read them: (runs, `core.loop.SIGNAL`, n + 1).

    n is that of the longest; a shorter one goes on with its last sample, which a preview beyond its end sees anyway.

    Raises
    ------
    InvalidInput
        When there are none.
    """
    signals = [scenario.sample(world.period) for scenario in scenarios]
    if not signals:
        raise InvalidInput("scenarios: none given.")
    longest = max(signal.n for signal in signals)
    rows = [
        np.pad(world.samples(signal, i), ((0, 0), (0, longest - signal.n)), mode="edge")
        for i, signal in enumerate(signals)
    ]
    return signals, np.ascontiguousarray(rows)


def called_back(plant: Any, controller: Controller) -> list[str]:
    """Names of functions of one's own that are called back in Python, as there is nothing here that compiles them."""
    members = [plant.compiled.member] if isinstance(plant, Plant) else []
    if isinstance(controller, CompiledController):
        members.append(controller.function)
    elif isinstance(controller, MPC):
        members += [controller.model.function, controller.estimator.function]
    return [member.name for member in members if getattr(member, "calls_python", False)]


class Batch:
    """Packed inputs that all runs of a batch share; arguments as for `rollout_batch`."""

    def __init__(
        self,
        plant: Plant,
        controller: Controller,
        scenarios: Sequence[Scenario | RoadDrive],
        profile: str | Profile = "paper",
        driver: Driver | None = None,
        failure: Failure | None = None,
        known_as: KnownAs = None,
    ) -> None:
        self.world = World.of(plant, controller, profile, driver, known_as, failure)
        self.controller, self.scheduler = controller, controller.scheduler
        self.scenarios = scenarios
        self._refuse_python()
        world = self.world
        self.signals, self.samples = sampled(world, scenarios)
        self.periods = np.array([signal.n for signal in self.signals])
        self.roads = pack_roads([getattr(scenario, "road", None) for scenario in scenarios])
        self.starts = np.array([world.start(scenario, s) for scenario, s in zip(scenarios, self.signals, strict=True)])
        self.substeps = np.array([world.substeps(float(s.speed.max())) for s in self.signals])
        self.settings = {int(steps): world.settings(int(steps)) for steps in np.unique(self.substeps)}

    def _refuse_python(self) -> None:
        controller = self.controller
        if isinstance(self.world.driver, SpeedControl):
            raise InvalidInput("driver: compiled runs have no SpeedControl; simulate(...) drives with one.")
        if slow := called_back(self.world.plant, controller):
            raise MissingExtra(
                f"{', '.join(slow)}: many runs need functions of one's own compiled, which numba does: python -m pip "
                "install 'adaptrack[compile]'; without it simulate(...) and `adaptrack drive` call them in Python."
            )
        fit = isinstance(controller, CompiledController) or (isinstance(controller, MPC) and controller.runs_in_kernel)
        scheduled = self.scheduler is None or isinstance(self.scheduler, CompiledScheduler)
        if not (fit and scheduled and isinstance(self.world.plant, Plant)):
            raise InvalidInput(
                "compiled runs need a compiled plant, an MPC or a compiled controller, a scheduler of "
                "adaptrack.scheduling, or none, and a QP solver of the kernels ('active-set', 'hildreth'); "
                "use simulate(...) for this one."
            )

    @property
    def tuning(self) -> Array:
        """(entries,) the controller's own tuning."""
        return self.controller.packed_tuning()

    def checked_tunings(self, tunings: ArrayLike) -> Array:
        """(runs, entries) tunings that a controller may have.

        Raises
        ------
        InvalidInput
            When they are none.
        """
        names = self.controller.tuning_names
        checked = np.array(tunings, dtype=np.float64, ndmin=2)
        if checked.ndim != 2 or checked.shape[1] != len(names) or not np.isfinite(checked).all():
            raise InvalidInput(
                f"tunings: need finite (runs, {len(names)}) of {', '.join(names)}; got shape {checked.shape}."
            )
        if isinstance(self.controller, MPC) and ((checked[:, 2] < 0.0).any() or (checked[:, 3] <= 0.0).any()):
            raise InvalidInput("tunings: every Q must be >= 0 and every R > 0.")
        return checked

    def mpc_settings(self, longest: float, most: float, residuals: bool) -> Any:
        """The MPC's settings with a workspace no larger than horizons up to these need; tiny for other controllers."""
        if isinstance(self.controller, MPC):
            return self.controller.settings(longest, most, residuals)
        return kernel.settings(
            period=self.world.period, longest_horizon=1, most_moves=1, output_min=-np.inf, output_max=np.inf
        )

    def arena(
        self, slots: int, steps: int, mpc_settings: Any, segments: int = 0, periods: int = 0,
        scheduler: CompiledScheduler | None = None,
    ) -> Any:  # fmt: skip
        """The kernels' arrays for up to `slots` runs that integrate `steps` times a period (`core.rollout.RunRecord`).

        segments: of each run; periods: to trace, 0 for no trace.
        """
        controller, plant = self.controller, self.world.plant
        assert isinstance(plant, Plant)
        if isinstance(controller, CompiledController):
            functions = kernel.functions()
            mpc = kernel.batch(slots, mpc_settings, (np.zeros(6), np.arange(4), np.zeros(0)), (np.zeros(0), 0))
            law = rollout.law_batch(slots, controller)
            width = law.answer.shape[1] + len(controller.tuning_names)
        else:
            assert isinstance(controller, MPC)
            mpc, law = (
                controller.batch(slots, mpc_settings, curved=bool(len(self.roads.numbers))),
                rollout.no_law_batch(),
            )
            functions = controller.functions
            width = mpc.answer.shape[1]
        loop = self.world.loop(
            period_kernel.Given(self.samples, self.roads, np.zeros(slots, np.int64), np.zeros(slots, np.int64)),
            vehicle_batch(plant.compiled, plant.packed(), np.zeros((slots, self.starts.shape[1]))),
            self.settings[steps],
            variables=scheduler is not None,
            trace=period_kernel.traces(slots, periods, width) if periods else None,
            segments=segments,
        )
        features = loop.features._replace(law=isinstance(controller, CompiledController))
        loop = loop._replace(features=features, measured=mpc.measured)
        return rollout.RunRecord(
            *loop,
            mpc=mpc,
            functions=functions,
            law=law,
            schedule=no_schedule() if scheduler is None else scheduler.plan(slots),
            tuning=np.zeros((slots, len(self.tuning))),
        )

    def chunks(self, runs: NDArray[np.int64], threads: int = 1) -> list[NDArray[np.int64]]:
        """Runs that are driven together: as long, and integrated with the same number of steps.

        A plant of one's own is advanced slot by slot: its runs are shared evenly among the threads.
        """
        chunks = []
        for steps in self.settings:
            for n in np.unique(self.periods):
                members = np.flatnonzero((self.substeps[runs] == steps) & (self.periods[runs] == n))
                ours = isinstance(self.world.plant, SingleTrack | DualTrack)
                even = SLOTS if ours else math.ceil(len(members) / threads)
                size = min(SLOTS, max(even, 1))
                chunks += [members[first : first + size] for first in range(0, len(members), size)]
        return chunks

    def longest(self, tunings: Array, scheduler: CompiledScheduler | None) -> tuple[float, float]:
        """The longest Np and Nc that runs with these tunings or this scheduler may ask for."""
        if not isinstance(self.controller, MPC):
            return 1.0, 1.0
        longest, most = tunings[:, 0].max(initial=1), tunings[:, 1].max(initial=1)
        if scheduler is not None:
            longest, most = max(longest, scheduler.largest[0]), max(most, scheduler.largest[1])
        return float(longest), float(most)

    def run(
        self, scenario_indices: NDArray[np.int64], tunings: Array, seeds: NDArray[np.int64], threads: int,
        traced: bool = False, segment: int = 0, weight: float = 0.0, scheduler: CompiledScheduler | None = None,
    ) -> BatchRuns:  # fmt: skip
        """Drive run i with scenario `scenario_indices`[i], tunings[i] and seeds[i]; a scheduler begins with the tuning.

        traced: keep what happened at every control instant, about 200 bytes for each of a run; segment: periods of a
        segment whose cost is wanted, with `weight` (m^2/rad^2) on the squared moves; 0: none.
        """
        runs, n = len(scenario_indices), int(self.periods.max())
        plan = _Plan(scenario_indices, tunings, seeds, segment, weight, n if traced else 0, scheduler)
        longest = (math.inf, math.inf) if traced else self.longest(tunings, scheduler)
        settings = self.mpc_settings(*longest, residuals=traced)
        result, counts = period_kernel.RESULT.new(runs), np.zeros((len(guard_kernel.COUNTS), runs), np.int64)
        segments = np.full((runs, math.ceil(n / segment) if segment else 0), np.nan)
        traces: list[tuple[NDArray[np.int64], Any]] = []
        waiting: queue.SimpleQueue[NDArray[np.int64]] = queue.SimpleQueue()
        chunks = self.chunks(scenario_indices, threads)
        for chunk in chunks:
            waiting.put(chunk)

        def work() -> None:
            outcome = None
            while True:
                try:
                    chunk = waiting.get_nowait()
                except queue.Empty:
                    return
                outcome = self._drive(chunk, plan, settings, outcome)
                result[chunk], segments[chunk, : outcome.segments.shape[1]] = outcome.result, outcome.segments
                if traced:
                    traces.append((chunk, outcome.trace))
                if scheduler is not None:
                    counts[:, chunk] = [outcome.schedule.memory[name] for name in guard_kernel.COUNTS]

        workers = max(1, min(threads, len(chunks)))
        if workers == 1:
            work()
        else:
            with ThreadPoolExecutor(workers) as pool:
                for future in [pool.submit(work) for _ in range(workers)]:
                    future.result()
        guard_counts = {} if scheduler is None else dict(zip(guard_kernel.COUNTS, counts, strict=True))
        return BatchRuns(result, _joined(traces, runs) if traces else period_kernel.no_trace(), guard_counts, segments)

    def _drive(self, chunk: NDArray[np.int64], plan: _Plan, mpc_settings: Any, last: Any) -> Any:
        """Drive the runs of one chunk; the `core.rollout.RunRecord` that they leave.

        last: that of a chunk before, None: none; its arrays are used again where they fit and nothing in them is kept.
        """
        run_indices, size = plan.scenario_indices[chunk], len(chunk)
        n = int(self.periods[run_indices[0]])
        segments = math.ceil(n / plan.segment) if plan.segment else 0
        steps, run = int(self.substeps[run_indices[0]]), last
        fits = run is not None and len(run.memory.own) == size and run.settings is self.settings[steps]
        fits = fits and run.segments.shape[1] == segments
        if not fits or plan.traced or plan.scheduler is not None:
            run = self.arena(size, steps, mpc_settings, segments, plan.traced, plan.scheduler)
        run.given.scenario[:], run.given.seeds[:] = run_indices, plan.seeds[chunk]
        run.vehicles.start[:], run.tuning[:] = self.starts[run_indices], plan.tunings[chunk]
        place = Resident(run)
        rollout.begin(size, place)
        rollout.rollout(period_kernel.RunSpan(n, size, plan.segment, plan.weight), place)
        return run


def _joined(traces: Sequence[tuple[NDArray[np.int64], Any]], runs: int) -> Any:
    """One trace of all runs, from those of the chunks."""
    first = traces[0][1]
    joined = type(first)(*(np.empty((runs, *part.shape[1:])) for part in first))
    for chunk, trace in traces:
        for part, values in zip(joined, trace, strict=True):
            part[chunk] = values
    return joined


@dataclass(frozen=True, eq=False)
class _Plan:
    """Inputs in which the runs of `Batch.run` differ."""

    scenario_indices: NDArray[np.int64]
    tunings: Array
    seeds: NDArray[np.int64]
    segment: int
    weight: float
    traced: int
    """periods to trace, 0 for no trace"""
    scheduler: CompiledScheduler | None
