"""Tables of axle force over slip."""

import numpy as np
import pytest

import adaptrack as at
from adaptrack.cars.tyre_fit import lateral_force

LOADS = (3800.0, 2600.0)
TYRE = at.load_tyre("sports-car")


def table(path, *, loads=(LOADS,), degrees=False, furthest=0.18, friction=0.95, write_loads=False, offset=0.0):
    """Axle forces of a known tyre."""
    head = ["slip_deg" if degrees else "slip_rad", "force_front_N", "force_rear_N"]
    head += ["load_front_N", "load_rear_N"] if write_loads else []
    lines = [",".join(head)]
    for front, rear in loads:
        for slip in np.linspace(-furthest, furthest, 31):
            row = [np.degrees(slip) if degrees else slip, 2 * lateral_force(TYRE, slip, front, friction),
                   2 * lateral_force(TYRE, slip - offset, rear, friction, rear=True)]  # fmt: skip
            lines.append(",".join(map(str, row + ([2 * front, 2 * rear] if write_loads else []))))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("degrees", [False, True])
def test_the_table_of_a_known_tyre_gives_it_back(tmp_path, degrees):
    fit = at.tyre_from_table(table(tmp_path / "axles.csv", degrees=degrees), LOADS)
    assert fit.tyre.name == "axles"
    front, rear = TYRE.stiffness_at(*LOADS)
    assert fit.tyre.stiffness_front == pytest.approx(front, rel=0.02)
    assert fit.tyre.stiffness_rear == pytest.approx(rear, rel=0.02)
    assert fit.deviation < 0.02
    assert fit.tyre.stiffness_load == "constant"
    assert any("does not depend on the load" in note for note in fit.notes)


def test_several_loads_give_the_dependence_on_load_and_friction_as_well(tmp_path):
    several = [(2000.0, 1500.0), (3800.0, 2600.0), (5500.0, 4200.0)]
    fit = at.tyre_from_table(table(tmp_path / "axles.csv", loads=several, write_loads=True))
    assert fit.deviation < 0.005
    for load in (1600.0, 3000.0, 5000.0):
        assert fit.tyre.stiffness_at(load, load) == pytest.approx(TYRE.stiffness_at(load, load), rel=0.02)
        slips = np.linspace(-0.15, 0.15, 21)
        ours, true = lateral_force(fit.tyre, slips, load, fit.friction), lateral_force(TYRE, slips, load, 0.95)
        assert np.abs(ours - true).max() < 0.01 * load


def test_a_table_that_does_not_saturate_says_so(tmp_path):
    fit = at.tyre_from_table(table(tmp_path / "axles.csv", furthest=0.01), LOADS)
    assert any("hardly saturate" in note for note in fit.notes)
    assert fit.tyre.stiffness_front == pytest.approx(TYRE.stiffness_at(*LOADS)[0], rel=0.05)


def test_an_offset_of_the_slip_is_taken_out_and_said(tmp_path):
    fit = at.tyre_from_table(table(tmp_path / "axles.csv", offset=0.004), LOADS)
    assert any("rear axle has no force at a slip of 0.0040 rad" in note for note in fit.notes)
    assert fit.deviation < 0.02


def test_an_axle_may_be_left_empty_in_some_rows_but_loads_are_needed(tmp_path):
    path = table(tmp_path / "axles.csv")
    with pytest.raises(at.InvalidInput, match="has no loads: add load_front_N"):
        at.tyre_from_table(path)
    lines = path.read_text().splitlines()
    lines[5] = lines[5].rsplit(",", 1)[0] + ","
    path.write_text("\n".join(lines))
    assert at.tyre_from_table(path, LOADS).deviation < 0.02


@pytest.mark.parametrize(("change", "message"), [
    (lambda t: t.replace("slip_rad", "slip"), r"column 'slip': unknown. Did you mean 'slip_"),
    (lambda t: t.replace("force_rear_N", "force_front_N"), "stands there twice"),
    (lambda t: t.replace("slip_rad,force_front_N,force_rear_N", "slip_rad,force_front_N,load_front_N"), "needs"),
    (lambda t: "", "is empty"),
    (lambda t: t.replace("0.18,", "nan,", 1), r"line 2: slip_rad = '.*nan': must be a finite number"),
    (lambda t: t + "1,2\n", r"line 33: 2 cells, the head has 3"),
    (lambda t: "\n".join(t.splitlines()[:4]), "needs at least 5"),
    (lambda t: t.replace("slip_rad,force_front_N", "force_front_N,slip_rad"), "no tyre is measured there"),
])  # fmt: skip
def test_a_table_that_is_none_is_named(tmp_path, change, message):
    path = table(tmp_path / "axles.csv")
    path.write_text(change(path.read_text()))
    with pytest.raises(at.ConfigError, match=message):
        at.tyre_from_table(path, LOADS)


def test_slip_in_degrees_in_a_column_of_radians_and_the_other_sign_are_named(tmp_path):
    path = table(tmp_path / "axles.csv", degrees=True)
    path.write_text(path.read_text().replace("slip_deg", "slip_rad"))
    with pytest.raises(at.ConfigError, match="in degrees it is column slip_deg"):
        at.tyre_from_table(path, LOADS)
    path = table(tmp_path / "axles.csv")
    head, *rows = path.read_text().splitlines()
    turned = [",".join([str(-float(row.split(",")[0])), *row.split(",")[1:]]) for row in rows]
    path.write_text("\n".join([head, *turned]))
    with pytest.raises(at.ConfigError, match=r"force_front_N falls with slip.*change the sign"):
        at.tyre_from_table(path, LOADS)
    with pytest.raises(at.ConfigError, match="times the load: wrong unit"):
        at.tyre_from_table(table(tmp_path / "axles.csv"), (38.0, 26.0))
