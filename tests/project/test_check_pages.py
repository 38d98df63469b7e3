"""`benchmarks/check_pages.py` passes our pages, and finds what is wrong with others."""

import ast
import importlib
import importlib.util
import sys
from pathlib import Path

import pytest

from adaptrack.results.drive import write_drive_page
from made_drives import made_run

ROOT = Path(__file__).resolve().parents[2]
WRONG = r"""<!doctype html><html><head><meta charset="utf-8"></head><body style="margin: 0">
<div style="width: 3000px">wide</div> \(x\) <img src="https://example.org/a.png">
<div class="table" style="overflow: auto; width: 50px"><table><tr><td>incomprehensible</td></tr></table></div>
<svg role="img" width="50" height="20"><text x="10" y="10">far too long for it</text></svg>
<script>console.error("said"); throw new Error("thrown");</script></body></html>"""


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def check_pages():
    return load(ROOT / "benchmarks" / "check_pages.py")


@pytest.mark.parametrize("script", [
    path for folder in ("benchmarks", "docs", "tools", "examples") for path in sorted((ROOT / folder).rglob("*.py"))
    if '"tests"' in path.read_text()
], ids=lambda path: str(path.relative_to(ROOT)))  # fmt: skip
def test_what_a_script_uses_of_a_module_of_the_tests_is_there(script):
    tree = ast.parse(script.read_text())
    modules = {
        alias.name: importlib.import_module(alias.name)
        for node in ast.walk(tree) if isinstance(node, ast.Import)
        for alias in node.names if (ROOT / "tests" / f"{alias.name}.py").is_file()
    }  # fmt: skip
    used = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)]
    missing = [f"{node.value.id}.{node.attr}" for node in used
               if node.value.id in modules and not hasattr(modules[node.value.id], node.attr)]  # fmt: skip
    assert not missing


@pytest.mark.parametrize("folder", ["benchmarks", "docs"])
def test_without_a_browser_it_says_so_and_ends(monkeypatch, tmp_path, folder):
    script = load(ROOT / folder / "check_pages.py")
    monkeypatch.setattr(script, "try_program", lambda name: ("", f"{name} is not installed"))
    monkeypatch.setattr(sys, "argv", ["check_pages.py", str(tmp_path)])
    with pytest.raises(SystemExit, match="check_pages: chromium is not installed"):
        script.main()


@pytest.mark.needs("chromium")
def test_it_prints_a_line_a_look_and_returns_the_number_of_pages_with_a_finding(
    check_pages, monkeypatch, tmp_path, capsys
):
    page = write_drive_page(tmp_path, [made_run()])
    monkeypatch.setattr(sys, "argv", ["check_pages.py", str(page)])
    assert check_pages.main() == 0
    assert capsys.readouterr().out.count(": ok") == 4


@pytest.mark.needs("chromium")
@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (400, "dark")])
def test_the_page_of_a_drive_has_verdict_and_picture_in_its_first_screen_and_nothing_is_cut(
    check_pages, tmp_path, width, scheme
):
    page = write_drive_page(tmp_path, [made_run()])
    assert check_pages.look(page, width, scheme).faults() == []


@pytest.mark.needs("chromium")
def test_what_is_wrong_with_a_page_is_found(check_pages, tmp_path):
    page = tmp_path / "index.html"
    page.write_text(WRONG)
    faults = "\n".join(check_pages.look(page, 1400, "light").faults())
    for told in (
        "px too wide", "broken", "beyond its picture: far too long", "formulas are not drawn", "cut without a hint",
        "no verdict", "said", "thrown",
    ):  # fmt: skip
        assert told in faults
