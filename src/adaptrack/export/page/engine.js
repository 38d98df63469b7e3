// The engine of the page: the closed loops, driven by the kernels. It runs in a worker, or wherever there is a `self`.
//
//   -> {type: "load", kernels, data}             the module's bytes, and what Python wrote (`page_data`)
//                                                <- {type: "loaded"}
//   -> {type: "start", id, setup}                <- {type: "started", id, period, duration, road, cars, plan}
//   -> {type: "advance", id, periods}            <- {type: "frames", id, first, count, cars}
//   -> {type: "change", id, car, what}           <- {type: "changed", id}
//   -> anything that cannot be                   <- {type: "refused", id, message, where}
//
// A frame of a car is a row of numbers (`columns` of "started" name them), the predicted path as x, y in turn, and the
// planned moves. The drive that a new one replaces is forgotten; nothing that was posted is kept.
"use strict";

/** What a user can mend, in words; where: "car", "road", "speed", "profile", "controller 1", ... */
class Refusal extends Error {
  constructor(where, message) {
    super(message);
    this.where = where;
  }
}

const MOST_PERIODS = 2000; // of an answer
let memory = null, written = null, drive = null;

function load({ kernels, data }) {
  const module = kernels instanceof WebAssembly.Module ? kernels : new WebAssembly.Module(kernels);
  memory = new Memory(new WebAssembly.Instance(module).exports, data.layouts, data.calls);
  written = data;
  return [{ type: "loaded" }];
}

// -- a drive ----------------------------------------------------------------------------------------------------------
function start({ id, setup }) {
  end(drive);
  drive = { id, setup, cars: [madeByPython()], done: 0 };
  const { road, outline } = written.first.shown;
  const typed = Object.fromEntries(Object.entries(road).map(([name, value]) =>
    [name, Array.isArray(value) ? Float64Array.from(value) : value]));
  const [car] = drive.cars;
  return [{
    type: "started", id, period: car.run.settings.period, duration: car.span.periods * car.run.settings.period, road: typed,
    cars: [{ name: "informed", columns: written.columns, horizon: car.horizon, moves: car.moves, outline, limits: {} }],
    plan: null,
  }];
}

/** The first drive, until all is made here. */
function madeByPython() {
  const first = written.first.run, measured = share(memory.array("F", first.measured.shape));
  const run = memory.make("rollout.Run", { ...first, measured, mpc: { ...first.mpc, measured } });
  return ready(run, written.first.periods);
}

function ready(run, periods) {
  const settings = run.mpc.settings;
  const horizon = settings.longest_horizon, moves = settings.most_moves;
  memory.call("begin_runs", 1, run);
  const span = memory.row("period.Span", { periods, slots: 1, segment: 0, weight: 0 });
  return { run, span, horizon, moves, shown: null };
}

function end(ended) {
  for (const car of ended?.cars ?? []) [car.run, car.span, ...(car.shown ?? [])].forEach((each) => memory.free(each));
}

/** Room for what so many periods show. */
function room(car, count) {
  if ((car.shown?.[0].shape[0] ?? 0) >= count) return car.shown;
  (car.shown ?? []).forEach((each) => memory.free(each));
  const widths = [written.columns.length, 2 * car.horizon, car.moves];
  return (car.shown = widths.map((width) => memory.array("F", [count, width])));
}

function advance({ id, periods }) {
  if (!drive || drive.id !== id) return [];
  const count = Math.max(0, Math.min(Math.floor(periods) || 0, MOST_PERIODS)), first = drive.done;
  const cars = drive.cars.map((car) => advanceCar(car, count));
  const most = Math.max(...cars.map((car) => car.count));
  drive.done += most;
  return [{ type: "frames", id, first, count: most, cars }];
}

function advanceCar(car, count) {
  const [numbers, predicted, moves] = room(car, count);
  const driven = count ? memory.call("drive_and_show", count, car.span, car.run, numbers, predicted, moves) : 0;
  const cut = (block) => block.values.slice(0, driven * block.shape[1]);
  return {
    count: driven, numbers: cut(numbers), predicted: Float32Array.from(cut(predicted)), moves: Float32Array.from(cut(moves)),
    ended: ending(car),
  };
}

const ENDINGS = ["the end of the road", "it left the road", "it spun", "its state is no number any more",
  "it never came near the road", "it was stopped"];

/** Why and when a car has ended; null while it drives. */
function ending({ run, span }) {
  const own = run.memory.own.row(0);
  if (own.ended === 0 && own.instant < span.periods) return null;
  return { at: own.ended === 0 ? span.periods * run.settings.period : own.ended_at, why: ENDINGS[own.ended], kind: own.ended };
}

// -- messages ---------------------------------------------------------------------------------------------------------
const ANSWERS = { load, start, advance };

function answers(message) {
  const answer = ANSWERS[message.type];
  if (!answer) return [];
  try {
    return answer(message);
  } catch (error) {
    const where = error instanceof Refusal ? error.where : "engine";
    const words = error instanceof Refusal ? error.message : `The engine failed: ${error.message}`;
    return [{ type: "refused", id: message.id, message: words, where }];
  }
}

/** The buffers of a message, which are handed over and not copied. */
function buffersOf(value) {
  if (ArrayBuffer.isView(value)) return [value.buffer];
  return value && typeof value === "object" ? Object.values(value).flatMap(buffersOf) : [];
}

self.onmessage = ({ data }) => {
  for (const message of answers(data)) self.postMessage(message, buffersOf(message));
};
