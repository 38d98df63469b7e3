// From a setup to what the kernels drive: car, world, road, speed, controller. All numbers are made by kernels.
//
//   carOf(setup.car)                            -> { name, numbers, rows, outline, domain }
//   worldOf(setup.profile, setup.truth)         -> { period, settings, actuator, ... }
//   roadOf(setup.road)                          -> { name, closed, length, line, roads } or { test, ... }
//   controllerOf(entry, car, world, where)      -> { kind, mpc | law, tuning, functions, schedule, columns, limits }
//
// What they lay into memory is given back by `forget(owned)`, where `owned` is the list that `owning(list)` has set.
"use strict";

let owned = [];
/** Whatever is made from now on belongs to this list. */
function owning(list) {
  owned = list;
}
function mine(made) {
  owned.push(made);
  return made;
}
function forget(list) {
  list.splice(0).forEach((each) => memory.free(each));
}

/** A number as Python writes it: JSON has no infinity. */
const real = (value) => (typeof value === "string" ? Number(value) : value ?? NaN);

/** A record of numbers, each field that of the same name in one of some tables, NaN (0 where whole) in none of them. */
function copied(name, ...tables) {
  const row = mine(memory.row(name));
  for (const [field, [, kind]] of Object.entries(memory.layouts[name].fields)) {
    if (kind !== "f" && kind !== "i") continue;
    const table = tables.find((each) => each?.[field] !== undefined && each[field] !== null);
    const value = table === undefined ? NaN : real(table[field]);
    row[field] = kind === "i" ? (Number.isNaN(value) ? 0 : Number(value)) : value;
  }
  return row;
}
/** A record of records and numbers, from a table of the same form. */
function filled(row, table) {
  for (const [field, value] of Object.entries(table)) {
    const [, kind] = row.$layout.fields[field];
    if (kind === "r") filled(row[field], value);
    else if (kind === "W") row[field].set(value.map(real));
    else row[field] = kind === "i" ? Number(value) : real(value);
  }
  return row;
}
const vectorOf = (values) => mine(memory.array("F", [values.length], Float64Array.from(values, real)));

// -- car --------------------------------------------------------------------------------------------------------------
function carOf(given) {
  const refuse = (text) => { throw new Refusal("car", text); };
  if (given?.sheet) return carOfSheet(given.sheet, refuse);
  if (given?.file) return carOfNumbers({ ...written.car_defaults, name: "car", ...given.file }, refuse);
  const known = written.cars[given?.name];
  return known ? carOfNumbers(known, refuse) : refuse(`There is no car named “${given?.name}”: choose one of ${Object.keys(written.cars).join(", ")}.`);
}

function carOfSheet(sheet, refuse) {
  const { mass, wheelbase, load = 0, body_style = "car" } = sheet;
  const row = copied("synthesis.car.Car", sheet), within = copied("synthesis.car.KnownWithin");
  const status = memory.call("complete_car", real(wheelbase), real(load), body_style === "truck" ? 1 : 0, row, within);
  if (status) refuse(written.words.sheet[status].replace("{mass}", mass).replace("{wheelbase}", wheelbase).replace("{load}", load));
  const numbers = { ...written.car_defaults, name: "sheet", ...sheet, ...row.$numbers };
  return carOfRows(numbers, row, within, refuse);
}

function carOfNumbers(numbers, refuse) {
  const row = copied("synthesis.car.Car", numbers), said = numbers.known_within;
  const within = copied("synthesis.car.KnownWithin", said ? { ...said, said: 1 } : {});
  const [flaw, ratio] = memory.call("car_flaw", row);
  if (flaw) refuse(written.words.car[flaw].replace("{ratio}", ratio.toPrecision(3)));
  return carOfRows(numbers, row, within, refuse);
}

function carOfRows(numbers, row, within, refuse) {
  const tyre = typeof numbers.tyre === "string" ? written.tyres[numbers.tyre] : numbers.tyre;
  if (!tyre) refuse(`There is no tyre named “${numbers.tyre}”: choose one of ${Object.keys(written.tyres).join(", ")}.`);
  const rows = {
    car: row, within, file: copied("synthesis.car.Steering", numbers.steering), chassis: copied("synthesis.plant.Chassis", numbers),
    tyre: copied("synthesis.plant.Tyre", tyre), body: copied("synthesis.plant.Body", numbers.body),
  };
  const outline = copied("synthesis.plant.Outline");
  const status = memory.call("outline_of", rows.body, rows.chassis, outline);
  if (status) refuse(written.words.outline[status]);
  const { lf, lr, track_front, track_rear } = rows.chassis.$numbers;
  return {
    name: numbers.name, numbers, rows, domain: { ...written.car_defaults.domain, ...numbers.domain },
    outline: { ...outline.$numbers, lf, lr, track_front, track_rear },
  };
}

// -- world ------------------------------------------------------------------------------------------------------------
const STEERING = ["lag", "dead_time", "bias"];

function worldOf(name, truth) {
  const known = written.profiles[name];
  if (!known) throw new Refusal("profile", `There is no profile named “${name}”: choose one of ${Object.keys(written.profiles).join(", ")}.`);
  const { period, delay, remembered, plants } = known;
  const world = {
    name, period, delay, remembered, plants, usual: known.settings, sees_vy: real(known.settings.noise_vy) < Infinity,
    actuator: copied("synthesis.plant.Actuator", known.actuator), usual_actuator: known.actuator,
    settings: Object.fromEntries(Object.entries(known.settings).map(([key, value]) => [key, real(value)])),
  };
  changeTruth(world, truth ?? {});
  return world;
}

/** Take over a changed truth: steering and noise; what is null is as the profile says. */
function changeTruth(world, truth) {
  for (const name of STEERING) {
    if (!(name in truth)) continue;
    world.actuator[name] = checkedTruth(name, truth[name] ?? real(world.usual_actuator[name]));
  }
  if ("noise" in truth) {
    const factor = checkedTruth("noise", truth.noise ?? 1);
    for (const name of Object.keys(world.settings).filter((each) => each.startsWith("noise_"))) {
      const usual = real(world.usual[name]);
      if (usual < Infinity) world.settings[name] = usual * factor;
    }
  }
}

/** A number of the truth within its bounds. */
function checkedTruth(name, value) {
  const [low, high] = written.bounds[name];
  const found = Number(value);
  if (!(found >= low && found <= high)) throw new Refusal("truth", `${name} is ${value}: it must be a number from ${low} to ${high}.`);
  return found;
}

/** The settings of the loop for a car up to a speed (m/s), and the plant's parameters and functions. */
function plantOf(car, world, topSpeed) {
  const { chassis, tyre } = car.rows, { actuator, period } = world;
  const parameters = mine(memory.array("F", [written.sizes.parameters]));
  memory.call("plant_parameters", chassis, tyre, actuator, parameters);
  const substeps = memory.call("plant_substeps", chassis, tyre, 1, period, topSpeed);
  return { parameters, substeps, functions: world.plants[memory.call("plant_law", tyre)] };
}
function settingsOf(car, world, substeps) {
  const { actuator, period, delay } = world, { mass, engine_power, traction_limit, brake_limit } = car.rows.chassis;
  const [dead_whole, dead_share] = memory.call("dead_periods", delay, actuator.dead_time, period);
  return {
    ...world.settings, substeps, dead_whole, dead_share, steering_lag: actuator.lag, steering_limit: actuator.limit,
    steering_bias: actuator.bias, mass, engine_power, traction_limit, brake_limit,
    failure_distance: car.domain.failure_distance,
  };
}

// -- road -------------------------------------------------------------------------------------------------------------
function roadOf(given) {
  if (given?.test !== undefined) return testOf(given.test);
  if (Array.isArray(given?.points)) return roadThrough(given);
  const known = written.roads[given?.name];
  if (!known) throw new Refusal("road", `There is no road named “${given?.name}”: choose one of ${Object.keys(written.roads).join(", ")}.`);
  const arrays = ["numbers", "start", "pieces"].map((name) => mine(memory.array("F", known[name].shape, unpackedNumbers(known[name].f8))));
  const numbers = view(arrays[0], 0, [written.sizes.road_numbers]);
  const headings = mine(memory.array("F", [memory.call("heading_count", numbers)]));
  return road({ ...known, name: given.name }, numbers, arrays[1], arrays[2], headings, true);
}

/** A part of an array as an array of its own. */
const view = (block, first, shape) => new Block(memory, block.at + WORD * first, "F", shape);

function road(said, numbers, start, pieces, headings, fresh) {
  const line = mine(memory.make("road.Centreline", { start: share(start), pieces: share(pieces), numbers: share(view(numbers, 0, [4])) }));
  if (fresh) memory.call("headings_along", line, headings);
  const { name, width_left, width_right, speed_limit, friction } = said;
  return {
    name, line, width_left, width_right, speed_limit, friction, closed: numbers.values[1] > 0.5, length: numbers.values[0],
    roads: {
      of: { shape: [1] }, numbers: share(view(numbers, 0, [1, written.sizes.road_numbers])), start: share(start),
      pieces: share(pieces), headings: share(headings),
    },
  };
}

const MOST_POINTS = 20000, MOST_WORDS = 2e7;
function roadThrough({ points, closed = false, name = "points" }) {
  const refuse = (text) => { throw new Refusal("road", text); };
  if (points.length > MOST_POINTS) refuse(`The road has ${points.length} points: at most ${MOST_POINTS} are taken; leave out some.`);
  const flat = Float64Array.from(points.flatMap((each) => [Number(each?.[0]), Number(each?.[1])]));
  const given = mine(memory.array("F", [points.length, 2], flat));
  let size = memory.call("path_words", given, closed ? 1 : 0);
  for (;;) {
    if (size > MOST_WORDS) refuse("The road is too long: its points may be in millimetres. Give x and y in metres.");
    const path = mine(memory.array("F", [Math.max(size, 1)]));
    const [status, found] = memory.call("path_through", given, closed ? 1 : 0, path);
    if (written.words.path[status] === "again") {
      size *= 2;
      continue;
    }
    if (status) refuse(written.words.path[status].replaceAll("{}", found));
    const [count, piece, start, heading] = memory.call("path_parts", path), numbers = view(path, 0, [written.sizes.road_numbers]);
    if (numbers.values[0] > written.bounds.road_length[1]) refuse(`The road is ${Math.round(numbers.values[0])} m long: at most ${written.bounds.road_length[1]} m are driven.`);
    return road({ ...written.road_defaults, name }, numbers, view(path, start, [count + 1]),
      view(path, piece, [count, written.sizes.piece]), view(path, heading, [memory.call("heading_count", numbers)]), false);
  }
}

function testOf(name) {
  const known = written.tests[name];
  if (!known) throw new Refusal("road", `There is no test named “${name}”: choose one of ${Object.keys(written.tests).join(", ")}.`);
  return { ...known, name, test: true, closed: false };
}

/** Centre line and edges, for drawing. */
function drawn(of) {
  if (of.test) return drawnTest(of);
  const count = Math.max(2, Math.min(Math.ceil(of.length / 2), 20000)) + 1;
  const s = vectorOf(Array.from({ length: count }, (_, k) => (of.length * k) / (count - 1)));
  const sides = [of.width_left, of.width_right].map((width) => vectorOf(new Array(count).fill(width)));
  const points = mine(memory.array("F", [count, 6]));
  memory.call("edges_along", of.line, s, ...sides, points);
  const column = (k) => Float64Array.from({ length: count }, (_, i) => points.values[6 * i + k]);
  const [x, y, left_x, left_y, right_x, right_y] = [0, 1, 2, 3, 4, 5].map(column);
  return { name: of.name, closed: of.closed, length: of.length, s: s.values.slice(), x, y, left_x, left_y, right_x, right_y };
}
function drawnTest(of) {
  const [x, y] = ["x", "y"].map((name) => unpackedNumbers(of[name].f8));
  const beside = (by) => Float64Array.from(y, (each) => each + by);
  return {
    name: of.name, closed: false, length: x.at(-1), s: x.slice(), x, y, left_x: x.slice(), left_y: beside(of.width_left),
    right_x: x.slice(), right_y: beside(-of.width_right),
  };
}

// -- controller -------------------------------------------------------------------------------------------------------
/** A controller of a setup: an MPC or a law, ready to be laid into a run. */
function controllerOf(entry, car, world, where) {
  const known = written.controllers[entry?.kind]?.[world.name];
  if (!known) throw new Refusal(where, `There is no controller of the kind “${entry?.kind}”: choose one of ${Object.keys(written.controllers).join(", ")}.`);
  if (known.refused) throw new Refusal(where, known.refused);
  return known.common ? lawOf(entry, known, car, where) : mpcOf(entry, known, car, where);
}

function checkedTuning(tuning, where) {
  const refuse = (text) => { throw new Refusal(where, text); };
  const { Np, Nc, Q, R } = tuning, { most_Np, most_Nc } = written.sizes;
  if (!(Number.isInteger(Np) && Number.isInteger(Nc) && Nc >= 1 && Nc <= Np && Np <= most_Np && Nc <= most_Nc))
    refuse(`Np = ${Np}, Nc = ${Nc}: both must be whole numbers, 1 ≤ Nc ≤ Np ≤ ${most_Np}, Nc ≤ ${most_Nc}.`);
  if (!(Q >= 0 && Q < Infinity)) refuse(`Q = ${Q}: it must be a number of at least 0.`);
  if (!(R > 0 && R < Infinity)) refuse(`R = ${R}: it must be a number above 0.`);
  return [Np, Nc, Q, R];
}

function checkedBelief(belief, where) {
  for (const name of ["lag", "dead_time"]) {
    const value = belief?.[name];
    if (value !== null && value !== undefined && !(value >= 0 && value <= 1))
      throw new Refusal(where, `The controller is to believe a ${name.replace("_", " ")} of ${value} s: give 0 to 1 s.`);
  }
  return belief;
}

function mpcOf(entry, known, car, where) {
  const believed = checkedBelief(entry.belief, where), wanted = entry.tuning ? checkedTuning(entry.tuning, where) : null;
  const made = known.order ? informedConstants(known, car, believed, where) : publishedConstants(known, car, where);
  const { constants } = made, settings = constants.settings.row(0);
  const tuning = wanted ?? [...constants.tuning.values.slice(0, 4)];
  settings.longest_horizon = Math.max(settings.longest_horizon, tuning[0]);
  settings.most_moves = Math.max(settings.most_moves, tuning[1]);
  return { ...made, kind: entry.kind, known, settings, tuning, learns: settings.learns > 0, schedule: written.schedules[known.schedule] };
}

const FINE = 0;
/** The numbers of an informed MPC of this car with what it believes. */
function informedConstants(known, car, believed, where) {
  const order = filled(mine(memory.row("synthesis.informed.Order")), known.order);
  order.car = car.rows.car;
  order.within = car.rows.within;
  order.file = car.rows.file;
  order.given = copied("synthesis.car.Steering", believed);
  const parts = mine(memory.row("synthesis.informed.Parts"));
  memory.call("usual_filter", new Block(memory, parts.filter.$at, "F", [parts.filter.$layout.words]));
  let status = memory.call("informed_parts", order, parts);
  if (status !== FINE) throw new Refusal(where, written.words.informed[status]);
  const [states, remembers, learned] = memory.call("informed_sizes", order, parts);
  const constants = constantsOf(states, learned);
  filled(constants.settings.row(0), known.settings);
  status = memory.call("informed_constants", order, parts, constants);
  if (status !== FINE) throw new Refusal(where, written.words.informed[status]);
  return { constants, states, remembers, learned, order, parts };
}

function publishedConstants(known, car, where) {
  const constants = constantsOf(written.sizes.published_states, 0, true);
  filled(constants.settings.row(0), known.settings);
  const status = memory.call("published_constants", car.rows.car, known.settings.period ?? known.period, constants);
  if (status !== FINE) throw new Refusal(where, written.words.informed[status]);
  return { constants, states: written.sizes.published_states, remembers: 0, learned: 0 };
}

function constantsOf(states, learned, published = false) {
  const { model, published_model, turning, estimator, learner } = written.sizes;
  return mine(memory.make("synthesis.informed.Constants", {
    settings: { shape: [1] }, tuning: { shape: [4] }, model: { shape: [published ? published_model : model] }, states: { shape: [states] },
    turning: { shape: [published ? 0 : turning] }, estimator: { shape: [published ? 0 : estimator] },
    learner: { shape: [learned ? learner : 0] }, fresh: { shape: [learned] },
  }));
}

function lawOf(entry, known, car, where) {
  if (entry.tuning && "Np" in entry.tuning) throw new Refusal(where, "This controller has no horizons: leave its tuning as it is.");
  const delay = () => memory.call("steering_delay", car.rows.file);
  const tuning = Object.values({ ...known.tuning, ...entry.tuning }).map((each) => (Number.isNaN(real(each)) ? delay() : real(each)));
  const parameters = mine(memory.array("F", [known.size])), common = copied("synthesis.laws.Common", known.common);
  const wanted = memory.calls[known.made_by][0].length === 4 ? [vectorOf(tuning)] : [];
  const fine = memory.call(known.made_by, car.rows.car, common, ...wanted, parameters);
  if (wanted.length && !fine) throw new Refusal(where, "There is no gain for weights so far apart: bring them nearer to one another.");
  return { kind: entry.kind, known, law: true, parameters, tuning, learns: false };
}
