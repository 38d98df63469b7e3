"""The result of a check of a loop's inputs."""

from __future__ import annotations

from adaptrack.base.result import Column, Result, ResultTable
from adaptrack.identification.loop_check import LoopCheck

LEAST = 2.0
"""s, from which on a comparison says something."""
COLUMNS = (
    Column("compared", "compared"),
    Column("seconds", "for", "s", meaning="of driving in which both could be compared"),
    Column("verdict", "verdict"),
)


def check_result(check: LoopCheck, log: str, notes: tuple[str, ...] = (), command: str = "") -> Result:
    """Return the contradictions between inputs as a result."""
    rows = [
        {
            "compared": each.compared, "seconds": each.seconds,
            "verdict": "contradict each other" if each.label else "agree" if each.seconds > LEAST else "cannot tell",
        }
        for each in check.found
    ]  # fmt: skip
    known = sum(row["verdict"] != "cannot tell" for row in rows)
    sliding = (f"The car slid for {check.sliding:.1f} s.",) if check.sliding else ()
    return Result(
        kind="check-loop",
        title=f"Inputs of a loop: {log}",
        answer=_answer(check, known, len(rows)),
        record={"log": log, "seconds": check.seconds, "sliding": check.sliding,
                "contradictions": list(check.contradictions), "compared": rows},
        tables=[ResultTable("console", f"{check.seconds:.0f} s of {log}", COLUMNS, rows, brief=True)],
        notes=[*check.contradictions[1:], *(f"{each}." for each in notes), *sliding],
        failed=bool(check.contradictions),
        command=command,
    )  # fmt: skip


def _answer(check: LoopCheck, known: int, relations: int) -> str:
    if check.contradictions:
        return f"Inputs contradict each other. {check.contradictions[0]}"
    if not known:
        return "Nothing could be compared: drive bends, and log speed with x, y and yaw, or yaw rate with the command."
    return f"No contradiction, in {known} of {relations} comparisons; the others lack a column or bends."
