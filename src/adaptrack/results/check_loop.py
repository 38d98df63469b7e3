"""Result of a check for contradictory inputs of a control loop."""

from __future__ import annotations

from adaptrack.base.result import Column, Result, ResultTable
from adaptrack.identification.loop_check import LEAST, LoopCheck

INPUT_CHECK_COLUMNS = (
    Column("compared", "compared signals"),
    Column("seconds", "time", "s", meaning="driving time in which both signals could be compared"),
    Column("verdict", "verdict"),
)


def check_result(check: LoopCheck, log: str, notes: tuple[str, ...] = (), command: str = "") -> Result:
    """Return the result with the contradictions of a log and all comparisons."""
    rows = [
        _row(finding.compared, finding.seconds, bool(finding.label), finding.seconds > LEAST)
        for finding in check.findings
    ] + [
        _row(agreement.compared, check.seconds * agreement.clear, bool(agreement.contradiction), agreement.clear)
        for agreement in check.agreements
    ]  # fmt: skip
    sliding = (f"The car slid for {check.sliding:.1f} s.",) if check.sliding else ()
    answer = f"No contradictions in {check.compared} of {len(rows)} comparisons; the others lack a log column or bends."
    if check.contradictions:
        answer = f"Inputs contradict each other. {check.contradictions[0]}"
    return Result(
        kind="check-loop",
        title=f"Inputs of a loop: {log}",
        answer=answer,
        record={"log": log, "seconds": check.seconds, "sliding": check.sliding,
                "contradictions": list(check.contradictions), "possibilities": list(check.possibilities),
                "compared": rows},
        tables=[ResultTable("console", f"{check.seconds:.0f} s of {log}", INPUT_CHECK_COLUMNS, rows, brief=True)],
        notes=[*check.contradictions[1:], *check.possibilities, *(f"{note}." for note in notes), *sliding],
        failed=bool(check.contradictions),
        command=command,
    )  # fmt: skip


def _row(compared: str, seconds: float, contradicts: bool, clear: bool) -> dict[str, str | float]:
    verdict = "contradictory" if contradicts else "consistent" if clear else "unknown"
    return {"compared": compared, "seconds": seconds, "verdict": verdict}
