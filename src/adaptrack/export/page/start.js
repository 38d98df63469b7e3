// What the page carries, unpacked, and the engine begun as a worker that needs no file of its own.
//
// await unpacked(name)    the bytes (ArrayBuffer) of a part: "engine", "kernels", "data"
// await begin()           -> { engine: Worker, data: object }
//
// The engine is given {type: "load", kernels: ArrayBuffer, data} first; messages that are posted afterwards follow it.
"use strict";

/** The bytes of a part of the page: base64 of gzip, in an element that no browser runs. */
async function unpacked(name) {
  if (typeof DecompressionStream === "undefined")
    throw new Error("This browser is too old for the page: it needs Chromium or Edge 103, Firefox 113, Safari 16.4, or newer.");
  const text = atob(document.getElementById(`part-${name}`).textContent.trim());
  const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

/** The engine in a worker, with its kernels, and the data of the page. */
async function begin() {
  const [script, kernels, packed] = await Promise.all(["engine", "kernels", "data"].map(unpacked));
  const data = JSON.parse(new TextDecoder().decode(packed));
  const place = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
  const engine = new Worker(place);
  URL.revokeObjectURL(place);
  engine.postMessage({ type: "load", kernels, data }, [kernels]);
  return { engine, data };
}
