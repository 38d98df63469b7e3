"""A kernel is the same function in the library, called by its address, and as the Python that it is."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from adaptrack.core import kernel, library
from adaptrack.core.build import header
from adaptrack.core.member import member
from adaptrack.core.roads.road import foot_about
from adaptrack.core.tracker.signals import TRACKER_SAMPLE
from adaptrack.road import Arc, Line, Road
from programs import run_program

needs_compiled = pytest.mark.skipif(kernel.INTERPRETED, reason="needs compiled kernels")


def test_a_quantity_defines_default_bounds_and_remark_of_a_field():
    kind = kernel.record("Kind", [kernel.Field("lag", "s", 0.5, "of the steering", "[0, 1)"),
                                  kernel.Field("pair", "", (1.0, 2.0), ""),
                                  kernel.Field("open", "", 3.0, "", "(0, inf]")])  # fmt: skip
    assert tuple(kernel.defaults(kind)) == (0.5, (1.0, 2.0), 3.0)
    assert kernel.size_of(kind) == 4
    assert kind.field_settings["lag"].limits == {"ge": 0.0, "lt": 1.0}
    assert kind.field_settings["open"].limits == {"gt": 0.0}
    assert kind.field_settings["lag"].remark == "s, [0, 1), of the steering"
    source, target = kind.new(1, lag=0.1)[0], kind.new(1)[0]
    kernel.copier(kernel.record("Copied", [kind.field_settings["lag"], kind.field_settings["open"]]))(source, target)
    assert target.lag == 0.1


def test_columns_keep_their_fields_and_the_header_describes_them():
    speed = kernel.Field("speed", "m/s", float("nan"), "along the car", "(-10, 10)")
    table = kernel.columns("t", speed)
    assert (table.t, table.speed, kernel.fields_of(table)) == (0, 1, (speed,))
    text = "".join(header._enumerations("adaptrack.core.tracker.signals"))
    for field in kernel.fields_of(TRACKER_SAMPLE):
        assert f"TRACKER_SAMPLE_{field.name.upper()} = " in text
        assert f"/* {field.remark} */" in text


@pytest.mark.parametrize(("lag", "ratio", "required", "optional"), [
    (0.0, 2.0, True, True), (1.0, 2.0, False, False), (-0.1, 2.0, False, False), (0.5, 0.0, False, False),
    (0.5, math.inf, True, True), (math.inf, 2.0, False, False), (math.nan, 2.0, False, True),
])  # fmt: skip
def test_numbers_are_within_the_bounds_of_their_fields_and_unknown_ones_where_they_may_be(
    lag, ratio, required, optional
):
    fields = kernel.Field("lag", "s", math.nan, "", "[0, 1)"), kernel.Field("ratio", "", math.nan, "", "(0, inf]")
    row = kernel.record("Bounded", fields).new(1, lag=lag, ratio=ratio)[0]
    assert kernel.bounds_checker(fields)(row) == required
    assert kernel.bounds_checker(fields, optional=True)(row) == optional


def test_an_exported_kernel_answers_as_its_python_does():
    road = Road.from_segments([Line(length=50.0), Arc(length=60.0, curvature=0.02)]).packed()
    for x, y in ((3.0, 1.0), (49.0, -2.0), (80.0, 12.0), (200.0, 60.0)):
        compiled = foot_about(x, y, 40.0, 400.0, road)
        assert compiled == pytest.approx(foot_about.function(x, y, 40.0, 400.0, road), rel=1e-9, abs=1e-9)


@needs_compiled
@pytest.mark.parametrize(("arguments", "why"), [
    (np.zeros(3, np.float32), "need an array of 1 dimensions, float64"),
    (np.zeros((2, 2)), "need an array of 1 dimensions, float64"),
    (np.zeros(6)[::2], "C-contiguous"),
    ([0.0, 1.0], "need an array"),
])  # fmt: skip
def test_an_array_that_is_not_what_a_kernel_takes_is_refused(arguments, why):
    with pytest.raises(TypeError, match=why):
        kernel.vector.convert(arguments)


@needs_compiled
@pytest.mark.compiled
def test_a_member_that_raises_leaves_nothing_that_counts(monkeypatch):
    monkeypatch.setattr(library, "can_compile", lambda: False)  # a compiler refuses what raises

    def own(a, out):
        out[0] = 1.0
        if a[0] > 0.0:
            raise ValueError("no")

    function, out = member(own, kernel.void(kernel.vector, kernel.vector)), np.zeros(2)
    function(np.array([-1.0]), out)
    assert out.tolist() == [1.0, 0.0]
    function(np.array([1.0]), out)
    assert np.isnan(out).all()


# -- the library ------------------------------------------------------------------------------------------------------
@pytest.fixture
def built(tmp_path, monkeypatch):
    """A copy of what was built, in place of it."""
    if not isinstance(library.loaded(), library.Library):
        pytest.skip("runs with the library")
    monkeypatch.delenv("ADAPTRACK_PROCESSOR", raising=False)
    for file in filter(Path.is_file, library.BUILT_FOLDER.iterdir()):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    monkeypatch.setattr(library, "BUILT_FOLDER", tmp_path)
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


@pytest.mark.parametrize(("file", "stale", "is_current"), [
    ("core/controllers/stanley.py", {"stanley"}, {"kinematic_mpc", "preview_lqr", "lqr"}),
    ("core/controllers/predicted_path.py", {"kinematic_mpc", "preview_lqr"}, {"stanley", "lqr", "mpc_step"}),
    ("core/qp/active_set.py", {"kinematic_mpc", "mpc_step"}, {"stanley", "preview_lqr", "lqr"}),
])  # fmt: skip
def test_an_edited_source_withdraws_the_kernels_that_depend_on_it_and_no_others(monkeypatch, file, stale, is_current):
    if not isinstance(library.loaded(), library.Library) or library.loaded().edited:
        pytest.skip("needs the library of these sources")
    edited = library.source_hashes() | {file: "of another text"}
    monkeypatch.setattr(library, "source_hashes", lambda: edited)
    loaded = library.Library()
    assert all(file in loaded.why_not(name) for name in stale)
    assert not any(loaded.why_not(name) for name in is_current)


def test_without_a_compiler_a_missing_library_is_refused_with_the_command(monkeypatch):
    monkeypatch.setattr(library, "loaded", lambda: "the kernels have not been compiled")
    monkeypatch.setattr(library, "can_compile", lambda: False)
    with pytest.raises(library.NoKernels, match=r"not been compiled.*python -m adaptrack\.core\.build"):
        library.find("mpc_step")


def test_an_unknown_way_to_run_kernels_is_refused():
    code = "import adaptrack.core.kernel"
    process = subprocess.run(
        [sys.executable, "-c", code], env={"ADAPTRACK_KERNELS": "fast", "PATH": ""}, capture_output=True, text=True
    )
    assert process.returncode != 0
    assert "ADAPTRACK_KERNELS=fast: need one of library, jit, interpreted." in process.stderr


def test_a_step_loads_no_compiler():
    if not isinstance(library.loaded(), library.Library):
        pytest.skip("runs with the library")
    code = (
        "import sys, adaptrack as at\n"
        "at.MPC(at.load_vehicle('paper'), profile='road').step([0.0, 0.0, 0.0, 0.1], 15.0, [0.0])\n"
        "print([name for name in ('ziglang', 'adaptrack.core.build.translate') if name in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


C_PROGRAM = r"""
#include <stdio.h>
#include "adaptrack.h"
int main(void) {{
    printf("%zu %zu %zu %d\n", sizeof(struct adaptrack_controllers_mpc_Mpc),
           sizeof(struct adaptrack_roads_road_RoadAheadRecord), sizeof(struct adaptrack_controllers_mpc_MPCSettings),
           ADAPTRACK_PLANTS_CONTRACT_PLANT_STATE_VX);
    double values[{count}] = {{ {values} }};
    double least = adaptrack_place_between(values[0], values[1], 0.0, 0.25);
    struct adaptrack_roads_road_Centreline line = {{0}};
    struct adaptrack_roads_road_RoadAheadRecord ahead = {{.line = line, .station = 3.0}};
    printf("%a %f\n", least, ahead.station);
    return 0;
}}
"""


@needs_compiled
@pytest.mark.needs("gcc")
def test_the_header_describes_the_library_to_c(built, tmp_path):
    from adaptrack.core.controllers.mpc import Mpc, MPCSettings
    from adaptrack.core.plants.contract import PLANT_STATE
    from adaptrack.core.roads.road import RoadAheadRecord
    from adaptrack.core.tuning.swarm import place_between

    low, high = 0.1, 0.7
    header = library.PACKAGE_FOLDER / "core" / "built" / "adaptrack.h"
    (tmp_path / "adaptrack.h").write_bytes(header.read_bytes())
    (tmp_path / "main.c").write_text(C_PROGRAM.format(count=2, values=f"{low.hex()}, {high.hex()}"))
    command = ["gcc", "-std=c11", "-Wall", "-Wextra", "-Werror", "-o", "program", "main.c"]
    run_program(*command, of_this_processor(built), "-lm", cwd=tmp_path)
    printed = run_program("./program", cwd=tmp_path, env={"LD_LIBRARY_PATH": str(built)})
    *sizes, place, answer, station = printed.split()
    expected = [8 * words(Mpc), 8 * words(RoadAheadRecord), 8 * words(MPCSettings), PLANT_STATE.vx]
    assert [int(word) for word in [*sizes, place]] == expected
    assert float.fromhex(answer) == place_between(low, high, 0.0, 0.25)
    assert float(station) == 3.0


def words(kind):
    """How many words of 8 bytes a record takes."""
    kinds = kind.kinds.values()
    return sum(words(kind) if hasattr(kind, "kinds") else 1 + getattr(kind, "ndim", 0) for kind in kinds)
