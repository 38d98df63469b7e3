"""Roads from CommonRoad scenarios: the centre line of a chain of lanelets, with its widths and speed limit.

A lanelet is a piece of a lane between two polygons, driven in one direction (P. Bender, J. Ziegler and C. Stiller,
*Lanelets: Efficient map representation for autonomous driving*, IEEE Intelligent Vehicles Symposium 2014; M. Althoff,
M. Koschi and S. Manzinger, *CommonRoad*, the same, 2017). The file is read by commonroad-io (extra `commonroad`).
"""

from __future__ import annotations

import itertools
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from adaptrack.base.errors import ConfigError, InvalidInput, did_you_mean
from adaptrack.base.files import printable, read_bytes
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.roads.path import MIN_PATH_POINTS
from adaptrack.road.fit import fit_road
from adaptrack.road.road import Road
from adaptrack.road.station_table import NO_LIMIT


def read_commonroad(
    path: str | os.PathLike[str], road: str | int | Sequence[int] | None = None, **options: Any
) -> Road:
    """The road along a chain of lanelets of a CommonRoad file: a smooth curve near the middle of their bounds.

    Parameters
    ----------
    road : str, int or sequence of int
        Ids of lanelets in the order in which they are driven ("12,15,31"), each a successor of the one before it. After
        one alone the road goes on as long as there is exactly one successor. May be left out in a file of one lanelet.
    **options
        As in `fit_road`: `max_deviation` of the centre line's points; width and speed limit in place of the file's.

    Raises
    ------
    InvalidInput
        When commonroad-io is not installed.
    StorageError
        When the file cannot be read.
    ConfigError
        When it is no such file, or the lanelets are no chain; with the remedy.
    """
    where = os.fspath(path)
    network = _network(where, read_bytes(path))
    lanelets = {int(lanelet.lanelet_id): lanelet for lanelet in network.lanelets}
    chain = [lanelets[number] for number in _chain(where, lanelets, _lanelet_numbers(where, road))]
    points, values = _middle(chain, [_limit(network, lanelet) for lanelet in chain])
    try:
        fitted_road = fit_road(points, **({"name": Path(path).stem, **values} | options))
    except InvalidInput as error:
        raise ConfigError(f"{where}: {str(error).removeprefix('fit_road: ')}") from None
    numbers = ", ".join(str(lanelet.lanelet_id) for lanelet in chain)
    return fitted_road.replace(notes=(f"lanelets {numbers}", *fitted_road.notes))


def _network(where: str, content: bytes) -> Any:
    try:
        with warnings.catch_warnings():  # of the packages below it
            warnings.simplefilter("ignore")
            from commonroad.common.file_reader import CommonRoadFileReader
    except ImportError as error:
        raise InvalidInput(
            f"{where}: reading CommonRoad files needs commonroad-io ({error}): pip install 'adaptrack[commonroad]'."
        ) from None
    if b"<commonRoad" not in content:
        raise ConfigError(f"{where}: it has no <commonRoad>; a scenario of format 2018b or 2020a is expected.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            network = CommonRoadFileReader(where).open_lanelet_network()
    except Exception as error:  # the reader's own errors are of many kinds
        raise ConfigError(f"{where}: commonroad-io cannot read it: {type(error).__name__}: {error}.") from None
    if not network.lanelets:
        raise ConfigError(f"{where}: there is no <lanelet> in it.")
    return network


def _lanelet_numbers(where: str, road: str | int | Sequence[int] | None) -> list[int]:
    if road is None:
        return []
    parts = road.split(",") if isinstance(road, str) else [road] if isinstance(road, int) else list(road)
    try:
        return [int(part) for part in parts]
    except ValueError:
        raise ConfigError(
            f"{where}: road {printable(str(road))!r}: give ids of lanelets, such as '12,15,31'."
        ) from None


def _chain(where: str, lanelets: dict[int, Any], numbers: list[int]) -> list[int]:
    """The ids of the lanelets in their order."""
    if not numbers:
        if len(lanelets) > 1:
            some = ", ".join(map(str, list(lanelets)[:8]))
            raise ConfigError(f"{where}: {len(lanelets)} lanelets; say which by their ids, in order: {some}, ...")
        numbers = list(lanelets)
    for number in numbers:
        if number not in lanelets:
            raise ConfigError(f"{where}: no lanelet is {number}. {did_you_mean(str(number), list(map(str, lanelets)))}")
    for predecessor, other in itertools.pairwise(numbers):
        if other not in lanelets[predecessor].successor:
            follow = ", ".join(map(str, lanelets[predecessor].successor)) or "none"
            raise ConfigError(f"{where}: lanelet {other} does not follow {predecessor}; its successors: {follow}.")
    if len(numbers) == 1:
        while len(lanelets[numbers[-1]].successor) == 1 and lanelets[numbers[-1]].successor[0] not in numbers:
            numbers = [*numbers, int(lanelets[numbers[-1]].successor[0])]
    return numbers


def _middle(chain: list[Any], limits: list[float | None]) -> tuple[Array, dict[str, Array]]:
    """The points (n, 2) between the bounds; widths and speed limit (n,) there.

    Where one lanelet ends and the next begins the lower of their limits counts.
    """
    speed_limits = [NO_LIMIT if limit is None else limit for limit in limits]
    rows = []
    for k, lanelet in enumerate(chain):
        left, right = (
            np.asarray(vertices, float)[:, :2] for vertices in (lanelet.left_vertices, lanelet.right_vertices)
        )
        half = 0.5 * portable.hypot(*(left - right).T)
        limit = np.full(half.shape, speed_limits[k])
        limit[0] = min(speed_limits[max(k - 1, 0)], speed_limits[k])
        lane_rows = np.column_stack([0.5 * (left + right), half, limit])
        rows.append(lane_rows if lanelet is chain[-1] else lane_rows[:-1])
    table = np.concatenate(rows)
    while len(table) < MIN_PATH_POINTS:  # a short straight lanelet
        table = np.insert(table, range(1, len(table)), 0.5 * (table[1:] + table[:-1]), axis=0)
    x, y, width, limit = table.T.copy()
    values = {"width_left": width, "width_right": width.copy()}
    if any(speed_limit is not None for speed_limit in limits):
        values["speed_limit"] = limit
    return np.column_stack([x, y]), values


def _limit(network: Any, lanelet: Any) -> float | None:
    """The lowest limit (m/s) of a lanelet's traffic signs, in any country's numbers."""
    signs = [network.find_traffic_sign_by_id(sign) for sign in lanelet.traffic_signs]
    elements = [element for sign in signs if sign is not None for element in sign.traffic_sign_elements]
    speeds = [
        float(element.additional_values[0])
        for element in elements
        if element.traffic_sign_element_id.name == "MAX_SPEED" and element.additional_values
    ]
    return min(speeds, default=None)
