"""Sample, status and answer of an exported tracker in C: members with their remarks, and where they are read."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

from adaptrack.core.friction_estimate import FRICTION_MEMORY
from adaptrack.core.kernel import Field, fields_of
from adaptrack.core.speed_control import SPEED_REQUEST
from adaptrack.core.tracker.signals import STATUS, TRACKED, TRACKER_SAMPLE

TYPES = {"status": "adaptrack_status", "suspect": "uint64_t", "speed_state": "adaptrack_speed_state",
         "limited_by": "adaptrack_speed_limit"}  # fmt: skip
"""Types of whole numbers that are not int."""
NAMES = {"belief_state": "belief", "belief_at_bound": "at_bound"}
"""Names of members that differ from those of the signals."""
_FRICTION = {f"friction_{end}": FRICTION_MEMORY._fields.index(end) for end in ("low", "high")}
WIDTH = 120


def signal_texts() -> dict[str, str]:
    """Return the texts of the C sources that follow from the signals, by their marks."""
    tracked, requests = fields_of(TRACKED), fields_of(SPEED_REQUEST)
    first, later = tracked[: TRACKED.first_top_speed], tracked[TRACKED.first_top_speed :]
    reads = [f"    answer->{_name(field)} = {_tracked_value(field)};" for field in tracked]
    request_reads = [f"    answer->{field.name} = {_requested_value(field)};" for field in requests]
    statuses = [
        (f"ADAPTRACK_STATUS_{field.name.upper()} = {place}{',' * (place + 1 < len(STATUS))}", field.meaning)
        for place, field in enumerate(fields_of(STATUS))
    ]
    return {
        "SAMPLE": _remarked((f"double {field.name};", _remark(field)) for field in fields_of(TRACKER_SAMPLE)),
        "UNKNOWN": ", ".join(["NAN"] * len(TRACKER_SAMPLE)),
        "STATUSES": _remarked(statuses),
        "ANSWER": _members([*sorted(first, key=_is_whole), *later]),  # an order that programs rely on
        "REQUESTS": _members(requests),
        "READ_ANSWER": "\n".join(reads),
        "READ_REQUESTS": "\n".join(request_reads),
        "ANSWER_NUMBERS": _numbers(tracked),
        "REQUEST_NUMBERS": _numbers(requests),
    }


def _is_whole(field: Field) -> bool:
    return isinstance(field.default, int)


def _name(field: Field) -> str:
    return NAMES.get(field.name, field.name)


def _type(field: Field) -> str:
    return TYPES.get(field.name, "int" if _is_whole(field) else "double")


def _remark(field: Field) -> str:
    return f"{field.unit}, {field.meaning}" if field.unit else field.meaning


def _members(fields: Sequence[Field]) -> str:
    return _remarked((f"{_type(field)} {_name(field)};", _remark(field)) for field in fields)


def _remarked(lines: Iterable[tuple[str, str]]) -> str:
    """Lines of C, each with a remark behind it; remarks begin in one column."""
    lines, texts = list(lines), []
    begin = 5 + max(len(code) for code, _ in lines)
    for code, remark in lines:
        rows = textwrap.wrap(f"{remark} */", WIDTH - begin - 3)
        texts.append(f"    {code}".ljust(begin) + "/* " + ("\n" + " " * (begin + 3)).join(rows))
    return "\n".join(texts)


def _tracked_value(field: Field) -> str:
    """A number of the kernel's row `tracked` as its member."""
    value, kind = f"tracked[{TRACKED._fields.index(field.name)}]", _type(field)
    if kind in ("double", "uint64_t"):
        return value if kind == "double" else f"bits({value})"
    return f"small({value})" if kind == "int" else f"({kind})small({value})"


def _requested_value(field: Field) -> str:
    """A number of the speed control as its member; its memory begins with the requests."""
    if field.name in _FRICTION:
        return f"friction[{_FRICTION[field.name]}]"
    value = f"memory[{SPEED_REQUEST._fields.index(field.name)}]"
    return f"({_type(field)}){value}.whole" if _is_whole(field) else f"{value}.number"


def _numbers(fields: Sequence[Field]) -> str:
    """The members of an answer as numbers of an array."""
    values = (f"{'(double)' * _is_whole(field)}answer->{_name(field)}," for field in fields)
    return textwrap.indent(textwrap.fill(" ".join(values), WIDTH - 8), " " * 8)
