"""The planned speed is the fastest that the limits allow; what a car cannot drive is named; the commands say so."""

import json
import math

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.sparse import csr_array, diags_array, vstack

import adaptrack as at
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.road import Arc, Clothoid, Comfort, Line, Stop, smallest_radius

CAR = at.load_vehicle("midsize-sedan")
KINDS = ("country", "town", "mountain", "lap")


# -- speed ------------------------------------------------------------------------------------------------------------
def test_a_straight_road_from_rest_to_rest_takes_the_time_of_the_trapezoid():
    road = at.Road.from_segments([Line(length=500.0)], speed_limit=20.0)
    plan = at.plan_speed(road, None, Comfort(accelerate=2.0, brake=4.0), start=0.0, end=0.0)
    gain, loss = 400.0 / 4.0, 400.0 / 8.0
    assert plan.duration == pytest.approx(20.0 / 2.0 + 20.0 / 4.0 + (500.0 - gain - loss) / 20.0, rel=1e-6)
    assert float(plan.at(25.0)) == pytest.approx(10.0)


RAMPS = Comfort(accelerate=2.0, brake=2.0)


def test_a_stop_costs_a_ramp_down_one_up_and_its_time_also_beside_a_place_of_the_plan():
    """On roads of one piece and of many, with places every metre."""
    for road in (at.Road.from_segments([Line(length=300.0)], speed_limit=10.0),
                 at.Road.from_segments([Line(length=33.3)] * 9, speed_limit=10.0)):  # fmt: skip
        free = at.plan_speed(road, None, RAMPS, start=10.0)
        for excess in (0.0, 1e-14, -1e-14, 1e-10, -3e-7, 1e-4):
            for place in free.s[[60, 150, 200]]:
                stopped = at.plan_speed(road, None, RAMPS, start=10.0, stops=[Stop(float(place) * (1.0 + excess), 7.0)])
                assert stopped.duration == pytest.approx(free.duration + 5.0 + 7.0, abs=2e-3)
                assert stopped.time[-1] == pytest.approx(stopped.duration)
                assert stopped.s[stopped.speed == 0.0] == pytest.approx([place], rel=2e-4)


@pytest.mark.parametrize("gap", [1e-5, 1e-3, 0.1, 0.3, 0.7])
@pytest.mark.parametrize("jerk", [math.inf, 5.0])
def test_between_two_stops_in_one_cell_the_car_moves(gap, jerk):
    """Up and down at 2 m/s^2; with a bounded jerk it takes longer. Standing times of stops at one place add up."""
    road = at.Road.from_segments([Line(length=100.0)], speed_limit=10.0)
    comfort = RAMPS.replace(jerk=jerk)
    single = at.plan_speed(road, None, comfort, start=0.0, end=0.0, stops=[Stop(40.2, 3.0)])
    pair = at.plan_speed(road, None, comfort, start=0.0, end=0.0, stops=[Stop(40.2, 3.0), 40.2 + gap])
    between = pair.duration - single.duration
    assert between == pytest.approx(2.0 * math.sqrt(gap / 2.0) - gap / 10.0, rel=0.02, abs=0.01) or jerk < math.inf
    assert 0.0 < between < 5.0
    joined = at.plan_speed(road, None, comfort, start=0.0, end=0.0, stops=[Stop(40.2, 3.0), Stop(40.2 + 1e-9, 2.0)])
    assert joined.duration == pytest.approx(single.duration + 2.0)
    assert joined.stops == [Stop(pytest.approx(40.2), pytest.approx(5.0))]


def test_stops_on_a_metre_of_road_and_under_a_bounded_jerk_are_reached_and_left():
    for stops in ([0.0], [0.3], [0.999], [1.0], [0.25, 0.5, 0.75], [1e-8, 1.0 - 1e-8]):
        plan = at.plan_speed(at.Road.from_segments([Line(length=1.0)]), None, start=0.0, end=0.0, stops=stops)
        assert 1.0 < plan.duration < 4.0
    road = at.generate_road("lap", seed=1, length=300.0)
    for jerk in (1.0, 5.0):
        free = at.plan_speed(road, CAR, Comfort(jerk=jerk))
        for stops in ([120.0], [0.0], [200.2, 200.7]):
            stopped = at.plan_speed(road, CAR, Comfort(jerk=jerk), stops=stops)
            assert free.duration + 2.0 < stopped.duration < free.duration + 20.0


@pytest.mark.parametrize(("bank", "sign"), [(0.0, 1.0), (0.1, 1.0), (-0.1, 1.0), (0.1, -1.0)])
def test_a_circle_is_driven_at_the_speed_that_its_radius_bank_and_friction_allow(bank, sign):
    road = at.Road.from_segments([Arc(length=100.0 * math.pi, curvature=sign / 50.0)], closed=True, bank=bank)
    for comfort, friction in ((Comfort(lateral=3.0), 0.9), (Comfort(lateral=30.0), 0.5)):
        felt = min(comfort.lateral, comfort.grip_share * friction * GRAVITY * math.cos(bank))
        exact = math.sqrt(50.0 * (felt + sign * GRAVITY * math.sin(bank)))
        plan = at.plan_speed(road.replace(friction=friction), None, comfort)
        np.testing.assert_allclose(plan.speed, exact, rtol=1e-9)
        assert plan.duration == pytest.approx(road.length / exact)


def test_full_power_on_a_straight_road_gains_what_the_engine_gives():
    road = at.Road.from_segments([Line(length=400.0)], friction=1.2)
    plan = at.plan_speed(road, CAR, Comfort(accelerate=50.0), start=10.0, spacing=0.25, top_speed=100.0)
    v, s = 10.0, 0.0
    while s < 400.0:  # independent: small steps of time
        force = min(CAR.traction_limit, CAR.engine_power / v)
        drag = 0.5 * CAR.air_density * CAR.frontal_area * CAR.drag_coefficient * v * v
        v += 1e-3 * ((force - drag) / CAR.mass - CAR.rolling_resistance * GRAVITY)
        s += 1e-3 * v
    assert plan.speed[-1] == pytest.approx(v, rel=5e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_a_plan_keeps_every_limit_within_two_per_cent(kind):
    road = at.generate_road(kind, seed=2, length=1500.0, friction=([0.0, 500.0, 501.0], [0.9, 0.9, 0.4]))
    comfort = Comfort(lateral=4.0)
    plan = at.plan_speed(road, CAR, comfort)
    s = np.linspace(0.0, road.length, 7001)[1:-1]
    v, curvature = plan.at(s), road.at(s).curvature
    along = plan.acceleration[np.searchsorted(plan.s, s, "right") - 1]
    grip = comfort.grip_share * road.along("friction", s) * GRAVITY
    sideways = v**2 * curvature
    assert (np.abs(sideways) / np.minimum(grip, 4.0)).max() < 1.02
    assert (v / road.along("speed_limit", s)).max() < 1.0 + 1e-9
    assert along.max() < 2.0 * 1.02
    assert along.min() > -3.0 * 1.02
    air = 0.5 * CAR.air_density * CAR.frontal_area * CAR.drag_coefficient * v**2
    tyres = along + air / CAR.mass + CAR.rolling_resistance * GRAVITY
    assert (np.hypot(tyres, sideways) / grip).max() < 1.02
    assert (CAR.mass * tyres * v).max() < CAR.engine_power * 1.02


def test_a_clothoid_is_driven_no_faster_than_its_lateral_jerk_allows():
    road = at.Road.from_segments([Clothoid(length=80.0, start_curvature=-0.01, end_curvature=0.01), Line(length=20.0)])
    plan = at.plan_speed(road, None, Comfort(lateral=50.0, grip_share=1.0, lateral_jerk=6.0), top_speed=60.0)
    sharpness = 0.02 / 80.0
    assert plan.speed[plan.s <= 80.0].max() == pytest.approx((6.0 / sharpness) ** (1.0 / 3.0), rel=1e-9)
    free = at.plan_speed(road, None, Comfort(lateral=50.0, grip_share=1.0, lateral_jerk=math.inf), top_speed=60.0)
    assert free.speed.max() > plan.speed.max()


@pytest.mark.parametrize("kind", KINDS)
def test_the_time_is_that_of_a_fine_optimum_within_three_per_cent(kind):
    # v^2 = w: the greatest w below the limits of curvature with |w'| <= 2a on a grid of 0.25 m, by linear programming,
    # the friction circle as a polygon about it.
    road = at.generate_road(kind, seed=3, length=500.0)
    comfort = Comfort(lateral=4.0)
    plan = at.plan_speed(road, None, comfort)
    s = np.linspace(0.0, road.length, 4 * math.ceil(road.length) + 1)
    n, ds = s.size, s[1]
    curvature = np.abs(road.at(s).curvature)
    grip = comfort.grip_share * 0.9 * GRAVITY
    top = np.minimum(KIND_SPEED[kind] ** 2, 4.0 / np.maximum(curvature, 1e-9))
    slope = csr_array(diags_array([-0.5 / ds, 0.5 / ds], offsets=[0, 1], shape=(n - 1, n)))
    rows, most = [slope, -slope], [np.full(n - 1, 2.0), np.full(n - 1, 3.0)]
    middle = 0.5 * (curvature[:-1] + curvature[1:])
    mean = csr_array(diags_array([0.5, 0.5], offsets=[0, 1], shape=(n - 1, n)))
    for angle in np.linspace(0.0, math.pi, 25):
        rows.append(math.cos(angle) * slope + csr_array(diags_array(math.sin(angle) * middle)) @ mean)
        most.append(np.full(n - 1, grip))
    if road.closed:
        seam = csr_array(([1.0, -1.0], ([0, 0], [0, n - 1])), shape=(1, n))
        rows += [seam, -seam]
        most += [np.zeros(1), np.zeros(1)]
    bounds = np.stack([np.zeros(n), top], axis=-1)
    optimum = linprog(-np.ones(n), A_ub=vstack(rows), b_ub=np.concatenate(most), bounds=bounds, method="highs")
    v = np.sqrt(optimum.x)
    assert plan.duration == pytest.approx(float((ds / (0.5 * (v[1:] + v[:-1]))).sum()), rel=0.03)


KIND_SPEED = {"country": 25.0, "town": 13.9, "mountain": 16.7, "lap": 25.0}


def test_a_bounded_jerk_is_kept_and_costs_time():
    road = at.generate_road("town", seed=1, length=600.0)
    free = at.plan_speed(road, CAR, start=0.0, end=0.0)
    soft = at.plan_speed(road, CAR, Comfort(jerk=1.5), start=0.0, end=0.0)
    middle = 0.5 * (soft.time[1:] + soft.time[:-1])
    assert np.abs(np.diff(soft.acceleration) / np.diff(middle)).max() < 1.5 * 1.02
    assert (soft.speed <= free.speed + 1e-9).all()
    assert free.duration < soft.duration < 1.4 * free.duration


def test_a_lap_is_planned_without_a_jump_at_its_seam():
    road = at.generate_road("lap", seed=1, length=700.0)
    plan = at.plan_speed(road, CAR, stops=[5.0])
    assert plan.speed[0] == plan.speed[-1]
    assert float(plan.at(road.length + 5.0)) == 0.0
    assert plan.acceleration[-1] < 0.0  # braking for the stop behind the seam


def line(length=100.0, **along):
    return at.Road.from_segments([Line(length=length)], **({"speed_limit": 20.0} | along))


@pytest.mark.parametrize(
    ("road", "options", "words"),
    [
        (line(), {"stops": [700.0]}, "on the road, 0 to 100 m"),
        (line(), {"start": -1.0}, "start"),
        (line(), {"end": 99.0}, "at most 20"),
        (line(60.0), {"start": 20.0, "end": 0.0}, "cannot brake in time; start at"),
        (line(), {"spacing": 0.0}, "spacing"),
        (line(), {"top_speed": math.nan}, "top_speed"),
        (line(bank=([0.0, 50.0, 51.0], [0.0, 0.0, 0.5])), {}, "at s = 51 m the bank alone"),
        (at.Road.from_segments([Line(length=50.0), Arc(length=1.0, curvature=2.0)]), {"car": CAR},
         "the radius is 0.5 m, and this car cannot turn so tightly"),
    ],
)  # fmt: skip
def test_a_plan_that_is_not_possible_is_refused(road, options, words):
    with pytest.raises(at.InvalidInput, match=words):
        at.plan_speed(road, **({"car": None} | options))


@pytest.mark.parametrize("none", [None, 1000.0])
def test_where_a_road_has_no_limit_the_domain_of_the_car_is_and_that_is_said(none):
    road = at.Road.from_segments([Line(length=3000.0)], speed_limit=none)
    top = CAR.domain.speed[1]
    plan = at.plan_speed(road, CAR)
    assert plan.speed.max() == pytest.approx(top)
    (finding,) = at.check_road(road, CAR, plan)
    assert (finding.kind, finding.drivable, finding.value) == ("domain", True, top)
    assert "no speed limit" in finding.text
    assert at.plan_speed(road, None).speed.max() == pytest.approx(27.0)  # no car: the usual domain
    fast = at.plan_speed(road, CAR, top_speed=40.0)
    for beyond in (fast, at.plan_speed(road.replace(speed_limit=40.0), CAR), 40.0):  # asked for, or the road's
        (finding,) = at.check_road(road, CAR, beyond)
        assert (finding.kind, finding.value, finding.limit) == ("domain", pytest.approx(40.0, rel=1e-3), top)
        assert "beyond the domain" in finding.text


# -- checks -----------------------------------------------------------------------------------------------------------
def bent(curvature):
    ramp = Clothoid(length=10.0, start_curvature=0.0, end_curvature=curvature)
    back = Clothoid(length=10.0, start_curvature=curvature, end_curvature=0.0)
    return at.Road.from_segments([Line(length=800.0), ramp, Arc(length=4.0, curvature=curvature), back])


def findings_by_kind(*arguments):
    return {finding.kind: finding for finding in at.check_road(*arguments)}


def test_a_bend_that_is_too_tight_or_too_fast_is_named_with_its_place():
    limited = CAR.replace(steering=at.Steering(limit=0.5))
    assert smallest_radius(limited) == pytest.approx(math.hypot(CAR.wheelbase / math.tan(0.5), CAR.lr))
    car = CAR.replace(steering=None)  # 30 degrees
    least = smallest_radius(car)
    radius, grip = findings_by_kind(bent(0.25), car, 25.0)["radius"], findings_by_kind(bent(0.25), car, 25.0)["grip"]
    assert radius.text == f"radius 4.0 m at s = 810 m, below this car's {least:.1f} m"
    tight = findings_by_kind(bent(1.0 / (0.9 * least)), car)["radius"]
    assert tight.value == pytest.approx(0.9 * least)
    assert 800.0 < tight.start < 810.0 < 814.0 < tight.end < 824.0
    assert grip.value == pytest.approx(25.0**2 / 4.0 / GRAVITY)
    assert "16 g at 25 m/s, radius 4 m at s = 810 m" in grip.text
    assert not grip.drivable


def test_bank_and_friction_count_for_the_grip():
    road = at.Road.from_segments([Arc(length=100.0, curvature=0.02)], friction=0.5)
    limit = math.sqrt(0.5 * GRAVITY / 0.02)
    assert at.check_road(road, CAR, 0.99 * limit) == []
    assert list(findings_by_kind(road, CAR, 1.01 * limit)) == ["grip"]
    assert at.check_road(road.replace(bank=0.1), CAR, 1.05 * limit) == []


def test_steering_rate_width_edges_and_jumps_are_named():
    country = at.generate_road("country", seed=1, length=1000.0)
    assert at.check_road(country, CAR, at.plan_speed(country, CAR)) == []  # it suits the car
    car = CAR.replace(steering=at.Steering(rate=0.3))
    needed = findings_by_kind(bent(0.1), car, 12.0)["steering-rate"].value
    assert needed == pytest.approx((CAR.wheelbase + CAR.understeer_gradient * 144.0) * 0.01 * 12.0, rel=1e-6)
    narrow = at.Road.from_segments([Line(length=50.0)], width_left=0.5, width_right=0.5)
    assert list(findings_by_kind(narrow, CAR)) == ["width"]
    (fold,) = at.check_road(at.Road.from_segments([Arc(length=20.0, curvature=0.05)], width_left=25.0), CAR)
    assert (fold.kind, fold.drivable) == ("fold", True)
    (jump,) = at.check_road(at.Road.from_segments([Line(length=50.0), Arc(length=20.0, curvature=0.02)]), CAR)
    assert (jump.kind, jump.start, jump.drivable) == ("jump", 50.0, True)
    with pytest.raises(at.InvalidInput, match="speed"):
        at.check_road(narrow, CAR, -1.0)


# -- commands ---------------------------------------------------------------------------------------------------------
def test_check_tells_what_a_road_is_and_ends_with_1_when_it_cannot_be_driven(run_command, output_of, tmp_path):
    (tmp_path / "road.csv").write_text("\n".join(f"{x},0" for x in range(0, 3000, 50)))
    out = output_of("road", "check", tmp_path / "road.csv")
    assert "can be driven" in out
    assert "the road has no speed limit: the plan ends at 27 m/s" in " ".join(out.split())
    assert "largest deviation" in out
    code, out, _ = run_command(
        "road", "check", "mountain", "--road-seed", "1", "--length", "800", "--speed", "25", "--json"
    )
    answer = json.loads(out)
    assert code == 1
    assert (answer["drivable"], answer["fastest"]) == (False, 25.0)
    assert {"grip"} == {row["kind"] for row in answer["rows"]}
    assert answer["limits"]["stretches"] == []  # nothing bounds a speed that is given
    code, out, _ = run_command("road", "check", "mountain", "--road-seed", "1", "--length", "800", "--json")
    answer = json.loads(out)
    assert answer["limits"]["stretches"][-1]["end"] == answer["length"]
    assert sum(answer["limits"]["shares"].values()) == pytest.approx(1.0)
    assert "speed limit" in answer["limits"]["shares"]


def test_a_speed_column_is_driven_as_it_is_unless_an_acceleration_bounds_it(answer_of, tmp_path):
    rows = [f"{30 * math.cos(a):.3f},{8 + math.sin(a):.3f},{30 * math.sin(a):.3f}" for a in np.arange(0.0, 6.28, 0.1)]
    (tmp_path / "lap.csv").write_text("# x_m,vx_mps,y_m\n" + "\n".join(rows))
    fastest = {}
    for bounds in ((), ("--lateral-acceleration", "2")):
        arguments = ("road", "check", tmp_path / "lap.csv", "--speed-column", "vx_mps", *bounds)
        fastest[bounds] = answer_of(*arguments)["fastest"]
    assert fastest[()] == pytest.approx(9.0, abs=0.01)
    assert fastest[("--lateral-acceleration", "2")] == pytest.approx(math.sqrt(2.0 * 30.0), abs=0.05)


@pytest.mark.drawn
def test_plot_writes_a_picture(output_of, tmp_path):
    out = output_of("road", "plot", "lap", "--length", "600", "--speed", "30", "--out", tmp_path / "a.png")
    assert str(tmp_path / "a.png") in out
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
