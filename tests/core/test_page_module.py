"""The WebAssembly module of the driving page: what it exports, and what it does with a stack that is too small."""

import json
import subprocess

import pytest

pytest.importorskip("ziglang", reason="compiles and links the module")
from adaptrack.core import library
from adaptrack.core.build import compile
from adaptrack.core.build.units import PAGE_KERNELS
from programs import find_program, run_program

pytestmark = pytest.mark.compiled
TEXT = """
static const double squares[5] = {0.0, 1.0, 4.0, 9.0, 16.0};
__attribute__((visibility("default"))) double adaptrack_square(long long i) {
    volatile double room[5];
    room[i] = squares[i];
    return room[i];
}
"""
STACK = compile.MODULE_STACK
SCRIPT = """
const module = new WebAssembly.Module(require("fs").readFileSync(process.argv[1]));
const { adaptrack_square } = new WebAssembly.Instance(module).exports;
console.log(JSON.stringify([0n, 1n, 2n, 3n, 4n].map(adaptrack_square)));
"""


@pytest.mark.parametrize("stack", [STACK, 16])
def test_a_module_runs_and_traps_where_its_stack_is_too_small(stack, tmp_path, monkeypatch):
    monkeypatch.setattr(compile, "MODULE_STACK", stack)
    (tmp_path / "square.c").write_text(TEXT)
    compile._compile(tmp_path, "square", "wasm32", compile.OPTIONS, tmp_path / "kernels.o")
    compile.link_module([tmp_path / "kernels.o"], ["square"], tmp_path / "kernels.wasm")
    command = [find_program("node"), "-e", SCRIPT, str(tmp_path / "kernels.wasm")]
    process = subprocess.run(command, capture_output=True, text=True)
    if stack == STACK:
        assert json.loads(process.stdout) == [0, 1, 4, 9, 16]
    else:
        assert "memory access out of bounds" in process.stderr


def test_a_module_that_needs_a_function_of_others_is_refused(tmp_path):
    (tmp_path / "root.c").write_text("double cbrt(double); double adaptrack_root(double x) { return cbrt(x); }")
    compile._compile(tmp_path, "root", "wasm32", compile.OPTIONS, tmp_path / "kernels.o")
    with pytest.raises(compile.CompileError, match="cbrt"):
        compile.link_module([tmp_path / "kernels.o"], ["root"], tmp_path / "kernels.wasm")


def test_the_module_of_the_page_has_what_the_page_calls_and_nothing_else():
    script = "const { Module } = WebAssembly, m = new Module(require('fs').readFileSync(process.argv[1]));"
    script += "console.log(JSON.stringify([Module.imports(m), Module.exports(m).map((e) => e.name)]));"
    imports, exports = json.loads(run_program("node", "-e", script, library.page_module()))
    assert imports == []
    assert sorted(exports) == sorted(
        ["memory", "__indirect_function_table", *(f"adaptrack_{name}" for name in PAGE_KERNELS)]
    )
