"""What is linked here without a linker is what LLVM's linker makes of the same object."""

import json
import subprocess

import pytest

pytest.importorskip("llvmlite", reason="what builds the kernels")
from adaptrack.core import library
from adaptrack.core.build.emission import emit
from adaptrack.core.build.page import CALLED, PAGE_MEMBERS
from adaptrack.core.build.wasm_link import STACK, linked
from programs import find_program

pytestmark = pytest.mark.compiled
TEXT = """
target datalayout = "e"
target triple = "any"
@squares = internal constant [5 x double] [double 0.0, double 1.0, double 4.0, double 9.0, double 16.0]
define double @adaptrack_soft_fma(double %a, double %b, double %c) noinline {
  %p = fmul double %a, %b
  %s = fadd double %p, %c
  ret double %s
}
define double @adaptrack_square(i64 %i) noinline {
  %room = alloca [5 x double]
  %at = getelementptr [5 x double], ptr @squares, i64 0, i64 %i
  %y = load double, ptr %at
  %to = getelementptr [5 x double], ptr %room, i64 0, i64 %i
  store volatile double %y, ptr %to
  %z = load volatile double, ptr %to
  ret double %z
}
"""
SCRIPT = """
const module = new WebAssembly.Module(require("fs").readFileSync(process.argv[1]));
const own = new WebAssembly.Instance(module).exports;
console.log(JSON.stringify([0n, 1n, 2n, 3n, 4n].map(own.adaptrack_square)));
"""


@pytest.mark.parametrize("stack", [STACK, 16])
def test_a_module_that_is_linked_here_runs_and_traps_where_its_stack_is_too_small(stack, tmp_path):
    (tmp_path / "squares.wasm").write_bytes(linked(emit(TEXT, "wasm32"), stack=stack))
    command = [find_program("node"), "-e", SCRIPT, str(tmp_path / "squares.wasm")]
    process = subprocess.run(command, capture_output=True, text=True)
    if stack == STACK:
        assert json.loads(process.stdout) == [0, 1, 4, 9, 16]
    else:
        assert "memory access out of bounds" in process.stderr


def test_an_object_that_needs_another_is_refused():
    text = TEXT + "declare double @cbrt(double)\ndefine double @adaptrack_root(double %x) {\n"
    text += "  %y = call double @cbrt(double %x)\n  ret double %y\n}\n"
    with pytest.raises(ValueError, match="needs cbrt"):
        linked(emit(text, "wasm32"))
    with pytest.raises(ValueError, match="not an object file"):
        linked(b"\x7fELF")


def test_the_module_of_the_page_has_what_the_page_calls_and_nothing_else(tmp_path):
    try:
        module = library.exported("wasm32-page").read_bytes()
    except library.UNUSABLE:
        pytest.skip(f"not compiled: {library.BUILD} --export wasm32-page")
    node = find_program("node")
    (tmp_path / "page.wasm").write_bytes(module)
    script = "const { Module } = WebAssembly, m = new Module(require('fs').readFileSync(process.argv[1]));"
    script += "console.log(JSON.stringify([Module.imports(m), Module.exports(m).map((e) => e.name)]));"
    output = subprocess.run([node, "-e", script, str(tmp_path / "page.wasm")], capture_output=True, check=True).stdout
    imports, exports = json.loads(output)
    assert imports == []
    assert sorted(exports) == sorted(
        ["memory", "__indirect_function_table", *(f"adaptrack_{name}" for name in (*CALLED, *PAGE_MEMBERS))]
    )
