"""Vehicles, tyres, actuators and pedals: what they mean, and that each number reaches its own slot."""

from __future__ import annotations

import math
import pickle
import re
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field, ValidationError

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import Record, build, dump_toml, read_toml, write_toml
from adaptrack.cars.vehicle import COASTING_SHARE, PedalMap, pack_plant
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.synthesis.plant import stiffness_coefficients

OWN_CAR = """\
mass = 1500
yaw_inertia = 2500.0
lf = 1.1
lr = 1.6
stiffness_front = 55e3
stiffness_rear = 60e3
"""  # the six numbers of the prediction model are all that a file must hold

PAPER_TABLE = dict(mass=1575, yaw_inertia=2875, lf=1.2, lr=1.6, stiffness_front=19000, stiffness_rear=33000)


def car(**changes) -> at.Vehicle:
    return at.Vehicle(**{"name": "test", **PAPER_TABLE, **changes})


def tyre(**changes) -> at.Tyre:
    numbers = {"stiffness_front": 8e4, "stiffness_rear": 9e4, "nominal_load": 4e3}
    return at.Tyre(**({"name": "test", "kind": "linear"} | numbers | changes))


def car_of(mass, lf, lr, index, front, rear):
    """A car by its dynamic index, and by the stiffness of its tyres over their static loads (1/rad)."""
    load = 0.5 * mass * GRAVITY / (lf + lr)
    return car(
        mass=mass, yaw_inertia=index * mass * lf * lr, lf=lf, lr=lr,
        stiffness_front=front * load * lr, stiffness_rear=rear * load * lf,
    )  # fmt: skip


cars = st.builds(
    car_of, mass=st.floats(500, 3000), lf=st.floats(0.8, 2.0), lr=st.floats(0.8, 2.0), index=st.floats(0.2, 5.0),
    front=st.floats(2.0, 100.0), rear=st.floats(2.0, 100.0),
)  # fmt: skip


def lateral_matrices(vehicle: at.Vehicle, vx: float) -> tuple[np.ndarray, np.ndarray]:
    """The paper's eq. (6) as d/dt (v_y, r) = A (v_y, r) + B delta."""
    m, inertia, lf, lr = vehicle.mass, vehicle.yaw_inertia, vehicle.lf, vehicle.lr
    front, rear = 2 * vehicle.stiffness_front, 2 * vehicle.stiffness_rear
    A = np.array(
        [
            [-(front + rear) / (m * vx), -vx - (front * lf - rear * lr) / (m * vx)],
            [-(front * lf - rear * lr) / (inertia * vx), -(front * lf**2 + rear * lr**2) / (inertia * vx)],
        ]
    )
    return A, np.array([front / m, front * lf / inertia])


class TestNamedSets:
    def test_every_named_vehicle_and_tyre_loads_and_a_model_has_the_stiffness_of_its_tyres_at_rest(self):
        assert {"paper", "midsize-sedan", "compact-ev", "van"} <= set(at.list_vehicles())
        assert {"magic-formula", "constant-stiffness", "passenger-car"} <= set(at.list_tyres())
        for load, listed in ((at.load_tyre, at.list_tyres()), (at.load_vehicle, at.list_vehicles())):
            assert [load(name).name for name in listed] == list(listed)
            assert all(load(name).description for name in listed)
        for vehicle in map(at.load_vehicle, at.list_vehicles()):
            matched = vehicle.matched_to(at.load_tyre(vehicle.tyre))
            stiffness = (vehicle.stiffness_front, vehicle.stiffness_rear)
            assert stiffness == pytest.approx((matched.stiffness_front, matched.stiffness_rear), rel=1e-3)

    def test_the_paper_car_has_the_papers_table(self):
        vehicle = at.load_vehicle("paper")
        assert {name: getattr(vehicle, name) for name in PAPER_TABLE} == PAPER_TABLE
        for name in ("magic-formula", "constant-stiffness"):
            assert (at.load_tyre(name).stiffness_front, at.load_tyre(name).stiffness_rear) == (19000, 33000)

    def test_the_released_tyre_leaves_the_paper_car_33_6_and_43_7_kilonewton_per_radian_and_axle(self):
        # Independent figures: read from the authors' released model.
        front, rear = at.load_tyre("constant-stiffness").stiffness_at(*at.load_vehicle("paper").static_loads)
        assert 2 * front == pytest.approx(33.6e3, rel=3e-3)
        assert 2 * rear == pytest.approx(43.7e3, rel=3e-3)

    def test_a_side_wind_of_30_metres_per_second_pushes_the_paper_car_with_1_5_kilonewton_and_turns_it_with_1_4(self):
        # Independent figures: read from the authors' released model, at a forward speed of 20 m/s.
        vehicle = at.load_vehicle("paper")
        pressure = 0.5 * vehicle.air_density * vehicle.frontal_area * (20**2 + 30**2)
        angle = min(math.atan2(30, 20), vehicle.wind_angle_limit)
        assert pressure * vehicle.side_force_slope * angle == pytest.approx(1500, rel=0.02)
        assert pressure * vehicle.yaw_moment_slope * angle * vehicle.wheelbase == pytest.approx(1400, rel=0.02)

    def test_the_sedan_has_the_figures_that_commonroad_publishes_for_its_vehicle_2(self):
        pound, foot = 4.4482216152605, 0.3048
        sedan = at.load_vehicle("midsize-sedan")
        assert sedan.mass == pytest.approx(74.91452 * pound / foot, rel=1e-4)
        assert sedan.yaw_inertia == pytest.approx(1321.416 * pound * foot, rel=1e-4)
        lengths = (sedan.lf, sedan.lr, sedan.track_front, sedan.track_rear, sedan.cg_height)
        assert lengths == pytest.approx([foot * x for x in (3.793293, 4.667707, 4.55, 4.475, 1.886053)], rel=1e-4)

    def test_the_electric_car_is_what_opendbc_makes_of_its_kerb_mass_and_wheelbase(self):
        car, mass, wheelbase = at.load_vehicle("compact-ev"), 1685 + 136, 2.6
        assert (car.mass, car.lf, car.lr) == pytest.approx((mass, 0.4 * wheelbase, 0.6 * wheelbase))
        civic_mass, civic_wheelbase = 1326 + 136, 2.7
        scaled = 2500 * mass * wheelbase**2 / (civic_mass * civic_wheelbase**2)
        assert car.yaw_inertia == pytest.approx(scaled, rel=1e-3)
        # between a Civic's axles, scaled by mass alone (both have their centre of gravity at 0.4), and the bare tyre
        share = 0.385 * mass / civic_mass / 2
        bare = at.load_tyre("passenger-car").stiffness_at(*car.static_loads)
        assert 192150 * share < car.stiffness_front < bare[0]
        assert 202500 * share < car.stiffness_rear < bare[1]

    def test_the_van_has_the_published_axles_and_the_inertia_of_commonroads_van_in_proportion(self):
        van = at.load_vehicle("van")
        assert (van.lf, van.lr, van.mass) == (1.484, 1.644, 2520 + 4 * 70)
        ratio = 2473.12 / (1478.898 * 1.150792 * 1.321136)  # vehicle 3 of CommonRoad: I_z/(m a b)
        assert van.yaw_inertia == pytest.approx(ratio * van.mass * van.lf * van.lr, rel=2e-3)

    def test_the_vans_tyre_is_the_passenger_cars_at_other_loads(self):
        ours, base, scale = at.load_tyre("van"), at.load_tyre("passenger-car"), 875 / 800
        for load in (3000.0, 5305.0, 7200.0):
            mine, theirs = ours.stiffness_at(load, load), base.stiffness_at(load / scale, load / scale)
            assert mine == pytest.approx([scale * their for their in theirs], rel=1e-3)


class TestFields:
    @pytest.mark.parametrize("model", [at.Vehicle, at.Tyre, at.SteeringActuator, at.Steering, at.Profile])
    def test_every_number_says_its_unit_and_every_field_its_meaning(self, model):
        units = ("kg", "kg m^2", "kg/m^3", "m", "m^2", "N", "N/rad", "1/rad", "rad", "rad/s", "s", "W", "-")
        units += ("m/s", "m/s^2", "m^2/rad^2")
        for name, field in model.model_fields.items():
            assert field.description, name
            if field.annotation in (float, float | None):
                unit, comma, meaning = field.description.partition(", ")
                assert unit in units, f"{name}: {unit!r}"
                assert comma
                assert meaning

    def test_a_changed_copy_is_validated_and_the_original_kept(self):
        vehicle = car()
        for mass in (2000, np.float64(2000), np.float32(2000), np.int64(2000)):
            assert vehicle.replace(mass=mass).mass == 2000
        with pytest.raises(ValidationError):
            vehicle.mass = 1.0
        assert vehicle.mass == 1575

    def test_sets_survive_their_file_pickling_and_json(self, tmp_path):
        sets = [
            *map(at.load_vehicle, at.list_vehicles()),
            *map(at.load_tyre, at.list_tyres()),
            at.SteeringActuator.ideal(),
        ]
        for record in sets:
            assert pickle.loads(pickle.dumps(record)) == record
            assert type(record).model_validate_json(record.model_dump_json()) == record
            record.to_toml(tmp_path / "copy.toml")
            name = {"name": record.name} if isinstance(record, at.Vehicle) else {}  # a car is named after its file
            assert build(type(record), read_toml(tmp_path / "copy.toml") | name, "copy") == record

    @pytest.mark.parametrize("name", sorted(PAPER_TABLE))
    def test_the_prediction_model_takes_positive_finite_numbers_only(self, name):
        for value in (0, -math.inf, math.nan, "1575", True, [1.0], 10**400):
            with pytest.raises(at.InvalidInput, match=rf"Vehicle: {name} = .*: must be a finite number > 0"):
                car(**{name: value})

    def test_the_ends_of_a_range_are_in_it(self):
        for value in (0, 1):
            assert car(drive_front=value, brake_front=value).drive_front == value


class TestTyre:
    def test_each_law_has_the_nominal_stiffness_at_the_nominal_load_and_linear_follows_it(self):
        digressive = tyre(stiffness_load="digressive", digressive_load_ratio=1.8)
        assert digressive.stiffness_at(4e3, 4e3) == pytest.approx((8e4, 9e4), rel=1e-12)
        assert tyre(stiffness_load="constant").stiffness_at(1e3, 9e3) == (8e4, 9e4)
        assert tyre(stiffness_load="linear").stiffness_at(1e3, 8e3) == (2e4, 18e4)

    @given(ratio=st.floats(0.5, 5), load=st.floats(10, 2e4))
    def test_digressive_is_pacejkas_sine_and_peaks_at_its_ratio(self, ratio, load):
        digressive = tyre(stiffness_load="digressive", digressive_load_ratio=ratio)
        pacejka = math.sin(2 * math.atan(load / 4e3 / ratio)) / math.sin(2 * math.atan(1 / ratio))
        assert digressive.stiffness_at(load, load)[0] == pytest.approx(8e4 * pacejka, rel=1e-9)
        assert digressive.stiffness_at(load, load)[0] <= digressive.stiffness_at(4e3 * ratio, 4e3)[0] * (1 + 1e-12)


class TestActuator:
    def test_ideal_has_no_lag_and_no_rate_limit(self):
        ideal = at.SteeringActuator.ideal()
        assert (ideal.lag, ideal.rate) == (0, math.inf)
        assert ideal.limit >= math.pi / 6  # the MPC's own bound stays the tighter one


class TestSteadyTurn:
    @given(vehicle=cars, vx=st.floats(1, 60))
    def test_yaw_gain_is_the_steady_state_of_equation_6(self, vehicle, vx):
        if vx > 0.9 * vehicle.critical_speed:
            return
        A, B = lateral_matrices(vehicle, vx)
        _, yaw_rate = np.linalg.solve(A, -B)
        assert vehicle.steady_state_yaw_gain(vx) == pytest.approx(yaw_rate, rel=1e-9)

    @given(vehicle=cars)
    def test_understeer_gradient_is_the_difference_of_the_slip_angles_per_lateral_acceleration(self, vehicle):
        share = vehicle.mass / vehicle.wheelbase  # F = m a_y share = 2 C alpha
        front = share * vehicle.lr / (2 * vehicle.stiffness_front)
        rear = share * vehicle.lf / (2 * vehicle.stiffness_rear)
        assert vehicle.understeer_gradient == pytest.approx(front - rear, rel=1e-9, abs=1e-12)

    def test_an_understeering_car_has_its_largest_yaw_gain_at_the_characteristic_speed(self):
        vehicle = at.load_vehicle("paper")
        top = vehicle.characteristic_speed
        gain = vehicle.steady_state_yaw_gain
        assert vehicle.critical_speed == math.inf
        assert gain(top) == pytest.approx(top / (2 * vehicle.wheelbase))
        assert gain(top) > max(gain(0.99 * top), gain(1.01 * top))

    def test_an_oversteering_car_becomes_unstable_at_the_critical_speed(self):
        vehicle = car(stiffness_front=60e3, stiffness_rear=30e3)
        critical = vehicle.critical_speed
        assert vehicle.characteristic_speed == math.inf
        assert np.linalg.eigvals(lateral_matrices(vehicle, 0.99 * critical)[0]).real.max() < 0
        assert np.linalg.eigvals(lateral_matrices(vehicle, 1.01 * critical)[0]).real.max() > 0

    def test_a_neutral_car_turns_as_its_wheelbase_says(self):
        vehicle = car(lf=1.4, lr=1.4, stiffness_front=5e4, stiffness_rear=5e4)
        assert vehicle.understeer_gradient == 0
        assert vehicle.characteristic_speed == vehicle.critical_speed == math.inf
        assert vehicle.steady_state_yaw_gain(28.0) == pytest.approx(10.0)

    @given(vehicle=cars)
    def test_static_loads_carry_the_weight_in_balance(self, vehicle):
        front, rear = vehicle.static_loads
        assert 2 * (front + rear) == pytest.approx(vehicle.mass * GRAVITY)
        assert front * vehicle.lf == pytest.approx(rear * vehicle.lr)


OTHER_SLOTS = {
    "steering_lag": lambda v, t, a: a.lag,
    "steering_rate": lambda v, t, a: a.rate,
    "steering_limit": lambda v, t, a: a.limit,
    "tyre_linear": lambda v, t, a: 1.0 if t.kind == "linear" else 0.0,
} | {f"stiffness_load_{i}": lambda v, t, a, i=i: stiffness_coefficients(t.numbers)[i] for i in range(3)}


class TestPackPlant:
    @staticmethod
    def distinct():
        """A vehicle, a tyre and an actuator without two equal numbers: a swap of two slots cannot go unnoticed."""
        vehicle = car(
            track_front=1.51, track_rear=1.52, cg_height=0.53, load_transfer_time=0.11, frontal_area=2.1,
            air_density=1.23, drag_coefficient=0.31, side_force_slope=3.1, yaw_moment_slope=1.01,
            wind_angle_limit=0.33, rolling_resistance=0.014, engine_power=95e3, traction_limit=7e3,
            brake_limit=14e3, drive_front=0.61, brake_front=0.71,
        )  # fmt: skip
        slick = tyre(
            kind="magic-formula", stiffness_load="digressive", digressive_load_ratio=2.2, shape=1.36,
            curvature=-0.4, friction_load_sensitivity=0.17, relaxation_length=0.45,
        )  # fmt: skip
        return vehicle, slick, at.SteeringActuator(lag=0.15, rate=0.5, limit=0.52)

    def test_each_number_reaches_its_own_slot(self):
        from adaptrack.core.models.car import PLANT_PARAMETERS

        vehicle, slick, actuator = self.distinct()
        packed = pack_plant(vehicle, slick, actuator)
        assert packed.shape == (len(PLANT_PARAMETERS),)
        assert packed.dtype == np.float64
        assert packed.flags.c_contiguous
        assert len(set(packed)) >= len(packed) - 1  # nearly all distinct (0 twice: Magic Formula, s0)
        for name, value in zip(PLANT_PARAMETERS, packed, strict=True):
            if name in OTHER_SLOTS:
                expected = OTHER_SLOTS[name](vehicle, slick, actuator)
            else:
                expected = getattr(slick if name in at.Tyre.model_fields else vehicle, name)
            assert value == expected, name

    @pytest.mark.parametrize("kind", ["vehicle", "tyre", "actuator"])
    def test_no_number_is_without_effect_except_those_of_the_prediction_model_and_the_loop(self, kind):
        parts = dict(zip(("vehicle", "tyre", "actuator"), self.distinct(), strict=True))
        before = pack_plant(**parts)
        record = parts[kind]
        numbers = {name for name, value in dict(record).items() if isinstance(value, float)}
        dead = set()
        for name in numbers:
            changed = record.replace(**{name: getattr(record, name) * 0.9})
            if np.array_equal(pack_plant(**{**parts, kind: changed}), before):
                dead.add(name)
        elsewhere = {"vehicle": {"stiffness_front", "stiffness_rear"}, "actuator": {"dead_time", "bias"}}  # the loop's
        assert dead == elsewhere.get(kind, set())


class TestPage:
    @pytest.fixture
    def page(self, project):
        return (project / "docs" / "vehicles.md").read_text(encoding="utf-8")

    def test_the_page_names_every_shipped_car_and_tyre(self, page):
        assert [name for name in (*at.list_vehicles(), *at.list_tyres()) if f"**`{name}`**" not in page] == []

    def test_the_refusal_shown_on_the_page_is_the_real_one(self, page, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        text = OWN_CAR.replace("mass = 1500", "mass = -1500.0").replace("yaw_inertia", "yaw_inertai")
        Path("my-car.toml").write_text(text)
        with pytest.raises(at.ConfigError) as caught:
            at.load_vehicle("my-car.toml")
        assert sorted(str(caught.value).splitlines()) == sorted(
            re.findall(r"```text\n(.*?)\n```", page, re.DOTALL)[0].splitlines()
        )


class TestOwnFiles:
    def write(self, folder: Path, text: str, name: str = "mine.toml") -> Path:
        path = folder / name
        path.write_text(text, encoding="utf-8")
        return path

    def test_six_numbers_make_a_car_by_any_path(self, tmp_path, monkeypatch):
        vehicle = at.load_vehicle(self.write(tmp_path, OWN_CAR))
        assert (vehicle.name, vehicle.mass) == ("mine", 1500)
        assert vehicle.tyre in at.list_tyres()
        monkeypatch.chdir(tmp_path)
        (tmp_path / "windows.toml").write_bytes(b"\xef\xbb\xbf" + OWN_CAR.replace("\n", "\r\n").encode())
        assert at.load_vehicle("windows.toml") == vehicle.replace(name="windows")
        assert at.load_vehicle("mine.toml") == at.load_vehicle(tmp_path / "mine.toml") == at.load_vehicle("./mine.toml")

    def test_a_tyre_file_is_looked_for_beside_the_vehicle_file(self, tmp_path, monkeypatch):
        tyre().to_toml(tmp_path / "slick.toml")
        path = self.write(tmp_path, OWN_CAR + 'tyre = "slick.toml"')
        monkeypatch.chdir("/")
        assert at.load_tyre(at.load_vehicle(path).tyre) == tyre()

    @settings(max_examples=20)
    @given(vehicle=cars, text=st.text(max_size=20))
    def test_any_vehicle_reads_back_equal_to_the_last_bit(self, vehicle, text, tmp_path_factory):
        path = tmp_path_factory.mktemp("any") / "any.toml"
        vehicle.replace(description=text).to_toml(path)
        assert at.load_vehicle(path) == vehicle.replace(name="any", description=text)
        assert re.search(r"^yaw_inertia = .*  # kg m\^2", path.read_text(), re.MULTILINE)

    def test_a_car_may_say_what_is_known_of_its_steering(self, tmp_path):
        path = self.write(tmp_path, OWN_CAR + "[steering]\nlag = 0.2\nratio = 15\n")
        steering = at.load_vehicle(path).steering
        assert (steering.lag, steering.ratio) == (0.2, 15.0)
        assert steering.dead_time is steering.rate is steering.limit is None
        at.load_vehicle(path).to_toml(tmp_path / "copy.toml")
        assert at.load_vehicle(tmp_path / "copy.toml").steering == steering
        assert at.load_vehicle("paper").steering is None

    @pytest.mark.parametrize(("line", "message"), [
        ("colour = 'red'", r"colour: unknown key. Known: 'air_density', .*'yaw_moment_slope'\."),
        ("cg_height = -0.5", r"cg_height = -0.5: must be a finite number >= 0 and <= 5 \(m, centre of gravity"),
        ("wind_angle_limit = 17", r"wind_angle_limit = 17: must be a finite number > 0 and <= 1.5708 \(rad"),
        ("tyre = 'pasenger-car'", r"tyre = 'pasenger-car': unknown tyre. Did you mean 'passenger-car'\?"),
        ("tyre = 'nowhere.toml'", r"tyre = '.*nowhere.toml': no such file"),
        ("name = ''", r"name = ''"),
        ("mass = 3", r"mine.toml.*: not valid TOML"),
        ("[steering]\nlagg = 0.2", r"steering.lagg: unknown key. Did you mean 'lag'\?"),
        ("[steering]\nrate = inf", r"steering.rate = inf: must be a finite number > 0 and <= 100 \(rad/s, "),
        ("[known_within]\nmass = 0.9", "known_within.mass = 0.9: must be a finite number >= 1"),
        ("[known_within]\nlf = -0.1", "known_within.lf = -0.1: must be a finite number >= 0"),
        ("[domain]\nspeed = [9.0, 4.0]", "speed = .9, 4.: need 0 < lowest"),
        ("[domain]\nfriction = [0.0, 1.0]", "friction"),
        ("[domain]\nlane_width = 0.0", "domain.lane_width"),
        ("estimated = ['masses']", "'masses' is no number of a car. Did you mean 'mass'"),
    ])  # fmt: skip
    def test_an_impossible_line_is_named_with_file_key_value_and_remedy(self, tmp_path, line, message):
        path = self.write(tmp_path, OWN_CAR + line)
        with pytest.raises(at.ConfigError, match=message) as caught:
            at.load_vehicle(path)
        assert str(caught.value).startswith(str(path))

    def test_all_problems_of_a_file_come_in_one_error(self, tmp_path):
        text = 'mas = 3\nyaw_inertia = -1\nlf = "a"\nlr = nan\ntyre = "x"\nstiffness_front = true\nbrake_front = 2'
        with pytest.raises(at.ConfigError) as caught:
            at.load_vehicle(self.write(tmp_path, text))
        message = str(caught.value)
        assert "9 problems" in message
        assert "stiffness_rear: missing; give a finite number > 0" in message
        for key in ("mas", "mass", "yaw_inertia", "lf", "lr", "tyre", "stiffness_front", "brake_front"):
            assert re.search(rf"^  {key}( = |: )", message, re.MULTILINE), key


class Step(Record):
    kind: Literal["step"] = "step"
    amplitude: float = Field(gt=0, description="m, height of the step")


class Table(Record):
    kind: Literal["table"] = "table"
    values: list[float]


class Drive(BaseModel):  # a plain pydantic model will do as well
    model_config = ConfigDict(extra="forbid")
    shape: Annotated[Step | Table, Field(discriminator="kind")]
    steps: list[Step] = []
    repeat: int | None = None


class TestTomlFiles:
    @pytest.mark.parametrize(("data", "message"), [
        ({"shape": {"kind": "step"}}, r"f: shape.amplitude: missing; give a finite number > 0 \(m, height"),
        ({"shape": {"kind": "step", "amplitud": 1, "amplitude": 1}}, r"shape.amplitud: unknown key. Did you mean"),
        ({"shape": {"kind": "table", "values": [1, "2"]}}, r"shape.values\[1\] = '2': must"),
        ({"shape": {"kind": "stepp", "amplitude": 1}}, r"shape.kind = 'stepp': unknown. Did you mean 'step'\?"),
        ({"shape": {"amplitude": 1}}, r"shape.kind: missing"),
        ({"shape": 3}, r"shape = 3: "),
        ({}, r"f: shape: missing"),
        ([1], r"f: expected a table of keys, got \[1\]"),
        ({"shape": {"kind": "step", "amplitude": 1}, "steps": [{"amplitude": 1}, {"amplitude": 0}]},
         r"steps\[1\].amplitude = 0: must be a finite number > 0"),
        ({"shape": {"kind": "step", "amplitude": 1}, "repeat": 1.5}, r"repeat = 1.5: must be a whole number"),
        ({"shape": {"kind": "step", "amplitude": "x" * 10_000}}, r"shape.amplitude = 'xxx"),
    ])  # fmt: skip
    def test_problems_in_nested_tables_are_named_by_their_place(self, data, message):
        with pytest.raises(at.ConfigError, match=message) as caught:
            build(Drive, data, "f")
        assert len(str(caught.value)) < 2000

    def test_written_tables_read_back(self, tmp_path):
        table = {"x": [1.5, 2], "y": {"z": "ü\n"}}
        data = {"a": 1, "t": table, "rows": [{"i": 1}, {"i": 2}], "b": [1, 2], "c": math.inf}
        with_nothing = {**data, "t": {**table, "no": None}, "nothing": None}
        write_toml(tmp_path / "f.toml", with_nothing, comments={"a": "kg,\n mass", "b": "m"})
        assert read_toml(tmp_path / "f.toml") == data
        assert "a = 1  # kg, mass\n" in (tmp_path / "f.toml").read_text()
        assert dump_toml({}) == ""


# -- pedal maps -------------------------------------------------------------------------------------------------------
MAP = PedalMap(
    speed=[0.0, 3.0, 20.0], throttle=[0.0, 0.1, 0.4, 1.0],
    force=[[400.0, 400.0, 3000.0, 7000.0], [-300.0, -100.0, 2000.0, 5000.0], [-600.0, -500.0, 500.0, 2500.0]],
    brake=[0.0, 0.1, 0.5, 0.9], brake_force=[0.0, 0.0, 4000.0, 10000.0],
)  # fmt: skip
BAND = COASTING_SHARE * 10000.0


def test_pedals_of_a_force_give_the_force_but_in_the_band_below_coasting_where_they_coast() -> None:
    for speed in (-1.0, 0.0, 1.5, 12.0, 30.0):
        coasting, largest = MAP.force_at(0.0, 0.0, speed), MAP.force_at(1.0, 0.0, speed)
        for force in np.linspace(coasting - 9000.0, largest, 300):
            throttle, brake = MAP.positions(force, speed)
            assert throttle * brake == 0.0
            expected = coasting if coasting - BAND <= force < coasting else force
            if not -2.0 * BAND < force - coasting < -BAND:
                assert MAP.force_at(throttle, brake, speed) == pytest.approx(expected, abs=1e-6)
        assert MAP.positions(1e6, speed) == (1.0, 0.0)
        assert MAP.positions(-1e6, speed) == (0.0, 0.9)


def test_hold_pressure_of_a_standing_car_is_a_brake_pedal_that_also_holds_its_creep() -> None:
    throttle, brake = MAP.positions(0.0, 0.0, hold=1600.0)
    assert throttle == 0.0
    assert MAP.force_at(throttle, brake, 0.0) == pytest.approx(-1600.0)


@pytest.mark.parametrize(("changes", "message"), [
    ({"throttle": [0.0, 10.0, 40.0, 100.0]}, "throttle must begin with 0 and end at most at 1"),
    ({"speed": [0.0, 3.0, 3.0]}, "speed must begin .* rise from value to value"),
    ({"force": MAP.force[:2]}, "a row for each speed"),
    ({"force": [*MAP.force[:2], (0.0, 5.0, 4.0, 9.0)]}, "force at 20 m/s is 0, 5, 4, 9 N: .* none below"),
    ({"brake_force": [0.0, 10.0]}, "brake_force is 0, 10 N: give a value for each position of brake"),
])  # fmt: skip
def test_a_table_that_is_no_map_is_refused_with_its_place(changes, message) -> None:
    with pytest.raises(InvalidInput, match=message):
        MAP.replace(**changes)
