"""`adaptrack car`: show a car, make one."""

from __future__ import annotations

import json

import pytest
from tests.cars.test_tyre_file import BOOK, tir
from tests.cars.test_tyre_table import table

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.data_sheet import vehicle_from_data_sheet
from adaptrack.cars.vehicle import list_vehicles, load_tyre, load_vehicle


@pytest.mark.parametrize("name", list_vehicles())
def test_every_shipped_car_is_shown_in_80_columns(run_command, name):
    code, out, err = run_command("car", name)
    assert (code, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    for words in ("understeer gradient", "characteristic speed", "yaw gain at", "Domain:"):
        assert words in out


def test_what_is_known_within_what_is_shown(output_of):
    out = output_of("car", "sports-car")
    assert "x/÷ 1.15" in out
    assert "± 0.05 m" in out
    assert "1.07 (0.34 to 1.97)" in out


def test_mass_and_wheelbase_make_a_car_that_loads_and_says_what_is_estimated(output_of, tmp_path):
    out = tmp_path / "new" / "my-car.toml"
    text = output_of("car", "--mass", 1500, "--wheelbase", 2.7, "--load", 75, "--lf", 1.2, "--out", out)
    assert "estimated" in text
    car = load_vehicle(out)
    assert (car.name, car.mass, car.lf, car.lr) == ("my-car", 1575.0, 1.2, pytest.approx(1.5))
    assert "stiffness_front" in car.estimated
    assert "lf" not in car.estimated
    assert "estimated" in output_of("car", out)


def test_a_tyre_file_makes_a_tyre_beside_the_car_and_the_pair_may_be_moved(output_of, tmp_path):
    file, out = tir(tmp_path / "a.tir", BOOK), tmp_path / "new" / "mine.toml"
    text = output_of("car", "midsize-sedan", "--tir", file, "--out", out)
    assert max(map(len, text.splitlines())) <= 80 + len(str(tmp_path))
    assert "force off by at most" in text
    car, tyre = load_vehicle(out), load_tyre(tmp_path / "new" / "mine-tyre.toml")
    assert load_tyre(car.tyre) == tyre
    assert tyre.name == "mine-tyre"
    matched = car.matched_to(tyre)
    assert car.stiffness_front == pytest.approx(matched.stiffness_front, rel=1e-4)
    assert car.stiffness_rear == pytest.approx(matched.stiffness_rear, rel=1e-4)
    (tmp_path / "new").rename(tmp_path / "moved")
    car = load_vehicle(tmp_path / "moved" / "mine.toml")
    assert load_tyre(car.tyre) == tyre
    car.to_toml(tmp_path / "copy.toml")
    assert load_tyre(load_vehicle(tmp_path / "copy.toml").tyre) == tyre


def test_a_tyre_file_alone_makes_a_tyre(output_of, tmp_path):
    output_of("car", "--tir", tir(tmp_path / "a.tir", BOOK), "--out", tmp_path / "tyre.toml")
    assert load_tyre(tmp_path / "tyre.toml").nominal_load == 4000.0


def test_a_table_of_axle_forces_is_fitted_at_the_loads_of_the_car(answer_of, tmp_path):
    result = answer_of("car", "sports-car", "--tyre-table", table(tmp_path / "axles.csv"))
    assert result["tyre"]["deviation"] < 0.02
    assert result["tyre"]["loads"][1] == pytest.approx(load_vehicle("sports-car").static_loads[0])
    assert result["car"]["stiffness_front"] == pytest.approx(result["tyre"]["tyre"]["stiffness_front"], rel=1e-3)


@pytest.mark.parametrize(("axle", "share"), [("front", 1.0), ("rear", 0.0), ("all", 0.5)])
def test_the_driven_axle_of_a_new_car_is_stated_or_assumed_with_a_note(run_command, tmp_path, axle, share):
    sheet, out = ("car", "--mass", 1500, "--wheelbase", 2.7), tmp_path / "mine.toml"
    code, text, _ = run_command(*sheet, "--drive", axle, "--out", out)
    assert (code, load_vehicle(out).drive_front) == (0, share)
    assert "drive_front" not in load_vehicle(out).estimated
    assert "driven axle" not in text
    _, text, _ = run_command(*sheet, "--out", out)
    assert "drive_front" in load_vehicle(out).estimated
    assert "The driven axle is unknown; front drive is assumed." in text


def test_a_driven_axle_is_stated_once():
    with pytest.raises(InvalidInput, match="driven_axle and drive_front: give only one"):
        vehicle_from_data_sheet("mine", 1500.0, 2.7, driven_axle="rear", drive_front=0.2)
    with pytest.raises(InvalidInput, match="driven_axle = 'middle': must be"):
        vehicle_from_data_sheet("mine", 1500.0, 2.7, driven_axle="middle")


def test_a_car_file_of_other_content_that_is_replaced_stays_beside_it(run_command, tmp_path):
    out, sheet = tmp_path / "mine.toml", ("car", "--mass", 1500, "--wheelbase")
    run_command(*sheet, 2.7, "--out", out)
    before = out.read_bytes()
    _, text, _ = run_command(*sheet, 2.7, "--out", out)
    assert ("previous content" in text, list(tmp_path.glob("*.bak"))) == (False, [])
    _, text, _ = run_command(*sheet, 2.8, "--out", out)
    assert f"The previous content is in {out}.bak" in text.replace("\n", "")
    assert (tmp_path / "mine.toml.bak").read_bytes() == before
    _, text, err = run_command(*sheet, 2.9, "--out", out, "--json")
    assert "previous content" in err.replace("\n", " ")
    assert json.loads(text)["written"] == [str(out)]
