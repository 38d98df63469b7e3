"""Roads by what they are called: a file, or a kind of generated road."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.road.commonroad import read_commonroad
from adaptrack.road.generate import KINDS, generate_road
from adaptrack.road.opendrive import read_opendrive
from adaptrack.road.points import road_from_csv
from adaptrack.road.road import Road
from adaptrack.road.toml import road_from_toml

_READERS: dict[str, Callable[..., Road]] = {
    ".csv": road_from_csv,
    ".txt": road_from_csv,
    ".toml": road_from_toml,
    ".xml": read_commonroad,
    ".xodr": read_opendrive,
}


def load_road(name_or_path: str | os.PathLike[str], **options: Any) -> Road:
    """A road from a file, or one of the kinds that `generate_road` knows.

    Parameters
    ----------
    name_or_path
        A .csv or .txt file of points (`Road.from_csv`), a .toml file of elements, points and what lies along
        (`Road.from_toml`), an OpenDRIVE file (.xodr, `Road.from_opendrive`), a CommonRoad file (.xml,
        `Road.from_commonroad`), or "motorway", "country", "town", "mountain", "lap".
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
    if ending not in _READERS and text not in KINDS:
        known = did_you_mean(text, KINDS)
        raise UnknownName(f"no road is named {text!r}. {known} A file ends in {', '.join(_READERS)}.")
    read = _READERS.get(ending)
    try:
        return generate_road(text, **options) if read is None else read(name_or_path, **options)
    except TypeError as error:
        if "unexpected keyword" not in str(error):
            raise
        raise InvalidInput(f"load_road: {text}: {error}.") from None
