"""What a comparison answers, in a sentence or two: the first line of its command.

Every sentence is chosen by the numbers: what an interval does not decide is called level, never better.
"""

from __future__ import annotations

from adaptrack.base.statistics import Ratio
from adaptrack.comparison.table import Comparison
from adaptrack.results.words import counted, listed, number

WORTH = 0.02
"""Share of the cost that a schedule must save to be worth having: it needs a guard and a certificate of its own."""


def less_or_more(ratio: Ratio, than: str) -> str:
    """A cost beside another: "6 % less than the default (0.941 times, 95 % interval 0.92 to 0.96)"."""
    interval = f"({number(ratio.mean)} times, 95 % interval {number(ratio.low)} to {number(ratio.high)})"
    if ratio.mean >= 2.0:
        return f"{number(ratio.mean - 1.0, 2)} times more than {than} {interval}"
    share = number(100.0 * abs(1.0 - ratio.mean), 2)
    return f"{share} % {'less' if ratio.mean < 1.0 else 'more'} than {than} {interval}"


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
