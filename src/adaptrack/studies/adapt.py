"""From a configuration to schedulers that can be deployed: tune, learn, guard, evaluate."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from adaptrack.base.checked import checked
from adaptrack.cars.plant import DualTrack, SingleTrack, fingerprint
from adaptrack.comparison.evaluate import on_drives, on_operating_points, on_tests
from adaptrack.comparison.table import Comparison
from adaptrack.control.scheduling import Schedule, list_schedulers, load_scheduler, made_for
from adaptrack.learning.adaptation.config import AdaptationConfig
from adaptrack.learning.adaptation.recipes import Recipes, safe_candidates, stability_map
from adaptrack.learning.adaptation.splits import SetUp, evaluation_points
from adaptrack.paper.campaign import Progress as CampaignProgress
from adaptrack.paper.campaign import closed_loop, evaluator_of, run_campaign, versions_of
from adaptrack.paper.data_set import DataSet, load_dataset
from adaptrack.studies.pipeline import JSONFile, Keeper, Progress, SchedulerFile, Stage, identity_of, run, software

Comparisons = Mapping[str, Comparison]
History = list[dict[str, float]]

CAMPAIGN = "campaign"
CONTENDERS = (
    "best constant", "best constant on drives", "fallback", "speed look-up", "look-up", "speed only", "nn unguarded",
    "nn", "anfis unguarded", "anfis", "paper recipe nn", "paper recipe anfis",
)  # fmt: skip
"""The schedulers that an adaptation makes, in this order, see `recipes.Recipes`."""
EVALUATIONS = ("operating points", "drives", "tests")


@dataclass(frozen=True, eq=False)
class Adapted:
    """What an adaptation made."""

    schedules: Mapping[str, Schedule]
    """by contender, see `CONTENDERS`"""
    histories: Mapping[str, History]
    operating_points: Comparisons
    """by how friction and wind are known, "exact" first"""
    drives: Comparisons
    tests: Comparisons
    """the paper's two"""


@checked
def adapt(
    config: AdaptationConfig,
    out: str | os.PathLike[str],
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Adapted:
    """Run the whole adaptation in a folder, or go on with one.

    Raises
    ------
    InvalidInput
        When the configuration makes no sense, see `SetUp.of`, or no constant tuning can hold its domain.
    StorageError
        When the folder cannot be written, or holds something damaged.
    """
    folder, setup = Path(out), SetUp.of(config)
    evaluation_points(setup, 1, config.evaluation.seed)  # one that was learned from is refused before any work
    learning = learning_stages(setup, folder, workers=workers, progress=progress)
    made = run([*learning, *evaluation_stages(setup, folder, learning, progress=progress)], progress)
    schedules = {name: made[name] for name in CONTENDERS}
    return Adapted(schedules, histories(schedules), *(made[name] for name in EVALUATIONS))


def learn(
    setup: SetUp, folder: Path, *, workers: int | None = None, progress: Progress | None = None
) -> dict[str, Schedule]:
    """The schedulers of an adaptation alone, each in its file under `schedulers`."""
    made = run(learning_stages(setup, folder, workers=workers, progress=progress), progress)
    return {name: made[name] for name in CONTENDERS}


def histories(schedules: Mapping[str, Schedule]) -> dict[str, History]:
    """What `improve` noted of its rounds, of those that learned by it."""
    return {name: list(each.provenance["history"]) for name, each in schedules.items() if "history" in each.provenance}


def shipped(name: str) -> dict[str, Schedule]:
    """The schedulers of an adaptation that ship with the package, by contender."""
    here = set(list_schedulers())
    names = {contender: file_name(name, contender) for contender in CONTENDERS}
    return {contender: load_scheduler(file) for contender, file in names.items() if file in here}


def contender_of(file: str, adaptations: Iterable[str]) -> str | None:
    """Which contender of one of these adaptations a file of this name holds (without its ending); None: of none."""
    named = {file_name(name, contender): contender for name in adaptations for contender in CONTENDERS}
    return named.get(file)


def file_name(adaptation: str, contender: str) -> str:
    """What the file of a contender is called, without its ending."""
    return f"{adaptation}-{contender.replace(' ', '-')}"


# -- the stages -------------------------------------------------------------------------------------------------------
def stage_identity(setup: SetUp, stage: str) -> str:
    """What the result of a learning stage depends on: configuration, method, campaign, software."""
    return identity_of(stage, [setup.config.settings, setup.plan.identity])


def learning_stages(
    setup: SetUp, folder: Path, *, workers: int | None = None, progress: Progress | None = None
) -> list[Stage]:
    """The campaign, then every contender that is made."""
    show = progress or (lambda what, done, of: None)
    keeper = _CampaignFolder(setup, folder / "campaign", workers, show)
    recipes: list[Recipes] = []  # made with the data of the campaign, once

    def maker(name: str, made: Mapping[str, Any]) -> Schedule:
        if not recipes:
            recipes.append(Recipes(setup, made[CAMPAIGN], show))
        return recipes[0].all()[name](made)

    purpose = made_for(setup.mpc, setup.profile)
    twin = ", learned on its twin" if setup.plan.setup.plant().costly else ""
    purpose |= {"plant": f"{setup.campaign.plant}{twin}", "tyre": setup.plant.tyre_name}
    record = {"settings": setup.config.settings, "campaign": setup.plan.identity, "software": software()}
    return [
        Stage(CAMPAIGN, setup.plan.identity, keeper.make, keeper),
        *(
            Stage(
                name, stage_identity(setup, name), partial(maker, name),
                SchedulerFile(folder / "schedulers" / f"{file_name(setup.config.name, name)}.json", record, purpose),
            )
            for name in CONTENDERS
        ),
    ]  # fmt: skip


def evaluation_stages(
    setup: SetUp, folder: Path, learning: Sequence[Stage], *, progress: Progress | None = None
) -> list[Stage]:
    """The comparisons on operating points, drives and tests."""
    evaluation, ways = setup.evaluation, setup.evaluation.known_as

    def schedules(made: Mapping[str, Any]) -> dict[str, Schedule]:
        return {name: made[name] for name in CONTENDERS}

    makers = {
        "operating points": lambda made: on_operating_points(
            setup, schedules(made), evaluation.operating_points, evaluation.seed, known_as=ways, progress=progress
        ),
        "drives": lambda made: on_drives(
            setup, schedules(made), evaluation.drives, evaluation.seed, known_as=ways, progress=progress
        ),
        "tests": lambda made: on_tests(setup, schedules(made)),
    }
    settings = [evaluation.model_dump(mode="json"), [stage.identity for stage in learning]]
    if not isinstance(setup.driven, SingleTrack | DualTrack):
        settings.append(fingerprint(setup.driven))
    return [
        Stage(
            name, identity_of(name, settings), makers[name],
            JSONFile(folder / "comparisons" / f"{name.replace(' ', '-')}.json", _encoded, _decoded),
        )
        for name in EVALUATIONS
    ]  # fmt: skip


def _encoded(comparisons: Comparisons) -> dict[str, Any]:
    return {name: each.as_json() for name, each in comparisons.items()}


def _decoded(content: Mapping[str, Any]) -> dict[str, Comparison]:
    return {name: Comparison.from_json(each) for name, each in content.items()}


@dataclass(frozen=True, eq=False)
class _CampaignFolder(Keeper):
    """The folder of a campaign, whose data set holds its identity and versions."""

    setup: SetUp
    place: Path
    workers: int | None
    show: Progress

    def load(self, identity: str) -> DataSet | None:
        finished = self.place / "dataset.parquet"
        if not finished.exists():
            return None
        found = load_dataset(finished)
        versions = versions_of(evaluator_of(closed_loop, self.setup.plan.setup))
        current = found.provenance.get("identity") == identity and found.provenance.get("versions") == versions
        return found if current else None

    def make(self, made: Mapping[str, Any]) -> DataSet:
        """Tune, or go on with what is there; the folder refuses another campaign or other software.

        A domain that no fallback can hold is refused before the first run.
        """

        def tell(at: CampaignProgress) -> None:
            self.show(CAMPAIGN, at.done, at.total)

        resume = self.place.exists()
        if not resume:
            safe_candidates(stability_map(self.setup), self.setup.method.constants)
        file = run_campaign(self.setup.campaign, self.place, resume=resume, workers=self.workers, progress=tell)
        return load_dataset(file)

    def save(self, result: DataSet, identity: str) -> None:
        """It was saved while it was made."""
