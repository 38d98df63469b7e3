// Runs an image (see image.py): node driver.mjs LIBRARY.wasm IMAGE ANSWERS [FUNCTION ...], those that it links to.
import fs from "node:fs";

const [library, given, answers, ...names] = process.argv.slice(2);
const module = new WebAssembly.Module(fs.readFileSync(library));
const imports = WebAssembly.Module.imports(module);
if (imports.length) throw new Error(`not whole: ${JSON.stringify(imports)}`);
const kernels = new WebAssembly.Instance(module).exports;
const image = fs.readFileSync(given);
const words = new BigInt64Array(image.buffer, image.byteOffset, image.length / 8);
const [size, places, links, steps] = [...words.slice(0, 4)].map(Number);
const pages = kernels.memory.grow(Math.ceil((8 * size + 64) / 65536));
const base = 65536 * pages;
const memory = new BigInt64Array(kernels.memory.buffer, base, size);
memory.set(words.slice(4, 4 + size));
const table = kernels.__indirect_function_table;
const functions = names.map((name) => {
  const place = table.grow(1);
  table.set(place, kernels[`adaptrack_${name}`]);
  return BigInt(place);
});
const place = (word) => base + 8 * Number(word);
let at = 4 + size;
for (let i = 0; i < places; i++, at += 2) memory[words[at]] = BigInt(place(words[at + 1]));
for (let i = 0; i < links; i++, at += 2) memory[words[at]] = functions[words[at + 1]];
const out = fs.openSync(answers, "w");
for (let i = 0; i < steps; i++, at += 5) {
  const [what, a, b, c, d] = words.slice(at, at + 5);
  if (what === 0n) kernels.adaptrack_elementary_values(a, place(b), 3n, c, place(d), c);
  else if (what === 1n) memory.copyWithin(Number(b), Number(a), Number(a + c));
  else if (what === 2n) kernels.adaptrack_mpc_step(place(a));
  else if (what === 3n) kernels.adaptrack_begin_runs(a, place(b));
  else if (what === 4n) kernels.adaptrack_roll_on(a, b, place(c));
  else if (what === 6n) kernels.adaptrack_informed_numbers(place(a), place(b));
  else if (what === 7n) kernels.adaptrack_lqr_parameters(place(a), place(b), place(c), 4n, place(d), 6820n);
  else fs.writeSync(out, new Uint8Array(kernels.memory.buffer, place(a), 8 * Number(b)));
}
