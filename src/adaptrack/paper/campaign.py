"""Campaigns: a particle swarm at every operating point, on all cores or the workers of a cluster.

    config = load_campaign("paper-grid")
    file = run_campaign(config, "out")

A campaign writes its operating points in parts, `out/parts/NNNNN.parquet`; each part is a data set of its own. A
campaign that was interrupted continues with the parts that are missing. The data set depends on the configuration and
the software only: not on the number of workers, the interruptions, or other processes that work in the same folder.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import re
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack import __version__
from adaptrack.base.checked import Count, checked
from adaptrack.base.errors import AdaptrackError, ContractError, InvalidInput, MissingExtra, StorageError
from adaptrack.base.files import Damaged, make_folder
from adaptrack.base.progress import ProgressCall, reports_progress
from adaptrack.cars.plant import DualTrack, SingleTrack, fingerprint
from adaptrack.control.controllers import MPC, Tuning, published_mpc
from adaptrack.core.library import kernels_hash
from adaptrack.core.maths.portable import Array
from adaptrack.paper.campaign_config import STANDARD_ROW, CampaignConfig, CampaignPlan, Setup
from adaptrack.paper.data_set import DataSet
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.objective import Objective, PointTuning

# -- workers of a cluster ---------------------------------------------------------------------------------------------
DASK_TIMEOUT = 5.0
"""s, for the connection to a scheduler, and then for its first worker"""

_ADDRESS = re.compile(r"(?:[a-z]+://)?(?:[^\s:/\[\]]+|\[[0-9A-Fa-f:.]+\]):(?P<port>[0-9]{1,5})/?")
"""tcp://host:port or host:port"""


def dask_client(address: str) -> Any:
    """A `distributed.Client` of the scheduler at an address, once it has a worker.

    Raises MissingExtra when Dask is not installed, and InvalidInput for text that is no address, and when no scheduler
    answers there or it has no worker.
    """
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise MissingExtra("Dask is not installed; install it: python -m pip install 'adaptrack[cluster]'") from None
    form = _ADDRESS.fullmatch(address)
    if form is None or not 0 < int(form["port"]) < 65536:
        raise InvalidInput(f"cluster = {address!r}: not an address; give one like tcp://127.0.0.1:8786.")
    try:
        _check_scheduler(distributed, address)
        client = distributed.Client(address, timeout=DASK_TIMEOUT, set_as_default=False)
    except Exception as error:  # a server other than Dask's can cause almost any error
        reason = str(error) or f"no answer within {DASK_TIMEOUT:g} s"
        raise InvalidInput(f"cluster = {address!r}: no Dask scheduler answers there ({reason}).") from None
    try:
        client.wait_for_workers(1, timeout=DASK_TIMEOUT)
    except TimeoutError:
        client.close()
        raise InvalidInput(
            f"cluster = {address!r}: the scheduler has no workers; start one: dask worker {address}"
        ) from None
    except BaseException:
        client.close()
        raise
    return client


def _check_scheduler(distributed: Any, address: str) -> None:
    """Ask a server for its type within `DASK_TIMEOUT`: a client would wait for a silent server without end."""

    async def ask() -> str:
        options = distributed.Security().get_connection_args("client")
        server = await distributed.core.connect(address, timeout=0.8 * DASK_TIMEOUT, **options)
        return str((await distributed.core.send_recv(server, op="identity", close=True))["type"])

    server_type = distributed.utils.LoopRunner().run_sync(ask, callback_timeout=DASK_TIMEOUT)
    if server_type != "Scheduler":
        raise OSError(f"the server is a {server_type}")


# -- the closed loop --------------------------------------------------------------------------------------------------
def tuned_mpc(setup: Setup, tuning: Tuning | None = None, **options: Any) -> MPC:
    """The paper's MPC for a campaign's car and profile, by default with the paper's tuning.

    options: of `MPC`.
    """
    profile = load_profile(setup.config.profile)
    return published_mpc(setup.vehicle, tuning, period=profile.period, preview=profile.preview, **options)


def campaign_objective(setup: Setup) -> Objective:
    """The cost of a tuning in a campaign: its plant or the plant's twin, its profile, and the MPC with free moves."""
    config = setup.config
    Np, Nc = config.search.Np[1], config.search.Nc[1]
    mpc = tuned_mpc(setup, longest_horizon=max(60, Np), most_moves=max(20, Nc))
    return Objective(
        plant=setup.searched_on,
        mpc=mpc,
        test=config.scenario,
        profile=load_profile(config.profile),
        noise_seeds=config.noise_seeds or (0,),
        move_weight=config.move_weight,
        duration=config.duration,
        failure=config.failure.rule,
    )


StreamNumbers = NDArray[np.int64]
Map = Callable[..., Iterable["TunedPoint"]]
"""The `map` of an executor"""


Software = tuple[tuple[str, str], ...]
"""Versions of the software by name, see `software_versions`"""


# -- one operating point ----------------------------------------------------------------------------------------------
class TunedPoint(NamedTuple):
    """The best tuning at an operating point, and the cost of the library there."""

    best: PointTuning
    standard_cost: float
    """m^2, of the paper's tuning"""
    landscape: Array
    """(T,) m^2, of the library's tunings"""


def software_versions(setup: Setup) -> dict[str, str]:
    """The software on which the last digit of a cost depends; the kernels by their hash."""
    plant = setup.searched_on
    user_plant = {} if isinstance(plant, SingleTrack | DualTrack) else {"plant": fingerprint(plant)}
    return {"adaptrack": __version__, **user_plant, "kernels": kernels_hash(), "numpy": version("numpy")}


@lru_cache(maxsize=4)
def objective_and_library(setup: Setup, software: Software) -> tuple[Objective, Array]:
    """The closed loop and the library of a campaign, prepared once in each process.

    software: of the process that started the campaign; ContractError when this process runs other software.
    """
    config, present = setup.config, tuple(software_versions(setup).items())
    if present != software:
        raise ContractError(f"a worker runs other software than the campaign: {present}, not {software}.")
    return campaign_objective(setup), config.library.rows(config.search)


def tune_point(setup: Setup, software: Software, stream: int, point: Array) -> TunedPoint:
    """Search the best tuning at an operating point (4,) and evaluate the library there.

    stream: the number of the operating point; random numbers depend on it and on the campaign's seed only.
    """
    config = setup.config
    objective, library = objective_and_library(setup, software)
    is_standard = (library == np.array(STANDARD_ROW)).all(axis=1)
    tunings = library if is_standard.any() else np.vstack([library, STANDARD_ROW])
    best = objective.tune(point.tolist(), config.swarm, config.seed, stream, config.search.space())
    costs = objective.costs(point.tolist(), tunings)
    standard = int(np.argmax(is_standard)) if is_standard.any() else -1
    return TunedPoint(best, float(costs[standard]), costs[: len(library)])


# -- parts ------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class CampaignParts:
    """The part files of a campaign, each with the hashes of settings and kernels in its metadata."""

    plan: CampaignPlan
    folder: Path
    provenance: Mapping[str, Any]
    """name, versions of the software, settings and identity (the hash of the settings)"""

    @cached_property
    def streams(self) -> list[StreamNumbers]:
        """The numbers of the operating points of each part."""
        computed, size = self.plan.fold.representatives, self.plan.config.chunk
        return [computed[first : first + size] for first in range(0, len(computed), size)]

    def file(self, number: int) -> Path:
        """The file of a part."""
        return self.folder / "parts" / f"{number:05d}.parquet"

    def missing(self) -> list[int]:
        """The numbers of the parts that are not there.

        Raises StorageError when a part is damaged or belongs to another campaign or other software.
        """
        return [number for number in range(len(self.streams)) if self.read(number) is None]

    def read(self, number: int) -> DataSet | None:
        """A part; None when its file does not exist. Raises like `missing`."""
        file = self.file(number)
        if not file.exists():
            return None
        try:
            part = DataSet.load(file)
        except Damaged as error:
            raise StorageError(f"{error} Remove this part, and run the campaign again.") from None
        for key, name in (("settings", "settings"), ("versions", "software")):
            if part.provenance.get(key) != self.provenance[key]:
                difference = _difference(part.provenance, self.provenance, key)
                raise StorageError(
                    f"{file}: was computed with other {name} ({difference}): choose another folder, or remove this one."
                )
        if not np.array_equal(part.stream, self.streams[number]):
            raise StorageError(f"{file}: holds other operating points; was `chunk` changed? Choose another folder.")
        return part

    def write(self, number: int, points: Iterable[TunedPoint]) -> None:
        """Write a part: aside, then renamed, so that a part is whole or missing. Of two writers the last one wins."""
        best, standard_costs, landscape = zip(*points, strict=True)
        streams = self.streams[number]
        count = len(streams)
        DataSet(
            operating_points=self.plan.operating_points[streams],
            tunings=np.array([tuned.tuning for tuned in best]),
            costs=np.array([tuned.cost for tuned in best]),
            standard_costs=np.array(standard_costs),
            traces=np.array([tuned.trace for tuned in best], np.float32),
            landscape=np.array(landscape, np.float32),
            library=self.plan.library,
            evaluations=np.array([tuned.evaluations for tuned in best]),
            control_steps=np.array([tuned.control_steps for tuned in best]),
            stream=streams,
            mirrored_from=np.full(count, -1),
            seed=np.full(count, self.plan.config.seed),
            provenance=dict(self.provenance),
        ).save(self.file(number))

    def merged(self) -> DataSet:
        """The data set: all parts in the order of the operating points, left-right twins included."""
        parts = [part for number in range(len(self.streams)) if (part := self.read(number)) is not None]
        fold, numbers = self.plan.fold, np.arange(len(self.plan.operating_points))
        origin = fold.representatives[fold.family]
        columns = {
            name: np.concatenate([getattr(part, name) for part in parts])[fold.family] for name in DataSet.ROW_FIELDS
        } | {
            "operating_points": self.plan.operating_points,
            "stream": numbers,
            "mirrored_from": np.where(origin == numbers, -1, origin),
        }
        return DataSet(**columns, library=self.plan.library, provenance=dict(self.provenance))


def _difference(theirs: Mapping[str, Any], ours: Mapping[str, Any], key: str) -> str:
    """The first entry in which the settings or the versions of two campaigns differ."""
    previous, current = theirs.get(key) or {}, ours[key]
    name = next(name for name in sorted({*previous, *current}) if previous.get(name) != current.get(name))
    return f"{name} = {previous.get(name)} there, {current.get(name)} here"


# -- the campaign -----------------------------------------------------------------------------------------------------
@reports_progress("campaign")
@checked
def run_campaign(
    config: CampaignConfig,
    out: str | os.PathLike[str],
    *,
    workers: Count | None = None,
    cluster: str | None = None,
    progress: ProgressCall | None = None,
) -> Path:
    """Tune every operating point of a campaign in the folder `out`; the path of the data set, for `load_dataset`.

    Parts that are in the folder are not computed again: after an interruption, call it again. workers: processes, by
    default one per core; 1 computes in this process. cluster: the address of a Dask scheduler whose workers compute
    instead. progress: called with "campaign", the operating points computed, and those to compute.

    Worker processes import the main script: protect its body by `if __name__ == "__main__":`.

    Raises
    ------
    InvalidInput
        When the configuration or an argument is invalid, or the cluster has no worker.
    StorageError
        When `out` cannot be written to, or holds parts of another campaign or of other software.
    MissingExtra
        When `cluster` is given and Dask is not installed.
    AdaptrackError
        When a worker process was killed; finished parts remain.
    """
    if workers is not None and cluster is not None:
        raise InvalidInput("workers and cluster: give one of them; a cluster has its own workers.")
    plan = CampaignPlan.of(config)
    provenance = {
        "name": config.name, "versions": software_versions(plan.setup), "settings": plan.settings,
        "identity": plan.identity,
    }  # fmt: skip
    parts = CampaignParts(plan, Path(out), provenance)
    make_folder(parts.file(0).parent)
    missing = parts.missing()
    if missing:
        with _opened_map(workers, cluster) as map_points:
            _compute(parts, missing, map_points, progress)
    file = parts.folder / "dataset.parquet"
    parts.merged().save(file)
    return file


def _compute(parts: CampaignParts, missing: list[int], map_points: Map, progress: ProgressCall | None) -> None:
    """Compute parts, and write each one when its last operating point is there."""
    tune = partial(tune_point, parts.plan.setup, tuple(parts.provenance["versions"].items()))
    streams = np.concatenate([parts.streams[number] for number in missing])
    points = parts.plan.operating_points[streams]
    tuned = _counted(map_points(tune, streams.tolist(), points), len(streams), progress)
    try:
        for number in missing:
            parts.write(number, islice(tuned, len(parts.streams[number])))
    except BrokenProcessPool:
        raise AdaptrackError(
            'a worker process ended: it was killed, or the main script has no `if __name__ == "__main__":`. Finished '
            f"parts are in {parts.folder}: run the campaign again to continue."
        ) from None


def _counted(points: Iterable[TunedPoint], total: int, progress: ProgressCall | None) -> Iterator[TunedPoint]:
    """The points, each reported to `progress` when it is there."""
    for count, point in enumerate(points, 1):
        if progress is not None:
            progress("campaign", count, total)
        yield point


@contextmanager
def _opened_map(workers: int | None, cluster: str | None) -> Iterator[Map]:
    """The `map` of this process, of worker processes, or of a cluster."""
    if cluster is not None:
        with dask_client(cluster) as client:
            yield client.get_executor(retries=3, pure=False).map
    elif workers == 1:
        yield map
    else:
        context = multiprocessing.get_context("spawn")  # the same on every system, and safe beside threads
        pool = ProcessPoolExecutor(workers or _cores(), context, initializer=_start_worker)
        try:
            yield pool.map
        finally:
            pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    """Leave Ctrl-C to the process that started this one, and end when that process is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
