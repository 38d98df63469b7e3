"""Open pages of ours in headless Chromium without a network, and say what a reader would trip over.

    python benchmarks/check_pages.py results/index.html drive/index.html --shots shots

Each page is opened 1400 and 400 px wide, light and dark, in a frame of 900 px height. Reported for each: messages of
the console (what it loads from elsewhere is one), sideways overflow of the document, pictures and formulas without a
size, text beyond the frame of its picture, tables that are cut without a hint, and whether the first screen holds the
verdict and most of its picture. The exit code is the number of pages with a finding. `docs/check_pages.py` looks at
the documentation.
"""

from __future__ import annotations

import argparse
import html
import re
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import browser
from programs import try_program

WIDTHS = (1400, 400)
HEIGHT = 900
SCHEMES = ("light", "dark")
PATIENCE = 120.0
"""s, for one page."""

PROBE = r"""
<script>
addEventListener("error", e => (window.faults = window.faults || []).push(String(e.message)));
addEventListener("load", () => setTimeout(() => {
  const found = {faults: window.faults || []};
  const root = document.documentElement, wide = root.clientWidth, high = innerHeight;
  found.overflow = root.scrollWidth - wide;
  found.dark = matchMedia("(prefers-color-scheme: dark)").matches;
  found.ground = getComputedStyle(document.body).backgroundColor;
  const box = e => e.getBoundingClientRect();
  const pictures = [...document.querySelectorAll("svg[role=img], img, .math, mjx-container, math")];
  found.pictures = pictures.length;
  found.empty = pictures.filter(e => box(e).width < 2 || box(e).height < 2).length;
  found.broken = [...document.images].filter(e => e.complete && !e.naturalWidth).length;
  found.outside = [...document.querySelectorAll("svg[role=img]")].flatMap(svg =>
    [...svg.querySelectorAll("text:not(:has(tspan))")]
    .filter(t => box(t).right > box(svg).right + 2 || box(t).left < box(svg).left - 2)
    .map(t => t.textContent.trim())).slice(0, 5);
  found.raw = (document.body.innerText.match(/\\\(|\$\$|\\frac|\\mathrm/g) || []).length;
  found.cut = [...document.querySelectorAll(".table")].filter(t => t.scrollWidth > t.clientWidth + 1).length;
  found.unhinted = [...document.querySelectorAll(".table")].filter(t => t.scrollWidth > t.clientWidth + 1)
    .filter(t => getComputedStyle(t).backgroundImage === "none")
    .filter(t => !t.nextElementSibling?.matches(".more") || box(t.nextElementSibling).height < 2).length;
  const verdict = document.querySelector(".verdict .box"), picture = document.querySelector(".verdict svg");
  found.verdict = verdict ? Math.round(box(verdict).bottom) : null;
  found.picture = picture ? [Math.round(box(picture).top), Math.round(box(picture).bottom)] : null;
  found.text = document.body.innerText.length;
  found.height = root.scrollHeight;
  fetch("/found", {method: "POST", body: JSON.stringify(found)});
}, 300));
</script>
"""

FRAME = """<!doctype html><meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">
<style>html, body {{ margin: 0 }} iframe {{ border: 0; display: block }}</style>
<iframe src="{page}" width="{width}" height="{height}"></iframe>"""


class Seen(NamedTuple):
    """A page as it was opened."""

    page: Path
    width: int
    scheme: str
    found: dict[str, Any]
    console: list[str]

    def faults(self) -> list[str]:
        """What a reader would trip over."""
        f = self.found
        said = [*self.console, *f["faults"]]
        said += [f"the document is {f['overflow']} px too wide"] if f["overflow"] > 0 else []
        said += [f"{f[key]} pictures {words}" for key, words in (("empty", "without a size"), ("broken", "broken"))
                 if f[key]]  # fmt: skip
        said += [f"text beyond its picture: {', '.join(f['outside'])}"] if f["outside"] else []
        said += [f"{f['raw']} formulas are not drawn"] if f["raw"] else []
        said += [f"{f['unhinted']} tables are cut without a hint"] if f["unhinted"] else []
        said += [f"{self.scheme} was asked for"] if f["dark"] != (self.scheme == "dark") else []
        said += [f"{f['cut']} tables are cut"] if f["cut"] and self.width >= 1400 else []
        return said + self._first_screen(f["verdict"], f["picture"])

    def _first_screen(self, verdict: int | None, picture: list[int] | None) -> list[str]:
        """A wide screen holds both whole; a telephone the verdict, and its picture begins there."""
        if verdict is None or picture is None:
            return ["no verdict with a picture"]
        ends = {"verdict": verdict, "picture": picture[1] if self.width >= 1000 else picture[0] + 60}
        return [f"first screen: the {name} ends at {end} px" for name, end in ends.items() if end > HEIGHT]


def look(page: Path, width: int, scheme: str) -> Seen:
    """Open the page, with the probe in it, in a frame of the width."""
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text(encoding="utf-8"))
    probed = text.replace("<head>", f"<head>{PROBE}", 1)  # the page's policy allows its own scripts alone
    frame = FRAME.format(page="/probed", width=width, height=HEIGHT)
    pages = {"/": browser.Served(frame), "/probed": browser.Served(probed)}
    found, said = browser.ask(pages, page.parent, scheme=scheme, timeout=PATIENCE)
    return Seen(page, width, scheme, found, said)


def shoot(page: Path, width: int, scheme: str, shots: Path, height: int) -> None:
    """Write the first `height` px of the page as a PNG."""
    shots.mkdir(parents=True, exist_ok=True)
    name = f"{page.resolve().parent.name}-{width}-{scheme}.png"
    with tempfile.TemporaryDirectory() as folder:
        frame = Path(folder) / "frame.html"
        frame.write_text(FRAME.format(page=html.escape(page.resolve().as_uri()), width=width, height=height))
        browser.shoot(frame.as_uri(), shots.resolve() / name, (width, height), scheme=scheme)


def main() -> int:
    """Print a line a look; the number of pages with a finding."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pages", nargs="+", type=Path, help="index.html of each page")
    parser.add_argument("--shots", type=Path, help="folder for a PNG of each look")
    parser.add_argument("--height", type=int, default=HEIGHT, help="px, of the PNG")
    options = parser.parse_args()
    _, reason = try_program("chromium")
    if reason:
        raise SystemExit(f"check_pages: {reason}")
    bad = set()
    for page in options.pages:
        for width, scheme in ((width, scheme) for width in WIDTHS for scheme in SCHEMES):
            faults = look(page, width, scheme).faults()
            bad |= {page} if faults else set()
            print(f"{page} {width} {scheme}: {'; '.join(faults) or 'ok'}", flush=True)
            if options.shots:
                shoot(page, width, scheme, options.shots, options.height)
    return len(bad)


if __name__ == "__main__":
    sys.exit(main())
