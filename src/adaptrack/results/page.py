"""A result as one self-contained HTML page, by the template of its kind, written with its PNG files."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from adaptrack import __version__
from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.base.files import PAGE_FILE, write_atomically
from adaptrack.base.presentation import content_policy, printable
from adaptrack.base.result import Column, Panel, Result, ResultTable
from adaptrack.results import style, words
from adaptrack.results.marks import Stroke
from adaptrack.results.record import replay_values


def write_result(out_dir: str | os.PathLike[str], result: Result, *, png: bool = True) -> Path:
    """Write ``index.html`` and the PNG files of a result's pictures into `out_dir`, and return the page's path.

    Everything is rendered before anything is written, every file appears whole, and the page comes last: a page that is
    there is complete. Other files in the folder stay as they are. png: whether to write the PNG files, which may take
    longer than the page, and link them.

    Raises InvalidInput when two pictures have the same file name, or one a name that is not a plain ``*.png``, and
    StorageError when a file cannot be written; files of an earlier page are then whole, old or new.
    """
    files: dict[str, bytes] = {}
    for picture in result.pictures:
        if not picture.file:
            continue
        if not re.fullmatch(r"[\w.-]+\.png", picture.file) or picture.file in files:
            raise InvalidInput(f"report: {picture.file!r} is not a name for a PNG file, or is used twice on this page.")
        files[picture.file] = style.png(style.print_figure(picture)) if png else b""
    page = render_result(result, png=png).encode()
    folder, existed = Path(out_dir), Path(out_dir).exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in ((files if png else {}) | {PAGE_FILE: page}).items():
            write_atomically(folder / name, content, through_links=False)
    except (OSError, StorageError) as error:
        if not existed:
            with contextlib.suppress(OSError):
                folder.rmdir()
        if isinstance(error, StorageError):
            raise
        raise StorageError(f"{folder}: the page cannot be written: {error.strerror or error}.") from error
    return folder / PAGE_FILE


def render_result(result: Result, *, png: bool = False) -> str:
    """The page of a result as HTML text: the template of its kind, or one that shows everything it holds."""
    template = make_environment().select_template([f"{result.kind}.html.j2", "result.html.j2"])
    return template.render(
        result=result, v=result.values, title=result.title, failed=result.headline,
        created=words.clock(result.created), version=__version__, png=png, titles=[],
        pictures={picture.name: picture for picture in result.pictures},
        tables={table.name: table for table in result.tables},
    )  # fmt: skip


def make_environment() -> jinja2.Environment:
    """Make the environment of the templates, with filters that write numbers, names and panels.

    The ids of panels are counted, so that one environment renders one page.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("adaptrack.results"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_printable,
        extensions=["jinja2.ext.do"],
    )
    counter = itertools.count(1)

    def inline(panel: Panel, size: tuple[float, float] | None = None) -> Markup:
        figure = style.panel_figure(panel, size)
        return Markup(style.inline_svg(figure, f"p{next(counter)}", style.describe_panel(panel)))

    formats = (
        "entry",
        "number",
        "percent",
        "listed",
        "counted",
        "capital",
        "title_of",
        "span",
        "few",
        "legible",
        "controller_name",
    )
    environment.filters |= {name: getattr(words, name) for name in formats}
    environment.filters |= {
        "inline": inline, "replay_values": replay_values, "policy": _policy, "anchor": words.slug,
        "words": _holds_words, "dashes": _dashes, "colour": lambda stroke: style.themed(stroke["color"]),
    }  # fmt: skip
    return environment


def _policy(text: str) -> Markup:
    """The security policy of a page with this text: nothing but its own scripts may run."""
    return Markup(content_policy(re.findall(r"<script>(.*?)</script>", text, re.DOTALL)))


def _holds_words(table: ResultTable, column: Column) -> bool:
    """Whether a column holds words, which are aligned to the left."""
    return any(isinstance(row[column.name], str) for row in table.rows) and not any(
        isinstance(row[column.name], int | float) for row in table.rows
    )


def _printable(value: Any) -> Any:
    """Replace characters of a name that no page can hold by escapes (the template escapes the rest)."""
    return printable(value, keep="\n\t") if type(value) is str else value


def _dashes(stroke: Stroke) -> str:
    """The SVG dash pattern of a stroke 2 wide; empty for a solid line."""
    pattern = stroke["linestyle"]
    return "" if pattern == "-" else " ".join(f"{2 * length:g}" for length in pattern[1])
