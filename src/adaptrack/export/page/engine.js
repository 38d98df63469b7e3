// The engine of the page: the closed loops, driven by the kernels. It runs in a worker, or wherever there is a `self`.
//
//   -> {type: "load", kernels, data}             the module's bytes, and what Python wrote (`page_data`)
//                                                <- {type: "loaded"}
//   -> {type: "start", id, setup}                <- {type: "started", id, period, duration, road, cars}
//   -> {type: "advance", id, periods}            <- {type: "frames", id, first, count, cars}
//   -> {type: "change", id, car, what}           <- {type: "changed", id}
//   -> {type: "read", id, what, text, name}     <- {type: "read", id, what, ...}; what: "car file", "csv": see inputs.js
//   -> {type: "write", id, what: "csv", columns; what: "car", car}               <- {type: "written", id, text}
//   -> {type: "memory", id}                      <- {type: "memory", id, bytes, all}
//   -> anything that cannot be                   <- {type: "refused", id, message, where}
//
// A frame of a car is a row of numbers (`columns` of "started" name them), the predicted path as x, y in turn, and the
// planned moves; behind a planner there are the trajectories that have arrived: {at: frame, time, stamp, points}, rows of
// t, x, y, yaw, speed. A car whose drive has ended gives no more frames and says why. What is changed acts from the next
// instant on; car: 0, 1, or null for all; friction, wind and ice are of the road, thus the same for all. The drive that
// a new one replaces is forgotten; nothing that was posted is kept.
"use strict";

/** What a user can mend, in words; where: "car", "road", "speed", "profile", "truth", "controller 1", ... */
class Refusal extends Error {
  constructor(where, message) {
    super(message);
    this.where = where;
  }
}

const MOST_PERIODS = 2000; // of an answer
const MOST_CARS = 2;
const SHOWN = 100; // periods of which a run keeps what is shown
let memory = null, written = null, drive = null;

function load({ kernels, data }) {
  const module = kernels instanceof WebAssembly.Module ? kernels : new WebAssembly.Module(kernels);
  memory = new Memory(new WebAssembly.Instance(module).exports, data.layouts, data.calls);
  written = data;
  return [{ type: "loaded" }];
}

// -- a drive ----------------------------------------------------------------------------------------------------------
function start({ id, setup }) {
  const newDrive = { setup, owned: [], cars: [], done: 0 };
  try {
    owning(newDrive.owned, () => begin(newDrive, setup));
  } catch (error) { // the drive under way goes on
    end(newDrive);
    throw error;
  }
  end(drive);
  drive = newDrive;
  return [owning(newDrive.owned, () => started(id, newDrive))];
}

function begin(made, setup) {
  const controllers = setup?.controllers;
  if (!Array.isArray(controllers) || controllers.length < 1 || controllers.length > MOST_CARS)
    throw new Refusal("controller 1", "Choose one or two controllers.");
  const seed = Number(setup.seed ?? 0);
  if (!(Number.isSafeInteger(seed) && seed >= 0))
    throw new Refusal("seed", `The seed is ${setup.seed}: it must be a whole number of at least 0.`);
  const world = worldOf(setup.profile, setup.truth), car = carOf(setup.car), of = roadOf(setup.road);
  const samples = samplesOf(setup, of, car, world);
  if (setup.planner && of.test) throw new Refusal("planner", "The paper's tests have no road to plan along: choose a road.");
  Object.assign(made, { world, car, of, samples, seed });
  controllers.forEach((entry, k) => carRun(entry, made, `controller ${k + 1}`));
}

/** A car of its own with its controller, before its first instant. */
function carRun(entry, made, where) {
  const { world, car, samples } = made, actuator = copied("synthesis.plant.Actuator", world.actuator.$numbers);
  const state = {
    entry: { ...entry },
    where,
    world: { ...world, settings: { ...world.settings }, actuator },
    sensors: {},
    made: [],
  };
  made.cars.push(state);
  const requestable = made.setup.planner ? written.tracker.top_speed : 0;
  state.plant = plantOf(car, state.world, Math.max(topSpeedOf(samples), requestable));
  if (entry?.speed_control) state.world.settings.prescribed_speed = written.speed_control.external_forces;
  const controller = owning(state.made, () => controllerOf(entry, car, state.world, where));
  state.speed = entry.speed_control ? speedControlOf(entry, carKnownTo(entry, car), controller, made, where) : null;
  if (made.setup.planner) state.tracker = trackerOf(state, controller, made);
  owning(state.made, () => Object.assign(state, ready(state, controller, made)));
  if (state.tracker) memory.call("tracker_engage", 0, NaN, state.tracker.record.tracker);
  if (state.tracker) memory.call("tracker_apply", state.tracker.record);
  state.horizon = state.run.controller.mpc.settings.longest_horizon;
  state.moves = state.run.controller.mpc.settings.most_moves;
}

/** A run with a controller, before its first instant. */
function ready(own, controller, made) {
  const parts = laid(controller, made.of, own.world.settings.noise_vy < Infinity);
  const answerColumns = parts.said.map((name) => (written.frame.includes(name) ? `answered_${name}` : name));
  const columns = [...written.frame, ...answerColumns, ...(own.speed ? written.speed_frame : [])];
  const run = memory.make("simulation.run.RunRecord", runOf({ ...own, controller, parts, columns }, made));
  if (own.speed && !own.tracker) own.speed.record = run.longitudinal;
  if (!controller.law) memory.call("mpc_prepare", run.controller.mpc);
  memory.call("begin_runs", 1, run);
  if (own.tracker) attachTracker(own, made, controller, run);
  return { controller, parts, run, columns: own.tracker ? [...columns, ...TRACKED_COLUMNS] : columns };
}

function topSpeedOf({ signals }) {
  const [, count] = signals.shape;
  return view(signals, written.places.signal.speed * count, [count]).values.reduce(
    (most, each) => Math.max(most, each),
    0,
  );
}

/** All that a run is made of. */
function runOf({ controller, parts, plant, speed: control, tracker, columns, world }, { car, of, samples, seed }) {
  const { sizes } = written, { signals } = samples, { schedule } = controller;
  const [rows, count] = signals.shape, speed = view(signals, written.places.signal.speed * count, [1]).values[0];
  const first = new Float64Array(sizes.own_states);
  first.set([...samples.pose, speed]);
  const size = (array) => array?.shape[0] ?? 0, roads = of.test ? NO_ROAD : of.roads;
  const chosen = {
    slots: 1,
    plant_parameters: sizes.parameters,
    plant_states: sizes.own_states,
    scenarios: 1,
    samples: count,
    roads: size(roads.numbers),
    starts: size(roads.start), pieces: size(roads.pieces), headings: size(roads.headings),
    dead_whole: memory.call("dead_periods", world.delay, written.bounds.dead_time[1], world.period)[0] + 1,
    past: world.remembered, requested: world.requested,
    speeds: control && !tracker ? written.speed_control.speeds_ahead : 0,
    frames: SHOWN, columns: columns.length,
    points: 2 * parts.settings.longest_horizon, moves: parts.settings.most_moves,
    controller: {
      ...parts.sizes,
      ...(schedule
        ? { integers: size(schedule.integers), numbers: size(schedule.numbers), scratch: size(schedule.scratch) }
        : {}),
    },
  };
  return runOfSizes(parts.settings, chosen, {
    settings: settingsOf(car, world, plant),
    features: {
      late: world.remembered > 0 ? 1 : 0,
      variables: schedule ? 1 : 0,
      estimates: 0,
      traces: 0,
      asks: tracker ? 1 : 0,
      window: 0,
    },
    vehicles: {
      advance: linked(plant.functions.advance),
      observe: linked(plant.functions.observe),
      member: 0,
      parameters: share(plant.parameters),
      start: first,
    },
    inputs: { signals: share(view(signals, 0, [1, rows, count])), roads, seeds: [BigInt(seed)], periods: [BigInt(samples.periods)] },
    cost_limit: [NaN],
    control_speed: linked(control && !tracker ? "control_planned_speed" : null),
    longitudinal: control ? lent(control.record) : {},
    show: linked("show_period"),
    controller: {
      ...parts.values,
      functions: controller.known.functions
        ? {
            discretise: linked(controller.known.functions.discretise),
            estimate: linked(controller.known.functions.estimate),
          }
        : {},
      schedule: schedule ?? written.no_schedule, tuning: controller.tuning, first_tuning: controller.tuning,
    },
  });
}
const linked = (name) => ({ function: name });
const NO_ROAD = { of: [-1n] };

function end(ended) {
  for (const car of ended?.cars ?? []) {
    memory.free(car.run);
    forget(car.tracker?.followed ?? []);
    forget(car.made);
  }
  if (ended) forget(ended.owned);
}

function started(id, { world, of, samples, cars, car }) {
  return {
    type: "started", id, period: world.period, duration: samples.duration, road: drawn(of),
    cars: cars.map((entry) => ({
      name: entry.entry.kind,
      columns: entry.columns,
      horizon: entry.horizon,
      moves: entry.moves,
      outline: car.outline,
      limits: limitsOf(entry),
      belief: beliefOf(entry),
    })),
  };
}

/** What bounds a controller, to either side: changes of its command in a period and the command (rad). */
function limitsOf(own) {
  const { known, law } = own.controller, from = law ? known.common : own.run.controller.mpc.settings;
  return { move: real(from.move_max), angle: real(from.angle_max) };
}
const namedTuning = (car) =>
  Object.fromEntries(car.controller.known.tuning_names.map((name, k) => [name, car.controller.tuning[k]]));
/** What a controller believes of the steering at first: lag, dead time (s); null where it does not say. */
function beliefOf({ controller }) {
  if (!controller.parts) return null;
  const { lag, dead_time } = controller.parts.belief.steering;
  return { lag, dead_time };
}

// -- frames -----------------------------------------------------------------------------------------------------------
function advance({ id, periods }) {
  const count = Math.max(0, Math.min(Math.floor(Number(periods)) || 0, MOST_PERIODS)), first = current().done;
  const cars = drive.cars.map((car) => advanceCar(car, count));
  const most = Math.max(...cars.map((advanced) => advanced.count));
  drive.done += most;
  return [{ type: "frames", id, first, count: most, cars }];
}

function current() {
  if (!drive) throw new Refusal("drive", "Nothing is being driven: set up a drive first.");
  return drive;
}

function advanceCar(own, count) {
  const widths = { numbers: own.columns.length, predicted: 2 * own.horizon, moves: own.moves }, rows = {};
  for (const [table, width] of Object.entries(widths)) rows[table] = new Float64Array(count * width);
  let periods = 0;
  while (periods < count) {
    const first = own.run.memory.drives.row(0).instant, chunk = own.tracker ? 1 : Math.min(count - periods, pulledFor(own), SHOWN);
    const advanced = own.tracker ? stepBehindPlanner(own) : memory.call("roll_on", chunk, 1, own.run);
    for (const [table, width] of Object.entries(widths)) {
      const { values, shape } = own.run.frames[table], [, shown] = shape;
      for (let k = 0; k < advanced; k++) {
        const from = ((first + k) % SHOWN) * shown;
        rows[table].set(values.subarray(from, from + shown), (periods + k) * width);
      }
    }
    if (own.tracker && advanced) showTracked(own, rows, periods);
    periods += advanced;
    afterPull(own, advanced);
    if (advanced < chunk) break;
  }
  const cut = (table) => rows[table].slice(0, periods * widths[table]);
  return {
    count: periods,
    numbers: cut("numbers"),
    predicted: new Float32Array(cut("predicted")),
    moves: new Float32Array(cut("moves")),
    ...(own.tracker ? { trajectories: own.tracker.trajectories.splice(0) } : {}),
    ended: ending(own),
  };
}

const ENDINGS = [null, "it left the road", "it spun", "its motion is no number any more", "it never came near the road",
  "it was stopped"];

/** When a car has ended, and why: null at the end of its road; null while it drives. */
function ending({ run }) {
  const record = run.memory.drives.row(0), periods = Number(run.inputs.periods.values[0]);
  if (record.ended === 0 && record.instant < periods) return null;
  return {
    at: record.ended === 0 ? periods * run.settings.period : record.ended_at,
    why: ENDINGS[record.ended],
    kind: record.ended,
  };
}

// -- touching ---------------------------------------------------------------------------------------------------------
function change({ id, car, what }) {
  const touched = current().cars.filter((_, k) => car === null || car === undefined || car === k);
  if (!touched.length) throw new Refusal("drive", `There is no car ${car}.`);
  for (const [name, value] of Object.entries(what ?? {})) {
    const touch = TOUCHES[name];
    if (!touch) throw new Refusal("drive", `Nothing is known of a change of “${name}”.`);
    touch(touched, value);
  }
  return [{ type: "changed", id }];
}

const TOUCHES = { tuning, belief, truth, push, pull, ice, sensors, speed_control: assumeFriction, planner: changePlanner };

/** Other settings of the planner, from its next trajectory on. */
function changePlanner(cars, given) {
  for (const { tracker, where } of cars) {
    if (!tracker) throw new Refusal(where, "This car follows no planner.");
    tracker.planner.settings = checkedPlanner({ ...tracker.planner.settings, ...given });
  }
}

function tuning(cars, given) {
  for (const car of cars) {
    const { controller, where } = car;
    if (controller.schedule)
      throw new Refusal(where, "Its schedule chooses the tuning of this controller at every instant.");
    if (controller.law) throw new Refusal(where, "This controller has no horizons and weights.");
    const [Np, Nc, Q, R] = checkedTuning({ ...namedTuning(car), ...given }, where);
    if (Np > car.horizon || Nc > car.moves)
      throw new Refusal(where, `Np = ${Np}, Nc = ${Nc}: there is room for ${car.horizon} and ${car.moves}.`);
    controller.tuning = [Np, Nc, Q, R];
    car.run.controller.tuning.values.set(controller.tuning);
  }
}

/** Another friction that the speed control assumes. */
function assumeFriction(cars, given) {
  for (const { speed, where } of cars) {
    if (!speed) throw new Refusal(where, "The speed of this car is kept exactly: no speed control assumes a friction.");
    const [low, high] = speed.ends(given.friction), [friction, friction_high] = speed.grip(given.friction);
    speed.record.settings.$set({ friction, friction_high, straight_ratio: low / friction });
    speed.record.friction.$set({ low, high });
    memory.call("begin_friction", speed.record.friction);
    speed.record.memory.row(0).friction = 0; // that of the settings, from the next instant on
  }
}

/** Another belief: the controller is made anew, but for its command, its plan and its tuning. */
function belief(cars, given) {
  for (const car of cars) {
    const { controller, where, entry } = car, made = [];
    if (!controller.parts) throw new Refusal(where, "This controller believes nothing of the steering.");
    const believed = { ...entry.belief, ...given };
    owning(made, () => {
      const other = controllerOf({ ...entry, belief: believed, tuning: null }, drive.car, car.world, where);
      other.settings.$set({ longest_horizon: car.horizon, most_moves: car.moves });
      exchange(car, { ...other, tuning: controller.tuning });
    });
    forget(car.made);
    car.made = made;
    entry.belief = believed;
  }
}

/** Put another controller into a run that goes on. */
function exchange(own, controller) {
  const old = own.run, kept = old.controller.mpc.memory.row(0).$numbers;
  const other = ready(own, controller, drive), { run } = other;
  for (const name of ["vehicles", "memory", "inputs"]) keepArrays(run[name], old[name]);
  keepArrays(run.controller.schedule, old.controller.schedule);
  run.settings.$copy(old.settings);
  run.result.row(0).$copy(old.result.row(0));
  const { command, reference, planned, age } = kept;
  const { mpc } = run.controller, { plan } = mpc;
  mpc.memory.row(0).$set({ command, reference, planned, age });
  plan.values.set(old.controller.mpc.plan.values.subarray(0, plan.values.length));
  memory.free(old);
  Object.assign(own, other);
}
/** Take over the contents of the arrays of a record that were laid alike. */
function keepArrays(record, other) {
  for (const [field, [, kind]] of Object.entries(record.$layout.fields)) {
    if (!"FIR".includes(kind) || record[field].at === other[field].at) continue;
    const from = other[field], to = record[field];
    memory.whole.copyWithin(to.at / WORD, from.at / WORD, from.at / WORD + Math.min(from.words, to.words));
  }
}

/** The world as it truly is. */
function truth(cars, given) {
  for (const car of cars) {
    const before = car.run.settings.steering_lag;
    changeTruth(car.world, given);
    applyTruth(car, before);
    if (!(car.run.memory.drives.row(0).instant > 0)) memory.call("begin_runs", 1, car.run);  // its steady turn is another
  }
  if ("friction" in given) everywhere(FRICTION, given.friction, "friction");
  if ("wind" in given) everywhere(WIND, given.wind, "wind");
  if ("slope" in given) climb(given);
  layIce();
}
/** Another slope of the road, which speed controls know. */
function climb(given) {
  const slope = slopeOf(given);
  if (drive.of.test) throw new Refusal("truth", "The paper's tests are level: a slope needs a road.");
  everywhere(["grade"], slope, "slope");
  for (const { speed } of drive.cars) speed?.climb(slope);
}
function applyTruth(own, lagBefore) {
  const { run, plant } = own;
  writePlant(plant, drive.car, own.world);
  const settings = settingsOf(drive.car, own.world, plant);
  for (const name of Object.keys(own.sensors)) settings[`noise_${name}`] = Infinity;
  if (own.pull) settings.steering_bias += own.pull.angle;
  const angle = wheelAngle(own);
  run.settings.$set(settings);
  run.controller.law.has_vy = settings.noise_vy < Infinity ? 1 : 0;
  if (!(lagBefore > 0) && settings.steering_lag > 0) setState(own, "steering", angle);
}

/** A row of the samples, and what was planned for it. */
function sampled(row) {
  const { signals } = drive.samples, [, count] = signals.shape;
  const { values } = view(signals, written.places.signal[row] * count, [count]);
  drive.planned ??= {};
  drive.planned[row] ??= values.slice();
  return values;
}

/** Another value of samples, for all cars: as they were planned where null is given. */
function everywhere(rows, value, name) {
  const target = value === null ? null : checked("truth", name, value);
  for (const row of rows) {
    const values = sampled(row);
    if (target === null) values.set(drive.planned[row]);
    else values.fill(target);
  }
}
const FRICTION = [...WHEELS, "known_friction"], WIND = ["wind_y", "known_wind"];

const inBlock = (row) => row * written.places.slots;
const setState = (car, name, value) => (car.run.vehicles.block.values[inBlock(written.places.state[name])] = value);
const stateOf = (car, name) => car.run.vehicles.block.values[inBlock(written.places.state[name])];
/** Where the wheels of a car without lag are: at the command that acts. */
const wheelAngle = (car) =>
  car.run.vehicles.block.values[inBlock(written.places.states + written.places.input.command)];

function push(cars, { vy = 0, yaw_rate = 0 }) {
  const pushed = { vy: checked("push", "vy", vy), yaw_rate: checked("push", "yaw_rate", yaw_rate) };
  for (const car of cars)
    for (const [name, by] of Object.entries(pushed)) setState(car, name, stateOf(car, name) + by);
}

function pull(cars, { angle, duration }) {
  const pulled = { angle: checked("pull", "angle", angle), duration: checked("pull", "duration", duration) };
  for (const car of cars) {
    car.pull = { angle: pulled.angle, left: Math.round(pulled.duration / car.world.period) };
    applyTruth(car, car.run.settings.steering_lag);
  }
}
/** Periods until the wheel is let go. */
const pulledFor = (car) => (car.pull ? Math.max(car.pull.left, 1) : Infinity);
function afterPull(own, driven) {
  if (!own.pull) return;
  own.pull.left -= driven;
  if (own.pull.left > 0) return;
  own.pull = null;
  applyTruth(own, own.run.settings.steering_lag);
}

/** A patch of ice between two stations (m) of the road, on every lap from the first one that comes there. */
function ice(cars, { from, to, friction }) {
  if (drive.of.test) throw new Refusal("ice", "The paper's tests have no stations: lay ice on a road.");
  const { length } = drive.of, slippery = checked("ice", "friction", friction);
  const { closed } = drive.of;  // there stations go on over all laps
  if (!(from >= 0 && to > from && (closed ? to - from <= length : to <= length))) {
    const on = `it must lie on the road, ${closed ? "less than a lap long" : `0 to ${length.toFixed(1)} m`}`;
    throw new Refusal("ice", `The ice lies from ${from} to ${to} m: ${on}.`);
  }
  (drive.ice ??= []).push({ from, to, friction: slippery });
  layIce();
}

/** Lay all patches on what the friction is else. */
function layIce() {
  if (!drive.ice) return;
  const { length, closed } = drive.of, station = sampled("station"), rows = FRICTION.map(sampled);
  station.forEach((s, k) => {
    for (const { from, to, friction } of drive.ice) {
      const place = closed ? (s - from) % length : s - from;
      if (place >= 0 && place <= to - from) for (const row of rows) row[k] = friction;
    }
  });
}

const SENSORS = ["vy", "yaw", "yaw_rate", "y", "wheel_angle", "lateral_acceleration"];
function sensors(cars, given) {
  for (const name of Object.keys(given))
    if (!SENSORS.includes(name)) throw new Refusal("sensors", `There is no sensor “${name}”.`);
  for (const car of cars) {
    for (const [name, on] of Object.entries(given)) {
      if (on) delete car.sensors[name];
      else car.sensors[name] = "off";
    }
    applyTruth(car, car.run.settings.steering_lag);
  }
}

// -- reading and writing ----------------------------------------------------------------------------------------------
const READERS = {
  "car file": ({ text }) => ({ car: readBy("car", () => inputs.readCarFile(text, written.inputs)) }),
  csv: ({ text, name, closed }) => {
    const { points, ...road } = readBy("road", () => inputs.readPoints(text, written.inputs, { name, closed }));
    return { ...road, points: Array.from({ length: points.length / 2 }, (_, k) => [points[2 * k], points[2 * k + 1]]) };
  },
};
function read(message) {
  const reader = READERS[message.what];
  if (!reader) throw new Refusal("read", `Nothing is known of reading “${message.what}”.`);
  return [{ type: "read", id: message.id, what: message.what, ...reader(message) }];
}
/** Text of a file: a drive, whose columns are those of its frames, one behind the other; a car. */
const WRITERS = {
  csv: ({ columns }) => {
    const count = Math.max(0, ...Object.values(columns).map((column) => column.length));
    return inputs.writeDrive({ cars: [{ columns, count }] }, 0, written.inputs);
  },
  car: ({ car }) => savedCar(car),
};
function write(message) {
  return [{ type: "written", id: message.id, what: message.what, text: WRITERS[message.what](message) }];
}

// -- messages ---------------------------------------------------------------------------------------------------------
/** Bytes of the kernels' memory that are in use, and of all of it. */
const used = ({ id }) => [{ type: "memory", id, bytes: memory.used, all: memory.exports.memory.buffer.byteLength }];

const ANSWERS = { load, start, advance, change, read, write, memory: used };

function answers(message) {
  const answer = ANSWERS[message?.type];
  if (!answer)
    return [
      {
        type: "refused",
        id: message?.id,
        message: `Nothing is known of a message “${message?.type}”.`,
        where: "engine",
      },
    ];
  try {
    return answer(message);
  } catch (error) {
    const isRefusal = error instanceof Refusal;
    return [
      {
        type: "refused",
        id: message.id,
        message: isRefusal ? error.message : `The engine failed: ${error.message}`,
        where: isRefusal ? error.where : "engine",
      },
    ];
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
