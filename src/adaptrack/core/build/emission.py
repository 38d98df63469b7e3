"""Machine code of kernels: modules of LLVM's, joined, optimised and emitted for a processor as an object file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm

from ..kernel import SYMBOL


class BuildError(RuntimeError):
    """The library cannot be built; the message says what to do."""


@dataclass(frozen=True)
class CompileTarget:
    """A processor, as LLVM names it.

    lacks: of `SOFT` what it has no instruction for, so that LLVM calls C's function of that name.
    """

    triple: str
    cpu: str = ""
    features: str = ""
    lacks: tuple[str, ...] = ()

    @property
    def has_parts(self) -> bool:
        """Whether a library is linked of several objects, each with modules of one folder; else of one."""
        return self.triple.endswith("linux-gnu") and not self.lacks


COMPILE_TARGETS = {
    "x86-64": CompileTarget("x86_64-unknown-linux-gnu", "x86-64", lacks=("fma", "floor", "ceil")),
    "x86-64-v3": CompileTarget("x86_64-unknown-linux-gnu", "x86-64-v3"),
    "x86-64-v4": CompileTarget(
        "x86_64-unknown-linux-gnu", "x86-64-v4", "-prefer-256-bit"
    ),  # eight floats in one register
    "aarch64": CompileTarget("aarch64-unknown-linux-gnu"),
    "riscv64": CompileTarget("riscv64-unknown-linux-gnu", "generic-rv64", "+m,+a,+f,+d"),
    "wasm32": CompileTarget("wasm32-unknown-unknown", "", "+simd128,+bulk-memory,-relaxed-simd", lacks=("fma",)),
    "windows-x86-64": CompileTarget("x86_64-pc-windows-msvc", "x86-64", lacks=("fma", "floor", "ceil")),
    "windows-x86-64-v3": CompileTarget("x86_64-pc-windows-msvc", "x86-64-v3"),
    "windows-x86-64-v4": CompileTarget("x86_64-pc-windows-msvc", "x86-64-v4", "-prefer-256-bit"),
    "macos-aarch64": CompileTarget("arm64-apple-macosx11.0.0", "apple-m1"),
    "macos-x86-64": CompileTarget("x86_64-apple-macosx11.0.0", "x86-64", lacks=("fma", "floor", "ceil")),
    "macos-x86-64-v3": CompileTarget("x86_64-apple-macosx11.0.0", "x86-64-v3"),
}
SOFT = {"fma": 3, "floor": 1, "ceil": 1, "sqrt": 1}
"""Functions of C's library that the kernels have themselves, exactly, as ``soft_NAME``; how many floats each takes."""

WINDOWS = """
module asm ".globl __chkstk"
module asm "__chkstk: pushq %rcx; pushq %rax; leaq 24(%rsp), %rcx"
module asm "1: cmpq $0x1000, %rax; jb 2f"
module asm "subq $0x1000, %rcx; testq %rcx, (%rcx); subq $0x1000, %rax; jmp 1b"
module asm "2: subq %rax, %rcx; testq %rcx, (%rcx); popq %rax; popq %rcx; ret"
@_fltused = constant i32 1
"""
"""What compilers for Windows ask of C's library: a stack grows (by rax bytes) when its pages are touched in turn; and a
name which says that there are floats.
"""

_FMA8 = """
define internal <8 x double> @soft_fma8(<8 x double> %a, <8 x double> %b, <8 x double> %c) {
  %pa = alloca <8 x double>, align 64
  %pb = alloca <8 x double>, align 64
  %pc = alloca <8 x double>, align 64
  %py = alloca <8 x double>, align 64
  store <8 x double> %a, ptr %pa, align 64
  store <8 x double> %b, ptr %pb, align 64
  store <8 x double> %c, ptr %pc, align 64
  call void @adaptrack_soft_fma8(ptr %pa, i64 8, ptr %pb, i64 8, ptr %pc, i64 8, ptr %py, i64 8)
  %y = load <8 x double>, ptr %py, align 64
  ret <8 x double> %y
}
"""
"""The kernel of this name, on values instead of arrays."""


def with_soft(text: str, target: CompileTarget, linkage: str, inlined: bool = False) -> str:
    """A module with C's functions that a target lacks, from the kernels' own; linkage: of these.

    Where there is floating-point arithmetic, LLVM's multiply-add becomes a call of ours before anything is optimised;
    without it, the one in whole numbers is faster. inlined: eight multiply-adds at once are a part of those that call
    them, which takes a quarter of the time and half of the code more.
    """
    for name in target.lacks:
        n_arguments, symbol = SOFT[name], f"soft_{name}"
        if name == "fma" and "sqrt" in target.lacks:
            symbol = "whole_fma"
        elif name == "fma":
            text = text.replace("call double @llvm.fma.f64(", "call double @adaptrack_soft_fma(")
            text = text.replace("call <8 x double> @llvm.fma.v8f64(", "call <8 x double> @soft_fma8(")
            if "@adaptrack_soft_fma8(" in text:
                text += _FMA8.replace(") {", ") alwaysinline {" if inlined else ") noinline {")
            text = re.sub(r"^(define .*careful_fma.*) \{$", r"\1 noinline cold {", text, flags=re.MULTILINE)
            text = re.sub(r"^(define .*@adaptrack_soft_fma\(.*) \{$", r"\1 noinline {", text, flags=re.MULTILINE)
        if f"@adaptrack_{symbol}(" not in text:
            text += f"declare double @adaptrack_{symbol}({', '.join(['double'] * n_arguments)})\n"
        parameters = ", ".join(f"double %x{i}" for i in range(n_arguments))
        text += f"define {linkage} double @{name}({parameters}) noinline {{\n"
        text += f"  %y = call double @adaptrack_{symbol}({parameters})\n  ret double %y\n}}\n"
    return text


def retargeted(text: str, target: CompileTarget, reloc: str = "pic") -> tuple[Any, str]:
    """LLVM's machine of a target, and the text of a module for it."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    if "windows" in target.triple:
        llvm.initialize_native_asmparser()
    machine = llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.cpu, features=target.features, opt=3, reloc=reloc
    )
    text = re.sub(r'target datalayout = ".*"', f'target datalayout = "{machine.target_data}"', text)
    return machine, re.sub(r'target triple = ".*"', f'target triple = "{target.triple}"', text)


def optimised(module: Any, machine: Any, speed: int = 3, vectors: bool = True) -> None:
    """Optimise a module for a machine, in place."""
    options = llvm.create_pipeline_tuning_options(speed_level=speed)
    options.loop_vectorization = options.slp_vectorization = vectors
    passes = llvm.create_pass_builder(machine, options)
    for function in module.functions:  # small before they are inlined: that takes half the time
        if not function.is_declaration:
            passes.getFunctionPassManager().run(function, passes)
    passes.getModulePassManager().run(module, passes)


def emit_files(paths: Iterable[Path], name: str, alone: bool = True) -> bytes:
    """Return the object file for a target, of modules in files of bitcode; alone: see `joined`."""
    return emit(joined(paths, alone), name)


def emit(text: str, name: str) -> bytes:
    """Return the object file of a module for a target.

    No function of C's is called: "no-builtins" keeps loops from becoming calls of memcpy and its like, and what the
    target lacks comes from `SOFT`.
    """
    target = COMPILE_TARGETS[name]
    machine, text = retargeted(text, target, "static" if target.triple.startswith("wasm") else "pic")
    text = with_soft(text, target, "hidden")
    if "windows" in target.triple:
        text = re.sub(r"^define (?=[^@]*@adaptrack_)", "define dllexport ", text, flags=re.MULTILINE) + WINDOWS
    module = llvm.parse_assembly(re.sub(r"^(define .*) \{$", r'\1 "no-builtins" {', text, flags=re.MULTILINE))
    optimised(module, machine)
    return bytes(machine.emit_object(module))


def joined(paths: Iterable[Path], alone: bool = True) -> str:
    """Return the text of one module of modules in files of bitcode.

    alone: kernels are called from within this module only, otherwise from other objects of the same library, too.
    """
    module = llvm.parse_assembly("")
    for path in paths:
        module.link_in(llvm.parse_bitcode(path.read_bytes()))
    for function in module.functions:
        if function.name.startswith(SYMBOL):
            if not alone:
                function.visibility = "hidden"
            elif not function.is_declaration:
                function.linkage = "internal"
    # LLVM's writer of WebAssembly ends the process at a `common` variable
    return re.sub(r"= common (local_unnamed_addr |unnamed_addr )?global", r"= internal \1global", str(module))
