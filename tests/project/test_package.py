"""The package as others meet it: light to import, complete, documented, the same version everywhere."""

from __future__ import annotations

import itertools
import json
import platform
import re
import tomllib
import zipfile
from importlib.metadata import version

import pytest

import adaptrack
from adaptrack.core.library import processor, source_hashes

HEAVY = ("ziglang", "numpy", "scipy", "sklearn", "matplotlib", "pydantic", "pandas", "pyarrow", "typer")
LIGHT = {
    "package": ("import adaptrack", HEAVY),
    "help": (
        "import runpy, sys\n"
        "sys.argv = ['adaptrack', '--help']\n"
        "try: runpy.run_module('adaptrack', run_name='__main__')\n"
        "except SystemExit as end: assert not end.code",
        ("scipy", "sklearn", "matplotlib", "pandas", "pyarrow"),
    ),
    "car and scenario": (
        "from adaptrack.cars.vehicle import load_vehicle; load_vehicle('paper')\n"
        "from adaptrack.scenario import load_scenario; load_scenario('general-trajectory')",
        ("ziglang", "scipy", "matplotlib", "sklearn"),
    ),
    "controllers and the page of a run": (
        "import adaptrack.control.controllers, adaptrack.results.page, adaptrack.results.drive, matplotlib",
        (*(f"scipy.{part}" for part in ("optimize", "interpolate", "special", "sparse", "stats")),
         "adaptrack.results.dataset", "sklearn", "pandas", "matplotlib.pyplot"),
    ),
}  # fmt: skip
"""What is done, and the slow modules that it does not load."""


@pytest.mark.parametrize(("code", "slow"), LIGHT.values(), ids=LIGHT)
def test_light_work_loads_nothing_heavy(run_python, code, slow):
    loaded = run_python(code=f"{code}\nimport sys\nprint('LOADED', *sys.modules)").rpartition("LOADED")[2].split()
    assert "adaptrack" in loaded
    assert not set(slow) & set(loaded)


def test_the_kernels_need_numpy_alone(run_python):
    # a wheel is built where nothing else is installed but the compiler
    code = (
        "import importlib, sys\n"
        "from adaptrack.core import library\n"
        "files = sorted((library.PACKAGE_FOLDER / 'core').rglob('*.py'))\n"
        "names = ['.'.join(file.relative_to(library.PACKAGE_FOLDER.parent).with_suffix('').parts) for file in files]\n"
        "for name in names:\n"
        "    if '.build.' not in name: importlib.import_module(name.removesuffix('.__init__'))\n"
        "print(*sys.modules)"
    )
    loaded = run_python(code=code).split()
    assert {"adaptrack.core.public", "adaptrack.core.controllers.kinematic_mpc"} <= set(loaded)
    assert set(HEAVY) & set(loaded) == {"numpy"}


def test_every_public_name_resolves_to_a_documented_object():
    assert [name for name in adaptrack.__all__ if name != "__version__" and not getattr(adaptrack, name).__doc__] == []
    assert dir(adaptrack) == sorted(adaptrack.__all__)


@pytest.mark.parametrize(("name", "words"), [
    ("Mpc", r"Mpc'. Did you mean 'MPC'\?$"),
    ("loadroad", r"loadroad'. Did you mean 'load_road'\?$"),
    ("simulat", "no attribute 'simulat'"),
])  # fmt: skip
def test_a_name_that_is_not_public_is_an_attribute_error_with_the_nearest(name, words):
    with pytest.raises(AttributeError, match=words):
        getattr(adaptrack, name)


def test_version_is_the_same_in_package_metadata_citation_and_changelog(project):
    citation = re.search(r"^version: \"?([\w.]+)", (project / "CITATION.cff").read_text(), re.MULTILINE)
    newest = re.search(r"^## (\d[\w.]*)", (project / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert {version("adaptrack"), citation[1], newest[1]} == {adaptrack.__version__}


def test_locks_pin_and_hash_every_declared_package(project):
    names = {}
    for file in ("requirements.lock", "requirements-extras.lock"):
        lock = (project / file).read_text()
        entries = re.split(r"\n(?=[a-z0-9])", re.sub(r"^\s*#.*\n", "", lock, flags=re.MULTILINE))
        pins = [re.match(r"([a-z0-9.-]+)==(\S+)", entry).groups() for entry in entries]
        assert all("--hash=sha256:" in entry for entry in entries)
        assert "://" not in lock
        names[file] = dict(pins)
    first, extras = names.values()
    assert all(extras[name] == first[name] for name in extras.keys() & first.keys())

    configuration = tomllib.loads((project / "pyproject.toml").read_text())["project"]
    optional = configuration["optional-dependencies"]
    extra = itertools.chain(*(optional.pop(name) for name in ("bench", "commonroad", "fmu", "gym")))
    declared = itertools.chain(configuration["dependencies"], *optional.values())
    for packages, pins in ((declared, first), (extra, extras)):
        assert {re.match(r"[a-z0-9-]+", package)[0] for package in packages} - {"adaptrack"} <= pins.keys()


def test_the_compiler_is_the_one_of_the_lock_wherever_it_is_declared(project):
    configuration = tomllib.loads((project / "pyproject.toml").read_text())
    pinned = re.search(r"^ziglang==[\d.]+", (project / "requirements.lock").read_text(), re.MULTILINE)[0]
    assert configuration["project"]["optional-dependencies"]["compile"] == [pinned]
    assert pinned in configuration["build-system"]["requires"]
    needed = configuration["project"]["dependencies"]  # who only drives installs no compiler
    assert not [package for package in needed if package.startswith("ziglang")]


@pytest.mark.slow  # the kernels for every processor of this kind
def test_wheel_holds_every_module_and_data_file_and_the_libraries_of_these_sources(project, run_python, tmp_path):
    # Hatchling obeys .gitignore: a careless pattern would drop data files without a word.
    run_python("-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path), cwd=project, timeout=900.0)  # compiles
    (wheel,) = tmp_path.glob("adaptrack-*-py3-none-*.whl")
    assert platform.system() != "Linux" or "manylinux" in wheel.name
    with zipfile.ZipFile(wheel) as archive:
        packed = set(archive.namelist())
        manifest = json.loads(archive.read("adaptrack/core/built/manifest.json"))
    source = project / "src"
    files = {p.relative_to(source).as_posix() for p in (source / "adaptrack").rglob("*") if p.is_file()}
    family = processor().removesuffix("-v3").removesuffix("-v4")  # libraries for others may have been made here
    libraries = (
        entry["file"] for name, entry in manifest["libraries"].items() if name.startswith((family, "wasm32-page"))
    )
    built = {f"adaptrack/core/built/{file}" for file in libraries}
    assert {name for name in files if "__pycache__" not in name and "/core/built/" not in name} | built <= packed
    assert {name for name in packed if "/core/built/kernels-" in name} == built
    assert manifest["sources"] == source_hashes()


def test_readme_examples_run(project, run_python):
    examples = re.findall(r"```python\n(.*?)```", (project / "README.md").read_text(), re.DOTALL)
    assert "mse" in run_python(code="\n".join(examples)).lower()
