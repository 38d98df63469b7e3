"""Looking for an input that breaks a claim, cutting it short, keeping it as a file, and going through it again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from adaptrack import __version__
from adaptrack.base.errors import ConfigError, InvalidInput
from adaptrack.base.files import read_json, write_json
from tools.fuzz.inputs import Case
from tools.fuzz.targets import TARGETS

STEPS_EACH = 1000
"""Of one case."""
EFFORT = 50_000
"""Steps, to cut a case short."""
KIND = "adaptrack fuzz case"


@dataclass(frozen=True)
class Failed:
    """A case, the inputs up to the one at which a claim did not hold, and that claim."""

    case: Case
    inputs: list[Case]
    claim: str


@dataclass
class Found:
    """What a search has done."""

    steps: Counter[str] = field(default_factory=Counter)
    """by target"""
    failed: list[Failed] = field(default_factory=list)


def replay(case: Case, inputs: Iterable[Case]) -> tuple[int, str] | None:
    """The first step at which something does not hold, and what; None: all holds."""
    target = TARGETS[case["target"]][2](case)
    for k, given in enumerate(inputs):
        try:
            wrong = target.step(given)
        except InvalidInput as error:
            wrong = f"refused well-formed input: {error}"
        except Exception as error:  # what is looked for
            wrong = f"raised {type(error).__name__}: {error}"
        if wrong is not None:
            return k, wrong
    return None


def search(
    steps: int, seed: int, targets: Iterable[str] = tuple(TARGETS), told: Callable[[Found], None] = lambda found: None
) -> Found:
    """Drive random cases, as many steps of each target; told: called with what there is after every case."""
    found = Found()
    for name in targets:
        draw, inputs_of, _ = TARGETS[name]
        number = 0
        while found.steps[name] < steps:
            rng = np.random.default_rng([seed, sum(name.encode()), number])
            case, count = draw(rng), min(STEPS_EACH, steps - found.steps[name])
            inputs = inputs_of(case, rng, count)
            wrong = replay(case, inputs)
            if wrong is not None:
                found.failed.append(Failed(case, inputs[: wrong[0] + 1], wrong[1]))
            found.steps[name] += count
            number += 1
            told(found)
    return found


def shortened(failed: Failed) -> Failed:
    """The same with fewer inputs: pieces of half the length, a quarter, ... are left out as long as it still fails.

    It ends after `EFFORT` steps.
    """
    inputs, claim = failed.inputs, failed.claim
    piece, left = len(inputs) // 2, EFFORT
    while piece:
        start = 0
        while start < len(inputs) - 1 and left > 0:
            fewer = inputs[:start] + inputs[start + piece :]
            left -= len(fewer)
            wrong = replay(failed.case, fewer) if fewer else None
            if wrong is None:
                start += piece
            else:
                inputs, claim = fewer[: wrong[0] + 1], wrong[1]
        piece //= 2
    return Failed(failed.case, inputs, claim)


def save(failed: Failed, path: Path) -> None:
    """Write a case as JSON; `load` reads it, `python -m tools.fuzz replay` goes through it.

    Raises
    ------
    StorageError
        When the file cannot be written.
    """
    inputs = [{name: _plain(value) for name, value in given.items()} for given in failed.inputs]
    write_json(
        path, {"kind": KIND, "version": __version__, "claim": failed.claim, "case": failed.case, "inputs": inputs}
    )


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def load(path: Path) -> Failed:
    """What `save` has written.

    Raises
    ------
    StorageError, ConfigError
        When the file cannot be read, or is something else.
    """
    content = read_json(path)
    if not isinstance(content, dict) or content.get("kind") != KIND:
        raise ConfigError(f"{path}: not a file of a fuzz case; `python -m tools.fuzz run` writes them.")
    return Failed(content["case"], content["inputs"], content["claim"])
