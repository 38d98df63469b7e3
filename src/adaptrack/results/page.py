"""One self-contained HTML page: sections of paragraphs, tables and pictures, written with its PNG files.

A part of the report (the runs of a simulation, a campaign, an evaluation) says what it shows as `Section`s;
`write_page` turns any list of them into a page that needs nothing but itself.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import jinja2
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptrack import __version__
from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.base.result import Column, Result, ResultTable
from adaptrack.base.text import printable
from adaptrack.results import draw, style
from adaptrack.results.words import (
    capital,
    clock,
    counted,
    entry,
    lettered,
    listed,
    number,
    percent,
    plain,
    slug,
    span,
    title_of,
)

Legend = Sequence[tuple[str, style.Stroke]]
"""Names and their strokes, in order."""

PAGE = "index.html"
"""The name of the page in its folder."""


@dataclass(frozen=True)
class Head:
    """The head of a table's column."""

    text: str
    unit: str = ""
    is_text: bool = False
    """Left-aligned words rather than right-aligned numbers."""


@dataclass(frozen=True)
class Cell:
    """One entry of a table."""

    text: str
    strong: bool = False
    """The best of its column."""
    warn: bool = False
    """Something the reader must not miss (a failed run, a failed QP)."""


@dataclass(frozen=True)
class Table:
    """A table; its first column heads the rows and stays in sight when the rest is scrolled."""

    caption: str
    heads: Sequence[Head]
    rows: Sequence[Sequence[Cell | str] | str]
    """A row that is only a string heads the rows below it."""
    note: str = ""


@dataclass(frozen=True)
class Drawing:
    """One panel of a picture, with the words that stand for it when it cannot be seen."""

    figure: Figure
    description: str


@dataclass(frozen=True)
class Panel:
    """One set of axes, to stand alone on the page and beside others in print."""

    title: str
    draw: Callable[[Axes], None]
    description: str
    """With the title, its alternative text."""

    def drawing(self) -> Drawing:
        """The panel alone."""
        return Drawing(style.panel_figure(self.show), plain(f"{self.title}. {self.description}"))

    def show(self, axes: Axes, title: str = "") -> None:
        """Draw it under its title, or another."""
        axes.set_title(title or self.title)
        self.draw(axes)


@dataclass(frozen=True)
class Picture:
    """Panels that flow into one or two columns, a legend, and the same as a file for print."""

    caption: str
    panels: Sequence[Drawing]
    legend: Legend = ()
    file: str = ""
    """The name of its PNG file beside the page; empty for none."""
    print_figure: Callable[[], Figure] | None = None
    """Draws what that file shows; the only panel when left out."""


@dataclass(frozen=True)
class Terms:
    """Terms with their meanings, or names with their values."""

    entries: Sequence[tuple[str, str]]
    summary: str = ""
    """When given, the list is folded away behind these words."""


@dataclass(frozen=True)
class Verbatim:
    """Text as it stands: a command line, a record."""

    text: str
    summary: str = ""
    """When given, the text is folded away behind these words."""


@dataclass(frozen=True)
class Verdict:
    """What came of it, in a box beside a picture.

    As the first item of the first section it opens the page: above the lead and the list of sections.
    """

    text: str
    entries: Terms
    """How sure it is, and against what."""
    picture: Picture
    """The main number with its interval."""
    failed: bool = False
    table: Table | None = None
    """Below both."""


@dataclass(frozen=True)
class Section:
    """A titled part of the page; strings among its items are paragraphs."""

    title: str
    items: Sequence[Item] = ()


KINDS = (Table, Picture, Terms, Verbatim, Verdict, Section)
"""Of items, beside strings; the template has a macro for each."""

Item: TypeAlias = "str | Table | Picture | Terms | Verbatim | Verdict | Section"


def printed(panels: Sequence[Panel], columns: int, height: float, legend: Legend = ()) -> Figure:
    """All panels in one figure, for print; `height` [inch] is that of one row.

    In a row, what two neighbours have on their y axes alike is written once.
    """
    with style.styled():
        figure, axes = style.grid_figure(-(-len(panels) // columns), columns, height)
        for i, (panel, ax) in enumerate(zip(panels, axes, strict=False)):
            panel.show(ax, lettered(i, panel.title) if len(panels) > 1 else "")
        labels = [ax.get_ylabel() for ax in axes]
        for i, ax in enumerate(axes):
            if i % columns and labels[i] == labels[i - 1]:
                ax.set_ylabel("")
        for spare in axes[len(panels) :]:
            spare.remove()
        if legend:
            style.legend_above(figure, legend)
    return figure


def write_page(
    out_dir: str | os.PathLike[str],
    sections: Sequence[Section],
    *,
    title: str,
    failed: str = "",
    lead: Sequence[str] = (),
    created: str = "",
    png: bool = True,
) -> Path:
    """Write ``index.html`` and the PNG files of its pictures into `out_dir`, and return the page's path.

    Everything is rendered before anything is written, every file appears whole, and the page comes last: a page that
    is there is complete. Other files in the folder stay as they are.

    Parameters
    ----------
    failed
        What failed, to stand before the title.
    lead
        Paragraphs under the title.
    created
        When the results were made, for the title's second line; the clock is the caller's.
    png
        Whether to write the PNG files, which may take longer than the page, and link them.

    Raises
    ------
    InvalidInput
        When two pictures ask for the same file name, or one for a name that is not a plain ``*.png``.
    StorageError
        When a file cannot be written; files of an earlier report are then whole, old or new.
    """
    printed_as: dict[str, Picture] = {}
    for picture in _pictures(sections):
        if not picture.file:
            continue
        if not re.fullmatch(r"[\w.-]+\.png", picture.file) or picture.file in printed_as:
            raise InvalidInput(f"report: {picture.file!r} is not a name for a PNG file, or is used twice on this page.")
        printed_as[picture.file] = picture
    files = {name: _png(picture) for name, picture in printed_as.items()} if png else {}
    files[PAGE] = render(sections, title=title, failed=failed, lead=lead, created=created, png=png).encode()
    _write_files(Path(out_dir), files)
    return Path(out_dir) / PAGE


def render(
    sections: Sequence[Section],
    *,
    title: str,
    failed: str = "",
    lead: Sequence[str] = (),
    created: str = "",
    png: bool = True,
) -> str:
    """The page as HTML text, see `write_page`."""
    opening, rest = _opening(sections)
    return _environment().get_template("sections.html.j2").render(
        title=title, failed=failed, opening=opening, lead=lead, sections=rest, created=created, version=__version__,
        png=png, titles=[section.title for section in rest],
    )  # fmt: skip


def write_result(
    out_dir: str | os.PathLike[str], result: Result, *, png: bool = True, embedded: Mapping[str, Markup] | None = None
) -> Path:
    """Write ``index.html`` and the PNG files of a result's pictures into `out_dir`, and return the page's path.

    Everything is rendered before anything is written, every file appears whole, and the page comes last: a page that
    is there is complete. Other files in the folder stay as they are.

    Parameters
    ----------
    png
        Whether to write the PNG files, which may take longer than the page, and link them.
    embedded
        Parts that bring their own HTML, style and script, by the name that the template of this kind has for them.

    Raises
    ------
    InvalidInput
        When two pictures have the same file name, or one a name that is not a plain ``*.png``.
    StorageError
        When a file cannot be written; files of an earlier page are then whole, old or new.
    """
    files: dict[str, bytes] = {}
    for picture in result.pictures:
        if not picture.file:
            continue
        if not re.fullmatch(r"[\w.-]+\.png", picture.file) or picture.file in files:
            raise InvalidInput(f"report: {picture.file!r} is not a name for a PNG file, or is used twice on this page.")
        files[picture.file] = draw.picture_png(picture) if png else b""
    page = render_result(result, png=png, embedded=embedded).encode()
    _write_files(Path(out_dir), (files if png else {}) | {PAGE: page})
    return Path(out_dir) / PAGE


def render_result(result: Result, *, png: bool = False, embedded: Mapping[str, Markup] | None = None) -> str:
    """The page of a result as HTML text: the template of its kind, or one that shows everything it holds."""
    environment = _environment()
    template = environment.select_template([f"{result.kind}.html.j2", "result.html.j2"])
    return template.render(
        result=result, record=result.record, v=result.values, title=result.title, failed=result.headline,
        created=clock(result.created), version=__version__, png=png, titles=[],
        pictures={each.name: each for each in result.pictures}, tables={each.name: each for each in result.tables},
        **(embedded or {}),
    )  # fmt: skip


def _environment() -> jinja2.Environment:
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

    def inline(panel: Any, size: tuple[float, float] | None = None) -> Markup:
        if isinstance(panel, Drawing):
            figure, description = panel.figure, panel.description
        else:
            figure, description = draw.panel_figure(panel, size), draw.described(panel)
        return Markup(style.inline_svg(figure, f"p{next(counter)}", description))

    environment.tests |= {
        "words": lambda item: isinstance(item, str),
        **{kind.__name__.lower(): _is(kind) for kind in KINDS},
    }
    environment.globals["variables"] = style.themed
    environment.filters |= {
        "inline": inline, "anchor": slug, "dasharray": _dasharray, "cell": _as_cell,
        "entry": entry, "words": _in_words, "colour": lambda stroke: style.themed(style.hex_of(stroke.colour)),
        "dashes": lambda stroke: _dasharray(style.drawn(stroke)),
        "number": number, "percent": percent, "listed": listed, "counted": counted, "capital": capital,
        "title_of": title_of, "span": span,
    }  # fmt: skip
    return environment


def _in_words(table: ResultTable, column: Column) -> bool:
    """Whether a column holds words: they stand to the left."""
    return any(isinstance(row[column.name], str) for row in table.rows) and not any(
        isinstance(row[column.name], int | float) for row in table.rows
    )


def _opening(sections: Sequence[Section]) -> tuple[Verdict | None, list[Section]]:
    """The verdict that opens the page, and the sections without it."""
    if not sections or not sections[0].items or not isinstance(sections[0].items[0], Verdict):
        return None, list(sections)
    first, *others = sections
    verdict, *items = first.items
    return verdict, [*([Section(first.title, items)] if items else []), *others]  # type: ignore[return-value]


def _pictures(items: Sequence[Item]) -> Iterator[Picture]:
    for item in items:
        if isinstance(item, Picture):
            yield item
        elif isinstance(item, Verdict):
            yield item.picture
        elif isinstance(item, Section):
            yield from _pictures(item.items)


def _png(picture: Picture) -> bytes:
    return style.png(picture.panels[0].figure if picture.print_figure is None else picture.print_figure())


def _printable(value: Any) -> Any:
    """Names are data: what no page can hold is shown as an escape (the template escapes the rest)."""
    return printable(value, keep="\n\t") if type(value) is str else value


def _is(kind: type) -> Any:
    return lambda item: isinstance(item, kind)


def _as_cell(entry: Cell | str) -> Cell:
    return entry if isinstance(entry, Cell) else Cell(entry)


def _dasharray(stroke: style.Stroke) -> str:
    """The SVG dash pattern of a stroke 2 wide; empty for a solid line."""
    if stroke.dash == "-":
        return ""
    return " ".join(f"{2 * length:g}" for length in stroke.dash[1])


def _write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write all files into a hidden folder first, then move them into place, in the given order."""
    existed = folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        blocked = [name for name in files if (folder / name).is_dir()]
        if blocked:
            raise StorageError(f"{folder / blocked[0]}: cannot be written: a folder has that name.")
        staging = Path(tempfile.mkdtemp(prefix=".report-", dir=folder))
        try:
            for name, content in files.items():
                (staging / name).write_bytes(content)
            for name in files:
                os.replace(staging / name, folder / name)
        finally:
            shutil.rmtree(staging, ignore_errors=True)
    except OSError as error:
        if not existed:
            with contextlib.suppress(OSError):
                folder.rmdir()
        if isinstance(error, StorageError):
            raise
        raise StorageError(f"{folder}: the report cannot be written: {error.strerror or error}.") from error
