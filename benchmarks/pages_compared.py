"""Which numbers of pages are missing on their successors: python benchmarks/pages_compared.py BEFORE AFTER

Both are folders of pages; those at the same path are compared. What counts is the text outside of pictures and the
alternative texts of these. A number is found when the successor has one that, rounded to as many
digits, is the same. Exit code 1 when a page or a number is missing.
"""

from __future__ import annotations

import re
import sys
from decimal import ROUND_HALF_UP, Decimal
from html.parser import HTMLParser
from pathlib import Path

NUMBER = re.compile(r"[-−]?\d[\d\u202f]*(?:\.\d+)?(?:·10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)|[eE]([-+]?\d+))?")
_EXPONENT = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
HIDDEN = {"style", "script", "title"}


class Reader(HTMLParser):
    """The text of a page outside pictures, with the alternative texts of these."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.hidden, self.pictures, self.words = 0, 0, list[str]()
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Alternative texts are read where a picture begins."""
        self.words += [text or "" for name, text in attrs if name == "aria-label"]
        self.hidden += tag in HIDDEN
        self.pictures += tag == "svg"

    def handle_endtag(self, tag: str) -> None:
        """Text behind it counts again."""
        self.hidden -= tag in HIDDEN
        self.pictures -= tag == "svg"

    def handle_data(self, data: str) -> None:
        """What is read."""
        if not self.hidden and not self.pictures:
            self.words.append(data)


def numbers(page: str) -> dict[str, Decimal]:
    """The numbers of a page: as written, and their values."""
    found = {}
    for match in NUMBER.finditer(" ".join(Reader(page).words)):
        written = match[0]
        mantissa = re.split(r"·10|[eE]", written)[0].replace("\u202f", "").replace("−", "-")
        power = (match[1] or "").translate(_EXPONENT) or match[2] or "0"
        found[written] = Decimal(mantissa).scaleb(int(power))
    return found


def missing(before: str, after: str) -> list[str]:
    """The numbers of a page that its successor does not have, as they are written."""
    known = list(numbers(after).values())
    return [
        written for written, value in numbers(before).items()
        if not any(other == value or _rounded(other, value) for other in known)
    ]  # fmt: skip


def _rounded(other: Decimal, value: Decimal) -> bool:
    step = Decimal(1).scaleb(int(value.as_tuple().exponent))
    return other.quantize(step, ROUND_HALF_UP) == value if abs(other) < Decimal(10) ** 15 else False


def main() -> int:
    """Compare two folders."""
    before, after = map(Path, sys.argv[1:3])
    wrong = 0
    for page in sorted(before.rglob("*.html")):
        successor = after / page.relative_to(before)
        if not successor.exists():
            print(f"{page.relative_to(before)}: no such page any more")
            wrong += 1
            continue
        old = page.read_text(encoding="utf-8")
        lacking = missing(old, successor.read_text(encoding="utf-8"))
        print(f"{page.relative_to(before)}: {len(numbers(old))} numbers, {len(lacking)} missing: {' '.join(lacking)}")
        wrong += bool(lacking)
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
