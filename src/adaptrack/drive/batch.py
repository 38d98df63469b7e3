"""Batches of compiled runs, vectorised over the runs."""

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

from adaptrack.base.checked import Count, Hint, checked
from adaptrack.base.errors import InvalidInput, MissingExtra
from adaptrack.cars.plant import DualTrack, Plant, SingleTrack
from adaptrack.control.controllers import CompiledScheduler, Controller
from adaptrack.control.controllers.base import Room
from adaptrack.core.kernel import Resident
from adaptrack.core.maths.portable import Array
from adaptrack.core.member import compiles
from adaptrack.core.plants.contract import SLOTS, vehicle_batch
from adaptrack.core.scheduling import guard as guard_kernel
from adaptrack.core.simulation import run as kernel
from adaptrack.drive.failure import FailureLimits, failure_of
from adaptrack.drive.world import Driver, PerceptionSource, RequestedForces, World
from adaptrack.road.road_ahead import pack_roads
from adaptrack.scenario import RoadDrive, Scenario, Signals
from adaptrack.scenario.profile import Profile

BatchPlant = Annotated[Plant, Hint("simulate(...) drives a SteppedPlant")]


@dataclass(frozen=True, eq=False)
class BatchResult:
    """Result of `rollout_batch`: measures as arrays of shape (runs,), one entry per run."""

    mse: Array
    """Mean of (Y - y_ref)^2 over the control instants (m^2); inf for a failed run."""
    mean_squared_move: Array
    """Mean of the squared changes of the command (rad^2)."""
    max_abs_error: Array
    """Largest |Y - y_ref| (m)."""
    failed: NDArray[np.object_]
    """Reason of a failed run (`failure.Reason`); None for a completed run."""
    failed_at: Array
    """Time of the failure (s); NaN for a completed run."""
    steps: NDArray[np.int64]
    """Number of completed control steps."""
    qp_capped: NDArray[np.int64]
    """Number of steps whose QP solver stopped at its iteration limit."""
    qp_failed: NDArray[np.int64]
    """Number of steps whose QP had no solution (infeasible, not finite or not convex)."""
    held: NDArray[np.int64]
    """Number of steps without a new solution: the car followed the last plan, or kept its last steering angle."""
    limited: NDArray[np.int64]
    """Number of steps with an active limit."""
    qp_iterations: NDArray[np.int64]
    """Iterations of the QP solver in all steps."""
    scheduler: dict[str, NDArray[np.int64]]
    """Counters of the scheduler by name (`core.scheduling.guard.COUNTS`); empty without a scheduler."""

    def cost(self, move_weight: float = 0.0) -> Array:
        """Return the cost of tuning, J = mean e^2 + move_weight * mean (change of command)^2 (m^2).

        It is inf for failed runs; move_weight: m^2/rad^2.
        """
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
    perception: PerceptionSource = None,
    failure: FailureLimits | None = None,
    threads: Count | None = None,
) -> BatchResult:
    """Simulate many compiled runs in parallel. The result of a run does not depend on other runs or on `threads`.

    Run i drives scenario ``scenario_indices[i]`` with ``tunings[i]`` and ``seeds[i]``.

    Parameters
    ----------
    plant
        Simulated car; a compiled plant.
    controller
        An `MPC` or another compiled controller.
    scenarios
        One scenario or road drive, or several.
    tunings : (runs, entries) array, optional
        Values of ``controller.tuning_names``, which are Np, Nc, Q and R for an MPC. Its horizons are rounded and
        limited to 1 <= Nc <= Np, to its longest horizon and to its largest number of moves. By default each run uses
        the scheduler of the MPC, or the tuning of the controller.
    scenario_indices : (runs,) array, optional
        Index of each run's scenario. Default without `tunings`: one run
        per scenario. Default with `tunings`: all runs drive scenario 0.
    profile
        Steering, sensors and computation time, see `Profile`.
    driver
        Longitudinal driver; None to follow the speed reference exactly.
    seeds : int or (runs,) array
        Seed of the sensor noise.
    perception
        Friction and wind that a scheduler receives, see `PerceptionSource`.
    failure
        Limits beyond which a run fails; by default those of the car.
    threads
        Number of threads; None for one per core.

    Raises
    ------
    InvalidInput
        When shapes do not match, a tuning is not finite, tunings are given for an MPC with a scheduler, or a component
        needs Python at every step.
    """
    scenario_list = [scenarios] if isinstance(scenarios, Scenario | RoadDrive) else scenarios
    batch = Batch(plant, controller, scenario_list, profile, driver, failure, perception)
    if tunings is None:
        scenario_indices = np.arange(len(batch.signals)) if scenario_indices is None else scenario_indices
        tunings = np.repeat(batch.tuning[None], np.size(scenario_indices), axis=0)
    elif batch.scheduler is not None:
        raise InvalidInput("tunings: this MPC has a scheduler, which chooses the tunings; leave the argument out.")
    tuning_rows = batch.controller.checked_tunings(tunings)
    runs = len(tuning_rows)
    index = np.zeros(runs, np.int64) if scenario_indices is None else np.array(scenario_indices)
    if index.dtype.kind not in "iu":
        raise InvalidInput("scenario_indices: must be whole numbers.")
    index = index.astype(np.int64)
    if index.shape != (runs,) or (runs and not (index.min() >= 0 and index.max() < len(batch.signals))):
        raise InvalidInput(f"scenario_indices: need {runs} indices into {len(batch.signals)} scenarios.")
    seed_array = np.array(seeds, dtype=np.int64)
    if seed_array.shape not in ((), (runs,)):
        raise InvalidInput(f"seeds: need one, or one for each of the {runs} runs; got shape {seed_array.shape}.")
    run_seeds = np.broadcast_to(seed_array, (runs,)).copy()
    return batch.run(index, tuning_rows, run_seeds, threads, scheduler=batch.scheduler).summary()


@dataclass(frozen=True, eq=False)
class BatchRuns:
    """Results of `Batch.run`."""

    result: Any
    """Results of the kernels, (runs,) records `core.simulation.run.RESULT`."""
    trace: Any
    """Signals of the runs, a `core.simulation.run.Trace` of arrays (runs, periods of the longest run, ...). They are
    NaN after the end of a run, and empty unless requested."""
    counts: dict[str, NDArray[np.int64]]
    """Counters (runs,) of the scheduler by name; empty without a scheduler."""
    segments: Array
    """Cost of each segment (m^2), (runs, segments): the sum of squared errors plus weighted squared moves. It is inf
    for the segment in which a run fails and NaN after the end of a run. The shape is (runs, 0) unless requested."""

    @property
    def has_failed(self) -> NDArray[np.bool_]:
        """Whether each run failed, (runs,)."""
        return np.asarray(self.result["ended"] != 0)

    def summary(self) -> BatchResult:
        """Return the means, largest values and counts of each run."""
        results = self.result
        steps = np.maximum(results["instants"], 1)
        return BatchResult(
            mse=results["squared_error"] / steps,
            mean_squared_move=results["squared_move"] / steps,
            max_abs_error=results["largest_error"].copy(),
            failed=np.array([failure_of(ended)[0] for ended in results["ended"].tolist()], dtype=object),
            failed_at=np.where(self.has_failed, results["ended_at"], np.nan),
            steps=results["instants"].copy(),
            qp_capped=results["capped"].copy(),
            qp_failed=results["unsolved"].copy(),
            held=results["held"].copy(),
            limited=results["limited"].copy(),
            qp_iterations=results["iterations"].copy(),
            scheduler=self.counts,
        )


def sampled(world: World, scenarios: Sequence[Scenario | RoadDrive]) -> tuple[list[Signals], Array]:
    """Sample scenarios at the control instants; InvalidInput when there is none.

    Return the samples of each scenario, and the same samples as the kernels read them, an array (scenarios,
    `core.simulation.world.SIGNAL`, n + 1), where n is the number of periods of the longest scenario. Shorter ones
    repeat their last sample; a preview beyond their end reads the same values.
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


def interpreted_functions(plant: Any, controller: Controller) -> list[str]:
    """Return the names of user functions that run in Python because they are not compiled."""
    members = [plant.compiled.member] if isinstance(plant, Plant) else []
    members += controller.user_functions()
    return [member.name for member in members if getattr(member, "calls_python", False)]


class Batch:
    """Kernel inputs that all runs of a batch share; the arguments are those of `rollout_batch`."""

    def __init__(
        self,
        plant: Plant,
        controller: Controller,
        scenarios: Sequence[Scenario | RoadDrive],
        profile: str | Profile = "paper",
        driver: Driver | RequestedForces | None = None,
        failure: FailureLimits | None = None,
        perception: PerceptionSource = None,
    ) -> None:
        self.world = World.of(plant, controller, profile, driver, perception, failure)
        self.controller, self.scheduler = controller, controller.scheduler
        self.scenarios = scenarios
        self._check_compiled()
        world = self.world
        self.signals, self.samples = sampled(world, scenarios)
        self.periods = np.array([signal.n for signal in self.signals])
        self.roads = pack_roads([getattr(scenario, "road", None) for scenario in scenarios])
        self.starts = np.array([world.start(scenario, s) for scenario, s in zip(scenarios, self.signals, strict=True)])
        self.substeps = np.array([world.substeps(float(s.speed.max())) for s in self.signals])
        self.settings = {int(steps): world.settings(int(steps)) for steps in np.unique(self.substeps)}

    def _check_compiled(self) -> None:
        """Raise an error if a component of the runs cannot be compiled."""
        controller = self.controller
        if names := interpreted_functions(self.world.plant, controller):
            remedy = "To compile them: python -m pip install 'adaptrack[compile]'."
            if compiles():
                remedy = "Their source cannot be read: write each to a file as `def name(...):`."
            raise MissingExtra(
                f"{', '.join(names)}: batches of runs need compiled functions. {remedy} "
                "Or use simulate(...) or `adaptrack drive`."
            )
        has_compiled_scheduler = self.scheduler is None or isinstance(self.scheduler, CompiledScheduler)
        if not (controller.runs_in_kernel and has_compiled_scheduler and isinstance(self.world.plant, Plant)):
            raise InvalidInput(
                "compiled runs need a compiled plant, an MPC or another compiled controller, a scheduler from "
                "adaptrack.scheduling or none, and the QP solver 'active-set' or 'hildreth'. Use simulate(...) for "
                "this combination."
            )

    @property
    def tuning(self) -> Array:
        """Tuning of the controller, (entries,)."""
        return self.controller.packed_tuning()

    def run_record(
        self, slots: int, steps: int, room: Room, segments: int = 0, periods: int = 0,
        scheduler: CompiledScheduler | None = None, **fields: Any,
    ) -> Any:  # fmt: skip
        """Allocate the kernels' arrays for up to `slots` runs (`core.simulation.run.RunRecord`).

        steps: integration steps per control period; room: horizons for which a controller has memory; periods: number
        of control periods to trace, 0 for no trace; scheduler: that of the MPC, None for a fixed tuning; segments,
        fields: see `World.run`.
        """
        plant, settings = self.world.plant, self.settings[steps]
        assert isinstance(plant, Plant)
        part = self.controller.part(
            slots, room, curved=bool(len(self.roads.numbers)), has_vy=math.isfinite(settings.noise_vy)
        )
        if scheduler is not None:
            part = part._replace(schedule=scheduler.plan(slots))
        width = part.answer.shape[1] + (0 if part.plans else part.tuning.shape[1])
        scenario, seeds = np.zeros(slots, np.int64), np.zeros(slots, np.int64)
        return self.world.run(
            kernel.RunInputs(self.samples, self.roads, scenario, seeds, np.full(slots, self.periods[0])),
            vehicle_batch(plant.compiled, plant.packed(), np.zeros((slots, self.starts.shape[1]))),
            settings, part, trace=kernel.traces(slots, periods, width) if periods else None, segments=segments,
            **{"needs_variables": scheduler is not None} | fields,
        )  # fmt: skip

    def chunks(self, runs: NDArray[np.int64], threads: int = 1) -> list[NDArray[np.int64]]:
        """Split runs into chunks for one kernel call each, with equal duration and integration steps within a chunk.

        A user plant is advanced one run at a time, so its runs are divided evenly among the threads. runs: (runs,)
        scenario index of each run. The chunks are indices into `runs`.
        """
        chunks = []
        for steps in self.settings:
            for n in np.unique(self.periods):
                members = np.flatnonzero((self.substeps[runs] == steps) & (self.periods[runs] == n))
                is_vectorised = isinstance(self.world.plant, SingleTrack | DualTrack)
                target_size = SLOTS if is_vectorised else math.ceil(len(members) / threads)
                size = min(SLOTS, max(target_size, 1))
                chunks += [members[first : first + size] for first in range(0, len(members), size)]
        return chunks

    def run(
        self, scenario_indices: NDArray[np.int64], tunings: Array, seeds: NDArray[np.int64],
        threads: int | None = None, traced: bool = False, segment: int = 0, weight: float = 0.0,
        scheduler: CompiledScheduler | None = None,
    ) -> BatchRuns:  # fmt: skip
        """Drive run i with scenario ``scenario_indices[i]``, ``tunings[i]`` and ``seeds[i]``.

        tunings: (runs, entries), which a scheduler replaces in the first period; threads: number of threads, None for
        one per core; traced: whether to record the signals at every control instant, about 200 bytes per instant and
        run; segment: length of the segments whose cost is recorded, in control periods, 0 for no segments; weight: of
        the squared moves in the segment costs (m^2/rad^2); scheduler: that of the MPC, None for fixed tunings.
        """
        threads, runs, n = threads or os.cpu_count() or 1, len(scenario_indices), int(self.periods.max())
        room = Room() if traced else self.controller.room_for(tunings, scheduler)
        result, counts = kernel.RESULT.new(runs), np.zeros((len(guard_kernel.COUNTS), runs), np.int64)
        segments = np.full((runs, math.ceil(n / segment) if segment else 0), np.nan)
        traces: list[tuple[NDArray[np.int64], Any]] = []
        waiting: queue.SimpleQueue[NDArray[np.int64]] = queue.SimpleQueue()
        chunks = self.chunks(scenario_indices, threads)
        for chunk in chunks:
            waiting.put(chunk)

        def drive(chunk: NDArray[np.int64], previous_record: Any) -> Any:
            """Drive the runs of a chunk; the arrays of a previous record are reused if their sizes match."""
            scenarios, size, run = scenario_indices[chunk], len(chunk), previous_record
            periods, steps = int(self.periods[scenarios[0]]), int(self.substeps[scenarios[0]])
            count = math.ceil(periods / segment) if segment else 0
            is_reusable = run is not None and len(run.memory.drives) == size and run.segments.shape[1] == count
            is_reusable = is_reusable and run.settings is self.settings[steps]
            if not is_reusable or traced or scheduler is not None:
                run = self.run_record(
                    size, steps, room, count, n if traced else 0, scheduler, segment=segment, weight=weight
                )
            run.inputs.scenario[:], run.inputs.seeds[:], run.inputs.periods[:] = scenarios, seeds[chunk], periods
            run.vehicles.start[:], run.controller.tuning[:] = self.starts[scenarios], tunings[chunk]
            resident = Resident(run)
            kernel.begin(size, resident)
            kernel.roll_on(periods, size, resident)
            return run

        def work() -> None:
            outcome = None
            while True:
                try:
                    chunk = waiting.get_nowait()
                except queue.Empty:
                    return
                outcome = drive(chunk, outcome)
                result[chunk], segments[chunk, : outcome.segments.shape[1]] = outcome.result, outcome.segments
                if traced:
                    traces.append((chunk, outcome.trace))
                if scheduler is not None:
                    counts[:, chunk] = [outcome.controller.schedule.memory[name] for name in guard_kernel.COUNTS]

        workers = max(1, min(threads, len(chunks)))
        if workers == 1:
            work()
        else:
            with ThreadPoolExecutor(workers) as pool:
                for future in [pool.submit(work) for _ in range(workers)]:
                    future.result()
        guard_counts = {} if scheduler is None else dict(zip(guard_kernel.COUNTS, counts, strict=True))
        return BatchRuns(result, _joined(traces, runs) if traces else kernel.traces(0, 0, 0), guard_counts, segments)


def _joined(traces: Sequence[tuple[NDArray[np.int64], Any]], runs: int) -> Any:
    """Join the traces of the chunks into one trace of all runs."""
    first = traces[0][1]
    joined = type(first)(*(np.empty((runs, *part.shape[1:])) for part in first))
    for chunk, trace in traces:
        for part, values in zip(joined, trace, strict=True):
            part[chunk] = values
    return joined
