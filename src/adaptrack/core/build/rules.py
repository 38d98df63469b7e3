"""What no kernel may do, as each processor does it differently: looked for in LLVM's text of all of them.

* convert a number to an integer that may not hold it: only `maths.bits.whole` converts, which bounds it first;
* shift by more than the width: by a number that is not written out only `maths.bits.left` and `right` shift.

Nor may it read memory that was not written, which LLVM's text does not show: a test lets valgrind look.
"""

from __future__ import annotations

import re
from collections import defaultdict

_CONVERTS, _SHIFTS = {"bits.whole"}, {"bits.left", "bits.right"}
_DEFINED = re.compile(r"define [^@]*@(?P<name>[^(]+)\(")
_CALLED = re.compile(r"(?:call|invoke) [^@]*@([^(]+)\(")
_SHIFT = re.compile(r"= (?:shl|lshr|ashr) (?:exact |nuw |nsw )*\S+ [^,]+, (?!\d+$)")


def plain(name: str) -> str:
    """The file and the function of a name that numba has made: those are hundreds of bytes long."""
    parts, at = [], len("_ZN")
    while name.startswith("_ZN") and (digits := re.match(r"\d+", name[at:])):
        begin = at + digits.end()
        at = begin + int(digits[0])
        parts.append(name[begin:at])
    return ".".join(parts[-2:]) or name


def violations(text: str) -> list[str]:
    """Where a module that is not yet optimised converts or shifts without bounds: sentences."""
    name, converting, callers, breaches = "", set(), defaultdict(set), []
    for line in text.splitlines():
        if line.startswith("define "):
            match = _DEFINED.match(line)
            name = match["name"].strip('"') if match else line
        elif "= fpto" in line:
            converting.add(name)
        elif _SHIFT.search(line) and plain(name) not in _SHIFTS:
            breaches.append(f"{plain(name)} shifts by a number that may be too large: {line.strip()}")
        elif match := _CALLED.search(line):
            callers[match[1].strip('"')].add(name)
    for function in converting:
        if plain(function) in _CONVERTS:
            continue
        if not function.startswith("_ZN5numba"):  # numba's own function for int()
            breaches.append(f"{plain(function)} converts a number to an integer that may not hold it")
        breaches += [
            f"{plain(caller)} converts a number to an integer that may not hold it"
            for caller in callers[function]
            if plain(caller) not in _CONVERTS and not caller.startswith("cfunc.")  # which nothing calls
        ]
    return sorted(set(breaches))
