"""The words are the field's: those that the project once coined do not come back."""

import io
import re
import tokenize
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent

COINED = {
    "told": "known, given, believed, reported",
    "untold": "unknown",
    "asked": "requested, given",
    "seen": "observed, measured",
    "trip": "drive",
    "trips": "drives",
    "pace": "speed",
    "lead": "delay steps, of a dead time in periods",
    "foretold": "predicted",
    "sight": "preview",
    "pond": "the name of a fixture says what it is",
    "lost": "drift; failed; the force that is lost",
    "astray": "far from the reference",
    "rung": "contender",
    "rungs": "contenders",
    "nearness": "modulus margin",
}
"""Each with the words of the field that say it."""

IDENTIFIERS = {"body": "plant", "bodies": "plants", "who": "options, contender"}
"""Words that are coined as names in code alone: a car has a body, and prose says who."""

MEANT = {
    "lead": {"docs/peers.md": 1, "docs/learning.md": 1},
    "asked": {"docs/campaign.md": 1},
    "told": {"src/adaptrack/cli/evaluate_schedules.py": 1},
    "body": {
        "docs/extensions/mathml.py": 1, "src/adaptrack/__init__.py": 1, "src/adaptrack/cars/data_sheet.py": 8,
        "src/adaptrack/cars/vehicle.py": 22,
        "src/adaptrack/core/synthesis/car.py": 3, "src/adaptrack/cli/car.py": 7,
        "src/adaptrack/core/build/header.py": 1, "src/adaptrack/core/synthesis/plant.py": 12,
        "src/adaptrack/export/page_data.py": 1, "src/adaptrack/export/page_inputs.py": 3,
        "examples/plugins/commonroad_cars.py": 3,
    },
}  # fmt: skip
"""Real uses, by file: what leads to something, nobody is asked (by a command), the older name of an option, a car's
body, the `body` of Sphinx and of Python's syntax tree."""

PLACES = ["README.md", "docs", "examples", "src/adaptrack"]
"""What is counted."""


def texts(place):
    """Files of prose and code below a place."""
    path = PROJECT / place
    files = [path] if path.is_file() else path.rglob("*")
    return sorted(each for each in files if each.suffix in (".md", ".rst", ".py", ".j2") and "_build" not in each.parts)


def words(file):
    """(word, whether it is a part of a name in code), in lower case; names are taken apart."""
    text = file.read_text()
    if file.suffix != ".py":
        yield from ((word.lower(), False) for word in re.findall(r"[A-Za-z]+", text))
        return
    nested = 0  # f-strings that are open: from Python 3.12 on they are many tokens, and their names are text here too
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        kind = tokenize.tok_name[token.type]
        nested += kind.endswith("STRING_START") - kind.endswith("STRING_END")
        if kind in ("NAME", "STRING", "COMMENT") or kind.endswith("STRING_MIDDLE"):
            is_name = kind == "NAME" and not nested
            yield from ((part.lower(), is_name) for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", token.string))


def coined(file):
    """How often each coined word stands in a file."""
    found = {}
    for word, is_name in words(file):
        if word in COINED or (is_name and word in IDENTIFIERS):
            found[word] = found.get(word, 0) + 1
    return found


@pytest.mark.parametrize("place", PLACES)
def test_no_coined_word_stands_where_the_field_has_one(place):
    wrong = []
    for file in texts(place):
        name = str(file.relative_to(PROJECT))
        for word, count in coined(file).items():
            if count > MEANT.get(word, {}).get(name, 0):
                wrong.append(f"{name}: {count} x {word!r}: say {(COINED | IDENTIFIERS)[word]}")
    assert not wrong, "\n".join(wrong)


def test_every_real_use_is_still_there():
    for word, files in MEANT.items():
        for name, count in files.items():
            assert coined(PROJECT / name).get(word) == count, (word, name)


def test_a_coined_word_is_found_in_names_texts_and_prose(tmp_path):
    (tmp_path / "a.py").write_text('def told_by(bodyStyle):\n    """Nothing was asked; the body rolls."""\n')
    (tmp_path / "b.py").write_text("body = f'seen {body:{body}} {f\"{body} astray\"} at once'\n")
    (tmp_path / "a.md").write_text("The pace of the body.\n")
    assert coined(tmp_path / "a.py") == {"told": 1, "body": 1, "asked": 1}
    assert coined(tmp_path / "b.py") == {"body": 1, "seen": 1, "astray": 1}
    assert coined(tmp_path / "a.md") == {"pace": 1}
