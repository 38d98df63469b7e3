"""Figures are made in every test, but drawn only where that is asked for: it takes most of the time of a page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

_savefig = Figure.savefig
_EMPTY = {
    "svg": '<svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"></svg>',
    "png": bytes.fromhex(
        "89504e470d0a1a0a0000000d49484452000000010000000108000000003a7e9b55"
        "0000000a49444154789c63f80f0001010100b138f6140000000049454e44ae426082"
    ),
}


def _save_empty(figure: Figure, to: Any, **options: Any) -> None:
    if hasattr(to, "write"):
        to.write(_EMPTY[options["format"]])
    else:
        Path(to).write_bytes(b"")


def _save_coarse(figure: Figure, to: Any, **options: Any) -> None:
    _savefig(figure, to, **(options | {"dpi": 20} if options.get("format") == "png" else options))


@contextmanager
def pictures(drawn: bool) -> Iterator[None]:
    """Within, figures are drawn when they are saved, coarsely for print, or empty files stand for them."""
    before, Figure.savefig = Figure.savefig, _save_coarse if drawn else _save_empty
    try:
        yield
    finally:
        Figure.savefig = before
