"""Numbers and names, formatted for readers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.presentation import printable
from adaptrack.base.result import Column

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_THIN_SPACE = "\u202f"


def number(value: float | int | None, digits: int = 3) -> str:
    """`digits` significant digits or a few more, no exponent from 1e-4 to 1e6; a dash for NaN and None."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if isinstance(value, int):
        text = f"{value:,}"
    elif value == 0.0:
        text = "0"
    else:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        if -4 <= int(exponent) < 6:
            text = f"{value:,.{max(digits - 1 - int(exponent), 0)}f}"
        else:
            text = f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPTS)}"
    return text.replace(",", _THIN_SPACE).replace("-", "−")


def entry(value: Any, column: Column) -> str:
    """Format a value of a table for a page."""
    if isinstance(value, tuple):
        ends = [entry(end, column) for end in value]
        if isinstance(column.show, int) and len(set(ends)) < len(set(value)):  # as many digits as tell them apart
            ends = [number(end, column.show + 1) for end in value]
        return " to ".join(ends)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str) or value is None:
        return value or "–"
    if column.show == "percent":
        return percent(value)
    if column.show == "power" and math.isfinite(value) and value != 0.0:
        mantissa, exponent = f"{value:.1e}".split("e")
        return f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPTS)}".replace("-", "−")
    if column.show == "whole":
        return number(round(value))
    if column.show == "given":
        return f"{value:g}"
    if column.show == "degrees":
        return f"{number(value, 3)} ({number(math.degrees(value), 3)})"
    return number(value, column.show if isinstance(column.show, int) else 3)


def percent(share: float) -> str:
    """A share 0..1 in percent, without the sign; what is not zero does not look like zero; a dash for NaN."""
    if share == 0.0 or math.isnan(share):
        return number(share)
    return "< 0.1" if share < 0.001 else f"{100 * share:.1f}"


def length(metres: float) -> str:
    """Write a length in mm, cm, m or km, to two or three digits."""
    if not math.isfinite(metres):
        return "unknown"
    if metres < 0.01:
        return f"{1000.0 * metres:.2g} mm"
    if metres < 0.995:
        return f"{100.0 * metres:.2g} cm"
    return f"{metres:.3g} m" if metres < 1000.0 else f"{metres / 1000.0:.3g} km"


def span(values: NDArray[Any], digits: int = 3) -> str:
    """The common value of all, or "lowest to highest"."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "–"
    low, high = (f"{bound + 0.0:.{digits}g}".replace("-", "−") for bound in (finite.min(), finite.max()))
    return low if low == high else f"{low} to {high}"


def listed(words: Sequence[str]) -> str:
    """Join words as a list: a; a and b; a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def few(names: Iterable[str], noun: str) -> str:
    """For a title: up to three names as a list, or else their number."""
    shown_names = list(names)
    return listed(shown_names) if 0 < len(shown_names) <= 3 else counted(len(shown_names), noun)


def counted(n: int, noun: str) -> str:
    """A number with its noun: 1 drive, 300 drives."""
    return f"{number(n)} {noun}{'' if n == 1 else 's'}"


def plain(label: str) -> str:
    """Remove the mathematical markup from a label of a figure."""
    return re.sub(r"\\mathrm\{(\w+)\}|\$", r"\1", label).replace(r"\log_{10}", "log10")


def legible(name: str, longest: int = 80) -> str:
    """Make any name printable, and cut it if it is too long."""
    text = printable(name[: longest + 1])
    return text if len(text) <= longest else text[: longest - 1] + "…"


def data_text(text: str) -> str:
    """Escape a name from data for a picture, so that it is not read as mathematics; cut if it is too long."""
    return legible(text).replace("$", r"\$")


def capital(text: str) -> str:
    """Make the first letter a capital."""
    return text[:1].upper() + text[1:]


def title_of(name: str) -> str:
    """A registered name as words: ``triple-lane-change`` becomes "Triple lane change"."""
    words = legible(name).replace("-", " ").replace("_", " ").strip()
    return words[:1].upper() + words[1:] if words else "Unnamed scenario"


def controller_name(name: str) -> str:
    """A controller's name as a label: as the paper writes it, where the paper has it."""
    paper_names = {"standard": "Standard MPC", "nn": "NN-MPC", "anfis": "ANFIS-MPC"}
    name = legible(name)
    return paper_names.get(name) or name[:1].upper() + name[1:] or "Controller"


def clock(moment: str) -> str:
    """An ISO 8601 time to the minute; other text as it stands."""
    try:
        when = datetime.fromisoformat(moment)
    except ValueError:
        return moment
    zone = when.strftime("%Z").replace("+00:00", "")
    return f"{when:%Y-%m-%d %H:%M} {zone}".strip()


def slug(text: str) -> str:
    """`text` as a file name or an anchor: lower-case words joined by hyphens."""
    return re.sub(r"[^\w]+", "-", text.lower()).strip("-") or "part"
