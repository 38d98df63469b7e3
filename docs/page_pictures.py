"""Take the pictures of docs/page.md from the page itself: python docs/page_pictures.py  (20 s; needs Chromium)"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from PIL import Image

import adaptrack as at
import pages
from browsers import Chromium, Media

IMAGES = Path(__file__).resolve().parent / "images"
BESIDE = {"controllers": [{"kind": "informed"}, {"kind": "pure-pursuit"}]}
LEARNING = {
    "car": {"name": "van"}, "truth": {"lag": 0.3, "dead_time": 0.1},
    "controllers": [{"kind": "learning"}, {"kind": "informed", "belief": {"lag": 0.3, "dead_time": 0.1}}],
}  # fmt: skip
EVERYTHING = """
document.getElementById("plot-choice").value = "all",
document.getElementById("plot-choice").dispatchEvent(new Event("change", {bubbles: true}))"""


def shot(
    file: Path, setup: dict[str, Any], t: float, size: tuple[int, int], scheme: str = "light", then: str = "0"
) -> Any:
    """The page in which a setup has driven for 30 s and shows the instant t (s)."""
    with tempfile.TemporaryDirectory() as folder, Chromium(size, Media(scheme)) as page:
        page.open(file.as_uri())
        page.wait(pages.READY)
        given = f"{{...adaptrackPage.state().setup, ...{json.dumps(setup)}}}"
        page.run(f"adaptrackPage.start({given}, {{playing: false}}).then(() => adaptrackPage.advance(600))")
        page.run(f"adaptrackPage.pause(), {then}, adaptrackPage.seek({t})")
        time.sleep(1.0)
        page.shoot(Path(folder) / "shot.png")
        return Image.open(Path(folder) / "shot.png").convert("RGB")


def save(picture: Any, name: str) -> None:
    """Write a picture, small."""
    picture.quantize(240, dither=Image.Dither.NONE).save(IMAGES / name, optimize=True)
    print(name, f"{(IMAGES / name).stat().st_size / 1e3:.0f} kB")


def main() -> None:
    """Take all of them."""
    with tempfile.TemporaryDirectory() as folder:
        file = at.export_page(Path(folder) / "drive.html")
        save(shot(file, BESIDE, 21.6, (1400, 900)), "page.png")
        tall = shot(file, LEARNING, 24.0, (1400, 1500), "dark", EVERYTHING)
        save(tall.resize((1050, 1125), Image.Resampling.LANCZOS), "page-belief.png")
        pair = Image.new("RGB", (840, 860), "white")
        for scheme, left in (("light", 0), ("dark", 440)):
            pair.paste(shot(file, BESIDE, 21.6, (400, 860), scheme), (left, 0))
        save(pair, "page-small.png")


if __name__ == "__main__":
    main()
