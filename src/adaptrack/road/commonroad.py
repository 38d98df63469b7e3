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
from adaptrack.core.path import MIN_PATH_POINTS
from adaptrack.road.along import NO_LIMIT
from adaptrack.road.fit import fit_road
from adaptrack.road.road import Road
from adaptrack.road.segments import Array


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
    known = {int(lanelet.lanelet_id): lanelet for lanelet in network.lanelets}
    chain = [known[each] for each in _chain(where, known, _wanted(where, road))]
    points, values = _middle(chain, [_limit(network, lanelet) for lanelet in chain])
    try:
        made = fit_road(points, **({"name": Path(path).stem, **values} | options))
    except InvalidInput as error:
        raise ConfigError(f"{where}: {str(error).removeprefix('fit_road: ')}") from None
    numbers = ", ".join(str(lanelet.lanelet_id) for lanelet in chain)
    return made.replace(notes=(f"lanelets {numbers}", *made.notes))


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


def _wanted(where: str, road: str | int | Sequence[int] | None) -> list[int]:
    if road is None:
        return []
    parts = road.split(",") if isinstance(road, str) else [road] if isinstance(road, int) else list(road)
    try:
        return [int(part) for part in parts]
    except ValueError:
        raise ConfigError(
            f"{where}: road {printable(str(road))!r}: give ids of lanelets, such as '12,15,31'."
        ) from None


def _chain(where: str, known: dict[int, Any], wanted: list[int]) -> list[int]:
    """The ids of the lanelets in their order."""
    if not wanted:
        if len(known) > 1:
            some = ", ".join(map(str, list(known)[:8]))
            raise ConfigError(f"{where}: {len(known)} lanelets; say which by their ids, in order: {some}, ...")
        wanted = list(known)
    for each in wanted:
        if each not in known:
            raise ConfigError(f"{where}: no lanelet is {each}. {did_you_mean(str(each), list(map(str, known)))}")
    for one, other in itertools.pairwise(wanted):
        if other not in known[one].successor:
            follow = ", ".join(map(str, known[one].successor)) or "none"
            raise ConfigError(f"{where}: lanelet {other} does not follow {one}; its successors: {follow}.")
    if len(wanted) == 1:
        while len(known[wanted[-1]].successor) == 1 and known[wanted[-1]].successor[0] not in wanted:
            wanted = [*wanted, int(known[wanted[-1]].successor[0])]
    return wanted


def _middle(chain: list[Any], limits: list[float | None]) -> tuple[Array, dict[str, Array]]:
    """The points (n, 2) between the bounds; widths and speed limit (n,) there.

    Where one lanelet ends and the next begins the lower of their limits counts.
    """
    said = [NO_LIMIT if limit is None else limit for limit in limits]
    rows = []
    for k, lanelet in enumerate(chain):
        left, right = (np.asarray(each, float)[:, :2] for each in (lanelet.left_vertices, lanelet.right_vertices))
        half = 0.5 * np.hypot(*(left - right).T)
        limit = np.full(half.shape, said[k])
        limit[0] = min(said[max(k - 1, 0)], said[k])
        own = np.column_stack([0.5 * (left + right), half, limit])
        rows.append(own if lanelet is chain[-1] else own[:-1])
    table = np.concatenate(rows)
    while len(table) < MIN_PATH_POINTS:  # a short straight lanelet
        table = np.insert(table, range(1, len(table)), 0.5 * (table[1:] + table[:-1]), axis=0)
    x, y, width, limit = table.T.copy()
    values = {"width_left": width, "width_right": width.copy()}
    if any(each is not None for each in limits):
        values["speed_limit"] = limit
    return np.column_stack([x, y]), values


def _limit(network: Any, lanelet: Any) -> float | None:
    """The lowest limit (m/s) of a lanelet's traffic signs, in any country's numbers."""
    signs = [network.find_traffic_sign_by_id(each) for each in lanelet.traffic_signs]
    elements = [element for sign in signs if sign is not None for element in sign.traffic_sign_elements]
    found = [
        float(each.additional_values[0])
        for each in elements
        if each.traffic_sign_element_id.name == "MAX_SPEED" and each.additional_values
    ]
    return min(found, default=None)
