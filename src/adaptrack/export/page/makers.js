// From a setup to what the kernels drive: car, world, road, speed, controller. All numbers are made by kernels.
//
//   carOf(setup.car)                            -> { name, numbers, rows, outline, domain }
//   worldOf(setup.profile, setup.truth)         -> { period, settings, actuator, ... }
//   roadOf(setup.road)                          -> { name, closed, length, line, roads } or { test, ... }
//   samplesOf(setup, road, car, world)          -> { signals, periods, plan, pose, duration }
//   controllerOf(entry, car, world, where)      -> { kind, mpc | law, tuning, functions, schedule, columns, limits }
//   speedControlOf(entry, car, controller, { world, of, samples, setup }, where)      -> { record, ends, grip, climb }
//
// What they lay into memory is given back by `forget(list)`, where `owning(list, make)` has called them.
"use strict";

let owned = [];
/** Whatever a function makes belongs to a list; where it fails, nothing stays. */
function owning(list, make) {
  const before = owned;
  owned = list;
  try {
    return make();
  } catch (error) {
    forget(list);
    throw error;
  } finally {
    owned = before;
  }
}
function mine(made) {
  owned.push(made);
  return made;
}
function forget(list) {
  list.splice(0).forEach((part) => memory.free(part));
}

/** The entry of a table that has this name, or a refusal with the names that there are. */
function named(table, name, kind, where = kind.split(" ")[0]) {
  if (table[name]) return table[name];
  throw new Refusal(where, `There is no ${kind} “${name}”: choose one of ${Object.keys(table).join(", ")}.`);
}

/** A number as Python writes it: JSON has no infinity. */
const real = (value) => (typeof value === "string" ? Number(value) : value ?? NaN);

/** A record of numbers, each field that of the same name in one of some tables, NaN (0 where whole) in none of them. */
function copied(name, ...tables) {
  const row = mine(memory.row(name));
  for (const [field, [, kind]] of Object.entries(memory.layouts[name].fields)) {
    if (kind !== "f" && kind !== "i") continue;
    const table = tables.find((row) => row?.[field] !== undefined && row[field] !== null);
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
const NO_CAR = "The numbers of the car do not belong together: write its file again with adaptrack car.";

/** A car of ours by its name, a sheet as it is typed, or a file as `inputs.readCarFile` gives it. */
function carOf(given) {
  if (given?.sheet) return carOfSheet(given.sheet);
  if (given?.file) return carOfFile(readBy("car", () => inputs.checkedCar(given.file, written.inputs)));
  return carOfFile(named(written.cars, given?.name, "car named"));
}

/** What throws InputErrors, as a refusal. */
function readBy(where, read) {
  try {
    return read();
  } catch (error) {
    if (error instanceof inputs.InputError) throw new Refusal(where, error.message);
    throw error;
  }
}
const refuseFlaw = (where, flaw) => {
  if (flaw) throw new Refusal(where, flaw);
};

/** The text of a car's file. */
function savedCar({ name, file, sheet }) {
  const rows = [], car = file ?? written.cars[name] ?? owning(rows, () => completed(sheet)[0]);
  forget(rows);
  return JSON.stringify({ page_car: car }, null, 1);
}

const carOfSheet = (typed) => carOfRows(...completed(typed));

/** The car of a sheet, and the row of how well its numbers are known. */
function completed(typed) {
  const sheet = readBy("car", () => inputs.readSheet(typed, written.inputs));
  const row = copied("models.car.CarRow", { ...sheet.known, mass: sheet.mass }),
    within = copied("synthesis.car.KnownWithinRow");
  const status = memory.call("complete_car", sheet.wheelbase, sheet.load, sheet.truck, row, within);
  refuseFlaw("car", inputs.sheetFlaw(status, sheet, written.inputs));
  return [inputs.carOfSheet(sheet, row.$numbers, within.$numbers, written.inputs), within];
}

/** What a controller knows of a car: all of it, or, where it knows the sheet, its mass and wheelbase. */
function carKnownTo(entry, car) {
  if (entry?.knows !== "sheet") return car;
  const { mass, lf, lr } = car.rows.car;
  return carOfSheet({ mass, wheelbase: lf + lr });
}

function carOfFile(car) {
  const tolerances = car.known_within;
  return carOfRows(car, copied("synthesis.car.KnownWithinRow", tolerances ? { ...tolerances, is_given: 1 } : {}));
}

function carOfRows(car, within) {
  const row = copied("models.car.CarRow", car.numbers);
  if (memory.call("car_flaw", row)[0] !== written.inputs.answers.car_flaw.OK) throw new Refusal("car", NO_CAR);
  const rows = {
    car: row,
    within,
    file: copied("models.car.SteeringRow", car.steering),
    tyre: copied("synthesis.plant.TyreRow", car.tyre.numbers), body: copied("synthesis.plant.BodyRow", car.body),
  };
  const outline = copied("synthesis.plant.OutlineRow"), { lf, lr, track_front, track_rear } = row.$numbers;
  if (memory.call("overhangs", rows.body, lf + lr)[0] !== written.inputs.answers.overhangs.OK)
    throw new Refusal("car", NO_CAR);
  memory.call("outline_of", rows.body, row, outline);
  const plain = mine(memory.array("F", [written.sizes.parameters]));
  memory.call("plant_parameters", row, rows.tyre, copied("synthesis.plant.Actuator", written.ideal), plain);
  return {
    name: car.name,
    rows,
    plain,
    domain: car.domain,
    assumesDrive: car.estimated?.includes("drive_front") ?? false,
    outline: { ...outline.$numbers, lf, lr, track_front, track_rear },
  };
}

// -- world ------------------------------------------------------------------------------------------------------------
const STEERING = ["lag", "dead_time", "bias"];

function worldOf(name, truth) {
  const profile = named(written.profiles, name, "profile named");
  const { period, delay, remembered, plants, requested, speed_requests } = profile;
  const world = {
    name, period, delay, remembered, plants, requested, speed_requests, usual: profile.settings,
    actuator: copied("synthesis.plant.Actuator", profile.actuator), usual_actuator: profile.actuator,
    mass: 1,
    settings: Object.fromEntries(Object.entries(profile.settings).map(([key, value]) => [key, real(value)])),
  };
  changeTruth(world, truth ?? {});
  return world;
}

/** Take over a changed truth: steering and noise; what is null is as the profile says. */
function changeTruth(world, truth) {
  for (const name of STEERING) {
    if (!(name in truth)) continue;
    const fallback = real(world.usual_actuator[name]);
    world.actuator[name] = truth[name] == null ? fallback : checked("truth", name, truth[name]);
  }
  if ("brake_lag" in truth)
    world.settings.brake_lag = truth.brake_lag == null ? real(world.usual.brake_lag) : checked("truth", "brake_lag", truth.brake_lag);
  if ("mass" in truth) world.mass = truth.mass == null ? 1 : checked("truth", "mass", truth.mass);
  if ("noise" in truth) {
    const factor = truth.noise == null ? 1 : checked("truth", "noise", truth.noise);
    for (const name of Object.keys(world.settings).filter((setting) => setting.startsWith("noise_"))) {
      const fallback = real(world.usual[name]);
      if (fallback < Infinity) world.settings[name] = fallback * factor;
    }
  }
}

/** The plant of a car up to a speed (m/s), as it truly is: car, parameters, steps and functions. */
function plantOf(car, world, topSpeed) {
  const plant = {
    topSpeed, car: copied("models.car.CarRow", car.rows.car.$numbers),
    parameters: mine(memory.array("F", [written.sizes.parameters])), functions: world.plants[memory.call("plant_law", car.rows.tyre)],
  };
  writePlant(plant, car, world);
  return plant;
}
function writePlant(plant, car, world) {
  const { tyre } = car.rows;
  plant.car.mass = car.rows.car.mass * world.mass;
  memory.call("plant_parameters", plant.car, tyre, world.actuator, plant.parameters);
  plant.substeps = memory.call("plant_substeps", plant.car, tyre, 1, world.period, plant.topSpeed);
}
function settingsOf(car, world, plant) {
  const { actuator, period, delay } = world, { mass, engine_power, traction_limit, brake_limit, lf, lr } = plant.car;
  const [dead_whole, dead_share] = memory.call("dead_periods", delay, actuator.dead_time, period);
  return {
    ...world.settings, substeps: plant.substeps, dead_whole, dead_share, steering_lag: actuator.lag,
    steering_limit: actuator.limit, steering_bias: actuator.bias, mass, engine_power, traction_limit, brake_limit,
    failure_distance: car.domain.failure_distance, lf, lr,
    understeer_gradient: memory.call("understeer_gradient", plant.car),
    rear_slip_gradient: memory.call("rear_slip_gradient", plant.car),
  };
}

// -- road -------------------------------------------------------------------------------------------------------------
function roadOf(given) {
  if (given?.test !== undefined) return testOf(given.test);
  if (Array.isArray(given?.points)) return roadThrough(given);
  const builtIn = named(written.roads, given?.name, "road named");
  const arrays = ["numbers", "start", "pieces"].map((name) =>
    mine(memory.array("F", builtIn[name].shape, unpackedNumbers(builtIn[name].f8))),
  );
  const numbers = view(arrays[0], 0, [written.sizes.road_numbers]);
  const headings = mine(memory.array("F", [memory.call("heading_count", numbers)]));
  return road({ ...builtIn, name: given.name }, numbers, arrays[1], arrays[2], headings, true);
}

/** A part of an array as an array of its own. */
const view = (block, first, shape) => new Block(memory, block.at + WORD * first, "F", shape);

function road(said, numbers, start, pieces, headings, fresh) {
  const line = mine(
    memory.make("roads.road.Centreline", {
      start: share(start),
      pieces: share(pieces),
      numbers: share(view(numbers, 0, [4])),
    }),
  );
  if (fresh) memory.call("headings_along", line, headings);
  const { name, width_left, width_right, speed_limit, friction } = said;
  return {
    name,
    line,
    width_left,
    width_right,
    speed_limit,
    friction,
    closed: numbers.values[1] > 0.5,
    length: numbers.values[0],
    roads: {
      numbers: share(view(numbers, 0, [1, written.sizes.road_numbers])), start: share(start),
      pieces: share(pieces), headings: share(headings),
    },
  };
}

const MOST_WORDS = 2e7;
function roadThrough({ points, closed = false, name = "points" }) {
  const refuse = (text) => { throw new Refusal("road", text); };
  const { most } = written.inputs.points;
  if (points.length > most) refuse(`The road has ${points.length} points: at most ${most} are taken; leave out some.`);
  const flat = Float64Array.from(points.flatMap((point) => [Number(point?.[0]), Number(point?.[1])]));
  const array = mine(memory.array("F", [points.length, 2], flat));
  let size = memory.call("path_words", array, closed ? 1 : 0);
  for (;;) {
    if (size > MOST_WORDS) refuse("The road is too long: its points may be in millimetres. Give x and y in metres.");
    const path = mine(memory.array("F", [Math.max(size, 1)]));
    const [status, found] = memory.call("path_through", array, closed ? 1 : 0, NaN, path);
    if (status === written.inputs.answers.path_through.TOO_SMALL) {
      size *= 2;
      continue;
    }
    refuseFlaw("road", inputs.roadFlaw(status, found, { count: points.length }, written.inputs));
    const [count, piece, start, heading] = memory.call("path_parts", path),
      numbers = view(path, 0, [written.sizes.road_numbers]);
    if (numbers.values[0] > written.bounds.road_length[1])
      refuse(
        `The road is ${Math.round(numbers.values[0])} m long: at most ${written.bounds.road_length[1]} m are driven.`,
      );
    return road({ ...written.road_defaults, name }, numbers, view(path, start, [count + 1]),
      view(path, piece, [count, written.sizes.piece]),
      view(path, heading, [memory.call("heading_count", numbers)]), false);
  }
}

function testOf(name) {
  return { ...named(written.tests, name, "test named", "road"), name, test: true, closed: false };
}

/** Centre line and edges, for drawing. */
function drawn(of) {
  if (of.test) return drawnTest(of);
  const count = Math.max(2, Math.min(Math.ceil(of.length / 2), 20000)) + 1;
  const s = vectorOf(Array.from({ length: count }, (_, k) => (of.length * k) / (count - 1)));
  const points = mine(memory.array("F", [count, 4])), edges = mine(memory.array("F", [count, 4]));
  memory.call("points_at", of.line, s, points);
  memory.call("road_edges", of.line, constantAlong(of.width_left), constantAlong(of.width_right), s, edges);
  const column = (block, k) => Float64Array.from({ length: count }, (_, i) => block.values[4 * i + k]);
  const [x, y] = [0, 1].map((k) => column(points, k));
  const [left_x, left_y, right_x, right_y] = [0, 1, 2, 3].map((k) => column(edges, k));
  return {
    name: of.name,
    closed: of.closed,
    length: of.length,
    s: s.values.slice(),
    x,
    y,
    left_x,
    left_y,
    right_x,
    right_y,
  };
}
function drawnTest(of) {
  const [x, y] = ["x", "y"].map((name) => unpackedNumbers(of[name].f8));
  const shifted = (by) => Float64Array.from(y, (value) => value + by);
  return {
    name: of.name,
    closed: false,
    length: x.at(-1),
    s: x.slice(),
    x,
    y,
    left_x: x.slice(),
    left_y: shifted(of.width_left),
    right_x: x.slice(), right_y: shifted(-of.width_right),
  };
}

// -- speed and samples ------------------------------------------------------------------------------------------------
/** A quantity of one value all along a road; Infinity: none is given. */
const alongOf = (value) =>
  value < Infinity
    ? { s: { shape: [1] }, value: { shape: [1], values: [value] } }
    : { s: { shape: [0] }, value: { shape: [0] } };
const constantAlong = (value) => mine(memory.make("planning.station_table.AlongRecord", alongOf(value)));

const AN_HOUR = 3600, MOST_SAMPLES = 200000;
const OK = 0;

/** How fast a road is driven: { table, plan (for RoadDrive), duration }. */
function planOf(speed, of, car, world) {
  const line = of.line,
    numbers = { start: share(line.start), pieces: share(line.pieces), numbers: share(line.numbers) };
  const route = {
    line: numbers,
    friction: alongOf(of.friction),
    bank: alongOf(0),
    speed_limit: alongOf(of.speed_limit),
    grade: alongOf(0),
  };
  const spacing = real(written.comfort.spacing), none = vectorOf([]);
  const places = memory.call("plan_places", line.start, spacing, none, none);
  if (!places) throw new Refusal("speed", "No speed can be planned on this road: its length is no number.");
  const table = mine(memory.array("F", [written.sizes.plan, places]));
  const planning = mine(memory.make("planning.speed.Planning", { route, car: share(car.plain), table: share(table) }));
  filled(planning.bounds, {
    ...written.comfort,
    domain_speed: car.domain.speed[1],
    steering_limit: car.rows.file.limit,
  });
  const duration =
    speed?.constant !== undefined ? constantPlan(speed.constant, planning) : lateralPlan(speed?.lateral, planning);
  if (!(duration > 0 && duration < Infinity))
    throw new Refusal("speed", "The plan never arrives: somewhere its speed is 0.");
  const row = (name) => view(table, written.places.plan[name] * places, [places]);
  return { route, places, table, s: row("s"), speed: row("speed"), time: row("time"), duration };
}

function constantPlan(speed, planning) {
  return memory.call("plan_constant", checked("speed", "constant", speed), planning);
}
function lateralPlan(lateral, planning) {
  planning.bounds.lateral = checked("speed", "lateral", lateral);
  const [status, place, value, duration] = memory.call("plan_along_road", planning);
  if (status === OK) return duration;
  const s = planning.table.values[written.places.plan.s * planning.table.shape[1] + place];
  throw new Refusal(
    "speed",
    written.words.plan[status].replace("{s}", s.toFixed(1)).replace("{value}", value.toPrecision(3)),
  );
}

/** A number within its bounds. */
function checked(where, name, value) {
  const [low, high] = written.bounds[name], found = value === null ? NaN : Number(value);
  if (found >= low && found <= high) return found;
  throw new Refusal(where, `${written.words.named[name]} is ${value}: it must be a number from ${low} to ${high}.`);
}

/** What happens at the instants: { signals, periods, plan, pose, duration }. */
function samplesOf(setup, of, car, world) {
  if (of.test) return samplesOfTest(of, world, setup.truth ?? {});
  const { period } = world, truth = setup.truth ?? {}, plan = planOf(setup.speed, of, car, world);
  const laps = of.closed ? Math.max(1, Math.floor(AN_HOUR / plan.duration)) : 1;
  const periods = memory.call("drive_periods", plan.duration, laps, period);
  if (!(periods >= 1 && periods < MOST_SAMPLES))
    throw new Refusal(
      "speed",
      `The drive lasts ${(plan.duration * laps).toPrecision(3)} s, ${periods} control periods; 1 to ${MOST_SAMPLES} ` +
        "are possible: drive faster, or take another road.",
    );
  const route = {
    ...plan.route,
    friction: alongOf(truth.friction == null ? of.friction : checked("truth", "friction", truth.friction)),
    grade: alongOf(slopeOf(truth)),
  };
  const wind = truth.wind == null ? 0 : checked("truth", "wind", truth.wind);
  const drive = mine(memory.make("planning.drive.RoadDriveRecord", {
    route,
    period,
    plan: {
      s: share(plan.s),
      speed: share(plan.speed),
      time: share(plan.time),
      duration: plan.duration,
      closed: of.closed ? 1 : 0,
    },
    reference: share(vectorOf([0])), wind_x: share(vectorOf([0])), wind_y: share(vectorOf([wind])),
  }));
  const signals = mine(memory.array("F", [written.sizes.signals, periods + 1])), pose = mine(memory.array("F", [3]));
  memory.call("drive_samples", drive, signals);
  memory.call("drive_start", of.line, 0, 0, pose);
  return { signals, periods, plan, pose: [...pose.values], duration: periods * period };
}

const slopeOf = ({ slope }) => (slope == null ? 0 : checked("truth", "slope", slope));

/** The samples of a test: what is known of it, completed by the kernel. */
function samplesOfTest(of, world, truth) {
  if (slopeOf(truth) !== 0) throw new Refusal("truth", "The paper's tests are level: a slope needs a road.");
  const every = Math.round(world.period / of.period),
    periods = Math.floor((of.samples - 1) / every),
    count = periods + 1;
  const signals = mine(memory.array("F", [written.sizes.signals, count])), { signal } = written.places;
  const put = (name, from, fixed) => {
    const values = fixed == null ? unpackedNumbers(of[from].f8) : null,
      target = view(signals, signal[name] * count, [count]).values;
    for (let k = 0; k < count; k++) target[k] = values ? values[every * k] : fixed;
  };
  put("y_ref", "y_ref");
  put("speed", "speed");
  for (const wheel of WHEELS)
    put(wheel, "friction", truth.friction == null ? null : checked("truth", "friction", truth.friction));
  put("wind_y", "wind", truth.wind == null ? null : checked("truth", "wind", truth.wind));
  memory.call("complete_samples", world.period, signals);
  return { signals, periods, plan: null, pose: of.start, duration: periods * world.period };
}
const WHEELS = ["friction_front_left", "friction_front_right", "friction_rear_left", "friction_rear_right"];

// -- controller -------------------------------------------------------------------------------------------------------
/** A controller of a setup: an MPC or a law, ready to be laid into a run. */
function controllerOf(entry, car, world, where) {
  const template = named(written.controllers, entry?.kind, "controller of the kind", where)[world.name];
  if (template.refused) throw new Refusal(where, template.refused);
  const believed = carKnownTo(entry, car);
  return template.common ? lawOf(entry, template, believed, where) : mpcOf(entry, template, believed, world, where);
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
      throw new Refusal(
        where,
        `The controller is to believe a ${name.replace("_", " ")} of ${value} s: give 0 to 1 s.`,
      );
  }
  return belief;
}

/** An MPC of this car with what it believes: all its numbers, and those that its learner remembers at first. */
function mpcOf(entry, known, car, world, where) {
  const believed = checkedBelief(entry.belief, where),
    wanted = entry.tuning ? checkedTuning(entry.tuning, where) : null;
  const numbers = mine(memory.row("synthesis.mpc.MPCNumbers"));
  const status = known.order
    ? memory.call("informed_numbers", orderOf(known, car, believed), numbers)
    : memory.call("published_numbers", car.rows.car, world.period, numbers);
  if (status !== OK) throw new Refusal(where, written.words.controller[status]);
  const settings = filled(numbers.settings, known.settings), learns = settings.learns > 0;
  const fresh = mine(memory.array("F", [numbers.learned]));
  if (learns) memory.call("learner_memory", numbers.learner, numbers.filter, fresh);
  const tuning = wanted ?? [...numbers.tuning];
  settings.longest_horizon = Math.max(settings.longest_horizon, tuning[0]);
  settings.most_moves = Math.max(settings.most_moves, tuning[1]);
  return {
    kind: entry.kind, known, numbers, parts: known.order ? numbers : undefined, fresh, settings, tuning, learns,
    schedule: written.schedules[known.schedule],
  };
}

/** What is known of a car and its loop. */
function orderOf(known, car, believed) {
  const order = filled(mine(memory.row("synthesis.mpc.Order")), known.order);
  order.car = car.rows.car;
  order.within = car.rows.within;
  order.file = car.rows.file;
  order.caller = copied("models.car.SteeringRow", believed);
  return order;
}

function lawOf(entry, known, car, where) {
  if (entry.tuning && "Np" in entry.tuning)
    throw new Refusal(where, "This controller has no horizons: leave its tuning as it is.");
  const delay = () => memory.call("steering_delay", car.rows.file);
  const tuning = Object.values({ ...known.tuning, ...entry.tuning }).map((value) =>
    Number.isNaN(real(value)) ? delay() : real(value),
  );
  const parameters = mine(memory.array("F", [known.size])), common = copied("synthesis.laws.Common", known.common);
  const tuningArgument = memory.calls[known.made_by][0].length === 4 ? [vectorOf(tuning)] : [];
  const fine = memory.call(known.made_by, car.rows.car, common, ...tuningArgument, parameters);
  if (tuningArgument.length && !fine)
    throw new Refusal(where, "There is no gain for weights so far apart: bring them nearer to one another.");
  return { kind: entry.kind, known, law: true, parameters, tuning, learns: false };
}

// -- speed control ----------------------------------------------------------------------------------------------------
/** What estimates the friction by the steering that an informed MPC assumes; low, high: of the interval at the start. */
function frictionOf({ rows, assumesDrive }, { parts }, { period }, [low, high]) {
  const reserve = assumesDrive ? written.speed_control.reserve : 0;
  const estimate = { memory: { shape: [1] }, period, low, high, reserve };
  if (!parts) return estimate;
  const { frictions, knowledge, longest_delay, sensors } = written.speed_control, { belief } = parts;
  const { lag, dead_time } = belief.steering, variances = mine(memory.array("F", [written.sizes.measured]));
  const car = mine(memory.array("F", [written.sizes.parameters]));
  memory.call("plant_parameters", rows.car, rows.tyre, copied("synthesis.plant.Actuator", belief.steering.$numbers), car);
  memory.call("sensor_variances", parts.filter.noise, variances);
  return {
    ...estimate, bank: { shape: [frictions] }, commands: { shape: [Math.ceil(longest_delay / period) + 1] },
    car: share(car), variances: share(vectorOf(sensors.map((sensor) => variances.values[sensor]))),
    knowledge: { ...knowledge, lag, dead_time: belief.computation + dead_time },
  };
}

/**
 * The speed control of a car along its plan; ends: of the interval of friction that is assumed; grip: what the car has
 * of them; climb: on a slope.
 */
function speedControlOf(entry, car, controller, { world, of, samples, setup }, where) {
  if (of.test) throw new Refusal(where, "The paper's tests prescribe their speed: a speed control needs a road.");
  const constants = written.speed_control, { plan } = samples, { car: numbers, file } = car.rows;
  const ends = (friction) => {
    const [low, high = low] = [friction].flat().map((end) => checked(where, "assumed_friction", end));
    if (!(low <= high)) throw new Refusal(where, `${written.words.named.assumed_friction}: the lower end must come first.`);
    return [low, high];
  };
  const grip = (friction) => ends(friction).map((end) => memory.call("usable_friction", car.plain, file.limit, end));
  const { air_density, frontal_area, drag_coefficient, rolling_resistance } = numbers;
  const [drag, rolling] = memory.call("resistance", air_density, frontal_area, drag_coefficient, rolling_resistance);
  const assumed = ends(entry.speed_control.friction), [friction, friction_high] = grip(assumed), { period } = world;
  const settings = copied("speed.speed_control.SpeedSettings", car.assumesDrive ? { drive_front: 0 } : {},
    { period, drag, rolling, friction, friction_high, straight_ratio: assumed[0] / friction }, constants.settings, numbers.$numbers);
  const top = plan.speed.values.reduce((most, each) => Math.max(most, each), 0);
  const { path, climb } = speedPathOf(of, plan, slopeOf(setup.truth ?? {}));
  const record = mine(memory.make("tracker.longitudinal.Longitudinal", {
    sample: { shape: [1] }, memory: { shape: [1] }, settings, path,
    banks: { drive: { shape: [constants.bank] }, brakes: { shape: [constants.bank] }, requests: { shape: [world.speed_requests] } },
    ahead: { shape: [memory.call("horizon_cells", top, settings.brake, constants.spacing)] },
    friction: frictionOf(car, controller, world, assumed),
  }));
  memory.call("longitudinal_begin", record);
  const top_speed = controller.learns ? memory.call("first_top_speed", controller.parts.learner) : Infinity;
  record.sample.row(0).$set({ acceleration: NaN, top_speed, grade: NaN });
  return { record, ends, grip, climb };
}

/** A plan at even places of its road of a slope, and what writes it for another slope. */
function speedPathOf(of, plan, slope) {
  const { line, length, closed } = of, stands = plan.stops?.shape[0] ?? 0;
  const arrays = mine(memory.make("speed.path.PlanArrays", {
    line: { start: share(line.start), pieces: share(line.pieces), numbers: share(line.numbers) },
    s: share(plan.s), speed: share(plan.speed), grade: alongOf(slope), bank: alongOf(Infinity), stops_at_end: 0,
    ...(stands ? { stops: share(plan.stops), seconds: share(vectorOf(new Array(stands).fill(Infinity))) } : {}),
  }));
  const words = mine(memory.array("F", [memory.call("speed_path_words", length, closed ? 1 : 0, stands)]));
  const [status, stops] = memory.call("write_speed_path", arrays, words);
  if (status !== OK) throw new Refusal("speed", "The speed control cannot follow this plan: choose another speed or road.");
  const climb = (value) => {
    arrays.grade.value.values.fill(value);
    memory.call("write_speed_path", arrays, words);
  };
  const count = (words.shape[0] - 2 * (stands + 1)) / 4, part = (first, size) => share(view(words, first, [size]));
  const path = {
    square: part(0, count), curvature: part(count, count), slope: part(2 * count, count), bank: part(3 * count, count),
    stops: part(4 * count, stops), seconds: part(4 * count + stops, stops),
    spacing: length / (closed ? count : count - 1), length, closed: closed ? 1 : 0,
  };
  return { path, climb };
}

// -- into a run -------------------------------------------------------------------------------------------------------
/** The controller as a part of a run: { settings, sizes, values }; of sizes those that are chosen for `run_sizes`. */
function laid(controller, of, hasVy) {
  return controller.law ? laidLaw(controller, hasVy) : laidMpc(controller, of);
}

function laidLaw({ known, parameters, tuning }, hasVy) {
  const heldPlace = known.diagnostics.indexOf("held"), count = known.diagnostics.length;
  const settings = copied("controllers.mpc.MPCSettings", {
    ...ZEROS("controllers.mpc.MPCSettings"), period: known.common.period, longest_horizon: 1, most_moves: 1,
    output_min: -Infinity, output_max: Infinity,
  });
  return {
    settings, said: ["command_change", "held", ...known.diagnostics, ...known.tuning_names],
    sizes: {
      mpc: { slots: 1 }, slots: 1, law_parameters: parameters.shape[0], law_memory: known.memory,
      law_answer: 1 + count, answer: written.sizes.common_answer + count, tuning: tuning.length,
    },
    values: {
      begin: { function: "begin_law" }, request: { function: "request_of_law" }, step: { function: "step_law" },
      takes_late: -1,
      law: {
        function: { function: known.function },
        parameters: share(parameters),
        held: heldPlace < 0 ? 0 : 1 + heldPlace,
        preview: known.preview ? 1 : 0,
        has_vy: hasVy ? 1 : 0,
      },
    },
  };
}
const ZEROS = (name) => Object.fromEntries(Object.keys(memory.layouts[name].fields).map((field) => [field, 0]));

function laidMpc({ numbers, parts, fresh, settings, learns }, of) {
  const words = (row, count = row.$layout.words) => new Block(memory, row.$at, "F", [count]), none = vectorOf([]);
  const model = words(numbers.model, parts ? undefined : written.sizes.published_model);
  const turning = parts ? words(numbers.turning) : none, estimator = parts ? words(numbers.estimator) : none;
  const learner = learns ? words(numbers.learner.parameters) : none, size = (block) => block.shape[0];
  return {
    settings, said: [...written.answer.slice(1), ...(learns ? written.beliefs : [])],
    sizes: {
      mpc: {
        slots: 1,
        states: numbers.state_count,
        parameters: size(model),
        turning: size(turning),
        lag: numbers.turning.lag,
        estimator: size(estimator), estimates: numbers.remembered, learner: size(learner), learned: numbers.learned,
        curved: of.test ? 0 : 1,
      },
      slots: 1, tuning: 4,
    },
    values: {
      begin: { function: "begin_mpc" }, request: { function: "request_of_mpc" }, step: { function: "step_mpc" },
      takes_late: -1, plans: 1, beliefs: learns ? written.answer.length : 0,
      mpc: {
        parameters: share(model), states: Array.from(numbers.states.slice(0, numbers.state_count), BigInt),
        feed: { turning: share(turning) },
        informed: { estimator: share(estimator), learner: share(learner), fresh: share(fresh) },
      },
    },
  };
}

/** How many arrays a record has. */
function arraysOf(name) {
  return Object.values(memory.layouts[name].fields).reduce((sum, [, kind, more]) =>
    sum + (kind === "r" ? arraysOf(more) : "FIR".includes(kind) ? 1 : 0), 0);
}

/** What a record is made of: the sizes of its arrays in turn from rows of sizes, with the values that are given. */
function shaped(name, rows, values = {}) {
  const parts = {};
  for (const [field, [, kind, more]] of Object.entries(memory.layouts[name].fields)) {
    const value = values[field];
    if (kind === "r") parts[field] = shaped(more, rows, value);
    else if ("FIR".includes(kind)) {
      const stated = rows.shift().slice(0, kind === "R" ? 1 : more);
      const shape = value?.share && stated.every((size) => size === 0) ? value.shape : stated;
      parts[field] =
        value?.share || value?.words || value?.f8 || value?.i8 ? { ...value, shape } : { shape, values: value };
    } else if (value !== undefined) parts[field] = value;
  }
  return parts;
}

/** A record as a part of another one: its numbers, and its arrays, which both have. */
function lent(record) {
  return Object.fromEntries(Object.entries(record.$layout.fields).map(([field, [, kind]]) => {
    const value = record[field];
    return [field, kind === "r" ? lent(value) : "FIR".includes(kind) ? share(value) : value];
  }));
}

/** All that a run is made of; sizes: those that are chosen; settings: of the MPC, which are completed. */
function runOfSizes(settings, chosen, values) {
  const count = arraysOf("simulation.run.RunRecord"), table = mine(memory.array("I", [count, 4]));
  const sizes = mine(memory.row("simulation.run.RunSizes"));
  setSizes(sizes, chosen);
  const status = memory.call("run_sizes", settings, sizes, table);
  if (status !== count) throw new Error(`a run has ${count} arrays, and ${status} are known`);
  const rows = Array.from({ length: count }, (_, k) => [...table.values.subarray(4 * k, 4 * k + 4)].map(Number));
  const { controller } = values, mpc = { ...controller.mpc, settings: settings.$numbers };
  return shaped("simulation.run.RunRecord", rows, { ...values, controller: { ...controller, mpc } });
}
function setSizes(sizes, chosen) {
  for (const [field, value] of Object.entries(chosen)) {
    if (typeof value === "object") setSizes(sizes[field], value);
    else sizes[field] = value;
  }
}
