"use strict";
// The drive in the page's memory, and where a car is at a time. One drive holds one or two cars on one road.
//
//   history = {
//     road: {name, closed, length, s?, x, y, left_x, left_y, right_x, right_y},     m; s: stations of the points
//     top, shades,               |error| (m) at the end of the colours of the trail, and those colours (CSS)
//     period,                    s, of control
//     cars: [{name, outline: {front, rear, width, lf, lr, track_front, track_rear}, failed: null | s, count,
//             limits: {angle, move},                      rad: |command| and |change of the command a period| at most
//             columns: {time, x, y, yaw, ...: typed arrays; the first `count` entries count},
//             predicted(i) -> null | {x, y, count},                    world, m; a view, valid until the next call
//             moves(i) -> null | {values, count, least, most},         rad; likewise
//             trajectory(i) -> undefined | {time, points}}],           the planner's last: rows of t, x, y, yaw, speed
//     events: [{time, text}],                                          marked on the road and in the plots
//     patches: [{from, to, friction}],                                 m; of ice
//     truth: {belief_lag: [{time, value}], ...},         what is true from a time on, by the column of the belief
//   }
//
//   makeHistory(started, {shades})        from the worker's "started" message; `top` grows with the errors
//   appendFrames(history, frames)         from its "frames" message; gives false when these frames don't follow. The
//                                         predicted path of a car is a row of x and y in turn, NaN behind its end
//   indexAt(time, count, t)               the last sample at or before t
//   placeAt(car, t, place)                fills `place`: index, share, x, y, yaw, wheel_angle, failed
//   valueAt(car, column, t, step)         between two samples on the straight line, or the one before (step)
//
// Memory: columns hold every instant (8 bytes a value). Predicted paths and moves are kept whole for the last
// RECENT instants and every COARSE-th before.

const RECENT = 2048, COARSE = 8;

function indexAt(time, count, t) {
  let low = 0, high = count - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (time[middle] <= t) low = middle; else high = middle - 1;
  }
  return low;
}

// Before the first sample and behind the last a car stands.
function placeAt(car, t, place) {
  const {time, x, y, yaw, wheel_angle} = car.columns, last = car.count - 1;
  if (last < 0) return Object.assign(place, {index: -1, share: 0, x: 0, y: 0, yaw: 0, wheel_angle: 0, failed: false});
  const i = indexAt(time, car.count, t), j = Math.min(i + 1, last);
  const share = j > i ? Math.min(Math.max((t - time[i]) / (time[j] - time[i]), 0), 1) : 0;
  place.index = i;
  place.share = share;
  place.x = x[i] + share * (x[j] - x[i]);
  place.y = y[i] + share * (y[j] - y[i]);
  place.yaw = yaw[i] + share * (yaw[j] - yaw[i]);
  place.wheel_angle = wheel_angle ? wheel_angle[i] + share * (wheel_angle[j] - wheel_angle[i]) : 0;
  place.failed = car.failed !== null && t >= Math.min(car.failed, time[last]);
  return place;
}

function valueAt(car, column, t, step = false) {
  const values = car.columns[column], {time} = car.columns;
  if (!values || !car.count) return NaN;
  const i = indexAt(time, car.count, t), j = Math.min(i + 1, car.count - 1);
  if (step || j === i || t <= time[i]) return values[i];
  return values[i] + Math.min((t - time[i]) / (time[j] - time[i]), 1) * (values[j] - values[i]);
}

// What the driving error is: from the reference where there is one, else from the centre line.
const errorOf = car => car.columns.error ?? car.columns.offset;

const firstTime = history => Math.min(...history.cars.map(car => car.count ? car.columns.time[0] : 0));
const lastTime = history => Math.max(...history.cars.map(car => car.count ? car.columns.time[car.count - 1] : 0));

// The |error| (m) at the end of the colours, as `offset_scale` of the replay has it: a round number above the largest of
// the cars that did not fail; where all failed, above their 95th percentiles.
const LEAST_TOP = 0.05, TOP_STEPS = [1, 1.5, 2, 3, 4, 5, 6, 8, 10];
function topOf(cars) {
  const completed = cars.filter(car => car.failed === null).map(car => car.largest);
  const high = Math.max(LEAST_TOP, ...(completed.length ? completed : cars.map(car => shareOfErrors(car, 0.95))));
  const decade = 10 ** Math.floor(Math.log10(high));
  return TOP_STEPS.map(step => Number((step * decade).toPrecision(2))).find(top => top >= high * (1 - 1e-9));
}
function shareOfErrors(car, share) {
  const errors = errorOf(car).slice(0, car.count).map(Math.abs).filter(Number.isFinite).sort();
  return errors.length ? errors[Math.round(share * (errors.length - 1))] : 0;
}

// ---- a history that grows

function makeHistory(started, {shades = []} = {}) {
  return {
    road: started.road, top: LEAST_TOP, shades, period: started.period, events: [], patches: [], truth: {},
    cars: started.cars.map(growingCar),
  };
}

function growingCar({name, outline, columns: names, horizon = 0, moves: most = 0, limits = {}}) {
  const columns = Object.fromEntries(names.map(name => [name, new Float64Array(1024)]));
  const paths = makeShelf(2 * horizon), plans = makeShelf(most);
  const path = {x: new Float64Array(horizon), y: new Float64Array(horizon), count: 0};
  const plan = {values: null, count: 0, least: NaN, most: NaN};
  return {
    name, outline, limits, names, columns, count: 0, largest: 0, failed: null, ended: null, paths, plans, trajectories: [],
    trajectory(i) { return this.trajectories.findLast(({at}) => at <= i); },
    predicted(i) {
      const row = paths.row(i);
      if (!row) return null;
      for (path.count = 0; path.count < horizon && Number.isFinite(row[2 * path.count]); path.count++) {
        path.x[path.count] = row[2 * path.count];
        path.y[path.count] = row[2 * path.count + 1];
      }
      return path.count ? path : null;
    },
    moves(i) {
      plan.values = plans.row(i);
      if (!plan.values) return null;
      plan.count = finiteCount(plan.values);
      plan.most = limits.move ?? NaN;
      plan.least = -plan.most;
      return plan.count ? plan : null;
    },
  };
}

function finiteCount(values) {
  let n = 0;
  while (n < values.length && Number.isFinite(values[n])) n++;
  return n;
}

// Rows of numbers by index: the recent ones in a ring, every COARSE-th for good.
function makeShelf(width) {
  const ring = new Float32Array(RECENT * width);
  let coarse = new Float32Array(64 * width), count = 0;
  return {
    width,
    put(rows, from) {
      const row = rows.subarray(from * width, (from + 1) * width);
      ring.set(row, (count % RECENT) * width);
      if (count % COARSE === 0) {
        const at = count / COARSE * width;
        if (at >= coarse.length) coarse = grown(coarse);
        coarse.set(row, at);
      }
      count++;
    },
    row(i) {
      if (!width || i < 0 || i >= count) return null;
      if (i >= count - RECENT) return ring.subarray((i % RECENT) * width, (i % RECENT + 1) * width);
      const at = Math.floor(i / COARSE) * width;
      return coarse.subarray(at, at + width);
    },
  };
}

function grown(values) {
  const larger = new values.constructor(2 * values.length);
  larger.set(values);
  return larger;
}

function appendFrames(history, {first, count, cars}) {
  if (history.cars.some(car => !car.ended && car.count !== first)) return false;
  history.cars.forEach((car, i) => { if (!car.ended) appendTo(car, count, cars[i]); });
  history.top = topOf(history.cars);
  return true;
}

function appendTo(car, count, {numbers, predicted, moves, trajectories = [], ended}) {
  car.trajectories.push(...trajectories);
  car.trajectories.splice(0, car.trajectories.length - RECENT);
  const {names, columns} = car, width = names.length;
  const rows = Math.min(count, Math.floor(numbers.length / width));
  for (let k = 0; k < width; k++) {
    let column = columns[names[k]];
    while (column.length < car.count + rows) columns[names[k]] = column = grown(column);
    for (let i = 0; i < rows; i++) column[car.count + i] = numbers[i * width + k];
  }
  for (let i = 0; i < rows; i++) {
    if (predicted) car.paths.put(predicted, i);
    if (moves) car.plans.put(moves, i);
  }
  const errors = errorOf(car);
  for (let i = 0; i < rows; i++) car.largest = Math.max(car.largest, Math.abs(errors[car.count + i]) || 0);
  car.count += rows;
  if (ended) {
    car.ended = ended;
    car.failed = ended.why ? ended.at : null;
  }
}
