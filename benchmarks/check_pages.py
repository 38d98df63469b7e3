"""Open pages in headless Chromium without a network, and say what a reader would trip over.

    python benchmarks/check_pages.py results/index.html drive/index.html --shots shots

Each page is opened 1400 and 400 px wide, light and dark, in a frame of 900 px height. Reported for each: messages of
the console, requests that leave the page's folder, sideways overflow of the document, pictures and formulas without a
size, text beyond the frame of its picture, tables that are cut without a hint, and whether the first screen holds the
verdict and most of its picture. `--docs` leaves out the last. The exit code is the number of pages with a finding.
"""

from __future__ import annotations

import argparse
import html
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

WIDTHS = (1400, 400)
HEIGHT = 900
SCHEMES = {"light": 1, "dark": 0}
"""Chromium's numbers of `prefers-color-scheme`."""
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
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
    .filter(t => !t.nextElementSibling || box(t.nextElementSibling).height < 2).length;
  const verdict = document.querySelector(".verdict .box"), picture = document.querySelector(".verdict svg");
  found.verdict = verdict ? Math.round(box(verdict).bottom) : null;
  found.picture = picture ? [Math.round(box(picture).top), Math.round(box(picture).bottom)] : null;
  found.text = document.body.innerText.length;
  found.height = root.scrollHeight;
  parent.postMessage(JSON.stringify(found), "*");
}, 300));
</script>
"""

FRAME = """<!doctype html><meta name="color-scheme" content="light dark"><style>html, body {{ margin: 0 }}
iframe {{ border: 0; display: block }}</style><iframe src="{page}" width="{width}" height="{height}"></iframe>
<script>addEventListener("message", e => {{ const p = document.createElement("pre"); p.id = "found";
p.textContent = e.data; document.body.append(p); }});</script>"""


class Seen(NamedTuple):
    """A page as it was opened."""

    page: Path
    width: int
    scheme: str
    found: dict[str, Any]
    console: list[str]

    def faults(self, docs: bool) -> list[str]:
        """What a reader would trip over."""
        if not self.found:
            return ["the page did not load", *self.console]
        f = self.found
        said = [*self.console, *f["faults"]]
        said += [f"the document is {f['overflow']} px too wide"] if f["overflow"] > 0 else []
        said += [f"{f[key]} pictures {words}" for key, words in (("empty", "without a size"), ("broken", "broken"))
                 if f[key]]  # fmt: skip
        said += [f"text beyond its picture: {', '.join(f['outside'])}"] if f["outside"] else []
        said += [f"{f['raw']} formulas are not drawn"] if f["raw"] else []
        said += [f"{f['unhinted']} tables are cut without a hint"] if f["unhinted"] else []
        said += [f"{self.scheme} was asked for"] if f["dark"] != (self.scheme == "dark") else []
        if not docs:
            said += self._first_screen(f["verdict"], f["picture"])
            said += [f"{f['cut']} tables are cut"] if f["cut"] and self.width >= 1400 else []
        return said

    def _first_screen(self, verdict: int | None, picture: list[int] | None) -> list[str]:
        """A wide screen holds both whole; a telephone the verdict, and its picture begins there."""
        if verdict is None or picture is None:
            return ["no verdict with a picture"]
        ends = {"verdict": verdict, "picture": picture[1] if self.width >= 1000 else picture[0] + 60}
        return [f"first screen: the {name} ends at {end} px" for name, end in ends.items() if end > HEIGHT]


def browser() -> str:
    """The path of a Chromium.

    Raises
    ------
    SystemExit
        When there is none.
    """
    for name in BROWSERS:
        found = shutil.which(name)
        if found:
            return found
    raise SystemExit(f"check_pages needs one of {', '.join(BROWSERS)}; on Debian: apt-get install chromium")


def look(page: Path, width: int, scheme: str, folder: Path) -> Seen:
    """Open a copy of the page, with the probe, in a frame of the width."""
    copy = page.with_name(f".check-{page.name}")
    copy.write_text(page.read_text().replace("<head>", f"<head>{PROBE}", 1))
    frame = folder / "frame.html"
    frame.write_text(FRAME.format(page=html.escape(copy.resolve().as_uri()), width=width, height=HEIGHT))
    try:
        ran = run(frame.as_uri(), scheme, folder, "--dump-dom", "--enable-logging=stderr", "--v=0")
    finally:
        copy.unlink()
    match = re.search(r'<pre id="found">(.*?)</pre>', ran.stdout, re.DOTALL)
    console = re.findall(r'CONSOLE[^\]]*\] "?(.*)', ran.stderr)
    return Seen(page, width, scheme, json.loads(html.unescape(match[1])) if match else {}, console)


def shoot(page: Path, width: int, scheme: str, folder: Path, shots: Path, height: int) -> None:
    """Write the first `height` px of the page as a PNG."""
    frame = folder / "frame.html"
    frame.write_text(FRAME.format(page=html.escape(page.resolve().as_uri()), width=width, height=height))
    shots.mkdir(parents=True, exist_ok=True)
    name = f"{page.resolve().parent.name}-{width}-{scheme}.png"
    run(frame.as_uri(), scheme, folder, f"--screenshot={shots / name}", f"--window-size={width},{height}")


def run(url: str, scheme: str, folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Chromium on one address, without a network."""
    size = () if any(each.startswith("--window-size") for each in options) else (f"--window-size=1500,{HEIGHT}",)
    return subprocess.run(
        [browser(), "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--mute-audio",
         "--host-resolver-rules=MAP * ~NOTFOUND", "--allow-file-access-from-files", "--virtual-time-budget=4000",
         f"--blink-settings=preferredColorScheme={SCHEMES[scheme]}", f"--user-data-dir={folder / 'profile'}",
         *size, *options, url],
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip


def looks(pages: list[Path], folder: Path) -> Iterator[Seen]:
    """Every page in each width and scheme."""
    for page in pages:
        for width in WIDTHS:
            for scheme in SCHEMES:
                yield look(page, width, scheme, folder)


def main() -> int:
    """Print a line a look; the number of pages with a finding."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pages", nargs="+", type=Path, help="index.html of each page")
    parser.add_argument("--docs", action="store_true", help="pages of the documentation, which have no verdict")
    parser.add_argument("--shots", type=Path, help="folder for a PNG of each look")
    parser.add_argument("--height", type=int, default=HEIGHT, help="px, of the PNG")
    asked = parser.parse_args()
    bad = set()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for seen in looks(asked.pages, folder):
            faults = seen.faults(asked.docs)
            bad |= {seen.page} if faults else set()
            print(f"{seen.page} {seen.width} {seen.scheme}: {'; '.join(faults) or 'ok'}", flush=True)
            if asked.shots:
                shoot(seen.page, seen.width, seen.scheme, folder, asked.shots, asked.height)
    return len(bad)


if __name__ == "__main__":
    sys.exit(main())
