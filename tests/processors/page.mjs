// Runs the worker of the page: node page.mjs WORKER.js KERNELS.wasm DATA.json REQUESTS.json ANSWERS
//
// REQUESTS: a list of messages, answered in turn. ANSWERS: a folder; answer k as k.json, its typed arrays as k.bin, in
// which {"at": byte, "count", "kind"} stand for them. Prints of each message the milliseconds, and those of the processor.
import fs from "node:fs";
import path from "node:path";
import vm from "node:vm";

const [worker, kernels, data, requests, folder] = process.argv.slice(2);
const posted = [];
const self = { postMessage: (message) => posted.push(message) };
const scope = vm.createContext({ self, WebAssembly, atob, console, TextDecoder, TextEncoder, performance });
vm.runInContext(fs.readFileSync(worker, "utf8"), scope, { filename: worker });

const times = [];
function ask(message) {
  const begun = performance.now(), before = process.cpuUsage();
  self.onmessage({ data: message });
  const { user, system } = process.cpuUsage(before);
  times.push([message.type, performance.now() - begun, (user + system) / 1000]);
}

ask({ type: "load", kernels: fs.readFileSync(kernels), data: JSON.parse(fs.readFileSync(data, "utf8")) });
for (const message of JSON.parse(fs.readFileSync(requests, "utf8"))) ask(message);

posted.forEach((message, k) => {
  const parts = [];
  let place = 0;
  const text = JSON.stringify(message, (_, value) => {
    if (!ArrayBuffer.isView(value)) return value;
    const bytes = Buffer.from(value.buffer, value.byteOffset, value.byteLength);
    parts.push(bytes);
    place += bytes.length;
    return { at: place - bytes.length, count: value.length, kind: value.constructor.name };
  });
  fs.writeFileSync(path.join(folder, `${k}.json`), text);
  fs.writeFileSync(path.join(folder, `${k}.bin`), Buffer.concat(parts));
});
console.log(JSON.stringify(times));
