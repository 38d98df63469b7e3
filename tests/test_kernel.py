"""A kernel is the same function in the library, called by its address, and as the Python that it is."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import published_mpc
from adaptrack.core import library
from adaptrack.core.kernel import (
    INTERPRETED,
    Array,
    Field,
    Resident,
    Row,
    copier,
    defaults,
    exported,
    float64,
    inlined,
    local,
    packer,
    record,
    size_of,
    stepper,
    unpacker,
    vector,
    viewer,
    void,
)
from adaptrack.core.member import member
from adaptrack.core.road import foot_about
from adaptrack.road import Arc, Line, Road
from inlined import entry

INNER = record("INNER", ("x", "y"))
OUTER = record("OUTER", ["a", ("inner", INNER), ("row", (float64, 3)), ("square", (float64, 2, 2)), "b"])
outer_at, square = viewer(OUTER), local(2, 2)
needs_compiled = pytest.mark.skipif(INTERPRETED, reason="needs compiled kernels")


def leaves(record):
    """(type, value) of every field of a nested record."""
    for kind, value in zip(record.kinds.values(), record, strict=True):
        yield from leaves(value) if isinstance(value, tuple) else [(kind, value)]


@needs_compiled
def test_the_words_of_a_record_are_where_its_arrays_lie_and_their_sizes():
    mpc = published_mpc(load_vehicle("paper"))
    record = mpc.batch(3, mpc.settings())
    words = []
    for kind, value in leaves(record):
        if isinstance(kind, Array):
            words += [value.ctypes.data, *value.shape]
        else:
            words.append(int(np.array(value, kind.name).view(np.int64)))
    assert Resident(record).words.tolist() == words


@needs_compiled
def test_a_record_is_written_where_it_is_read():
    pair = record("Pair", ("a", "b"))
    read, write, along = unpacker(pair, 4), packer(pair, 4), stepper(pair)
    values = np.arange(8.0)
    write(values, 1, along(read(values, 1), 2.0, pair(10.0, 100.0)))
    assert values.tolist() == [0.0, 21.0, 2.0, 3.0, 4.0, 205.0, 6.0, 7.0]


def test_a_quantity_defines_default_bounds_and_remark_of_a_field():
    kind = record("Kind", [Field("lag", "s", 0.5, "of the steering", "[0, 1)"), Field("pair", "", (1.0, 2.0), ""),
                           Field("open", "", 3.0, "", "(0, inf]")])  # fmt: skip
    assert tuple(defaults(kind)) == (0.5, (1.0, 2.0), 3.0)
    assert size_of(kind) == 4
    assert kind.field_settings["lag"].ends == (0.0, 1.0)
    assert kind.field_settings["lag"].remark == "s, [0, 1), of the steering"
    source, target = kind.new(1, lag=0.1)[0], kind.new(1)[0]
    entry(copier(record("Copied", [kind.field_settings["lag"], kind.field_settings["open"]])))(source, target)
    assert target.lag == 0.1


def test_an_exported_kernel_answers_as_its_python_does():
    road = Road.from_segments([Line(length=50.0), Arc(length=60.0, curvature=0.02)]).packed()
    for x, y in ((3.0, 1.0), (49.0, -2.0), (80.0, 12.0), (200.0, 60.0)):
        compiled = foot_about(x, y, 40.0, 400.0, road)
        assert compiled == pytest.approx(foot_about.function(x, y, 40.0, 400.0, road), rel=1e-9, abs=1e-9)


@needs_compiled
@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (np.zeros(3, np.float32), "need an array of 1 dimensions, float64"),
        (np.zeros((2, 2)), "need an array of 1 dimensions, float64"),
        (np.zeros(6)[::2], "C-contiguous"),
        ([0.0, 1.0], "need an array"),
    ],
)
def test_an_array_that_is_not_what_a_kernel_takes_is_refused(wrong, why):
    with pytest.raises(TypeError, match=why):
        vector.convert(wrong)


@needs_compiled
@pytest.mark.compiled
def test_a_member_that_raises_leaves_nothing_that_counts():
    def own(a, out):
        out[0] = 1.0
        if a[0] > 0.0:
            raise ValueError("no")

    made, out = member(own, void(vector, vector)), np.zeros(2)
    made(np.array([-1.0]), out)
    assert out.tolist() == [1.0, 0.0]
    made(np.array([1.0]), out)
    assert np.isnan(out).all()


# -- parts of vectors, and small arrays -------------------------------------------------------------------------------
@inlined
def written_by_name(values):
    """Write every field of the record that lies at place 2."""
    m = outer_at(values, 2)
    m.a, m.inner.x, m.inner.y, m.b = 1.0, 2.0, 3.0, 11.0
    for i in range(3):
        m.row[i] = 4.0 + i
    for i in range(2):
        for j in range(2):
            m.square[i, j] = 7.0 + 2 * i + j
    return m.square[1, 0] + m.inner.y


@exported(float64(Row(INNER), vector), name="test_sum_of_a_row")
def sum_of_a_row(inner, values):
    return inner.x + inner.y + values[0]


@inlined
def handed_on(values):
    """Fields of a record as arguments of an exported kernel."""
    m = outer_at(values, 2)
    return sum_of_a_row(m.inner, m.row)


@inlined
def filled(x):
    """The sum of a small array, filled anew at each of three rounds."""
    total = 0.0
    for _ in range(3):
        z = square()
        for i in range(2):
            total += z[0, i] + z[1, i]  # zero, whatever the round before has left
            z[1, i] = x
        total += z[1, 0] + z[1, 1] + z[0, 0]
    return total


def test_the_parts_of_a_vector_are_read_and_written_by_name():
    values = np.zeros(16)
    assert entry(written_by_name)(values) == 12.0
    assert size_of(OUTER) == 11
    assert values.tolist() == [0.0, 0.0, *range(1, 12), 0.0, 0.0, 0.0]
    m = outer_at(values, 2)
    assert (m.a, m.inner.x, m.row.tolist(), m.square.tolist()) == (1.0, 2.0, [4.0, 5.0, 6.0], [[7.0, 8.0], [9.0, 10.0]])
    m.inner.x, m.row[1] = -1.0, -2.0
    assert (values[3], values[6]) == (-1.0, -2.0)


def test_the_parts_of_a_vector_are_arguments_as_any_other():
    values = np.arange(16.0)
    assert entry(handed_on)(values) == sum_of_a_row(outer_at(values, 2).inner, outer_at(values, 2).row) == 12.0


def test_a_small_array_is_zero_at_each_call():
    assert entry(filled)(5.0) == 30.0


# -- the library ------------------------------------------------------------------------------------------------------
@pytest.fixture
def built(tmp_path, monkeypatch):
    """A copy of what was built, in place of it."""
    if not isinstance(library.loaded(), library.Library):
        pytest.skip("runs with the library")
    for file in filter(Path.is_file, library.BUILT_FOLDER.iterdir()):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    monkeypatch.setattr(library, "BUILT", tmp_path)
    return tmp_path


def of_this_processor(folder):
    return folder / json.loads((folder / library.MANIFEST).read_text())["libraries"][library.processor()]["file"]


@pytest.mark.parametrize("harm", ["cut", "bit", "gone", "foreign"])
def test_a_library_that_is_not_what_was_built_is_never_loaded(built, harm):
    path = of_this_processor(built)
    content = bytearray(path.read_bytes())
    if harm == "gone":
        path.unlink()
    else:
        content[len(content) // 2] ^= 1
        path.write_bytes({"cut": content[:1000], "bit": content, "foreign": b"\x7fELF"}[harm])
    why = library.loaded.__wrapped__()
    assert isinstance(why, str)
    assert path.name in why


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"libraries": 3}', '{"libraries": {}}'])
def test_a_manifest_that_is_none_is_said(built, text):
    (built / library.MANIFEST).write_text(text)
    assert library.MANIFEST in library.loaded.__wrapped__()


@pytest.mark.parametrize(
    ("file", "stale", "good"),
    [
        ("core/controllers/stanley.py", {"stanley"}, {"kinematic_mpc", "preview_lqr", "lqr"}),
        ("core/controllers/predicted_path.py", {"kinematic_mpc", "preview_lqr"}, {"stanley", "lqr", "mpc_step"}),
        ("core/qp/active_set.py", {"kinematic_mpc", "mpc_step"}, {"stanley", "preview_lqr", "lqr"}),
    ],
)
def test_an_edited_source_withdraws_the_kernels_that_depend_on_it_and_no_others(monkeypatch, file, stale, good):
    if not isinstance(library.loaded(), library.Library) or library.loaded().edited:
        pytest.skip("needs the library of these sources")
    edited = library.source_hashes() | {file: "of another text"}
    monkeypatch.setattr(library, "source_hashes", lambda: edited)
    found = library.Library()
    assert all(file in found.why_not(name) for name in stale)
    assert not any(found.why_not(name) for name in good)


def test_without_numba_a_missing_library_is_refused_with_the_command(monkeypatch):
    monkeypatch.setattr(library, "loaded", lambda: "the kernels have not been compiled")
    monkeypatch.setattr(library, "can_compile", lambda: False)
    with pytest.raises(library.NoKernels, match=r"not been compiled.*python -m adaptrack\.core\.build"):
        library.find("mpc_step")


def test_an_unknown_way_to_run_kernels_is_refused():
    code = "import adaptrack.core.kernel"
    done = subprocess.run(
        [sys.executable, "-c", code], env={"ADAPTRACK_KERNELS": "fast", "PATH": ""}, capture_output=True, text=True
    )
    assert done.returncode != 0
    assert "ADAPTRACK_KERNELS=fast: need one of library, jit, interpreted." in done.stderr


def test_a_step_loads_no_compiler():
    if not isinstance(library.loaded(), library.Library):
        pytest.skip("runs with the library")
    code = (
        "import sys, adaptrack as at\n"
        "at.MPC(at.load_vehicle('paper'), profile='road').step([0.0, 0.0, 0.0, 0.1], 15.0, [0.0])\n"
        "print([name for name in ('numba', 'llvmlite') if name in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


C_PROGRAM = r"""
#include <stdio.h>
#include "adaptrack.h"
int main(void) {{
    printf("%zu %zu %zu %d\n", sizeof(struct adaptrack_controllers_mpc_Mpc),
           sizeof(struct adaptrack_road_RoadAheadRecord), sizeof(struct adaptrack_controllers_mpc_MPCSettings),
           ADAPTRACK_PLANTS_CONTRACT_PLANT_STATE_VX);
    double values[{count}] = {{ {values} }};
    double least = adaptrack_place_between(values[0], values[1], 0.0, 0.25);
    struct adaptrack_road_Centreline line = {{0}};
    struct adaptrack_road_RoadAheadRecord ahead = {{.line = line, .station = 3.0}};
    printf("%a %f\n", least, ahead.station);
    return 0;
}}
"""


@needs_compiled
@pytest.mark.needs("gcc")
def test_the_header_describes_the_library_to_c(built, tmp_path):
    from adaptrack.core.controllers.mpc import Mpc, MPCSettings
    from adaptrack.core.plants.contract import PLANT_STATE
    from adaptrack.core.road import RoadAheadRecord
    from adaptrack.core.swarm import place_between

    low, high = 0.1, 0.7
    (tmp_path / "main.c").write_text(C_PROGRAM.format(count=2, values=f"{low.hex()}, {high.hex()}"))
    given = ["-std=c11", "-Wall", "-Wextra", "-Werror", "main.c", str(of_this_processor(built)), "-lm", "-o", "program"]
    subprocess.run(["gcc", *given], cwd=tmp_path, check=True)
    done = subprocess.run(
        ["./program"], cwd=tmp_path, capture_output=True, text=True, check=True, env={"LD_LIBRARY_PATH": str(built)}
    )
    *sizes, place, answer, station = done.stdout.split()
    expected = [8 * words(Mpc), 8 * words(RoadAheadRecord), 8 * words(MPCSettings), PLANT_STATE.vx]
    assert [int(each) for each in [*sizes, place]] == expected
    assert float.fromhex(answer) == place_between(low, high, 0.0, 0.25)
    assert float(station) == 3.0


def words(kind):
    """How many words of 8 bytes a record takes."""
    kinds = kind.kinds.values()
    return sum(words(each) if hasattr(each, "kinds") else 1 + getattr(each, "ndim", 0) for each in kinds)
