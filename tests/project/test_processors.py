"""Every command gives the same numbers on every processor: the code of NumPy, BLAS and the C library is exchanged."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from benchmarks.against_release import NOT_COMPARED, compare, leaves
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

COMMANDS = """
drive triple-lane-change accelerating-double-lane-change
drive random-drive --controller standard --scheduler road-nn --profile road --allow-failed
drive lane-change --profile production --vehicle compact-ev --learn
drive sine --plant single-track --controller kinematic-mpc
drive country --length 500 --vehicle midsize-sedan --speed-control --out log
drive track.csv --vehicle van --controller preview-lqr
drive lap --length 600 --vehicle sports-car --controller stanley --wind 8 --allow-failed
drive town --length 300 --controller lqr
road check track.csv --vehicle van
road check noisy.csv
road check mountain --road-seed 3 --length 800
car midsize-sedan
car --mass 1450 --wheelbase 2.65
identify log/country-0-informed.parquet --mass 1578 --wheelbase 2.6
identify log/country-0-informed.parquet --car midsize-sedan --longitudinal
shadow log/country-0-informed.parquet --vehicle midsize-sedan
certify --speed 10 15 --friction 0.6 0.8
certify --feasible --speed 10 12 --friction 0.6 0.8
tune midsize-sedan --road town --length 300 --controller lqr --runs 20 --out tuned
compare country --length 400 --vehicle compact-ev --controller informed --controller lqr --budget 0 --out compared
export c --vehicle midsize-sedan --speed-control --out c
export page --out drive.html
paper reproduce --quick --out paper
"""
FILES = ("c/*.c", "c/*.h", "drive.html")
"""What the commands write and whose bytes are compared: constants of an export, a page."""
ANSWER = f"""
import contextlib, io, json, shlex, sys
from adaptrack.cli import main
answers = {{}}
for line in {COMMANDS!r}.split(chr(10))[1:-1]:
    sys.argv = ["adaptrack", *shlex.split(line), "--json"]
    with contextlib.redirect_stdout(io.StringIO()) as out:
        try:
            code = main()
        except SystemExit as stop:
            code = stop.code
    answers[line] = {{"exit code": code, "answer": json.loads(out.getvalue())}}
json.dump(answers, open("answers.json", "w"))
"""
TRAINING = "paper reproduce --quick --out paper"
"""The command that trains networks: scikit-learn leaves the products of matrices to BLAS, see docs/install.md."""
OLD_PROCESSOR = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable"}
"""The C library's functions without a fused multiply-add."""
OTHERS = {
    "NumPy without its vector code": {"NPY_DISABLE_CPU_FEATURES": " ".join(__cpu_dispatch__)},
    "BLAS for Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "BLAS for Nehalem, C library of an old processor": {"OPENBLAS_CORETYPE": "Nehalem", **OLD_PROCESSOR},
}


def answers(folder, **environment):
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    track = np.column_stack([220.0 * np.sin(angle) + 25.0 * np.sin(3.0 * angle), 130.0 * np.cos(angle)])
    noise = np.random.default_rng(1).normal(0.0, 0.1, track.shape)
    for name, points in (("track.csv", track), ("noisy.csv", track + noise)):
        np.savetxt(folder / name, points, delimiter=",", header="x,y", comments="", fmt="%.4f")
    code = "import warnings; warnings.simplefilter('ignore')" + ANSWER
    subprocess.run([sys.executable, "-c", code], check=True, cwd=folder, env=os.environ | environment)
    files = {str(file.relative_to(folder)): file.read_text() for kind in FILES for file in folder.glob(kind)}
    return json.loads((folder / "answers.json").read_text()), files


def has_same_digits(expected, computed):
    """Whether the numbers of two answers agree to eight digits, residuals near 0 to 1e-9; times are not compared."""
    old, new = (
        {path: value for path, value in leaves(answer) if not any(part in path for part in NOT_COMPARED)}
        for answer in (expected, computed)
    )
    numbers = {path for path, value in old.items() if isinstance(value, float)}
    is_close = (old[path] == pytest.approx(new[path], rel=1e-8, abs=1e-9, nan_ok=True) for path in numbers)
    return old.keys() == new.keys() and all(is_close) and all(old[path] == new[path] for path in old.keys() - numbers)


@pytest.fixture(scope="module")
def local_features(tmp_path_factory):
    return answers(tmp_path_factory.mktemp("here"))


@pytest.mark.slow  # twenty commands, once for each way to compute
@pytest.mark.parametrize("other", OTHERS)
def test_twenty_commands_give_the_same_bits_whatever_code_the_libraries_choose(other, local_features, tmp_path):
    environment = OTHERS[other]
    if "NPY_DISABLE_CPU_FEATURES" in environment and not any(__cpu_features__[name] for name in __cpu_dispatch__):
        pytest.skip(f"this processor has none of {', '.join(__cpu_dispatch__)}: NumPy has nothing to switch off")
    there, files = answers(tmp_path, **environment)
    expected = dict(local_features[0])
    if "OPENBLAS_CORETYPE" in environment:
        assert has_same_digits(expected.pop(TRAINING), there.pop(TRAINING))
    different = [line for name, answer in expected.items() for line in [name, *compare(answer, there[name])][2:]]
    assert not different
    assert files == local_features[1]
