"""Sample, status and answer of an exported tracker in C: members with their remarks, and where they are read."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

from adaptrack.core.kernel import Field, fields_of
from adaptrack.core.speed.friction import FRICTION_MEMORY
from adaptrack.core.speed.speed_control import SPEED_REQUEST
from adaptrack.core.tracker.signals import STATUS, TRACKED, TRACKER_SAMPLE

TYPES = {"status": "adaptrack_status", "suspect": "uint64_t", "speed_state": "adaptrack_speed_state",
         "limited_by": "adaptrack_speed_limit"}  # fmt: skip
"""Types of whole numbers that are not int."""
MEMBER_NAMES = {"belief_state": "belief", "belief_at_bound": "at_bound"}
"""Names of members that differ from those of the signals."""
WIDTH = 120


def signal_texts() -> dict[str, str]:
    """Return the texts of the C sources that follow from the signals, by their marks."""
    tracked, requests = fields_of(TRACKED), fields_of(SPEED_REQUEST)
    first, later = tracked[: TRACKED.first_top_speed], tracked[TRACKED.first_top_speed :]
    comma = [","] * (len(STATUS) - 1) + [""]
    return {
        "SAMPLE": _members(fields_of(TRACKER_SAMPLE), "double"),
        "UNKNOWN": ", ".join(["NAN"] * len(TRACKER_SAMPLE)),
        "STATUSES": _remarked(
            (f"ADAPTRACK_STATUS_{field.name.upper()} = {i}{comma[i]}", field)
            for i, field in enumerate(fields_of(STATUS))
        ),
        "ANSWER": _members([*sorted(first, key=_is_whole), *later]),  # an order that programs rely on
        "REQUESTS": _members(requests),
        "READ_ANSWER": "\n".join(
            f"    answer->{_name(field)} = {_tracked(i, field)};" for i, field in enumerate(tracked)
        ),
        "READ_REQUESTS": "\n".join(
            f"    answer->{field.name} = {_requested(i, field)};" for i, field in enumerate(requests)
        ),
        "ANSWER_NUMBERS": _numbers(tracked),
        "REQUEST_NUMBERS": _numbers(requests),
    }


def _is_whole(field: Field) -> bool:
    return isinstance(field.default, int)


def _name(field: Field) -> str:
    return MEMBER_NAMES.get(field.name, field.name)


def _type(field: Field) -> str:
    return TYPES.get(field.name, "int" if _is_whole(field) else "double")


def _members(fields: Iterable[Field], kind: str = "") -> str:
    return _remarked((f"{kind or _type(field)} {_name(field)};", field) for field in fields)


def _remarked(lines: Iterable[tuple[str, Field]]) -> str:
    """Lines of C, each with unit and meaning of a field behind it; these remarks begin in one column."""
    lines, texts = list(lines), []
    begin = 5 + max(len(code) for code, _ in lines)
    for code, field in lines:
        remark = ", ".join(filter(None, (field.unit, field.meaning)))
        rows = textwrap.wrap(f"{remark} */", WIDTH - begin - 3)
        texts.append(f"    {code}".ljust(begin) + "/* " + ("\n" + " " * (begin + 3)).join(rows))
    return "\n".join(texts)


def _tracked(i: int, field: Field) -> str:
    """A number of the kernel's row `tracked` as a member."""
    if not _is_whole(field):
        return f"tracked[{i}]"
    return f"bits(tracked[{i}])" if _type(field) == "uint64_t" else f"({_type(field)})small(tracked[{i}])"


def _requested(i: int, field: Field) -> str:
    """A request as a member: of the memory of the speed control, which begins with requests, or of the friction."""
    if i >= SPEED_REQUEST.friction_low:
        return f"friction[{FRICTION_MEMORY._fields.index(field.name.removeprefix('friction_'))}]"
    return f"({_type(field)})memory[{i}].whole" if _is_whole(field) else f"memory[{i}].number"


def _numbers(fields: Iterable[Field]) -> str:
    """The members of an answer as numbers of an array."""
    values = (f"{'(double)' * _is_whole(field)}answer->{_name(field)}," for field in fields)
    return textwrap.indent(textwrap.fill(" ".join(values), WIDTH - 8), " " * 8)
