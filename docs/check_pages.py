"""Open built pages in a browser without a network: python docs/check_pages.py docs/_build/html [PAGE ...]

Each page is opened at 1400 and 400 px. It must not be wider than the window, draw every formula, load nothing from
elsewhere and write no error to the console. Needs Chromium (Debian: apt install chromium).
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import browser
from programs import try_program

WIDTHS = (1400, 400)
LOOK = """
<!doctype html><link rel="icon" href="data:,"><body><script>
const pages = %s, widths = %s, found = [];
const text = element => element.closest(".math").textContent.trim().slice(0, 60);
async function look(page, width) {
  const frame = document.createElement("iframe");
  frame.style = `width:${width}px;height:900px;border:0`;
  frame.src = "/" + page;
  const loaded = new Promise(resolve => { frame.onload = resolve; });
  document.body.append(frame);
  await loaded;
  const inside = frame.contentDocument, root = inside.documentElement;
  await inside.fonts.ready;
  const formulas = [...inside.querySelectorAll("math")];
  const undrawn = formulas.filter(m => m.getClientRects().length && !(m.getBoundingClientRect().width > 2)).map(text);
  const outside = [...inside.querySelectorAll("article *")].filter(
    element => element.getBoundingClientRect().right > width + 1
      && !element.closest("pre, .table-wrapper, div.math, table") && element.getClientRects().length);
  const elsewhere = frame.contentWindow.performance.getEntriesByType("resource").map(entry => entry.name)
    .filter(name => !name.startsWith(location.origin) && !name.startsWith("data:"));
  const font = !formulas.length || [...inside.fonts].some(f => f.family.includes("STIX") && f.status == "loaded");
  found.push({page, width, overflow: root.scrollWidth - width, formulas: formulas.length, undrawn, elsewhere, font,
    outside: outside.slice(0, 3).map(e => e.outerHTML.slice(0, 120)),
    broken: [...inside.images].filter(i => i.complete && !i.naturalWidth).map(i => i.src)});
  frame.remove();
}
(async () => {
  for (const page of pages) for (const width of widths) await look(page, width);
  await fetch("/found", {method: "POST", body: JSON.stringify(found)});
})();
</script>
"""
"""Filled with names of pages and widths; what it finds is posted back."""


def look(folder: Path, pages: Sequence[str], timeout: float = 300.0) -> tuple[list[dict[str, Any]], list[str]]:
    """What each page shows at each width, and what the browser said on its console.

    folder: of the built pages; pages: their paths in it; timeout: s.
    """
    looking = LOOK % (json.dumps(list(pages)), json.dumps(WIDTHS))
    found, said = browser.ask({"/": browser.Served(looking)}, folder, timeout=timeout)
    return found, said


def complaints(found: Sequence[dict[str, Any]], said: Sequence[str]) -> list[str]:
    """What is wrong, a line each."""
    wrong = list(said)
    for each in found:
        where = f"{each['page']} at {each['width']} px"
        if each["overflow"] > 0:
            wrong.append(f"{where}: {each['overflow']} px wider than the window: {each['outside']}")
        if not each["font"]:
            wrong.append(f"{where}: the font of the formulas is not loaded")
        for what in ("undrawn", "elsewhere", "broken"):
            wrong += [f"{where}: {what}: {one}" for one in each[what]]
    return wrong


def main() -> int:
    """Look at all pages of a folder, or at those named."""
    _, reason = try_program("chromium")
    if reason:
        raise SystemExit(f"check_pages: {reason}")
    folder = Path(sys.argv[1])
    pages = sys.argv[2:] or sorted(str(path.relative_to(folder)) for path in folder.rglob("*.html"))
    found, said = look(folder, pages)
    wrong = complaints(found, said)
    formulas = sum(each["formulas"] for each in found if each["width"] == WIDTHS[0])
    print(*wrong, f"{len(pages)} pages, {formulas} formulas, {len(wrong)} complaints", sep="\n")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
