"""`benchmarks/check_pages.py` passes our pages, and finds what is wrong with others."""

import importlib.util
from pathlib import Path

import pytest

from adaptrack.results.drive import write_drive_page
from made_drives import made_run

pytestmark = pytest.mark.needs("chromium")

WRONG = r"""<!doctype html><html><head><meta charset="utf-8"></head><body style="margin: 0">
<div style="width: 3000px">wide</div> \(x\) <img src="https://example.org/a.png">
<div class="table" style="overflow: auto; width: 50px"><table><tr><td>incomprehensible</td></tr></table></div>
<svg role="img" width="50" height="20"><text x="10" y="10">far too long for it</text></svg>
<script>console.error("said"); throw new Error("thrown");</script></body></html>"""


@pytest.fixture(scope="module")
def check_pages():
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "check_pages.py"
    spec = importlib.util.spec_from_file_location("check_pages", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (400, "dark")])
def test_the_page_of_a_drive_has_verdict_and_picture_in_its_first_screen_and_nothing_is_cut(
    check_pages, tmp_path, width, scheme
):
    page = write_drive_page(tmp_path, [made_run()])
    assert check_pages.look(page, width, scheme).faults() == []


def test_what_is_wrong_with_a_page_is_found(check_pages, tmp_path):
    page = tmp_path / "index.html"
    page.write_text(WRONG)
    faults = "\n".join(check_pages.look(page, 1400, "light").faults())
    for told in (
        "px too wide", "broken", "beyond its picture: far too long", "formulas are not drawn", "cut without a hint",
        "no verdict", "said", "thrown",
    ):  # fmt: skip
        assert told in faults
