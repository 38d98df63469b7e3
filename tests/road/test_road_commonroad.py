"""Roads from CommonRoad lanelets; skipped without the extra `commonroad`."""

import math
import warnings

import numpy as np
import pytest

from adaptrack.base.errors import ConfigError
from adaptrack.road import load_road


@pytest.fixture(scope="module", autouse=True)
def _installed():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pytest.importorskip("commonroad", reason="needs commonroad-io: pip install 'adaptrack[commonroad]'")


def bound(name, points):
    return f"<{name}>" + "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x, y in points) + f"</{name}>"


def lanelet(number, middle, after=(), sign=None, half=1.75):
    """A lanelet about points (x, y, heading)."""
    left = [(x - half * math.sin(h), y + half * math.cos(h)) for x, y, h in middle]
    right = [(x + half * math.sin(h), y - half * math.cos(h)) for x, y, h in middle]
    children = "".join(f'<successor ref="{successor}"/>' for successor in after)
    children += "<laneletType>urban</laneletType>" + (f'<trafficSignRef ref="{sign}"/>' if sign else "")
    return f'<lanelet id="{number}">{bound("leftBound", left)}{bound("rightBound", right)}{children}</lanelet>'


STRAIGHT = [(x, 0.0, 0.0) for x in np.linspace(0.0, 60.0, 7)]
ARC = [(60.0 + 50.0 * math.sin(a), 50.0 - 50.0 * math.cos(a), a) for a in np.linspace(0.0, 1.0, 12)]
AHEAD = [(x, 0.0, 0.0) for x in np.linspace(60.0, 90.0, 4)]
FORKED = lanelet(1, STRAIGHT, (2, 3)) + lanelet(2, ARC, sign=9) + lanelet(3, AHEAD)
SIGN = (
    '<trafficSign id="9"><trafficSignElement><trafficSignID>274</trafficSignID>'
    "<additionalValue>8.33</additionalValue></trafficSignElement>"
    "<position><point><x>60.0</x><y>-3.0</y></point></position><virtual>false</virtual></trafficSign>"
)


def scenario(path, lanelets=FORKED + SIGN):
    path.write_text(
        '<?xml version="1.0" encoding="UTF-8"?><commonRoad timeStepSize="0.1" commonRoadVersion="2020a" author="" '
        'affiliation="" source="" benchmarkID="DEU_Test-1_1_T-1" date="2026-01-01"><location><geoNameId>-999'
        "</geoNameId><gpsLatitude>999</gpsLatitude><gpsLongitude>999</gpsLongitude></location><scenarioTags/>"
        f"{lanelets}</commonRoad>"
    )
    return path


def test_a_chain_of_lanelets_is_the_line_between_their_bounds(tmp_path):
    road = load_road(scenario(tmp_path / "map.xml"), road="1,2")
    assert road.length == pytest.approx(110.0, abs=0.05)
    assert road.deviation < 0.1
    foot = road.project([30.0, *(p[0] for p in ARC[3:9])], [0.0, *(p[1] for p in ARC[3:9])])
    assert np.abs(foot.offset).max() < 0.05
    for side in ("width_left", "width_right"):
        np.testing.assert_allclose(road.along(side, np.linspace(0.0, 110.0, 50)), 1.75, atol=1e-9)
    assert "lanelets 1, 2" in road.notes[0]


def test_the_speed_limit_is_that_of_the_signs_of_each_lanelet(tmp_path):
    road = load_road(scenario(tmp_path / "map.xml"), road=[1, 2])
    assert (road.along("speed_limit", [62.0, 80.0, 109.0]) == 8.33).all()
    assert float(road.along("speed_limit", 20.0)) > 100.0
    assert load_road(tmp_path / "map.xml", road="1,3").speed_limit is None


def test_after_one_lanelet_the_road_goes_on_where_there_is_one_way(tmp_path):
    chain = lanelet(1, STRAIGHT, (2,)) + lanelet(2, ARC)
    assert load_road(scenario(tmp_path / "map.xml", chain), road=1).length == pytest.approx(110.0, abs=0.05)
    assert load_road(scenario(tmp_path / "map.xml"), road=1).length == pytest.approx(60.0, abs=0.05)


@pytest.mark.parametrize(("lanelets", "road", "words"), [
    (FORKED + SIGN, None, "3 lanelets; say which"),
    (FORKED + SIGN, "2,3", "3 does not follow 2; its successors: none"),
    (FORKED + SIGN, "7", "no lanelet is 7"),
    (FORKED + SIGN, "a", "give ids of lanelets"),
    ("", None, "no <lanelet>"),
    ("<lanelet id='x'/>", None, "cannot read it"),
])  # fmt: skip
def test_a_scenario_without_such_a_chain_is_refused(tmp_path, lanelets, road, words):
    with pytest.raises(ConfigError, match=words):
        load_road(scenario(tmp_path / "map.xml", lanelets), road=road)
    (tmp_path / "other.xml").write_text("<html/>")
    with pytest.raises(ConfigError, match="no <commonRoad>"):
        load_road(tmp_path / "other.xml")
