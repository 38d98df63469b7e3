"""What is taken into other programs: an object file for each target, of the kernels that a controller calls; and for
pages a module of WebAssembly, of those that a whole drive calls.

Nothing in it is global but these kernels, nothing is written that is static, and every function and constant has a
section of its own, so that a linker leaves out what a program does not call. It calls nothing but what a target's
`calls` names. For a microcontroller it is built for size: the same bits, but no function is inlined by force.
"""

from __future__ import annotations

import gzip
import io
import json
import re
import tarfile
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm

from .. import library
from . import page
from .emission import COMPILE_TARGETS, SOFT, WINDOWS, BuildError, CompileTarget, optimised, retargeted, with_soft
from .objects import undefined
from .rules import plain
from .units import PLANTS, TRACKERS, UNIT_KERNELS
from .wasm_link import linked

KERNELS = (
    # of a program: a whole call, and a path
    "tracker_step", "tracker_engage", "tracker_follow", "path_words", "path_through",
    # a speed control behind it, and its plan
    "longitudinal_begin", "longitudinal_follow",
    "longitudinal_release", "longitudinal_acknowledge", "speed_path_words", "write_speed_path", "horizon_cells",
    # a controller alone, and the sizes of its arrays
    "mpc_step", "mpc_sizes", "schedule_step",
    # members, whose addresses records hold
    *TRACKERS,
    # what tells whether a processor rounds as others do
    "elementary_values",
)  # fmt: skip
"""What other programs call, or have in a record by its address; the rest of an object file is internal."""


@dataclass(frozen=True)
class ExportTarget:
    """How a target is exported.

    compact: built for size; calls: functions that every compiler for it brings along, by the run-time ABI's names;
    kernels: those that are global; is_module: a module, made for speed, not an object.
    """

    target: CompileTarget
    compact: bool = False
    calls: tuple[str, ...] = ()
    kernels: tuple[str, ...] = KERNELS
    is_module: bool = False


_WHOLE_NUMBERS = ("__aeabi_d2lz", "__aeabi_l2d", "__aeabi_ul2d", "__aeabi_ldivmod", "__aeabi_uldivmod")
"""Conversions of 64 bits and their quotient. They are exact, or rounded to the nearest: everywhere the same."""
_DOUBLES = (
    "__aeabi_dadd", "__aeabi_dsub", "__aeabi_dmul", "__aeabi_ddiv", "__aeabi_dcmpeq", "__aeabi_dcmplt",
    "__aeabi_dcmple", "__aeabi_dcmpge", "__aeabi_dcmpgt", "__aeabi_dcmpun", "__aeabi_i2d", "__aeabi_ui2d",
    "__aeabi_d2iz", "__aeabi_d2uiz", "__aeabi_lmul",
)  # fmt: skip
"""IEEE arithmetic in software (Run-time ABI for the Arm Architecture, section 5.1)."""

_FMUS = {name: (*KERNELS, *PLANTS, *sum(UNIT_KERNELS.values(), ())) for name in ("x86-64-v3", "windows-x86-64-v3")}
"""The targets that FMUs have a binary for, and what these call."""
_HOSTED = ("x86-64", "x86-64-v3", "aarch64", "riscv64", "wasm32", "windows-x86-64", "windows-x86-64-v3",
           "macos-aarch64", "macos-x86-64", "macos-x86-64-v3")  # fmt: skip


def _exported(name: str) -> ExportTarget:
    target = COMPILE_TARGETS[name]
    if "windows" in name:  # the same ABI, but a function that needs a large stack asks for it by a name we may choose
        target = replace(target, triple="x86_64-pc-windows-gnu")
    return ExportTarget(target, kernels=_FMUS.get(name, KERNELS))


EXPORT_TARGETS = {
    **{name: _exported(name) for name in _HOSTED},
    "wasm32-page": ExportTarget(COMPILE_TARGETS["wasm32"], kernels=(*page.CALLED, *page.PAGE_MEMBERS), is_module=True),
    "cortex-m7": ExportTarget(CompileTarget("thumbv7em-unknown-none-eabihf", "cortex-m7"), True, _WHOLE_NUMBERS),
    "cortex-m33": ExportTarget(
        CompileTarget("thumbv8m.main-unknown-none-eabi", "cortex-m33", "-fpregs", tuple(SOFT)),
        True,
        _WHOLE_NUMBERS + _DOUBLES,
    ),
}


def shipped(processors: list[str]) -> list[str]:
    """Return what a wheel with the libraries of these processors has for other programs."""
    objects = [name for name in EXPORT_TARGETS if name in processors or f"{name.removesuffix('-v3')}-v4" in processors]
    return [*objects, "wasm32", "wasm32-page"]


def archive(folder: Path) -> Path:
    """Pack all that is exported into a folder; what lies in a wheel is in it too.

    The same object files give the same bytes.
    """
    stem = f"adaptrack-targets-{version('adaptrack')}"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{stem}.tar.gz"
    listed = library.manifest()
    entries = {name: listed["exports"][name] for name in EXPORT_TARGETS if name in listed["exports"]}
    files = {entry["file"]: library.verified_file(entry).read_bytes() for entry in entries.values()}
    files[library.MANIFEST] = json.dumps({"sources": listed["sources"], "exports": entries}, indent=1).encode()
    files["LICENSE"] = (library.PACKAGE_FOLDER.parents[1] / "LICENSE").read_bytes()
    with gzip.GzipFile(path, "wb", mtime=0) as packed, tarfile.open(fileobj=packed, mode="w") as tar:
        for name, content in sorted(files.items()):
            entry = tarfile.TarInfo(f"{stem}/{name}")
            entry.size, entry.mode = len(content), 0o644
            tar.addfile(entry, io.BytesIO(content))
    return path


def emit_export(text: str, name: str) -> bytes:
    """Return the object file for a target, of a module of all kernels.

    Raises BuildError where it calls what it may not.
    """
    chosen = EXPORT_TARGETS[name]
    target = chosen.target
    machine, text = retargeted(text, target, "pic" if _hosted(target) else "static")
    module = _select_kernels(text, chosen, machine)
    optimised(module, machine, speed=2 if chosen.compact else 3, vectors=not chosen.compact)
    content = bytes(machine.emit_object(llvm.parse_assembly(_split_sections(str(module), target))))
    left = [symbol for symbol in undefined(content) if symbol not in chosen.calls]
    if left:
        raise BuildError(f"what is exported for {name} calls {', '.join(left)}: allow it by name, or replace it.")
    return linked(content) if chosen.is_module else content


def _hosted(target: CompileTarget) -> bool:
    return not re.search("none|wasm", target.triple)


def _select_kernels(text: str, chosen: ExportTarget, machine: Any) -> Any:
    """The module of the kernels and what they call, ready to be optimised."""
    target = chosen.target
    if chosen.compact:
        text = text.replace(" alwaysinline", " nounwind")
    text = re.sub(r"^ +store ptr @\.const\.picklebuf\S+, ", "  store ptr null, ", text, flags=re.MULTILINE)
    text = with_soft(text, target, "internal", inlined=chosen.is_module)
    if target.lacks:
        kept_symbols = ", ".join(f"ptr @{symbol}" for symbol in target.lacks)
        text += f"@llvm.compiler.used = appending global [{len(target.lacks)} x ptr] [{kept_symbols}]"
        text += ', section "llvm.metadata"\n'
    attributes = '"no-builtins" "no-jump-tables"="true" nounwind' + (" optsize" if chosen.compact else "")
    if "windows" in target.triple:
        attributes += ' "probe-stack"="adaptrack_grow_stack"'
        text += re.sub(r"module asm \"\.globl.*\n", "", WINDOWS.split("@_fltused")[0]).replace(
            "__chkstk", "adaptrack_grow_stack")  # fmt: skip
    module = llvm.parse_assembly(re.sub(r"^(define .*) \{$", rf"\1 {attributes} {{", text, flags=re.MULTILINE))
    names = {f"adaptrack_{kernel}" for kernel in chosen.kernels}
    for function in module.functions:
        if not function.is_declaration:
            function.linkage = "external" if function.name in names else "internal"
            if function.name.startswith("_ZN"):
                function.name = plain(function.name)
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    return module


def _split_sections(text: str, target: CompileTarget) -> str:
    """A module with a section for each function and constant; for WebAssembly and macOS they are apart as they are."""
    if re.search("wasm|macosx", target.triple):
        return text
    separator = "$" if "windows" in target.triple else "."
    names: set[str] = set()

    def placed(match: re.Match[str], kind: str, comdat: str) -> str:
        names.add(match["name"])
        symbol = match["name"].strip('"')
        comma = "," if kind != ".text" else ""
        section = f'section "{kind}{separator}{symbol}"{comdat if separator == "$" else ""}'
        return f"{match['all']}{comma} {section}{match['rest']}"

    name = r'(?P<name>"[^"]+"|[-\w.$]+)'
    function = rf"^(?P<all>define [^@]*@{name}\(.*\).*?)(?P<rest>( personality.*)? \{{)$"
    text = re.sub(function, lambda match: placed(match, ".text", " comdat"), text, flags=re.MULTILINE)
    words = "(?:local_unnamed_addr |unnamed_addr )*"
    constant = rf"^(?P<all>@{name} = (?:internal|private) {words}constant .*?)(?P<rest>(, align \d+)?)$"
    kind = ".rdata" if separator == "$" else ".rodata"
    text = re.sub(constant, lambda match: placed(match, kind, ", comdat"), text, flags=re.MULTILINE)
    if separator == "$":
        first = text.index("\n", text.index("target triple")) + 1
        text = text[:first] + "".join(f"${name} = comdat nodeduplicate\n" for name in sorted(names)) + text[first:]
    return text
