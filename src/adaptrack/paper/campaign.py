"""Campaigns: a particle swarm at every operating point, on all cores or many machines, that survives being stopped.

    config = load_campaign("paper-grid")
    file = run_campaign(config, "out", resume=True, progress=print)

Work is split into chunks of operating points; each becomes one file the moment it is done. The result depends on the
configuration only: not on the number of workers, the order of the chunks, or how often the work was interrupted.
"""

from __future__ import annotations

import math
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack import __version__
from adaptrack.base.checked import Count, checked
from adaptrack.base.cluster import dask_client
from adaptrack.base.errors import AdaptrackError, ContractError, InvalidInput, StorageError
from adaptrack.paper.campaign_config import STANDARD, CampaignConfig, Plan, Setup
from adaptrack.paper.evaluator import EvaluatedLoop
from adaptrack.paper.operating_points import NAMES
from adaptrack.paper.store import COLUMNS, FORMAT_VERSION, Columns, Folder

if TYPE_CHECKING:
    from adaptrack.paper.evaluator import Evaluator, SwarmFinding

Array = NDArray[np.float64]


def closed_loop(setup: Setup) -> Evaluator:
    """The evaluator of campaigns: the compiled closed loop that `setup` describes."""
    return EvaluatedLoop(setup)


# -- one chunk, wherever it is computed -------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Job:
    """What all chunks of a campaign share; travels to the workers."""

    evaluate: Callable[[Setup], Evaluator]
    setup: Setup
    versions: dict[str, str]
    library: Array
    """(T, 4)"""


class Chunk(NamedTuple):
    """The finished rows of some operating points."""

    columns: Columns
    seconds: float
    worker: str


_build_lock = threading.Lock()


@lru_cache(maxsize=4)
def _build(evaluate: Callable[[Setup], Evaluator], setup: Setup) -> Evaluator:
    return evaluate(setup)


def evaluator_of(evaluate: Callable[[Setup], Evaluator], setup: Setup) -> Evaluator:
    """The evaluator of this process, built once."""
    with _build_lock:
        return _build(evaluate, setup)


def versions_of(evaluator: Evaluator) -> dict[str, str]:
    """The software on which the numbers depend."""
    return {"adaptrack": __version__, **evaluator.versions()}


def compute(job: Job, streams: NDArray[np.int64], points: Array, give_up: threading.Event | None = None) -> Chunk:
    """Tune at each operating point (n, 4) and find the landscape there.

    Raises
    ------
    ContractError
        When this worker has other software than the one that asks, or an answer makes no sense.
    CancelledError
        When `give_up` was set.
    """
    begun = time.perf_counter()
    evaluator = evaluator_of(job.evaluate, job.setup)
    worker = f"{socket.gethostname()}:{os.getpid()}:{threading.get_native_id()}"
    here = versions_of(evaluator)
    if here != job.versions:
        raise ContractError(f"worker {worker} has other software than the campaign: {here}, not {job.versions}.")
    rows = []
    for stream, point in zip(streams.tolist(), points, strict=True):
        if give_up is not None and give_up.is_set():
            raise CancelledError
        rows.append(_row(evaluator, job, stream, point))
    columns = {each.name: np.array([row[each.name] for row in rows], dtype=each.dtype) for each in COLUMNS}
    return Chunk(columns, time.perf_counter() - begun, worker)


def _row(evaluator: Evaluator, job: Job, stream: int, point: Array) -> dict[str, Any]:
    """What a data set holds of one operating point."""
    seed, standard, library = job.setup.config.seed, np.array([STANDARD]), job.library
    place = np.flatnonzero((library == standard).all(axis=1))
    tunings = library if place.size else np.vstack([library, standard])
    tuned = evaluator.tune(point, seed, stream)
    costs = np.asarray(evaluator.landscape(point, tunings), dtype=float)
    Np, Nc, Q, R = _checked(tuned, costs, len(tunings), point)
    return {
        "stream": stream,
        **dict(zip(NAMES, point.tolist(), strict=True)),
        "Np": Np,
        "Nc": Nc,
        "Q": Q,
        "R": R,
        "r_over_q": R / Q,
        "cost": float(tuned.cost),
        "standard_cost": costs[place[0] if place.size else -1],
        "evaluations": int(tuned.evaluations),
        "control_steps": int(tuned.control_steps),
        "seed": seed,
        "mirrored_from": -1,
        "trace": np.asarray(tuned.trace, dtype=np.float32),
        "landscape": costs[: len(library)].astype(np.float32),
    }


def _checked(tuned: SwarmFinding, costs: Array, size: int, point: Array) -> tuple[int, int, float, float]:
    """The tuning of an answer that makes sense."""
    Np, Nc, Q, R = (float(value) for value in tuned.tuning)
    horizons = Np.is_integer() and Nc.is_integer() and 1 <= Nc <= Np
    if not (horizons and 0 < Q < math.inf and 0 < R < math.inf):
        fault = f"the tuning {[Np, Nc, Q, R]}"
    elif math.isnan(tuned.cost) or np.isnan(tuned.trace).any():
        fault = "a cost that is not a number"
    elif costs.shape != (size,) or np.isnan(costs).any():
        fault = f"a landscape of shape {costs.shape} for {size} tunings, {int(np.isnan(costs).sum())} of them NaN"
    else:
        return int(Np), int(Nc), Q, R
    where = dict(zip(NAMES, point.tolist(), strict=True))
    raise ContractError(f"the objective answered operating point {where} with {fault}.")


# -- the whole --------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Progress:
    """How far a campaign is."""

    done: int
    """operating points finished, earlier sessions included"""
    total: int
    """operating points to compute; left-right twins count once"""
    runs: int
    """closed-loop runs of this session"""
    seconds: float
    """since this session began to compute"""
    seconds_left: float
    """until the end, at the speed of this session; inf before its first chunk"""

    @property
    def runs_per_s(self) -> float:
        """Closed-loop runs per second."""
        return self.runs / self.seconds if self.seconds > 0.0 else 0.0


class CampaignStopped(AdaptrackError):
    """A campaign that could not go on; what was finished is kept."""


class CampaignInterrupted(KeyboardInterrupt):
    """A campaign that the user stopped; the message says what is kept and how to go on."""


@checked
def run_campaign(
    config: CampaignConfig,
    out: str | os.PathLike[str],
    *,
    resume: bool = False,
    workers: Count | None = None,
    dask: str | None = None,
    executor: Executor | None = None,
    progress: Callable[[Progress], None] | None = None,
    evaluate: Callable[[Setup], Evaluator] = closed_loop,
) -> Path:
    """Run a campaign in the folder `out`, or go on with one; the path of its data set, for `load_dataset`.

    resume: go on where an earlier session was stopped, however that came about; nothing to do is no error. workers:
    threads, by default one per core. dask: address of a Dask scheduler whose workers do it instead. executor: any
    other `concurrent.futures.Executor`. progress: called in this thread after each chunk. evaluate: builds what is
    tuned; a function of a module that the workers can import.

    The first Ctrl-C finishes the chunks in work, a second one gives them up.

    Raises
    ------
    InvalidInput
        When the configuration or the arguments fit nothing, or the Dask scheduler has no workers; before any work, like
        the next two.
    StorageError
        When `out` cannot be used, see `store.Folder`; later, when a file cannot be written.
    MissingExtra
        When `dask` is given and not installed.
    CampaignStopped
        When the workers failed.
    CampaignInterrupted
        After Ctrl-C.
    """
    plan = Plan.of(config)
    with ExitStack() as stack:
        pool = stack.enter_context(_pool(workers, dask, executor))  # first: it takes seconds, compilation minutes
        versions = versions_of(evaluator_of(evaluate, plan.setup))
        manifest = _manifest(plan, versions)
        folder = stack.enter_context(Folder.opened(out, manifest, resume))
        if folder.has_dataset():
            folder.drop_chunks()
            return folder.dataset
        about = {key: manifest[key] for key in ("name", "versions")}
        job = Job(evaluate, plan.setup, versions, plan.library)
        session = _Session(plan, folder, job, about, progress)
        session.run(pool)
        session.merge()
        return folder.dataset


def _manifest(plan: Plan, versions: dict[str, str]) -> dict[str, Any]:
    """What a folder says about its campaign."""
    config, count = plan.config, len(plan.fold.representatives)
    return {
        "name": config.name,
        "format_version": FORMAT_VERSION,
        "identity": plan.identity,
        "operating_points": len(plan.operating_points),
        "computed": count,
        "chunk": config.chunk,
        "chunks": math.ceil(count / config.chunk),
        "versions": versions,
        "settings": plan.settings,
    }


@dataclass(frozen=True)
class _Pool:
    """An executor, and how to make what it runs stop early (threads only)."""

    executor: Executor
    give_up: threading.Event | None = None


@contextmanager
def _pool(workers: int | None, dask: str | None, executor: Executor | None) -> Iterator[_Pool]:
    if sum(choice is not None for choice in (workers, dask, executor)) > 1:
        raise InvalidInput("workers, dask and executor: give one of them; a Dask scheduler has its own workers.")
    if executor is not None:
        yield _Pool(executor)
    elif dask is not None:
        with dask_client(dask) as client:
            yield _Pool(client.get_executor(retries=3, pure=False))
    else:
        give_up = threading.Event()
        with ThreadPoolExecutor(workers or _cores(), thread_name_prefix="adaptrack") as threads:
            try:
                yield _Pool(threads, give_up)
            finally:
                give_up.set()  # nobody waits for what is still in work


def _cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        return os.cpu_count() or 1


@dataclass(eq=False)
class _Session:
    """One sitting of a campaign: computes what is missing, then merges."""

    plan: Plan
    folder: Folder
    job: Job
    about: Mapping[str, Any]
    progress: Callable[[Progress], None] | None
    kept: dict[int, Columns] = field(default_factory=dict)
    """finished chunks"""
    found: int = 0
    """operating points that earlier sessions finished"""
    done: int = 0
    """operating points finished"""
    runs: int = 0
    begun: float = 0.0

    def part(self, number: int) -> NDArray[np.int64]:
        """The streams of one chunk."""
        return self.plan.fold.representatives[number * self.folder.size : (number + 1) * self.folder.size]

    def run(self, pool: _Pool) -> None:
        """Compute and keep every chunk that is not there yet."""
        for number in range(self.folder.chunks):
            columns = self.folder.read_chunk(number)
            if columns is not None:
                self._keep(number, columns)
        self.found = self.done
        missing = [number for number in range(self.folder.chunks) if number not in self.kept]
        self.folder.note(session="begins", at=time.time(), chunks=len(missing), versions=self.job.versions)
        self.begun = time.perf_counter()
        self._tell()
        more = () if pool.give_up is None else (pool.give_up,)
        waiting: dict[Future[Chunk], int] = {}
        try:
            for number in missing:
                streams = self.part(number)
                task = pool.executor.submit(compute, self.job, streams, self.plan.operating_points[streams], *more)
                waiting[task] = number
            self._collect(waiting)
        except KeyboardInterrupt:
            self._wind_up(waiting)
        except StorageError as error:
            raise StorageError(f"{error} {self._hint()}") from error
        except CancelledError:
            raise CampaignStopped(f"the workers are gone. {self._hint()}") from None
        finally:
            for task in waiting:
                task.cancel()
        self.folder.note(session="ends", at=time.time(), seconds=time.perf_counter() - self.begun)

    def _collect(self, waiting: dict[Future[Chunk], int]) -> None:
        """Keep each chunk when it comes; it leaves `waiting` once it is safe."""
        while waiting:
            # Those that came together in their order, so that what a sitting leaves behind is a matter of time only.
            for task in sorted(wait(waiting, return_when=FIRST_COMPLETED).done, key=waiting.__getitem__):
                number = waiting[task]
                try:
                    chunk = task.result()
                except (AdaptrackError, CancelledError):
                    raise
                except Exception as error:
                    reason = f"{type(error).__name__}: {error}".rstrip(".")
                    raise CampaignStopped(f"chunk {number} failed: {reason}. {self._hint()}") from error
                self.folder.write_chunk(number, chunk.columns, self.about)
                del waiting[task]
                self._keep(number, chunk.columns)
                swarm_runs = int(chunk.columns["evaluations"].sum())
                seeds = len(self.plan.config.noise_seeds or (0,))
                self.runs += seeds * (swarm_runs + chunk.columns["landscape"].size)
                self.folder.note(chunk=number, seconds=chunk.seconds, worker=chunk.worker)
                self._tell()

    def _keep(self, number: int, columns: Columns) -> None:
        streams = self.part(number)
        if not np.array_equal(columns["stream"], streams):
            raise StorageError(f"{self.folder.chunk(number)}: holds other operating points than it should: remove it.")
        self.kept[number] = columns
        self.done += len(streams)

    def _wind_up(self, waiting: dict[Future[Chunk], int]) -> None:
        """After Ctrl-C: drop what has not begun, finish what has, unless the user insists."""
        for task in list(waiting):
            if task.cancel():
                del waiting[task]
        with suppress(KeyboardInterrupt, CancelledError):  # then their time is wasted, no more
            self._collect(waiting)
        raise CampaignInterrupted(f"interrupted. {self._hint()}") from None

    def _hint(self) -> str:
        return (
            f"{len(self.kept)} of {self.folder.chunks} chunks are kept in {self.folder.path}; "
            "go on with --resume (resume=True)."
        )

    def _tell(self) -> None:
        if self.progress is not None:
            total, seconds = len(self.plan.fold.representatives), time.perf_counter() - self.begun
            mine = self.done - self.found
            left = seconds * (total - self.done) / mine if mine else (math.inf if self.done < total else 0.0)
            self.progress(Progress(self.done, total, self.runs, seconds, left))

    def merge(self) -> None:
        """Put the chunks together in the order of the operating points, twins included."""
        parts = [self.kept[number] for number in range(self.folder.chunks)]
        generations = {part["trace"].shape[1] for part in parts}
        if len(generations) > 1:
            raise ContractError(f"the objective's traces differ in length: {sorted(generations)} generations.")
        fold, numbers = self.plan.fold, np.arange(len(self.plan.operating_points))
        columns = {each.name: np.concatenate([part[each.name] for part in parts])[fold.family] for each in COLUMNS}
        origin = fold.representatives[fold.family]
        columns |= dict(zip(NAMES, self.plan.operating_points.T, strict=True))
        columns |= {"stream": numbers, "mirrored_from": np.where(origin == numbers, -1, origin)}
        settings = self.plan.settings
        about = {**self.about, "settings": settings, "library": self.plan.library.tolist()}
        self.folder.write_dataset(columns, about)
