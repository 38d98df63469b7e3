"""The page on which one drives, as one HTML file that loads nothing: markup, scripts, kernels and data inside it.

The scripts of the page stand in it as they are written. The engine, which runs in a worker, the kernels as a module of
WebAssembly, and the data are compressed (gzip) and written as base64; `page/start.js` unpacks them.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adaptrack.base.errors import StorageError
from adaptrack.base.files import write_atomically

SOURCES = Path(__file__).parent / "page"
ENGINE = ("memory.js", "inputs.js", "engine.js")
"""Files of the worker, in the order in which they stand in its script; all other scripts are the page's."""
FIRST, LAST = ("start.js", "viewer.js", "plots.js"), ("app.js",)
"""Of the page's: they stand before and behind the others."""
LARGEST = 3_000_000
"""bytes of a page"""


@dataclass(frozen=True)
class PageParts:
    """What a page is made of."""

    html: str
    css: str
    script: str
    """of the page"""
    engine: str
    """script of the worker"""
    kernels: bytes
    """module of WebAssembly"""
    data: dict[str, Any]
    """what Python writes into the page"""


def page_parts() -> PageParts:
    """The parts of the page, before they are packed.

    Raises
    ------
    InvalidInput
        Where the kernels for WebAssembly are not there.
    """
    from adaptrack.export.page_data import page_data
    from adaptrack.export.page_kernels import page_kernels

    others = {each.name for each in SOURCES.glob("*.js")} - {*ENGINE, *FIRST, *LAST}
    page = (*FIRST, *sorted(others), *LAST)
    return PageParts(_text("page.html"), _text("page.css"), _together(page), _together(ENGINE), page_kernels(),
                     page_data())  # fmt: skip


def write_page(path: str | os.PathLike[str], setup: Mapping[str, Any] | None = None) -> Path:
    """Write the page; setup: what it begins with, see `export_page`.

    Raises
    ------
    InvalidInput
        Where the kernels for WebAssembly are not there.
    StorageError
        When it cannot be written.
    """
    file = Path(path)
    if file.is_dir():
        raise StorageError(f"{file}: cannot be written to: is a folder; name a file.")
    try:
        write_atomically(file, page_html(page_parts(), setup).encode())
    except OSError as error:
        raise StorageError(f"{file}: cannot be written to: {error.strerror or error}.") from error
    return file


def page_html(parts: PageParts, setup: Mapping[str, Any] | None = None) -> str:
    """The page as text."""
    data = parts.data if setup is None else {**parts.data, "setup": dict(setup)}
    packed = {
        "engine": parts.engine.encode(), "kernels": parts.kernels,
        "data": json.dumps(data, separators=(",", ":"), allow_nan=False).encode(),
    }  # fmt: skip
    carried = "".join(
        f'<script type="application/gzip" id="part-{name}">{base64.b64encode(gzip.compress(each, 9, mtime=0)).decode()}'
        "</script>\n"
        for name, each in packed.items()
    )
    html = _once(parts.html, "<head>", f'<head>\n<meta http-equiv="Content-Security-Policy" content="{policy(parts)}">')
    html = _once(html, "</head>", f"<style>\n{parts.css}</style>\n</head>")
    return _once(html, "</body>", f"{carried}<script>{parts.script}</script>\n</body>")


def policy(parts: PageParts) -> str:
    """The Content-Security-Policy: this script, its worker and its kernels run, and nothing is loaded from anywhere."""
    digest = base64.b64encode(hashlib.sha256(parts.script.encode()).digest()).decode()
    return (
        f"default-src 'none'; script-src 'sha256-{digest}' 'wasm-unsafe-eval'; worker-src blob:; "
        "style-src 'unsafe-inline'; img-src data: blob:; form-action 'none'; base-uri 'none'"
    )


def _text(name: str) -> str:
    return (SOURCES / name).read_text(encoding="utf-8")


def _together(names: tuple[str, ...]) -> str:
    """One script of several files, which share one scope of their own."""
    files = "\n".join(f"// -- {name}\n{_text(name)}" for name in names)
    return f'\n(() => {{\n"use strict";\n{files}}})();\n'


def _once(text: str, found: str, put: str) -> str:
    """The text with the one place of a tag written anew."""
    before, _, behind = text.partition(found)
    return f"{before}{put}{behind}"
