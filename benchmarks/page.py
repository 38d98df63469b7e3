"""How fast the page on which one drives is: python -m benchmarks.page [--browser firefox] [--seconds 20]  (2 minutes)

Bytes; opening to the first metre; frames a second with two cars and all plots; simulated seconds a second of two cars.
Chromium runs without a GPU. Nothing else should run on the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import adaptrack as at
import pages
from browsers import BROWSERS

SETUP = {
    "car": {"name": "midsize-sedan"}, "road": {"name": "mountain"}, "speed": {"lateral": 3.0}, "profile": "road",
    "truth": {}, "seed": 0,
}  # fmt: skip
FIRST_METRE = """
(async () => {
  for (;;) {
    await new Promise(requestAnimationFrame);
    const {clock, drive} = window.adaptrackPage?.page ?? {}, car = drive?.history.cars[0];
    if (!car?.count) continue;
    const at = car.columns.time.subarray(0, car.count).findLastIndex((time) => time <= clock.t);
    if (at >= 0 && car.columns.station[at] - car.columns.station[0] >= 1) return performance.now() / 1000;
  }
})()"""
EVERYTHING = """
(() => {
  const choice = document.getElementById("plot-choice");
  choice.value = "all";
  choice.dispatchEvent(new Event("change", {bubbles: true}));
  return document.querySelectorAll("#plots canvas").length;
})()"""
FRAMES = """
(async (seconds) => {
  const times = [], tasks = [];
  const watch = window.PerformanceObserver && PerformanceObserver.supportedEntryTypes.includes("longtask")
    ? new PerformanceObserver((list) => tasks.push(...list.getEntries().map((each) => each.duration))) : null;
  watch?.observe({entryTypes: ["longtask"]});
  adaptrackPage.play();
  const end = performance.now() + 1000 * seconds;
  while (performance.now() < end) times.push(await new Promise(requestAnimationFrame));
  adaptrackPage.pause();
  watch?.disconnect();
  return {times, tasks};
})"""


def controllers(*kinds: str) -> dict[str, Any]:
    """A setup of these controllers side by side."""
    return {**SETUP, "controllers": [{"kind": each, "tuning": None, "belief": None} for each in kinds]}


def machine() -> str:
    """The processor and its cores."""
    found = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text()) if sys.platform == "linux" else None
    return f"{found[1] if found else platform.processor()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--browser", choices=BROWSERS, default="chromium")
    parser.add_argument("--seconds", type=float, default=20.0, help="of driving, for the frames")
    parser.add_argument("--periods", type=int, default=1200, help="of the drives as fast as they can")
    given = parser.parse_args()
    kind, program, missing = BROWSERS[given.browser]
    if program is None:
        raise SystemExit(missing)
    version = subprocess.run([program, "--version"], capture_output=True, text=True).stdout.strip()
    print(f"{version}; {machine()}")
    with tempfile.TemporaryDirectory() as folder:
        file = at.export_page(Path(folder) / "drive.html")
        print(f"page: {file.stat().st_size:,} bytes")
        opening = []
        for _ in range(5):
            with kind() as page:
                page.open(file.as_uri())
                opening.append(page.run(FIRST_METRE))
        print(
            f"opening to the first metre: {np.median(opening):.2f} s (of 5: {min(opening):.2f} to {max(opening):.2f})"
        )
        with kind((1400, 2400)) as page:  # all plots are in the window
            page.open(file.as_uri())
            page.wait(pages.READY)
            for names in (("informed", "informed"), ("learning", "learning")):
                frames(page, names, given.seconds)
            page.run("adaptrackPage.pause()")
            for names in (("informed", "informed"), ("learning", "learning")):
                speed(page, names, given.periods)


def frames(page: Any, names: tuple[str, ...], seconds: float) -> None:
    """Frames a second while these cars drive."""
    page.run(f"adaptrackPage.start({json.dumps(controllers(*names))}).then(() => 0)")
    page.run("adaptrackPage.advance(20)")
    plots = page.run(EVERYTHING)
    found = page.run(f"{FRAMES}({seconds})")
    steps = np.diff(found["times"])
    tasks = found["tasks"]
    print(
        f"{' and '.join(names)}, {plots} plots: {1000 / np.percentile(steps, 95):.0f} frames/s (5th percentile), "
        f"{1000 / np.median(steps):.0f} (median); {len(tasks)} tasks longer than 50 ms, the longest "
        f"{max(tasks, default=0):.0f} ms"
    )


def speed(page: Any, names: tuple[str, ...], periods: int) -> None:
    """Simulated seconds a second of the engine alone; the first third warms up."""
    page.run("0")
    found = pages.drive(page, controllers(*names), periods)
    if "refused" in found:
        raise SystemExit(f"{names}: {found['refused']['message']}")
    print(
        f"{' and '.join(names)}: {found['done'] * found['period'] / found['seconds']:.0f} simulated s/s; "
        f"ready to drive {found['begun']:.2f} s after the setup was given"
    )


if __name__ == "__main__":
    main()
