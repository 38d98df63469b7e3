"""The page on which one drives, as tests open it: from the disk or a server, its engine alone, what lies on it."""

from __future__ import annotations

import base64
import contextlib
import functools
import http.server
import json
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import adaptrack as at
from adaptrack.base.errors import InvalidInput

READY = "window.adaptrackPage && adaptrackPage.ready && adaptrackPage.state().cars.length > 0"
STATE = "adaptrackPage.state()"

ENGINE = """
(async (setup, periods, changes) => {
  const part = (name) => {
    const text = atob(document.getElementById(`part-${name}`).textContent.trim());
    const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
  };
  const [script, kernels, packed] = await Promise.all(["engine", "kernels", "data"].map(part));
  const data = JSON.parse(new TextDecoder().decode(packed));
  const place = URL.createObjectURL(new Blob([script], {type: "text/javascript"}));
  const worker = new Worker(place);
  const ask = (message) => new Promise((take, fail) => {
    worker.onmessage = (event) => { if (event.data.type !== "loaded") take(event.data); };
    worker.onerror = (event) => fail(new Error(event.message));
    worker.postMessage({id: 1, ...message});
  });
  worker.postMessage({type: "load", kernels, data});
  const begun = performance.now();
  const started = await ask({type: "start", setup});
  if (started.type === "refused") { worker.terminate(); return {refused: started}; }
  const rows = started.cars.map(() => []), ended = started.cars.map(() => null);
  const ready = performance.now();
  let done = 0;
  while (done < periods) {
    for (const {at, car, what} of changes) if (at === done) await ask({type: "change", car, what});
    const next = Math.min(periods, ...changes.filter(({at}) => at > done).map(({at}) => at), done + 400);
    const frames = await ask({type: "advance", periods: next - done});
    if (frames.type === "refused") { worker.terminate(); return {refused: frames}; }
    frames.cars.forEach((car, i) => { rows[i].push(car.numbers); ended[i] = car.ended; });
    if (!frames.count) break;
    done += frames.count;
  }
  const seconds = (performance.now() - ready) / 1000;
  worker.terminate();
  const text = (parts) => {
    let found = "";
    for (const each of parts) {
      const bytes = new Uint8Array(each.buffer, each.byteOffset, each.byteLength);
      for (let i = 0; i < bytes.length; i += 8192) found += String.fromCharCode(...bytes.subarray(i, i + 8192));
    }
    return btoa(found);
  };
  return {period: started.period, duration: started.duration, begun: (ready - begun) / 1000, seconds, done,
    cars: started.cars.map(({name, columns}, i) => ({name, columns, ended: ended[i], numbers: text(rows[i])}))};
})"""
"""A drive of the page's engine in a worker of its own: what it began with, and the frames of each car."""


def export_page(folder: Path) -> Path:
    """The page in a folder; a test is skipped where its kernels have not been built."""
    try:
        return at.export_page(folder / "drive.html")
    except InvalidInput as error:
        pytest.skip(str(error))


def drive(
    page: Any, setup: dict[str, Any], periods: int, changes: list[dict[str, Any]] | None = None
) -> dict[str, Any]:
    """What the engine of an open page drives; `numbers` of each car are (frames, columns)."""
    answer = page.run(f"{ENGINE}({json.dumps(setup)}, {periods}, {json.dumps(changes or [])})")
    for car in answer.get("cars", ()):
        numbers = np.frombuffer(base64.b64decode(car["numbers"]), "<f8")
        car["numbers"] = numbers.reshape(-1, len(car["columns"]))
    return answer


def open_page(window: Any, file: Path, fragment: str = "") -> Any:
    """The page in a browser, opened anew and paused."""
    window.open("about:blank")
    window.open(file.as_uri() + fragment)
    window.wait(READY)
    window.run("adaptrackPage.pause()")
    return window


def check_that_space_plays(window: Any, state: str) -> None:
    """Press the space bar twice: the clock of a page runs, then rests. state: what gives the state of the page."""
    window.press(" ")
    assert window.run(f"{state}.playing")
    window.press(" ")
    assert not window.run(f"{state}.playing")


@contextlib.contextmanager
def serve(folder: Path) -> Iterator[tuple[str, list[str]]]:
    """The address of a server of a folder, and the paths that it was asked for."""
    paths: list[str] = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *words: Any) -> None:
            paths.append(self.path)

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", paths
    finally:
        server.shutdown()
        server.server_close()


def axe() -> Path | None:
    """The checker of accessibility (axe-core, MPL-2.0), where there is one; it is not part of this project."""
    script = os.environ.get("ADAPTRACK_AXE")
    places = [Path(script)] if script else []
    places += [parent / "node_modules/axe-core/axe.min.js" for parent in Path(__file__).resolve().parents]
    return next((place for place in places if place.is_file()), None)


NO_AXE = "no axe-core: npm install axe-core somewhere, and ADAPTRACK_AXE=.../axe.min.js"

CONTROLS = """
[...document.querySelectorAll("a[href], button, input, select, textarea, summary, [tabindex]")].filter((each) =>
  each.tabIndex >= 0 && !each.disabled && !each.closest("[inert], dialog:not([open])")
  && (each.checkVisibility ? each.checkVisibility({visibilityProperty: true}) : each.offsetParent !== null)
  && !(each.type === "radio" && !each.checked && document.querySelector(`input[name="${each.name}"]:checked`)))"""
"""The elements that Tab reaches, in the order of the page."""

NAME = """((each) => each === document.body ? "body" : `${each.id || each.dataset.part
  || (each.getAttribute("aria-label") || each.textContent).trim().slice(0, 30)} <${each.tagName.toLowerCase()}>`)"""
"""A control in words."""


def differing(columns: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> dict[str, int]:
    """By column, how many numbers of a drive of the page differ in any bit from those of Python."""
    count, differences = len(expected["x"]), {}
    for name, values in expected.items():
        column = np.ascontiguousarray(columns[name][:count])
        assert column.size == count, name
        both = np.isnan(column) & np.isnan(values)
        differences[name] = int(((column.view(np.int64) != values.view(np.int64)) & ~both).sum())
    return {name: number for name, number in differences.items() if number}
