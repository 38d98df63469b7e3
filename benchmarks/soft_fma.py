"""The multiply-add of WebAssembly, ours and the C library's: python -m benchmarks.soft_fma  (two minutes)

Nanoseconds of one by itself, microseconds of a step of the informed MPC with each, and whether the bits are the same;
in Node. The C library's is musl's, as ziglang brings it. Needs ziglang and numba; nothing else should run.
"""

from __future__ import annotations

import os

os.environ["ADAPTRACK_KERNELS"] = "jit"

import platform
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from adaptrack.core.build import exports, numba_functions
from adaptrack.core.build.library import TARGETS, optimised, retargeted
from adaptrack.core.build.wasm_link import linked
from adaptrack.core.controllers.mpc_step import step
from adaptrack.core.estimators.kalman import kalman
from adaptrack.core.maths import exact
from adaptrack.core.models.path import discretise
from test_processors import mpc_steps

SOFT = (exact.soft_fma, exact.careful_fma, exact.whole_fma, exact.soft_fma8)
LOOPS = """
double FMA(double, double, double);
static double room[4][1024];
double *place(int i) { return room[i]; }
void apart(int rounds) {
  for (int r = 0; r < rounds; r++) for (int i = 0; i < 1024; i++) room[3][i] = FMA(room[0][i], room[1][i], room[2][i]);
}
double chain(double b, double c, int n) { double y = 1.0; for (int i = 0; i < n; i++) y = FMA(y, b, c); return y; }
"""
TIME_LOOPS = """
const own = new WebAssembly.Instance(new WebAssembly.Module(require("fs").readFileSync(process.argv[1])), {}).exports;
const numbers = new Float64Array(own.memory.buffer);
for (let i = 0; i < 3; i++) for (let k = 0; k < 1024; k++) numbers[own.place(i) / 8 + k] = Math.sin(1 + 7 * k + i);
let apart = Infinity, chained = Infinity;
for (let round = 0; round < 20; round++) {
  let begun = performance.now();
  own.apart(200);
  apart = Math.min(apart, (performance.now() - begun) * 1e6 / 204800);
  begun = performance.now();
  own.chain(0.999, 0.01, 200000);
  chained = Math.min(chained, (performance.now() - begun) * 1e6 / 200000);
}
console.log(`${apart.toFixed(1)} ns where they do not wait for each other, ${chained.toFixed(1)} ns where they do`);
"""
TIME_STEPS = """
const fs = require("fs"), [library, given, answers, ...names] = process.argv.slice(1);
const kernels = new WebAssembly.Instance(new WebAssembly.Module(fs.readFileSync(library)), {}).exports;
const image = fs.readFileSync(given), words = new BigInt64Array(image.buffer, image.byteOffset, image.length / 8);
const [size, places, links, steps] = [...words.slice(0, 4)].map(Number);
const base = 65536 * kernels.memory.grow(Math.ceil((8 * size + 64) / 65536)), place = (word) => base + 8 * Number(word);
const memory = new BigInt64Array(kernels.memory.buffer, base, size), table = kernels.__indirect_function_table;
const first = table.grow(names.length);
names.forEach((name, i) => table.set(first + i, kernels[`adaptrack_${name}`]));
let told = [], best = new Float64Array(steps).fill(Infinity), count = 0;  // of each step, as others run here too
for (let round = 0; round < 9; round++) {
  let at = 4 + size;
  count = 0;
  told = [];
  memory.set(words.slice(4, 4 + size));
  for (let i = 0; i < places; i++, at += 2) memory[words[at]] = BigInt(place(words[at + 1]));
  for (let i = 0; i < links; i++, at += 2) memory[words[at]] = BigInt(first) + words[at + 1];
  for (let i = 0; i < steps; i++, at += 5) {
    const [what, a, b, c] = words.slice(at, at + 4);
    if (what === 1n) memory.copyWithin(Number(b), Number(a), Number(a + c));
    else if (what === 2n) {
      const begun = performance.now();
      kernels.adaptrack_mpc_step(place(a));
      best[count] = Math.min(best[count++], performance.now() - begun);
    } else told.push(...memory.slice(Number(a), Number(a + b)));
  }
}
const mean = 1000 * best.subarray(0, count).reduce((sum, each) => sum + each, 0) / count;
fs.writeFileSync(answers, new Uint8Array(new BigInt64Array(told).buffer));
console.log(`${mean.toFixed(1)} us a step`);
"""


def made(kernels: tuple[Any, ...], own: bool) -> bytes:
    """An object of these kernels for WebAssembly, with our multiply-add as the page has it, or a call of C's."""
    target = TARGETS["wasm32"] if own else replace(TARGETS["wasm32"], lacks=())
    chosen = exports.Exported(target, kernels=tuple(each.name for each in kernels), whole=True)
    machine, text = retargeted(str(numba_functions.linked(dict.fromkeys((*kernels, *SOFT)))), target, "static")
    module = exports._of_these(text.replace("= common ", "= internal "), chosen, machine)
    optimised(module, machine)
    return bytes(machine.emit_object(llvm.parse_assembly(str(module))))


def by_zig(*arguments: str) -> None:
    """Compile or link for WASI."""
    command = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-target",
        "wasm32-wasi",
        "-O3",
        "-fno-builtin",
        "-mexec-model=reactor",
    ]
    subprocess.run([*command, *arguments], check=True, capture_output=True)


def told(script: str, *arguments: str) -> str:
    """What Node prints."""
    return subprocess.run(["node", "-e", script, *arguments], check=True, capture_output=True, text=True).stdout.strip()


def main() -> None:
    """Measure and print."""
    version = subprocess.run(["node", "--version"], capture_output=True, text=True).stdout.strip()
    print(f"Node {version}, {platform.machine()}, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "loops.c").write_text(LOOPS)
        (folder / "own.o").write_bytes(made(SOFT, own=True))
        for who, function, others in (("C's", "fma", []), ("ours", "adaptrack_soft_fma", [str(folder / "own.o")])):
            options = [f"-DFMA={function}", *(f"-Wl,--export={each}" for each in ("apart", "chain", "place"))]
            by_zig(str(folder / "loops.c"), *others, *options, "-o", str(folder / "loops.wasm"))
            print(f"{who}: {told(TIME_LOOPS, str(folder / 'loops.wasm'))}")
        image, kernels = mpc_steps(np.random.default_rng(5)), (step, discretise, kalman)
        image.words().tofile(folder / "image")
        (folder / "c.o").write_bytes(made(kernels, own=False))
        options = [
            "--export-dynamic",
            "--export-table",
            "--growable-table",
            *(f"--export=adaptrack_{each.name}" for each in kernels),
        ]
        by_zig(str(folder / "c.o"), *(f"-Wl,{each}" for each in options), "-o", str(folder / "c.wasm"))
        (folder / "own.wasm").write_bytes(linked(made(kernels, own=True)))
        answers = []
        for who, module in (("C's", "c.wasm"), ("ours", "own.wasm")):
            given = [str(folder / each) for each in (module, "image", "answers")]
            print(f"informed MPC with {who}: {told(TIME_STEPS, *given, *image.functions)}")
            answers.append(np.fromfile(folder / "answers", np.int64))
        both = np.isnan(answers[0].view(float)) & np.isnan(answers[1].view(float))
        print(f"numbers that differ: {int(np.sum((answers[0] != answers[1]) & ~both))} of {both.size:,}")


if __name__ == "__main__":
    main()
