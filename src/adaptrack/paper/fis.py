"""The text files of MATLAB's Fuzzy Logic Toolbox (`.fis`, version 2.0), for Sugeno systems.

Read and written are: product as AND, weighted average as output, Gaussian and generalised-bell membership functions,
linear and constant outputs, rule weights, inputs that a rule does not ask (0). Everything else is refused, with its
line.
"""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from adaptrack.base.checked import Count, checked
from adaptrack.base.errors import ConfigError, InvalidInput, StorageError
from adaptrack.base.files import write_atomically
from adaptrack.control.scheduling.functions.sugeno import ANY, BELL_SLOPE, BELL_WIDTH, Sugeno
from adaptrack.paper.anfis import ANFIS

_FUNCTION = re.compile(r"'([^']*)'\s*:\s*'([^']*)'\s*,\s*\[([^\]]*)\]\s*")
_RULE = re.compile(r"([-\d\s]+),([-\d\s]+)\(([^()]*)\)\s*:\s*(\d+)\s*")
_NUMBERS = {"gaussmf": 2, "gbellmf": 3}


class _Value(NamedTuple):
    text: str
    line: int


class _Section(NamedTuple):
    name: str
    line: int
    values: dict[str, _Value]


class _Function(NamedTuple):
    kind: str
    numbers: list[float]
    line: int


class _Variable(NamedTuple):
    name: str
    range: list[float]
    functions: list[_Function]


@checked
def read_fis(path: str | os.PathLike[str], output: Count = 1) -> ANFIS:
    """The fitted `ANFIS` that a `.fis` file describes; of several outputs the one with the number `output`, from 1.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it is malformed, or asks for what is not supported; the message names the line.
    """
    return _Reader(path).estimator(output)


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


class _Reader:
    """One file, line by line; each complaint names the file and the line."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            raw = self.path.read_bytes()
        except OSError as error:
            raise StorageError(f"{self.path}: cannot be read: {error.strerror or error}.") from error
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:  # names in an older encoding; nothing else is outside ASCII
            text = raw.decode("latin-1")
        self.sections: dict[str, _Section] = {}
        self.rules: list[_Value] = []
        self._divide(text)

    def fail(self, line: int, sentence: str) -> NoReturn:
        raise ConfigError(f"{self.path}, line {line}: {sentence}")

    def estimator(self, output: int) -> ANFIS:
        system = self.section("System")
        self._supported(system)
        inputs, outputs, rules = (self.count(system, key) for key in ("NumInputs", "NumOutputs", "NumRules"))
        if output > outputs:
            self.fail(system.values["NumOutputs"].line, f"output {output} is requested, but there are {outputs}.")
        variables = [self.variable(f"Input{i + 1}") for i in range(inputs)]
        answer = self.variable(f"Output{output}")
        if len(self.rules) != rules:
            line = system.values["NumRules"].line
            self.fail(line, f"NumRules = {rules}, but [Rules] holds {len(self.rules)} rules.")
        premises = [self.premise(function) for variable in variables for function in variable.functions]
        first = np.cumsum([0, *(len(variable.functions) for variable in variables)])
        memberships, consequents, weights = [], [], []
        for value in self.rules:
            antecedents, conclusion, weight = self.rule(value, variables, outputs, output)
            if conclusion:  # zero: this rule says nothing about this output
                if conclusion > len(answer.functions):
                    self.fail(value.line, f"output function {conclusion} of {len(answer.functions)} does not exist.")
                memberships.append([first[i] + a - 1 if a else ANY for i, a in enumerate(antecedents)])
                consequents.append(self.consequent(answer.functions[conclusion - 1], inputs))
                weights.append(weight)
        if not any(weights):
            self.fail(system.line, f"no rule with a weight above zero concludes on output {output}.")
        system_read = Sugeno(
            owner=np.repeat(np.arange(inputs), [len(variable.functions) for variable in variables]),
            bell=np.array([bell for bell, _ in premises], dtype=bool),
            premises=np.array([numbers for _, numbers in premises], dtype=np.float64).reshape(-1, 3),
            rules=np.array(memberships, dtype=np.intp),
            consequents=np.array(consequents),
            weights=np.array(weights),
        )
        names = [variable.name or f"in{i + 1}" for i, variable in enumerate(variables)]
        return ANFIS.from_system(system_read, [variable.range for variable in variables], answer.range, names)

    def _divide(self, text: str) -> None:
        """Into sections, their keys, and the rules."""
        current: _Section | None = None
        for line, written in enumerate(text.split("\n"), start=1):
            content = written.strip()
            if not content or content.startswith(("%", "#")):
                continue
            if content.startswith("["):
                if not content.endswith("]"):
                    self.fail(line, f"{content!r}: a section reads [Name].")
                current = _Section(content[1:-1].strip(), line, {})
                if current.name in self.sections:
                    self.fail(line, f"[{current.name}] was given before, in line {self.sections[current.name].line}.")
                self.sections[current.name] = current
            elif current is None:
                self.fail(line, f"{content!r} stands before the first section, which must be [System].")
            elif current.name == "Rules":
                self.rules.append(_Value(content, line))
            else:
                key, equals, value = (part.strip() for part in content.partition("="))
                if not equals or not value:
                    self.fail(line, f"{content!r}: expected key=value.")
                if key in current.values:
                    self.fail(line, f"{key} was given before, in line {current.values[key].line}.")
                current.values[key] = _Value(value, line)

    def section(self, name: str) -> _Section:
        if name not in self.sections:
            last = max((section.line for section in self.sections.values()), default=1)
            self.fail(last, f"the section [{name}] is missing from the file.")
        return self.sections[name]

    def value(self, section: _Section, key: str) -> _Value:
        if key not in section.values:
            self.fail(section.line, f"[{section.name}]: {key} is missing.")
        return section.values[key]

    def word(self, section: _Section, key: str) -> tuple[str, int]:
        value = self.value(section, key)
        if len(value.text) < 2 or value.text[0] != "'" or value.text[-1] != "'":
            self.fail(value.line, f"{key} = {value.text}: must be text in single quotes.")
        return value.text[1:-1], value.line

    def count(self, section: _Section, key: str) -> int:
        value = self.value(section, key)
        least = 0 if key == "NumMFs" else 1
        if not value.text.isdecimal() or int(value.text) < least:
            self.fail(value.line, f"{key} = {value.text}: must be a whole number, at least {least}.")
        return int(value.text)

    def numbers(self, text: str, line: int) -> list[float]:
        values = []
        for word in text.replace(",", " ").split():
            try:
                values.append(float(word))
            except ValueError:
                self.fail(line, f"{word!r} is not a number.")
        if not all(map(math.isfinite, values)):
            self.fail(line, f"[{text}]: every number must be finite.")
        return values

    def _supported(self, system: _Section) -> None:
        for key, allowed in (("Type", "sugeno"), ("AndMethod", "prod"), ("DefuzzMethod", "wtaver")):
            word, line = self.word(system, key)
            if word != allowed:
                self.fail(line, f"{key} = '{word}' is not supported; only '{allowed}' is.")
        version = self.value(system, "Version")
        if self.numbers(version.text, version.line) != [2.0]:
            self.fail(version.line, f"Version = {version.text} is not supported; only 2.0 is.")

    def variable(self, name: str) -> _Variable:
        """An input or an output: its range and functions."""
        section = self.section(name)
        limits_text = self.value(section, "Range")
        if not (limits_text.text.startswith("[") and limits_text.text.endswith("]")):
            self.fail(limits_text.line, f"Range = {limits_text.text}: must read [low high].")
        limits = self.numbers(limits_text.text[1:-1], limits_text.line)
        if len(limits) != 2 or limits[0] > limits[1]:
            self.fail(limits_text.line, f"Range = {limits_text.text}: must be two numbers, the lower one first.")
        functions = []
        for j in range(self.count(section, "NumMFs")):
            value = self.value(section, f"MF{j + 1}")
            match = _FUNCTION.fullmatch(value.text)
            if match is None:
                self.fail(value.line, f"{value.text!r}: a function reads 'name':'type',[numbers].")
            functions.append(_Function(match[2], self.numbers(match[3], value.line), value.line))
        for key, value in section.values.items():
            if re.fullmatch(r"MF\d+", key) and not 1 <= int(key[2:]) <= len(functions):
                self.fail(value.line, f"{key} is beyond NumMFs = {len(functions)}.")
        title = self.word(section, "Name")[0] if "Name" in section.values else ""
        return _Variable(title, limits, functions)

    def premise(self, function: _Function) -> tuple[bool, list[float]]:
        """Whether an input's function is a bell, and its row of the premises."""
        kind, numbers, line = function
        if kind not in _NUMBERS:
            self.fail(line, f"'{kind}' is not supported as a membership function; 'gaussmf' and 'gbellmf' are.")
        if len(numbers) != _NUMBERS[kind]:
            self.fail(line, f"'{kind}' needs {_NUMBERS[kind]} numbers, found {len(numbers)}.")
        bell = kind == "gbellmf"
        premise = numbers if bell else [numbers[0], 1.0, numbers[1]]
        premise[BELL_WIDTH] = abs(premise[BELL_WIDTH])  # only its square counts, or its magnitude
        if premise[BELL_WIDTH] == 0.0 or premise[BELL_SLOPE] <= 0.0:
            self.fail(line, f"'{kind}' with {numbers}: the width must not be 0, the slope must be above 0.")
        return bell, premise

    def consequent(self, function: _Function, inputs: int) -> list[float]:
        kind, numbers, line = function
        if kind not in ("linear", "constant"):
            self.fail(line, f"'{kind}' is not supported as an output function; 'linear' and 'constant' are.")
        if len(numbers) != (inputs + 1 if kind == "linear" else 1):
            needed = inputs + 1 if kind == "linear" else 1
            self.fail(line, f"'{kind}' needs {needed} numbers for {inputs} inputs, found {len(numbers)}.")
        return numbers if kind == "linear" else [0.0] * inputs + numbers

    def rule(
        self, value: _Value, variables: list[_Variable], outputs: int, output: int
    ) -> tuple[list[int], int, float]:
        """The functions that a rule asks for, the one it concludes with, and its weight."""
        match = _RULE.fullmatch(value.text)
        if match is None:
            self.fail(value.line, f"{value.text!r}: a rule reads '1 2, 1 (1) : 1'.")
        try:
            antecedents, concluded = [int(word) for word in match[1].split()], [int(word) for word in match[2].split()]
        except ValueError:
            self.fail(value.line, f"{value.text!r}: functions are given by whole numbers.")
        if len(antecedents) != len(variables) or len(concluded) != outputs:
            counts = f"found {len(antecedents)} and {len(concluded)}"
            self.fail(value.line, f"a rule needs {len(variables)} input and {outputs} output functions, {counts}.")
        if min(*antecedents, *concluded) < 0:
            self.fail(value.line, "a negative number (NOT) is not supported.")
        for i, (number, variable) in enumerate(zip(antecedents, variables, strict=True), start=1):
            if number > len(variable.functions):
                self.fail(value.line, f"input {i} has {len(variable.functions)} functions, the rule asks for {number}.")
        if match[4] != "1" and sum(number > 0 for number in antecedents) > 1:
            self.fail(value.line, "a rule that joins its inputs by OR (: 2) is not supported; only AND (: 1) is.")
        weight = self.numbers(match[3], value.line)
        if len(weight) != 1 or not 0.0 <= weight[0] <= 1.0:
            self.fail(value.line, f"weight ({match[3]}): must be one number, 0..1.")
        return antecedents, concluded[output - 1], weight[0]
