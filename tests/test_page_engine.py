"""The engine of the page, run by Node on the kernels for WebAssembly: its drives are Python's to the last bit."""

import functools
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import page_drives
from adaptrack.base.errors import AdaptrackError
from adaptrack.core import library

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(library.WAY != "library", reason="needs the kernels' library")]
DRIVER = Path(__file__).parent / "processors" / "page.mjs"


@functools.cache
def parts():
    """Worker, kernels and data of the page; skips where they are not there."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    from adaptrack.export.page_data import page_data
    from adaptrack.export.page_file import ENGINE, _together
    from adaptrack.export.page_kernels import page_kernels

    try:
        return _together(ENGINE), page_kernels(), json.dumps(page_data(), allow_nan=False)
    except AdaptrackError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def ask(tmp_path_factory):
    """A function that hands messages to a fresh engine and gives its answers, typed arrays as NumPy's."""
    home = tmp_path_factory.mktemp("page")
    worker, kernels, data = parts()
    (home / "worker.js").write_text(worker)
    (home / "kernels.wasm").write_bytes(kernels)
    (home / "data.json").write_text(data)

    def answers(*messages):
        folder = tmp_path_factory.mktemp("answers")
        (folder / "requests").write_text(json.dumps(messages))
        files = [str(home / name) for name in ("worker.js", "kernels.wasm", "data.json")]
        done = subprocess.run(["node", str(DRIVER), *files, str(folder / "requests"), str(folder)],
                              capture_output=True, text=True, timeout=300)  # fmt: skip
        assert done.returncode == 0, done.stderr
        return [_answer(folder, k) for k in range(len(list(folder.glob("*.json"))))]

    return answers


def _answer(folder, k):
    content = (folder / f"{k}.bin").read_bytes()

    def typed(value):
        if set(value) != {"at", "count", "kind"}:
            return value
        kind = {"Float64Array": "<f8", "Float32Array": "<f4"}[value["kind"]]
        return np.frombuffer(content, kind, value["count"], value["at"])

    return json.loads((folder / f"{k}.json").read_text(), object_hook=typed)


def drive(setup, periods=4000, each=700):
    """The messages of a drive from its start on."""
    return [{"type": "start", "id": 1, "setup": setup},
            *({"type": "advance", "id": 1, "periods": each} for _ in range(-(-periods // each)))]  # fmt: skip


def frames(answers):
    """Of each car of a drive its frames, by the names of their columns."""
    started = next(each for each in answers if each["type"] == "started")
    found = []
    for k, car in enumerate(started["cars"]):
        rows = [
            each["cars"][k]["numbers"].reshape(-1, len(car["columns"])) for each in answers if each["type"] == "frames"
        ]
        found.append(dict(zip(car["columns"], np.concatenate(rows).T, strict=True)))
    return found


def refused(answers):
    return [(each["where"], each["message"]) for each in answers if each["type"] == "refused"]


def differing(found, expected):
    """Numbers of which a bit differs, by column; every NaN is like any other."""
    count, wrong = len(expected["x"]), {}
    for name, values in expected.items():
        here = np.ascontiguousarray(found[name][:count])
        both = np.isnan(here) & np.isnan(values)
        bad = (here.view(np.int64) != values.view(np.int64)) & ~both if here.size == count else np.ones(1, bool)
        if bad.any():
            wrong[name] = int(bad.sum()), int(bad.argmax())
    return wrong


@pytest.mark.parametrize("name", page_drives.SETUPS)
def test_a_drive_of_the_page_is_the_drive_of_the_package(name, ask):
    answers = ask(*drive(page_drives.SETUPS[name]))
    assert refused(answers) == []
    found, expected = frames(answers), page_drives.driven(name)
    assert len(found) == len(expected)
    assert [differing(here, there) for here, there in zip(found, expected, strict=True)] == [{}] * len(found)
    assert [len(here["x"]) for here in found] == [len(there["x"]) for there in expected]
