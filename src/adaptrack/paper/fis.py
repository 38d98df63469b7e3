"""The text files of MATLAB's Fuzzy Logic Toolbox (`.fis`, version 2.0), for Sugeno systems.

Written are: product as AND, weighted average as output, Gaussian and generalised-bell membership functions, linear
outputs, rule weights, inputs that a rule does not ask (0).
"""

from __future__ import annotations

import os

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import write_atomically
from adaptrack.control.scheduling import Sugeno
from adaptrack.paper.anfis import ANFIS


def write_fis(estimator: ANFIS, path: str | os.PathLike[str], name: str = "anfis") -> None:
    """Write a fitted `ANFIS` as a `.fis` file; every number is written so that it reads back exactly.

    Raises
    ------
    InvalidInput
        When the estimator is not fitted.
    StorageError
        When the file cannot be written.
    """
    if not hasattr(estimator, "system_"):
        raise InvalidInput("write_fis: the ANFIS is not fitted; call fit first.")
    write_atomically(path, _text(estimator, name).encode())


def _text(estimator: ANFIS, name: str) -> str:
    system: Sugeno = estimator.system_
    lines = [
        "[System]",
        f"Name='{_plain(name)}'",
        "Type='sugeno'",
        "Version=2.0",
        f"NumInputs={system.n_inputs}",
        "NumOutputs=1",
        f"NumRules={system.n_rules}",
        "AndMethod='prod'",
        "OrMethod='probor'",
        "ImpMethod='prod'",
        "AggMethod='sum'",
        "DefuzzMethod='wtaver'",
    ]
    number = np.zeros(len(system.owner) + 1, dtype=np.intp)  # within its input, from 1; the last one is what ANY finds
    for i, variable in enumerate(estimator.input_names_):
        members = np.flatnonzero(system.owner == i)
        number[members] = np.arange(1, len(members) + 1)
        lines += ["", f"[Input{i + 1}]", f"Name='{_plain(variable)}'", f"Range={_list(estimator.input_range_[i])}"]
        lines.append(f"NumMFs={len(members)}")
        for j, function in enumerate(members, start=1):
            bell = bool(system.bell[function])
            numbers = system.premises[function, [0, 1, 2] if bell else [0, 2]]
            lines.append(f"MF{j}='in{i + 1}mf{j}':'{'gbellmf' if bell else 'gaussmf'}',{_list(numbers)}")
    lines += ["", "[Output1]", "Name='out1'", f"Range={_list(estimator.output_range_)}", f"NumMFs={system.n_rules}"]
    for j, numbers in enumerate(system.consequents, start=1):
        lines.append(f"MF{j}='out1mf{j}':'linear',{_list(numbers)}")
    lines += ["", "[Rules]"]
    for j, (rule, weight) in enumerate(zip(number[system.rules], system.weights, strict=True), start=1):
        lines.append(f"{' '.join(map(str, rule))}, {j} ({_number(weight)}) : 1")
    return "\n".join(lines) + "\n"


def _plain(name: object) -> str:
    """A name without what would end it in the file."""
    return " ".join(str(name).replace("'", " ").split())


def _list(numbers: np.ndarray) -> str:
    return "[" + " ".join(_number(number) for number in numbers) + "]"


def _number(number: float) -> str:
    text = repr(float(number))
    return text.removesuffix(".0")
