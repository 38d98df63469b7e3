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
@where = internal constant [2 x ptr] [ptr getelementptr ([5 x double], ptr @squares, i64 0, i64 3), ptr @squares]
@kept = internal global [3 x double] zeroinitializer
define double @adaptrack_soft_fma(double %a, double %b, double %c) noinline {
  %p = fmul double %a, %b
  %s = fadd double %p, %c
  ret double %s
}
define double @adaptrack_square(i64 %i) noinline {
  %at = getelementptr [5 x double], ptr @squares, i64 0, i64 %i
  %y = load double, ptr %at
  ret double %y
}
define double @adaptrack_by_pointer(i64 %i) {
  %at = getelementptr [2 x ptr], ptr @where, i64 0, i64 %i
  %place = load ptr, ptr %at
  %y = load double, ptr %place
  ret double %y
}
define double @adaptrack_reversed(i64 %i) {
  %room = alloca [5 x double]
  br label %next
next:
  %k = phi i64 [0, %0], [%more, %next]
  %value = call double @adaptrack_square(i64 %k)
  %back = sub i64 4, %k
  %to = getelementptr [5 x double], ptr %room, i64 0, i64 %back
  store volatile double %value, ptr %to
  %more = add i64 %k, 1
  %done = icmp eq i64 %more, 5
  br i1 %done, label %end, label %next
end:
  %from = getelementptr [5 x double], ptr %room, i64 0, i64 %i
  %y = load volatile double, ptr %from
  ret double %y
}
define double @adaptrack_counted(double %x) {
  %at = getelementptr [3 x double], ptr @kept, i64 0, i64 2
  %old = load double, ptr %at
  %new = fadd double %old, %x
  store double %new, ptr %at
  ret double %new
}
define double @adaptrack_called(ptr %f, i64 %i) {
  %y = call double %f(i64 %i)
  ret double %y
}
"""
SCRIPT = """
const module = new WebAssembly.Module(require("fs").readFileSync(process.argv[1]));
if (WebAssembly.Module.imports(module).length) throw new Error("not whole");
const own = new WebAssembly.Instance(module).exports, found = [];
const place = own.__indirect_function_table.grow(1);
own.__indirect_function_table.set(place, own.adaptrack_reversed);
for (let i = 0n; i < 5n; i++) {
  found.push(own.adaptrack_square(i), own.adaptrack_reversed(i));
  found.push(own.adaptrack_called(place, i), own.adaptrack_counted(1.5));
}
found.push(own.adaptrack_by_pointer(0n), own.adaptrack_by_pointer(1n), own.memory.grow(1) > 0);
console.log(JSON.stringify(found));
"""


def told(module, folder, name):
    node = find_program("node")
    (folder / name).write_bytes(module)
    done = subprocess.run([node, "-e", SCRIPT, str(folder / name)], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_a_stack_that_is_too_small_is_a_trap_and_overwrites_nothing(tmp_path):
    module = linked(emit(TEXT, "wasm32"), stack=16)
    with pytest.raises(subprocess.CalledProcessError) as raised:
        told(module, tmp_path, "small.wasm")
    assert "memory access out of bounds" in raised.value.stderr
    assert STACK > 16


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
    found = subprocess.run([node, "-e", script, str(tmp_path / "page.wasm")], capture_output=True, check=True).stdout
    imports, exports = json.loads(found)
    assert imports == []
    assert sorted(exports) == sorted(
        ["memory", "__indirect_function_table", *(f"adaptrack_{each}" for each in (*CALLED, *PAGE_MEMBERS))]
    )
