// A car behind a planner: the tracker of its controller, and the simulated planner whose trajectories it follows.
//
//   checkedPlanner(settings)              -> { period, delay, noise, start: "line" | "pose", silent }, or a refusal
//   trackerOf(own, controller, drive)     -> { record, planner, followed, trajectories }; before the run is made
//   attachTracker(own, drive, controller, run)    let the tracker steer the run with the controller that the run holds
//   stepBehindPlanner(own)                one control period; how many were driven, 0 at the end
//
// The planner is `drive.planner.SimulatedPlanner`, the order of calls that of `control.tracker.Tracker`: without noise a
// drive has the bits of `adaptrack drive --planner`.
"use strict";

const TRACKED_COLUMNS = ["late", "driven_by"]; // of frames, behind those of the run
const BY_PLANNER = 1, ANSWERED = 2; // core.planned.records, core.simulation.world

function checkedPlanner({ period, delay = 0, noise = 0, start = "line", silent = false }) {
  if (start !== "line" && start !== "pose")
    throw new Refusal("planner", `The planner starts at “${start}”: it must be “line” or “pose”.`);
  const numbers = Object.entries({ period, delay, noise }).map(([name, value]) => [
    name,
    checked("planner", `planner_${name}`, value),
  ]);
  return { ...Object.fromEntries(numbers), start, silent: Boolean(silent) };
}

/** What a function returns, whose arrays and records are given back. */
function lending(make) {
  const list = [];
  try {
    return owning(list, make);
  } finally {
    forget(list);
  }
}
const zeros = (...shape) => mine(memory.array("F", shape));

/** Values of an elementary function, with the bits of `core.maths.portable`. */
const elementary = (name, values) => lending(() => {
  const at = zeros(3, values.length), results = zeros(values.length);
  at.values.set(values);
  memory.call("elementary_values", written.tracker.functions.indexOf(name), at, results);
  return [...results.values];
});
const [cosine, sine, tangent] = ["cos", "sin", "tan"].map((name) => (x) => elementary(name, [x])[0]);

/** Points of a road at arc lengths (m): { x, y, heading } each. */
const roadPoints = (line, s) => lending(() => {
  const points = zeros(s.length, 4);
  memory.call("points_at", line, vectorOf(s), points);
  const rows = [...points.values];
  return s.map((_, k) => ({ x: rows[4 * k], y: rows[4 * k + 1], heading: rows[4 * k + 2] }));
});

// -- the planner ------------------------------------------------------------------------------------------------------
/** A planner at the beginning of a drive along the road of a setup. */
function plannerRun({ setup, of, samples, seed }) {
  const { s, speed, time, duration } = samples.plan, columns = { s: share(s), speed: share(speed), time: share(time) };
  const [x, y, yaw] = samples.pose;
  return {
    settings: checkedPlanner(setup.planner), of, seed, count: 0, station: 0, time: 0, next: 0, pending: [],
    plan: mine(memory.make("speed.plan.SpeedPlanRecord", { ...columns, duration, closed: of.closed ? 1 : 0 })),
    sample: { t: 0, x, y, yaw, speed: speed.values[0], yaw_rate: NaN, lateral_velocity: NaN }, // the last with a pose
  };
}

/** Trajectories that arrive at the time of a sample: { time, stamp, points }. */
function arrivalsAt(planner, sample) {
  const { settings } = planner, end = sample.now + 1e-9;
  if (["t", "now", "x", "y", "yaw", "speed"].every((name) => Number.isFinite(sample[name]))) planner.sample = sample;
  for (; planner.next <= end; planner.next += settings.period) {
    const time = planner.next + (planner.next > 0 ? settings.delay : 0);
    planner.pending.push({ time, stamp: planner.next, points: trajectoryFrom(planner, planner.next) });
  }
  planner.pending.sort((a, b) => a.time - b.time);
  const count = planner.pending.filter(({ time }) => time <= end).length, arrivals = planner.pending.splice(0, count);
  return settings.silent ? [] : arrivals;
}

/** Rows t, x, y, yaw, speed of a trajectory from a time (s) on. */
function trajectoryFrom(planner, stamp) {
  const { settings, sample, of, plan } = planner, constants = written.tracker.planner;
  const elapsed = stamp - sample.t, drift = sample.lateral_velocity / Math.max(sample.speed, 1), known = (x) => x || 0;
  const way = sample.speed * elapsed, turn = known(sample.yaw_rate) * elapsed;
  const course = sample.yaw + known(drift) + 0.5 * turn;
  const foot = footOf(of.line, sample.x + way * cosine(course), sample.y + way * sine(course), planner.station);
  const merge = Math.max(constants.merge * sample.speed, constants.shortest_merge), atPose = settings.start === "pose";
  planner.station = foot.s;
  let begin = foot.s, time = stamp;
  if (atPose) {
    const [place, speed] = motionOf(plan, planner.time + settings.period);
    const isStopping = speed < constants.pause_speed && Math.abs(place - begin) < constants.pause_distance;
    time = isStopping ? planner.time + settings.period : Math.max(arrivalTimes(plan, [begin])[0], planner.time);
  } else {
    begin = Math.min(begin, motionOf(plan, stamp)[0]) - constants.behind;
    if (!of.closed) begin = Math.max(begin, 0);
  }
  planner.time = time;
  const s = placesBetween(plan, of, begin, time + constants.horizon), line = roadPoints(of.line, s);
  const t = arrivalTimes(plan, s).map((arrival) => Math.min(arrival - time, constants.horizon));
  const speeds = speedsOf(plan, s), headings = line.map(({ heading }) => heading), number = planner.count++;
  const [sines, cosines] = ["sin", "cos"].map((name) => elementary(name, headings));
  const slope = atPose && Number.isFinite(drift) ? tangent(sample.yaw + turn + drift - foot.heading) : 0;
  const growth = atPose ? (2 * foot.offset) / merge + slope : 0, first = atPose ? foot.offset : 0;
  const offsets = s.map((place) => first + growth * (place - begin));
  const toGo = s.map((place) => Math.max(1 - (place - begin) / merge, 0)); // the offset is a cubic, that ends along the road
  const turns = elementary("atan", s.map((_, k) => growth * toGo[k] * toGo[k] - (2 * offsets[k] * toGo[k]) / merge));
  const noise = (channel) => settings.noise && settings.noise * memory.call("counted_normal", planner.seed, number, channel);
  const rows = line.map(({ x, y, heading }, k) => {
    const offset = offsets[k] * toGo[k] * toGo[k];
    return [
      atPose ? Math.max(t[k], 0) : t[k],
      x - offset * sines[k] + noise(2 * k),
      y + offset * cosines[k] + noise(2 * k + 1),
      heading + turns[k],
      speeds[k],
    ];
  });
  return Float64Array.from(rows.filter((_, k) => !atPose || k === 0 || t[k] > 0).flat());
}

const footOf = (line, x, y, near) => lending(() => {
  const foot = zeros(1, 4);
  memory.call("project_all", line, mine(memory.array("F", [1, 3], [x, y, near])), foot);
  const [s, offset, heading] = foot.values;
  return { s, offset, heading };
});

/** Arc lengths (m) from one on to the place of the plan at a time (s), beyond the end of an open road if need be. */
function placesBetween(plan, of, begin, until) {
  const { spacing } = written.tracker.planner, last = plan.speed.values.at(-1);
  const beyond = of.closed ? 0 : Math.max(until - plan.duration, 0) * last;
  const end = Math.max(motionOf(plan, until)[0] + beyond, begin), count = Math.ceil((end - begin) / spacing);
  const step = (end - begin) / count;
  return Array.from({ length: count + 1 }, (_, k) => (k === count ? (count ? end : begin) : k * step + begin));
}

/** Station (m) and speed (m/s) of a plan at a time (s). */
const motionOf = (plan, time) => lending(() => {
  const stations = zeros(1), speeds = zeros(1);
  memory.call("plan_motion", plan, vectorOf([time]), stations, speeds);
  return [stations.values[0], speeds.values[0]];
});

const speedsOf = (plan, s) => lending(() => {
  const values = vectorOf(s);
  memory.call("planned_speeds", plan.closed ? plan.s.values.at(-1) : 0, plan.s, plan.speed, values);
  return [...values.values];
});

/** Times (s) at which a plan arrives at places (m), over all laps. */
function arrivalTimes(plan, places) {
  const length = plan.s.values.at(-1), laps = places.map((place) => (plan.closed ? Math.floor(place / length) : 0));
  const inside = places.map((place, k) => place - laps[k] * length), here = speedsOf(plan, inside);
  const [s, speed, time] = [plan.s, plan.speed, plan.time].map((column) => column.values);
  return inside.map((place, k) => {
    let after = 1, high = s.length - 1;
    while (after < high) {
      const middle = (after + high) >> 1;
      if (s[middle] < place) after = middle + 1;
      else high = middle;
    }
    const mean = Math.max(0.5 * (here[k] + speed[after]), 1e-6);
    return laps[k] * plan.duration + time[after] - (s[after] - place) / mean;
  });
}

// -- the tracker ------------------------------------------------------------------------------------------------------
/** The tracker of a car with its speed control, before its first trajectory. */
function trackerOf(own, controller, drive) {
  if (controller.schedule) throw new Refusal(own.where, "A tracker has no schedule: choose a controller without one.");
  if (!own.speed) throw new Refusal(own.where, "A planner also moves the car: let a speed control keep its speed.");
  const record = mine(memory.make("tracker.step.Tracking", {
    tracker: written.tracker.record, longitudinal: lent(own.speed.record), control_speed: linked("longitudinal_step"),
  }));
  own.speed.record = record.longitudinal;
  return { record, planner: plannerRun(drive), followed: [], points: 0, trajectories: [], roadIndex: mine(memory.array("I", [1])) };
}

function attachTracker(own, { car: whole }, controller, run) {
  const { record } = own.tracker, { known, parts, learns } = controller, { period } = own.world, { tracker } = record;
  const { move, angle } = limitsOf({ controller, run }), widest = Math.min(angle, written.tracker.widest);
  const car = learns ? parts.learner.car : carKnownTo(own.entry, whole).rows.car;
  const delay = parts && !learns ? parts.lag + parts.dead_time : Infinity;
  tracker.settings.row(0).$set({
    period, angle_min: -widest, angle_max: widest, move, late: Math.max(known.takes_late, 0),
    filtered: known.takes_late < 0 ? 0 : 1, drift_arm: car.lr, drift_load: car.mass * car.lf,
    drift_stiffness: 2 * car.stiffness_rear * (car.lf + car.lr),
    first_top_speed: learns ? memory.call("first_top_speed", parts.learner) : Infinity,
  });
  tracker.planned.settings.row(0).$set({ period });
  memory.call("check_settings", car, period, delay, known.position_noise, tracker.check.settings);
  record.longitudinal.settings.patience = known.patience;
  record.controller.$copy(run.controller).$set({ takes_late: known.takes_late });
  record.controller.law.has_vy = 1;
  record.$set({ narrow_friction: linked(controller.law ? null : "narrow_tracked_friction") });
  run.controller.$set({ begin: 0, step: 0 }); // the run asks the tracker
  run.longitudinal.$copy(record.longitudinal);
}

/** Let a record refer to other arrays, and take over other numbers. */
const refer = (record, given) => lending(() => record.$copy(mine(memory.make(record.$name, given))));

/** Follow a trajectory from its arrival (s) on, if it is accepted; what it replaces is given back. */
function followTrajectory(own, { stamp, points }, time) {
  const { tracker, run } = own, list = [];
  let isPossible = true;
  const isFollowed = owning(list, () => {
    const { record } = tracker, count = points.length / 5, parts = mine(memory.array("I", [7]));
    const rows = zeros(count, 7);
    rows.values.fill(NaN);
    for (let k = 0; k < count; k++) rows.values.set(points.subarray(5 * k, 5 * k + 5), 7 * k);
    let length = 0;
    for (let k = 1; k < count; k++)
      length += Math.hypot(points[5 * k + 1] - points[5 * k - 4], points[5 * k + 2] - points[5 * k - 3]);
    const buffer = zeros(memory.call("trajectory_words", count, tracker.points, length));
    const arrival = mine(memory.make("tracker.planner.Arrival", { stamp, time, role: BY_PLANNER, is_urgent: 0 }));
    const [verdict, status] = memory.call("take_trajectory", rows, arrival, NaN, record.tracker, buffer, parts);
    isPossible = written.tracker.accepted.includes(status);
    if (verdict !== written.tracker.taken || !isPossible) return false;
    putTrajectory(tracker, buffer, Array.from(parts.values, Number));
    memory.call("longitudinal_follow", record.longitudinal);
    memory.call("begin_trajectory", arrival, record.tracker);
    memory.call("tracker_apply", record);
    run.longitudinal.$copy(record.longitudinal);
    return true;
  });
  if (!isFollowed) forget(list);
  if (!isPossible)
    throw new Refusal("planner", `The planner’s trajectory at ${time.toFixed(2)} s is impossible: make its points less noisy.`);
  if (!isFollowed) return;
  forget(tracker.followed);
  tracker.followed = list;
}

/** Let the tracker refer to what `take_trajectory` has written: line, speeds and times; make the plan of its speeds. */
function putTrajectory(tracker, buffer, [points, places, stopCount, speedsAt, room, stopsAt, pathAt]) {
  const { record } = tracker, { planned } = record.tracker;
  const path = view(buffer, pathAt, [buffer.shape[0] - pathAt]), [count, piece, start, heading] = memory.call("path_parts", path);
  const numbers = view(path, 0, [written.sizes.road_numbers]), pieces = view(path, piece, [count, written.sizes.piece]);
  const starts = view(path, start, [count + 1]), length = numbers.values[0];
  const [s, speed, arrive, leave] = [0, 1, 2, 3].map((k) => view(buffer, speedsAt + k * room, [places]));
  refer(record.tracker.path, {
    of: share(tracker.roadIndex), numbers: share(view(path, 0, [1, written.sizes.road_numbers])), start: share(starts),
    pieces: share(pieces), headings: share(view(path, heading, [memory.call("heading_count", numbers)])),
  });
  refer(record.tracker.plan, { s: share(s), speed: share(speed) });
  refer(planned, {
    settings: share(planned.settings), memory: share(planned.memory), far: share(planned.far),
    points: share(view(buffer, 0, [points, 3])),
    speeds: { s: share(s), speed: share(speed), arrive: share(arrive), leave: share(leave) },
  });
  const line = { start: starts, pieces, numbers: view(path, 0, [4]) }, stops = view(buffer, stopsAt, [stopCount]);
  const top = speed.values.reduce((most, value) => Math.max(most, value), 0), { brake } = record.longitudinal.settings;
  const ahead = zeros(memory.call("horizon_cells", top, brake, written.speed_control.spacing));
  const speeds = speedPathOf({ line, length, closed: false }, { s, speed, stops }, 0);
  refer(record.longitudinal, { ...lent(record.longitudinal), path: speeds.path, ahead: share(ahead) });
  tracker.points = points;
}

/** What a tracker is told at the instant of a run: the pose in the plane, the motion, and the times of both. */
function sampleOf({ run, world }, { of }) {
  const names = written.places.measured, values = run.measured.values.slice(), { period } = world;
  const { instant, station_estimate, speed } = run.memory.drives.row(0), now = instant * period;
  const [poseAge, motionAge] = ["pose_age", "motion_age"].map((name) => values[names[name]] || 0), offset = values[names.y];
  const [foot] = roadPoints(of.line, [station_estimate - poseAge * speed]);
  return {
    t: now - poseAge, now, x: foot.x - offset * sine(foot.heading), y: foot.y + offset * cosine(foot.heading),
    yaw: foot.heading + values[names.yaw], speed, yaw_rate: values[names.yaw_rate], lateral_velocity: values[names.vy],
    lateral_acceleration: values[names.lateral_acceleration], wheel_angle: values[names.wheel_angle],
    motion_time: now - motionAge, driver: 0,
  };
}

function stepBehindPlanner(own) {
  const { run, tracker } = own, { record } = tracker, car = run.memory.drives.row(0);
  if (car.instant >= Number(run.inputs.periods.values[0])) return 0;
  memory.call("roll_on", 1, 1, run); // up to the question what to do
  if (car.ended !== 0) return 0;
  const sample = sampleOf(own, tracker.planner);
  for (const arrival of arrivalsAt(tracker.planner, sample)) {
    followTrajectory(own, arrival, sample.now);
    tracker.trajectories.push({ at: car.instant, ...arrival });
  }
  memory.call("watch_planner", sample.now, record.tracker);
  record.tracker.sample.values.set(written.tracker.sample.map((name) => sample[name] ?? NaN));
  memory.call("tracker_step", record);
  const { force, hold } = record.longitudinal.memory.row(0);
  run.controller.answer.values[0] = record.tracker.tracked.values[written.places.tracked.command];
  car.$set({ requested_force: force, requested_hold: hold, caller_state: ANSWERED });
  return memory.call("roll_on", 1, 1, run);
}

/** Complete the rows of a frame: lateness and who drives; the path that the controller foresees on its trajectory. */
function showTracked({ tracker, columns, horizon }, rows, period) {
  const { tracked } = tracker.record.tracker, width = columns.length, names = TRACKED_COLUMNS.map((name) => written.places.tracked[name]);
  rows.numbers.set(names.map((place) => tracked.values[place]), (period + 1) * width - names.length);
  lending(() => {
    const points = zeros(2 * horizon), [count] = memory.call("tracker_predict", tracker.record, points);
    points.values.fill(NaN, 2 * count);
    rows.predicted.set(points.values, 2 * horizon * period);
  });
}
