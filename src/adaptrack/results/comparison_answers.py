"""What a comparison answers, in a sentence or two: the first line of its command.

Every sentence is chosen by the numbers: what an interval does not decide is called level, never better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from adaptrack.base.statistics import Ratio
from adaptrack.comparison.table import Comparison
from adaptrack.comparison.views import road_rows, standing_rows
from adaptrack.results.answers import length
from adaptrack.results.words import counted, few, listed, number

WORTH = 0.02
"""Share of the cost that a schedule must save to be worth having: it needs a guard and a certificate of its own."""


def less_or_more(ratio: Ratio, than: str) -> str:
    """A cost beside another: "6 % less than the default (0.941 times, 95 % interval 0.92 to 0.96)"."""
    interval = f"({number(ratio.mean)} times, 95 % interval {number(ratio.low)} to {number(ratio.high)})"
    if ratio.mean >= 2.0:
        return f"{number(ratio.mean - 1.0, 2)} times more than {than} {interval}"
    share = number(100.0 * abs(1.0 - ratio.mean), 2)
    return f"{share} % {'less' if ratio.mean < 1.0 else 'more'} than {than} {interval}"


# -- one constant -----------------------------------------------------------------------------------------------------
def of_tuning(name: str, ratio: Ratio, better: bool) -> str:
    """Of a search on roads. ratio: cost of the tuned controller over the default's, on noise that no search saw."""
    if not better:
        return f"The search found nothing better than the default of {name}, which is kept."
    first = f"{name}, tuned, costs {less_or_more(ratio, 'its default')} on noise that the search did not see"
    return f"{first}{_sure(ratio)}."


def _sure(ratio: Ratio) -> str:
    if ratio.verdict == "level":
        return "; the interval holds 1: not sure"
    return "" if ratio.verdict == "cheaper" else ": keep the default, or search on more roads"


# -- on roads ---------------------------------------------------------------------------------------------------------
def on_roads(made: Comparison) -> str:
    """Who costs least, by how much, how far off the road, and who failed."""
    rows = {row["contender"]: row for row in road_rows(made)}
    first, *level = made.best
    where = f"On {counted(len(made.roads), 'road')} with {counted(len(made.seeds), 'noise seed')} each"
    words = f"{where}, {first} costs least{f', level with {listed(level)}' if level else ''}"
    others = sorted(set(rows) - {first, *level}, key=lambda contender: made.mean_ratio(contender, first))
    errors = [f"{length(rows[first]['rms_error'])} RMS"]
    if others:
        second = others[0]
        errors.append(f"then {second} with {number(made.mean_ratio(second, first))} times its cost, "
                      f"{length(rows[second]['rms_error'])}")  # fmt: skip
    return f"{words}: {', '.join(errors)}. {_failed(rows.values())}"


def _failed(rows: Any) -> str:
    failed = [f"{row['contender']} in {row['failures']} of {row['runs']} runs" for row in rows if row["failures"]]
    return f"Failed: {listed(failed)}." if failed else "No run failed."


# -- on cars and roads ------------------------------------------------------------------------------------------------
def on_cars(profile: str, made: Comparison) -> str:
    """Who is first in the RMS error, how the best of the others stands, and where a default beats its tuning."""
    rows = standing_rows(made)
    first, rest = [row for row in rows if row["rank"] == 1], [row for row in rows if row["rank"] > 1]
    labels = [row["label"] for row in first]
    words = f"Profile {profile}: {few(labels, 'other', 4)} {'is' if len(first) == 1 else 'are'} first in the RMS error"
    words += f" ({length(min(row['rms_error'] for row in first))})"
    if rest:
        best = min(rest, key=lambda row: row["rms_ratio"])
        over = made.ratio(best["label"], labels[0], "rms_error")
        words += (
            f"; best behind: {best['label']}, {number(over.mean)} times the error of {labels[0]} "
            f"({number(over.low)} to {number(over.high)})"
        )
    return f"{words}.{''.join(f' {each}' for each in worse_tuned(made))} {_failed(_as_contenders(rows))}"


def _as_contenders(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    return [{**row, "contender": row["label"]} for row in rows]


def worse_tuned(made: Comparison) -> list[str]:
    """A sentence for each controller whose default has, for sure, a smaller error than the tuning that was found."""
    sentences = []
    for label in made.contenders:
        name = made.role(label).controller
        default = f"{name}, default"
        if made.role(label).tuning != "tuned" or default not in made.contenders:
            continue
        over, cost = made.ratio(label, default, "rms_error"), made.ratio(label, default)
        if over.low > 1.0:
            why = (
                f"it was sought for J, which is {less_or_more(cost, 'that of the default')}"
                if cost.mean < 1.0
                else "the search had too few roads or closed loops (--budget)"
            )
            interval = f"({number(over.low)} to {number(over.high)})"
            sentences.append(f"{label}, has {number(over.mean)} times the error of its default {interval}: {why}.")
    return sentences


# -- schedules --------------------------------------------------------------------------------------------------------
def best_schedule(made: Comparison) -> str | None:
    """The cheapest contender that could be deployed and whose tuning changes while it drives; None where none does.

    Of the same controller as the reference: another one's schedules are compared by `compare`.
    """
    controller = made.role(made.reference).controller
    roles = {contender: made.role(contender) for contender in made.adaptive}
    fit = [contender for contender, role in roles.items() if role.deployable and role.controller == controller]
    return min(fit, key=lambda contender: made.mean_ratio(contender, made.reference), default=None)


def best_constant(made: Comparison) -> str:
    """The cheapest contender that keeps one tuning, of the same controller as the schedules; else the reference."""
    kinds = ("best constant", "standard")
    return min(
        made.of_kind(*kinds), key=lambda contender: made.mean_ratio(contender, made.reference), default=made.reference
    )


def is_worth(ratio: Ratio) -> bool:
    """Whether a schedule saves enough over a constant: for sure something, and `WORTH` in the mean."""
    return ratio.high < 1.0 and ratio.mean <= 1.0 - WORTH


def of_schedules(made: Comparison, noun: str) -> str:
    """What the best schedule saves over the best constant, and whether that is worth it; noun: of a run."""
    schedule, constant = best_schedule(made), best_constant(made)
    runs = counted(made.table(made.reference).size, noun)
    if schedule is None:
        first, *level = made.best
        return f"On {runs} {first} costs least{f', level with {listed(level)}' if level else ''}."
    over = made.ratio(schedule, constant)
    worth = "worth it" if is_worth(over) else "not worth it" if over.verdict != "level" else "level, not worth it"
    return f"On {runs} the best schedule, {schedule}, costs {less_or_more(over, f'the {constant}')}: {worth}."
