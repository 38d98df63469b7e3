"""Roads by what they are called: a file, or a kind of generated road."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from typing import Any

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.road.commonroad import read_commonroad
from adaptrack.road.fit import fit_road
from adaptrack.road.generate import ROAD_KINDS, generate_road
from adaptrack.road.opendrive import read_opendrive
from adaptrack.road.points import road_from_csv
from adaptrack.road.road import Road
from adaptrack.road.station_table import ALONG_QUANTITIES
from adaptrack.road.toml import road_from_toml

_READERS: dict[str, Callable[..., Road]] = {
    ".csv": road_from_csv,
    ".txt": road_from_csv,
    ".toml": road_from_toml,
    ".xml": read_commonroad,
    ".xodr": read_opendrive,
}
ROAD_ENDINGS = tuple(_READERS)
"""Endings of files that hold roads; `cli.road.ROADS_HELP` explains them."""


@checked
def load_road(name_or_path: str | os.PathLike[str], **options: Any) -> Road:
    """A road from a file, or one of the kinds that `generate_road` knows.

    Parameters
    ----------
    name_or_path
        A .csv or .txt file of points (`adaptrack.road.points.read_points`), a .toml file of elements, points and what
        lies along (`adaptrack.road.toml`), an OpenDRIVE file (.xodr, `adaptrack.road.opendrive.read_opendrive`), a
        CommonRoad file (.xml, `adaptrack.road.commonroad.read_commonroad`), or "motorway", "country", "town",
        "mountain", "lap".
    **options
        Of the function that makes the road.

    Raises
    ------
    UnknownName
        When it is neither.
    StorageError, ConfigError
        When the file cannot be read, or holds no road.
    InvalidInput
        For an option that the function does not have, or a value that it refuses.
    """
    text = os.fspath(name_or_path)
    ending = os.path.splitext(text)[1].lower()
    if ending not in _READERS and text not in ROAD_KINDS:
        suggestion = did_you_mean(text, ROAD_KINDS)
        raise UnknownName(f"no road is named {text!r}. {suggestion} A file ends in {', '.join(ROAD_ENDINGS)}.")
    read: Callable[..., Road] = _READERS.get(ending, generate_road)
    for name in options:
        _check_option(text, name, read)
    return read(text, **options)


def _check_option(text: str, name: str, read: Callable[..., Road]) -> None:
    """Refuse an option that is not one of the function that makes the road."""
    if name in _options(read):
        return
    elsewhere = [ending for ending, reader in _READERS.items() if name in _options(reader)]
    elsewhere += ["generated"] if name in _options(generate_road) else []
    if elsewhere:
        raise InvalidInput(f"{text}: {name} is an option of {', '.join(elsewhere)} roads; leave it out.")
    raise InvalidInput(f"{text}: unknown option {name}. {did_you_mean(name, _options(read))}")


def _options(read: Callable[..., Road]) -> set[str]:
    """The options of a function that makes a road."""
    names = set(list(inspect.signature(read).parameters)[1:-1]) | set(ALONG_QUANTITIES)
    if read in (road_from_csv, read_commonroad):
        names |= set(list(inspect.signature(fit_road).parameters)[1:-1])
    return names if read is generate_road else names | {"name"}
