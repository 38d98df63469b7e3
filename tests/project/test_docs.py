"""The pages: every public name is in the reference, and formulas are drawn without a network."""

import importlib
import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import adaptrack as at
from programs import find_program

PROJECT = Path(__file__).resolve().parents[2]
DOCS = PROJECT / "docs"
PAGES = [*sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("gallery/*.md"))]


def loaded(path):
    """A program of the documentation, as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def described():
    """(module, name) of everything that the pages of the reference describe."""
    names = re.findall(
        r"^\.\. auto\w+:: ([\w.]+)$",
        "\n".join(path.read_text() for path in sorted(DOCS.glob("api/*.rst"))),
        re.MULTILINE,
    )
    homes = [name if name.startswith("adaptrack.") else f"adaptrack.{name}" for name in names]
    return [tuple(name.rsplit(".", 1)) for name in homes]


# -- the reference ----------------------------------------------------------------------------------------------------
def test_every_public_name_is_described_once_and_what_is_described_exists():
    names = [name for module, name in described() if module == "adaptrack"]
    assert sorted(names) == sorted(at.__all__)
    assert [name for name in described() if not hasattr(importlib.import_module(name[0]), name[1])] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_every_name_that_a_page_imports_is_described(page):
    objects = {getattr(importlib.import_module(module), name, None) for module, name in described()}
    imported = re.findall(r"^from (adaptrack[\w.]*) import ([^\n(]+|\([^)]*\))", page.read_text(), re.MULTILINE)
    for module, names in imported:
        for name in re.findall(r"\w+", names):
            assert getattr(importlib.import_module(module), name) in objects, f"{module}.{name}"


def test_the_first_reading_names_eight_files_of_at_most_3000_lines():
    files = re.findall(r"^\| \d\. `([\w/]+\.py)` \|", (DOCS / "first-reading.md").read_text(), re.MULTILINE)
    assert len(files) == 8
    assert sum(len((PROJECT / "src/adaptrack" / file).read_text().splitlines()) for file in files) <= 3000


# -- links ------------------------------------------------------------------------------------------------------------
LINKING = [PROJECT / "README.md", PROJECT / "CONTRIBUTING.md", *PAGES, *sorted(PROJECT.glob("examples/**/*.md"))]


def anchors(page):
    """The fragments under which a host of Markdown shows the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", LINKING, ids=lambda page: str(page.relative_to(PROJECT)))
def test_every_relative_link_and_every_path_of_a_page_leads_somewhere(page):
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    for link in re.findall(r"\]\((?!\w+:)([^)\s]+)\)", text):
        file, _, anchor = link.partition("#")
        target = page.parent / file if file else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link
    for code in re.findall(r"`([^`]+)`", text):
        for path in re.findall(r"(?<!\S)(?:benchmarks|docs|examples|experiments|src|tests|tools)/[\w./-]*\w", code):
            assert (PROJECT / path).exists() or (page.parent / path).exists(), path


# -- formulas ---------------------------------------------------------------------------------------------------------
def formulas():
    """(LaTeX, whether on a line of its own) of all formulas of the pages."""
    result = []
    for page in PAGES:
        text = re.sub(r"^```.*?^```$|`[^`\n]+`", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
        result += [(block, True) for block in re.findall(r"\$\$(.*?)\$\$", text, re.DOTALL)]
        result += [
            (inline, False)
            for inline in re.findall(r"(?<!\$)\$([^$]+)\$", re.sub(r"\$\$.*?\$\$", "", text, flags=re.DOTALL))
        ]
    return result


def test_every_formula_has_its_mathml_and_an_unknown_command_is_refused():
    math_core = pytest.importorskip("math_core", reason="needs math-core (make install)")
    to_mathml = loaded(DOCS / "extensions" / "mathml.py").to_mathml
    assert len(formulas()) > 300
    for latex, display in formulas():
        assert to_mathml(latex, display).startswith("<math")
    with pytest.raises(math_core.LatexError):
        to_mathml(r"\nonsense x", display=False)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A page of all formulas on lines of their own, built as the others are; and one that is wrong in every way."""
    pytest.importorskip("math_core", reason="needs math-core (make install)")
    pytest.importorskip("furo", reason="needs furo (make install)")
    folder = tmp_path_factory.mktemp("pages")
    for name in ("static", "extensions"):
        shutil.copytree(DOCS / name, folder / name)
    shutil.copy(DOCS / "conf.py", folder)
    blocks = "\n\n".join(f"$${latex}$$" for latex, display in formulas() if display)
    (folder / "index.md").write_text(f"# Formulas\n\n{blocks}\n")
    command = [sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", "-b", "html", folder, folder / "html"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    broken_page = (
        '<meta charset="utf-8"><article><div style="width: 3000px">wide</div><img src="https://example.org/a.png">'
        '<div class="math"><math style="font-family: serif"><mi></mi></math></div></article>'
        '<script src="https://example.org/a.js"></script><script>console.error("said")</script>'
    )
    (folder / "html" / "wrong.html").write_text(broken_page)
    return folder / "html"


@pytest.fixture(scope="module")
def looked_at(built):
    check_pages = loaded(DOCS / "check_pages.py")
    find_program("chromium")
    return check_pages, *check_pages.look(built, ["index.html", "wrong.html"], timeout=120.0)


def test_pages_draw_all_formulas_without_a_network(looked_at):
    check_pages, views, _ = looked_at
    formula_views = [view for view in views if view["page"] == "index.html"]
    assert [view["formulas"] for view in formula_views] == [sum(display for _, display in formulas())] * len(
        check_pages.WIDTHS
    )
    assert check_pages.complaints(formula_views, []) == []


def test_what_is_wrong_with_a_page_is_found(looked_at):
    check_pages, views, messages = looked_at
    complaints = "\n".join(check_pages.complaints([view for view in views if view["page"] == "wrong.html"], messages))
    for name in ("wider than the window", "font of the formulas", "undrawn", "broken", "said", "elsewhere"):
        assert name in complaints


def test_pages_name_no_script_style_or_font_of_elsewhere(built):
    text = "\n".join(
        path.read_text() for path in [*built.glob("*.html"), *built.glob("_static/*.css")] if path.stem != "wrong"
    )
    assert not re.findall(r'(?:src="|url\(["\']?|<link[^>]*href=")https?://', text)


# -- the workflow of a public host ------------------------------------------------------------------------------------
def test_every_step_of_the_workflow_is_a_target_of_the_makefile(project):
    workflow = (project / ".github" / "workflows" / "checks.yml").read_text()
    targets = set(re.findall(r"^([a-z-]+):", (project / "Makefile").read_text(), re.MULTILINE))
    steps = re.findall(r"^ +(?:- )?run: (.*)$", workflow, re.MULTILINE)
    assert steps
    for step in steps:
        make, target, *variables = step.split()
        assert make == "make", step
        assert target in targets, step
        assert all(re.fullmatch(r"PYTHON=python[\d.]*", variable) for variable in variables), step


def test_the_workflow_runs_what_every_change_must_pass(project):
    workflow = (project / ".github" / "workflows" / "checks.yml").read_text()
    required = re.findall(r"^make --no-print-directory (\S+)", (project / ".ci" / "run").read_text(), re.MULTILINE)
    assert required
    assert [target for target in required if f"run: make {target}" not in workflow] == []
