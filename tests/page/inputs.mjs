// Calls functions of inputs.js: node inputs.mjs FILE/inputs.js, a list of {call, args} as JSON on its standard input.
// Answers a list of {value} or {error, name, problems}, each with the ms that it took.
import fs from "node:fs";

const [source] = process.argv.slice(2);
const inputs = new Function(`${fs.readFileSync(source, "utf8")}\nreturn inputs;`)();
const asked = JSON.parse(fs.readFileSync(0, "utf8"));
const told = [];
for (const { call, args, base64 } of asked) {
  const given = base64 !== undefined ? [Buffer.from(base64, "base64").toString("utf8"), ...args] : args;
  const start = performance.now();
  let answer;
  try {
    const value = await inputs[call](...given);
    answer = { value: value && value.points ? { ...value, points: [...value.points] } : value };
  } catch (error) {
    answer = { error: error.message, name: error.name, problems: error.problems ?? null };
  }
  told.push({ ...answer, ms: performance.now() - start });
}
process.stdout.write(JSON.stringify(told));
