"use strict";
// Small plots over time, one cursor through all of them and the road. Needs history.js, the palette of viewer.js, and a
// clock.
//
//   plots = makePlots(box, history, clock)
//     show(history)          another drive
//     setSpan(seconds)       of the window: 20 at first; 0: all
//     choose(names)          which of PLOTS are shown, by name; null: all that the drive has columns for
//     list                   the plots shown; each: {name, toPixel(t, value), toValue(px, py), describe(),
//                            decimated(line): the indices of the samples that are drawn}
//     describe()             what all plots show at the cursor, in sentences
//     draw()                 now, all of them
//
//   spec = {name, title, unit, digits, scale (factor to the unit), least (smallest span of the axis), log, around0,
//           lines: [{column, or, label, step, once, ink}],   of each car, or of the first (once; unless it has
//                                                 the column `unless`); a second car has its
//                                                 own colour and dashes; or: the column where there is no such one;
//                                                 ink: a truth. A car without the first of them has no line
//           limits: [{value, label}] | history => [...],   drawn where within the axis
//           band: {column, sigma, k, ratio},      value +- k sigma, or times exp(+-k sigma) (ratio)
//           truth: name,                          in history.truth
//           asked: true,                          shown only where `choose` names it
//           marks: {column, label}}               where a count grows: a mark below
//        or {name, kind: "moves", title, unit, digits, scale}     the planned moves at the cursor against their limits
//   PLOTS holds them; `specsFor(history, names)` gives those that a drive has the columns for.
//
//   A plot is a slider of time: arrows, page up/down, home, end move the cursor, Enter and a click seek, Escape leaves.

const DEGREES = 180 / Math.PI;

const ROAD_FRICTION = {column: "friction", label: "of the road", once: true, ink: true};

const PLOTS = [
  {
    name: "path", title: "Path beside the road's centre", unit: "m", digits: 3, least: 0.5, asked: true,
    lines: [{column: "offset", label: "driven"}, {column: "y_ref", label: "reference", once: true}],
  },
  {
    name: "error", title: "Error", unit: "m", digits: 3, least: 0.1, around0: true,
    lines: [{column: "error", or: "offset", label: "error"}],
  },
  {
    name: "steering", title: "Steering", unit: "°", digits: 2, scale: DEGREES, least: 2, around0: true,
    lines: [{column: "command", label: "command"}, {column: "wheel_angle", label: "wheels"}],
    limits: history => limitsOf(history, "angle", "limit"),
  },
  {
    name: "moves", kind: "moves", title: "Planned moves", unit: "°", digits: 2, scale: DEGREES,
  },
  {
    name: "speed", title: "Speed", unit: "m/s", digits: 2, least: 2,
    lines: [
      {column: "vx", or: "speed", label: "speed"}, {column: "planned_speed", or: "v_ref", label: "planned", once: true, unless: "governed_speed"},
      {column: "governed_speed", label: "governed"},
    ],
  },
  {
    name: "late", title: "Behind the times of the planner", unit: "s", digits: 2, least: 0.2, around0: true,
    lines: [{column: "late", label: "late"}],
  },
  {
    name: "longitudinal", title: "Longitudinal acceleration", unit: "m/s²", digits: 2, least: 1, around0: true,
    lines: [{column: "longitudinal_acceleration", label: "longitudinal"}],
  },
  {
    name: "grip", title: "Used share of the assumed grip", unit: "", digits: 2, least: 1,
    lines: [{column: "grip_used", label: "used grip"}], limits: [{value: 1, label: "assumed grip"}],
  },
  {
    name: "assumed_friction", title: "Friction that the speed control assumes", unit: "", digits: 2, least: 0.2,
    lines: [{column: "friction_low", label: "at least"}, {column: "friction_high", label: "at most"}, ROAD_FRICTION],
  },
  {
    name: "acceleration", title: "Lateral acceleration", unit: "m/s²", digits: 2, least: 1, around0: true,
    lines: [{column: "lateral_acceleration", label: "lateral"}],
  },
  ...[
    ["lag", "Believed lag", "s", 3, 0.1, false], ["dead_time", "Believed dead time", "s", 3, 0.1, false],
    ["stiffness", "Believed stiffness", "", 2, 0.2, true], ["bias", "Believed steering bias", "rad", 4, 0.01, false],
    ["friction", "Believed friction", "", 2, 0.2, true],
  ].map(([name, title, unit, digits, least, ratio]) => ({
    name, title, unit, digits, least, truth: `belief_${name}`,
    lines: [{column: `belief_${name}`, label: "belief"}, ...(name === "friction" ? [ROAD_FRICTION] : [])],
    band: {column: `belief_${name}`, sigma: `belief_${name}_sigma`, k: 2, ratio},
  })),
  {
    name: "horizons", title: "Horizons chosen", unit: "periods", digits: 0, least: 4,
    lines: [{column: "Np", label: "Np", step: true}, {column: "Nc", label: "Nc", step: true}],
    marks: {column: "guard", label: "the guard steps in"},
  },
  {
    name: "weights", title: "Weights chosen", unit: "", digits: 3, log: true, least: 1,
    lines: [{column: "Q", label: "Q", step: true}, {column: "R", label: "R", step: true}],
    marks: {column: "guard", label: "the guard steps in"},
  },
];

// ---- which plots

const columnOf = (car, line) => car.columns[line.column] ? line.column : car.columns[line.or] ? line.or : null;

// Those of PLOTS, by name or all, that the drive has something for.
function specsFor(history, names) {
  const drawn = (spec, car) => spec.kind === "moves" ? car.plans?.width : columnOf(car, spec.lines[0]);
  const has = spec => history.cars.some(car => drawn(spec, car));
  return PLOTS.filter(spec => has(spec) && (names ? names.includes(spec.name) : !spec.asked));
}

// ±limit of the first car that says one.
function limitsOf(history, name, label) {
  const value = history.cars.map(car => car.limits?.[name]).find(Number.isFinite);
  return value === undefined ? [] : [{value, label}, {value: -value, label}];
}

// ---- numbers to pixels

// A line thinned to what a picture `wide` px wide can show: of each pixel's samples the first, the smallest, the
// largest and the last, in their order. Writes indices into `found`, gives their count.
function decimate(time, values, from, to, perSecond, found) {
  let n = 0;
  for (let i = from; i <= to;) {
    const pixel = Math.floor(time[i] * perSecond);
    let low = i, high = i, j = i;
    for (; j <= to && Math.floor(time[j] * perSecond) === pixel; j++) {
      if (values[j] < values[low]) low = j;
      if (values[j] > values[high]) high = j;
    }
    const last = j - 1, one = Math.min(low, high), two = Math.max(low, high);
    found[n++] = i;
    if (one > i) found[n++] = one;
    if (two > one) found[n++] = two;
    if (last > two) found[n++] = last;
    i = j;
  }
  return n;
}

function niceStep(span, most) {
  const decade = 10 ** Math.floor(Math.log10(span / most));
  return [1, 2, 5, 10].find(step => step * decade * most >= span * (1 - 1e-9)) * decade;
}

// An axis that grows at once and shrinks only when much too large, so that it does not flicker.
function makeAxis({least = 0, around0 = false, log = false}) {
  const axis = {low: 0, high: 0, step: 1, log};
  axis.fit = (low, high) => {
    if (!(low <= high)) [low, high] = log ? [1, 10] : [0, least || 1];
    if (log) [low, high] = [Math.log10(Math.max(low, 1e-12)), Math.log10(Math.max(high, 1e-12))];
    if (around0) [low, high] = [Math.min(low, -high), Math.max(high, -low)];
    const short = Math.max(least - (high - low), 0) / 2 || (high === low ? Math.abs(high) * 0.05 || 0.5 : 0);
    low -= short;
    high += short;
    const inside = axis.high > axis.low && low >= axis.low && high <= axis.high;
    if (inside && high - low > 0.45 * (axis.high - axis.low)) return;
    axis.step = log ? Math.max(1, Math.ceil((high - low) / 4)) : niceStep(high - low, 3);
    axis.low = Math.floor(low / axis.step + 1e-9) * axis.step;
    axis.high = Math.ceil(high / axis.step - 1e-9) * axis.step;
  };
  axis.share = value => ((log ? Math.log10(Math.max(value, 1e-12)) : value) - axis.low) / (axis.high - axis.low);
  axis.value = share => {
    const value = axis.low + share * (axis.high - axis.low);
    return log ? 10 ** value : value;
  };
  return axis;
}

function tickText(value, step) {
  const digits = Math.min(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), 6);
  return signed(Math.abs(value) < step * 1e-6 ? 0 : value, digits);
}

// ---- one plot

const TRUTH = [4, 2];
const cssOf = line => line.colour === "ink" ? "var(--ink)" : `var(--series-${line.colour})`;
const colourOf = line => line.colour === "ink" ? palette.ink : palette.series[line.colour];
const DASHES = [[[], [2, 3], [8, 3, 2, 3]], [[7, 4], [7, 3, 1, 3], [3, 3]]];  // of a car, of its lines
const MARGIN = {left: 46, right: 10, top: 8, bottom: 20};
const points = new Int32Array(1 << 16);  // of the line that is being drawn

function dashOf(car, line) {
  return DASHES[car % 2][line % 3];
}

function element(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const name in attributes) node.setAttribute(name, attributes[name]);
  node.append(...children);
  return node;
}

// A piece of a line, for the legend.
function swatch(colour, dash, wide = 2.4) {
  const stroke = `stroke="${colour}" stroke-width="${wide}" stroke-dasharray="${dash.join(" ")}"`;
  const template = element("template");
  template.innerHTML = `<svg width="22" height="8" aria-hidden="true"><line x2="22" y1="4" y2="4" ${stroke}/></svg>`;
  return template.content.firstChild;
}

// What all kinds of plot have: a figure with title, legend and canvas.
function makeFrame(spec, history) {
  const title = spec.unit ? `${spec.title} (${spec.unit})` : spec.title;
  const legend = element("ul", {class: "values"}), limit = element("span", {class: "limit"});
  const canvas = element("canvas");
  const caption = element("figcaption", {}, element("b", {}, title), limit, legend), still = element("canvas");
  const figure = element("figure", {class: "plot", "data-plot": spec.name}, caption, canvas);
  const frame = {
    figure, canvas, legend, limit, still, pen: canvas.getContext("2d"), width: 1, height: 1, dense: 1,
    get inside() { return [frame.width - MARGIN.left - MARGIN.right, frame.height - MARGIN.top - MARGIN.bottom]; },
    resize() {
      frame.dense = window.devicePixelRatio || 1;
      frame.width = Math.max(canvas.clientWidth, 1);
      frame.height = Math.max(canvas.clientHeight, 1);
      for (const layer of [canvas, frame.still]) {
        layer.width = Math.round(frame.width * frame.dense);
        layer.height = Math.round(frame.height * frame.dense);
      }
    },
    // A value in the legend; those of one row stand together.
    entry(row, colour, dash, label, wide) {
      const value = element("span", {class: "value"});
      row.append(element("span", {class: "entry"}, swatch(colour, dash, wide), element("span", {}, label), value));
      return value;
    },
    row(k) {
      const row = element("li"), style = `border-color: var(--series-${k % 6})`;
      if (history.cars.length > 1 && k >= 0) row.append(element("i", {class: "car", style}, `${k + 1}`));
      legend.append(row);
      return row;
    },
  };
  return frame;
}

function write(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

// The lines of all cars: {car, k, column, label, name (in full), colour, dash, step}.
function linesOf(spec, history) {
  const several = history.cars.length > 1, alone = spec.lines.length === 1;
  const drawnCars = history.cars.filter(car => columnOf(car, spec.lines[0]));
  return history.cars.flatMap((car, k) => spec.lines.flatMap((line, j) => {
    const column = columnOf(car, line);
    const once = line.once && !car.columns[line.unless];
    if (!column || !drawnCars.includes(car) || once && car !== drawnCars[0]) return [];
    const label = several && alone ? car.name : line.label, colour = line.ink ? "ink" : k % 6;
    const name = several && !alone && !once ? `${car.name}, ${line.label}` : label;
    return [{car, k, column, label, name, colour, step: line.step, dash: line.ink ? TRUTH : dashOf(k, j)}];
  }));
}

function makeTimePlot(spec, history, clock, window_) {
  const frame = makeFrame(spec, history), {canvas, figure} = frame, scale = spec.scale ?? 1, axis = makeAxis(spec);
  const limits = (typeof spec.limits === "function" ? spec.limits(history) : spec.limits) ?? [];
  const lines = linesOf(spec, history);
  const rows = history.cars.map((_, k) => lines.some(line => line.k === k) ? frame.row(k) : null);
  const values = lines.map(line => frame.entry(rows[line.k], cssOf(line), line.dash, line.label));
  const truthRow = spec.truth && (rows.length > 1 ? frame.row(-1) : rows[0]);
  const truthValue = spec.truth ? frame.entry(truthRow, "var(--ink)", TRUTH, "true", 1.6) : null;
  const plot = {
    name: spec.name, spec, frame, figure, canvas, lines, axis, values, from: 0, to: 1, drawnAt: -1, stale: true,
    toPixel, toValue, decimated, describe, paintStill, paint, tell, resize: frame.resize,
  };
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "slider");
  canvas.setAttribute("aria-label", `${spec.title}${spec.unit ? `, ${spec.unit}` : ""}, over time`);

  const hasTruth = () => Boolean(spec.truth && history.truth?.[spec.truth]?.length);

  // -- geometry

  function toPixel(t, value) {
    const [wide, high] = frame.inside;
    return [MARGIN.left + (t - plot.from) / (plot.to - plot.from) * wide, MARGIN.top + (1 - axis.share(value)) * high];
  }

  function toValue(px, py) {
    const [wide, high] = frame.inside;
    return [plot.from + (px - MARGIN.left) / wide * (plot.to - plot.from), axis.value(1 - (py - MARGIN.top) / high)];
  }

  // The samples in the window and one beyond each of its ends.
  function span(car) {
    const {time} = car.columns;
    if (!car.count) return [0, -1];
    return [indexAt(time, car.count, plot.from), Math.min(indexAt(time, car.count, plot.to) + 1, car.count - 1)];
  }

  // The indices that are drawn of a line.
  function decimated(line) {
    const [from, to] = span(line.car), perSecond = frame.inside[0] / (plot.to - plot.from);
    const {columns} = line.car;
    return points.subarray(0, decimate(columns.time, columns[line.column], from, to, perSecond, points));
  }

  // Least and largest value in the window, of lines, band and truth.
  function extremes() {
    let low = Infinity, high = -Infinity;
    const take = value => {
      if (value < low) low = value;
      if (value > high) high = value;
    };
    for (const line of lines) {
      const [from, to] = span(line.car), column = line.car.columns[line.column];
      for (let i = from; i <= to; i++) take(column[i]);
    }
    low *= scale;
    high *= scale;
    if (spec.truth) eachTruth((time, value) => { if (time <= plot.to) take(value); });
    if (spec.band) for (const car of history.cars) {
      const [from, to] = car.columns[spec.band.sigma] ? span(car) : [0, -1];
      for (let i = from; i <= to; i += 4) {
        take(edge(car, i, -1));
        take(edge(car, i, 1));
      }
    }
    return [low, high];
  }

  function edge(car, i, side) {
    const {column, sigma, k = 2, ratio} = spec.band, value = car.columns[column][i], wide = k * car.columns[sigma][i];
    return (ratio ? value * Math.exp(side * Math.min(wide, 3)) : value + side * wide) * scale;
  }

  function eachTruth(then) {
    for (const {time, value} of history.truth?.[spec.truth] ?? [])
      if (Number.isFinite(value)) then(time, value * scale);
  }

  // -- the part that stands still

  function paintStill(now) {
    const pen = frame.still.getContext("2d");
    [plot.from, plot.to] = window_(plot);
    axis.fit(...extremes());
    pen.setTransform(frame.dense, 0, 0, frame.dense, 0, 0);
    pen.clearRect(0, 0, frame.width, frame.height);
    drawAxes(pen);
    pen.save();
    pen.beginPath();
    pen.rect(MARGIN.left, MARGIN.top - 3, ...frame.inside.map((size, i) => size + (i ? 6 : 0)));
    pen.clip();
    drawLimits(pen);
    if (spec.band) history.cars.forEach((car, k) => drawBand(pen, car, k));
    drawTruth(pen);
    for (const line of lines) drawLine(pen, line);
    drawMarks(pen);
    pen.restore();
    plot.drawnAt = now;
  }

  function drawAxes(pen) {
    const [wide, high] = frame.inside;
    pen.font = `11.5px ${palette.font}`;
    pen.fillStyle = palette.muted;
    pen.strokeStyle = palette.grid;
    pen.lineWidth = 1;
    pen.beginPath();
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let tick = axis.low; tick <= axis.high + axis.step * 1e-6; tick += axis.step) {
      const y = Math.round(MARGIN.top + (1 - (tick - axis.low) / (axis.high - axis.low)) * high) + 0.5;
      pen.moveTo(MARGIN.left, y);
      pen.lineTo(MARGIN.left + wide, y);
      pen.fillText(spec.log ? powerText(tick) : tickText(tick, axis.step), MARGIN.left - 5, y);
    }
    pen.textAlign = "center";
    pen.textBaseline = "alphabetic";
    const step = niceStep(plot.to - plot.from, Math.max(2, Math.floor(wide / 70)));
    for (let t = Math.ceil(plot.from / step - 1e-9) * step; t <= plot.to + 1e-9; t += step) {
      const x = Math.round(toPixel(t, 0)[0]) + 0.5;
      pen.moveTo(x, MARGIN.top + high);
      pen.lineTo(x, MARGIN.top + high + 3);
      const unit = t + step > plot.to ? " s" : "";
      pen.fillText(`${tickText(t, step)}${unit}`, Math.min(x, frame.width - 18), frame.height - 5);
    }
    pen.stroke();
  }

  const powerText = tick => Math.abs(tick) < 4 ? String(+(10 ** tick).toPrecision(1)) : `1e${tick}`;

  function drawLimits(pen) {
    pen.strokeStyle = pen.fillStyle = palette.warn;
    pen.lineWidth = 1.2;
    pen.setLineDash([10, 4]);
    for (const {value, label} of limits) {
      const y = toPixel(0, value * scale)[1];
      if (y < MARGIN.top - 1 || y > frame.height - MARGIN.bottom + 1) continue;
      pen.beginPath();
      pen.moveTo(MARGIN.left, y);
      pen.lineTo(frame.width - MARGIN.right, y);
      pen.stroke();
      pen.textAlign = "left";
      pen.fillText(label, MARGIN.left + 4, value > 0 ? y + 12 : y - 4);
    }
    pen.setLineDash([]);
  }

  // value +- k sigma; few points: of a belief that moves slowly.
  function drawBand(pen, car, k) {
    if (!car.columns[spec.band.sigma] || !car.columns[spec.band.column]) return;
    const [from, to] = span(car), {time} = car.columns, stride = Math.max(1, Math.floor((to - from) / 300));
    if (to < from) return;
    const side = (i, sign) => pen.lineTo(...toPixel(time[i], edge(car, i, sign)));
    pen.beginPath();
    for (let i = from; i < to; i += stride) side(i, 1);
    side(to, 1);
    side(to, -1);
    for (let i = to - 1 - (to - 1 - from) % stride; i >= from; i -= stride) side(i, -1);
    pen.closePath();
    pen.fillStyle = palette.series[k % 6];
    pen.globalAlpha = 0.2;
    pen.fill();
    pen.globalAlpha = 1;
  }

  function drawTruth(pen) {
    pen.strokeStyle = palette.ink;
    pen.lineWidth = 1.6;
    pen.setLineDash(TRUTH);
    pen.beginPath();
    let before = NaN;
    eachTruth((time, value) => {
      const t = Math.max(time, plot.from);
      if (Number.isFinite(before)) pen.lineTo(...toPixel(t, before));
      if (Number.isFinite(before)) pen.lineTo(...toPixel(t, value)); else pen.moveTo(...toPixel(t, value));
      before = value;
    });
    if (Number.isFinite(before)) pen.lineTo(...toPixel(Math.min(plot.to, Math.max(clock.end, plot.from)), before));
    pen.stroke();
    pen.setLineDash([]);
  }

  function drawLine(pen, line) {
    const {time} = line.car.columns, column = line.car.columns[line.column], drawn = decimated(line);
    const [wide, high] = frame.inside, perSecond = wide / (plot.to - plot.from);
    const x0 = MARGIN.left - plot.from * perSecond;
    let oldY = 0;
    pen.strokeStyle = colourOf(line);
    pen.lineWidth = 1.8;
    pen.lineJoin = "round";
    pen.setLineDash(line.dash);
    pen.beginPath();
    for (let n = 0, begun = false; n < drawn.length; n++) {
      const i = drawn[n], x = x0 + time[i] * perSecond;
      const y = MARGIN.top + (1 - axis.share(column[i] * scale)) * high;
      if (!Number.isFinite(y)) {
        begun = false;
        continue;
      }
      if (begun && line.step) pen.lineTo(x, oldY);
      if (begun) pen.lineTo(x, y); else pen.moveTo(x, y);
      oldY = y;
      begun = true;
    }
    pen.stroke();
    pen.setLineDash([]);
  }

  // Below: where a count grew, and events.
  function drawMarks(pen) {
    const base = frame.height - MARGIN.bottom;
    if (spec.marks) history.cars.forEach((car, k) => {
      const column = car.columns[spec.marks.column], [from, to] = span(car);
      if (!column) return;
      pen.fillStyle = palette.series[k % 6];
      let lastX = -Infinity;
      for (let i = from + 1; i <= to; i++) {
        if (!(column[i] > column[i - 1])) continue;
        const x = toPixel(car.columns.time[i], 0)[0];
        if (x - lastX < 2) continue;
        pen.fillRect(x - 1, base - 9, 2, 9);
        lastX = x;
      }
    });
    pen.fillStyle = palette.ink;
    for (const event of history.events) {
      if (event.time < plot.from || event.time > plot.to) continue;
      const x = toPixel(event.time, 0)[0];
      pen.beginPath();
      pen.moveTo(x, MARGIN.top + 6);
      pen.lineTo(x - 4, MARGIN.top - 2);
      pen.lineTo(x + 4, MARGIN.top - 2);
      pen.fill();
    }
  }

  // -- the part that moves: the cursor

  function paint() {
    const {pen} = frame, t = clock.shown, base = frame.height - MARGIN.bottom;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.drawImage(frame.still, 0, 0);
    pen.setTransform(frame.dense, 0, 0, frame.dense, 0, 0);
    if (clock.cursor !== null) drawCursor(clock.t, palette.muted, 1, base);
    drawCursor(t, palette.ink, 1.5, base);
    for (const line of lines) {
      const value = valueAt(line.car, line.column, t, line.step) * scale;
      const [x, y] = toPixel(Math.min(t, line.car.count ? line.car.columns.time[line.car.count - 1] : t), value);
      if (!Number.isFinite(y) || x < MARGIN.left - 1 || x > frame.width - MARGIN.right + 2) continue;
      pen.fillStyle = colourOf(line);
      pen.strokeStyle = palette.ground;
      pen.lineWidth = 1.5;
      pen.beginPath();
      pen.arc(x, y, 3.6, 0, 2 * Math.PI);
      pen.fill();
      pen.stroke();
    }
  }

  function drawCursor(t, colour, wide, base) {
    const {pen} = frame, x = Math.min(toPixel(t, 0)[0], frame.width - MARGIN.right);
    if (x < MARGIN.left) return;
    pen.strokeStyle = colour;
    pen.lineWidth = wide;
    pen.beginPath();
    pen.moveTo(x, MARGIN.top - 4);
    pen.lineTo(x, base);
    pen.stroke();
  }

  // -- words

  const unit = spec.unit === "°" ? "°" : spec.unit ? ` ${spec.unit}` : "", digits = spec.digits ?? 2;
  const figures = value => spec.log ? String(+value.toPrecision(3)) : signed(value, digits);
  const inUnits = value => `${figures(value)}${unit}`;

  function textAt(line, t) {
    const value = valueAt(line.car, line.column, t, line.step) * scale, {band} = spec;
    const halfWidth = band && line.column === band.column ? (band.k ?? 2) * valueAt(line.car, band.sigma, t) : NaN;
    if (!Number.isFinite(value) || !Number.isFinite(halfWidth)) return inUnits(value);
    if (!band.ratio) return `${signed(value, digits)} ± ${inUnits(halfWidth * scale)}`;
    const [low, high] = [-halfWidth, halfWidth].map(bound => signed(value * Math.exp(bound), digits));
    return `${inUnits(value)} (${low} to ${high})`;
  }

  function truthAt(t) {
    let current = NaN;
    eachTruth((time, value) => { if (time <= t + 1e-9) current = value; });
    return current;
  }

  // The values beside the labels.
  function tell() {
    const t = clock.shown, limit = limits.find(candidate => candidate.value > 0);
    if (limit) write(frame.limit, ` ${limit.label} ${sidesOf(limit)}${inUnits(limit.value * scale)}`);
    if (spec.marks) write(frame.limit, marked().length ? ` bars below: ${spec.marks.label}` : "");
    lines.forEach((line, i) => write(values[i], textAt(line, t)));
    if (truthValue) truthValue.parentNode.hidden = !hasTruth();
    if (hasTruth()) write(truthValue, inUnits(truthAt(t)));
    canvas.setAttribute("aria-valuemin", clock.start.toFixed(2));
    canvas.setAttribute("aria-valuemax", clock.end.toFixed(2));
    canvas.setAttribute("aria-valuenow", t.toFixed(2));
    canvas.setAttribute("aria-valuetext", `${signed(t, 2)} s: ${spoken(t)}`);
  }

  function spoken(t) {
    const texts = lines.map(line => `${line.name} ${textAt(line, t)}`);
    if (hasTruth()) texts.push(`true ${inUnits(truthAt(t))}`);
    return texts.join(", ");
  }

  // The counts that have grown up to the instant that is shown.
  function marked() {
    if (!spec.marks) return [];
    const {column, label} = spec.marks;
    const counts = history.cars.map(car => [car.name, valueAt(car, column, clock.shown, true)]);
    return counts.filter(([, count]) => count > 0).map(([name, count]) => ` ${name}: ${label} ${count} times.`);
  }

  // Of a line in the window: least and largest, and when each was.
  function range(line) {
    const [from, to] = span(line.car), column = line.car.columns[line.column], {time} = line.car.columns;
    let low = -1, high = -1;
    for (let i = from; i <= to; i++) {
      if (time[i] < plot.from || time[i] > plot.to || !Number.isFinite(column[i])) continue;
      if (low < 0 || column[i] < column[low]) low = i;
      if (high < 0 || column[i] > column[high]) high = i;
    }
    if (low < 0) return null;
    return {low: column[low] * scale, high: column[high] * scale, lowAt: time[low], highAt: time[high]};
  }

  function rangeText(line) {
    const lineRange = range(line);
    if (!lineRange) return "";
    if (lineRange.low === lineRange.high) return ` ${line.name}: ${inUnits(lineRange.low)} throughout.`;
    const at = (value, t) => `${inUnits(value)} at ${signed(t, 1)} s`;
    return ` ${line.name}: from ${at(lineRange.low, lineRange.lowAt)} to ${at(lineRange.high, lineRange.highAt)}.`;
  }

  const sidesOf = ({value}) => limits.some(other => other.value === -value) ? "±" : "";

  function describe() {
    [plot.from, plot.to] = window_(plot);
    const ends = `Between ${signed(plot.from, 1)} and ${signed(Math.min(plot.to, clock.end), 1)} s:`;
    const above = limits.filter(({value}) => value > 0);
    const met = above.map(limit => ` The ${limit.label} is ${sidesOf(limit)}${inUnits(limit.value * scale)}.`);
    const summary = `${spec.title} at ${signed(clock.shown, 2)} s: ${spoken(clock.shown)}.`;
    return `${summary} ${ends}${[...lines.map(rangeText), ...met, ...marked()].join("")}`;
  }

  listenTo(plot, clock, px => toValue(px, 0)[0]);
  return plot;
}

// ---- the planned moves

function makeMovesPlot(spec, history, clock) {
  const frame = makeFrame(spec, history), {canvas, figure} = frame, scale = spec.scale ?? 1;
  const axis = makeAxis({least: 0.02, around0: true}), several = history.cars.length > 1;
  const values = history.cars.map((car, k) =>
    frame.entry(frame.row(k), `var(--series-${k % 6})`, [], several ? car.name : "next move", 7));
  const plot = {
    name: spec.name, spec, frame, figure, canvas, lines: [], axis, values, drawnAt: -1, stale: true,
    describe, paintStill() {}, paint, tell, resize: frame.resize,
  };
  canvas.setAttribute("role", "img");

  // The different limits (rad) of the cars' plans.
  const limitsOfMoves = () => [...new Set(history.cars.map(car => movesOf(car)?.most).filter(Number.isFinite))];
  const movesOf = car => car.count ? car.moves?.(indexAt(car.columns.time, car.count, clock.shown)) ?? null : null;

  function paint() {
    const {pen} = frame, [wide, high] = frame.inside;
    pen.setTransform(frame.dense, 0, 0, frame.dense, 0, 0);
    pen.clearRect(0, 0, frame.width, frame.height);
    let most = 0, count = 1;
    for (const car of history.cars) {
      const plan = movesOf(car);
      if (!plan) continue;
      count = Math.max(count, plan.count);
      for (let j = 0; j < plan.count; j++) most = Math.max(most, Math.abs(plan.values[j] * scale));
    }
    const limits = limitsOfMoves().map(limit => limit * scale), reach = 6 * most;
    for (const limit of limits) if (limit < reach) most = Math.max(most, limit);  // one that is far away would hide the moves
    axis.fit(-most, most);
    const y = value => MARGIN.top + (1 - axis.share(value)) * high;
    drawMovesAxes(pen, wide, high, count, y);
    history.cars.forEach((car, k) => drawBars(pen, movesOf(car), k, wide / count, y));
    drawMoveLimits(pen, limits, wide, y);
  }

  function drawMovesAxes(pen, wide, high, count, y) {
    pen.font = `11.5px ${palette.font}`;
    pen.fillStyle = palette.muted;
    pen.strokeStyle = palette.grid;
    pen.lineWidth = 1;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    pen.beginPath();
    for (let tick = axis.low; tick <= axis.high + axis.step * 1e-6; tick += axis.step) {
      pen.moveTo(MARGIN.left, Math.round(y(tick)) + 0.5);
      pen.lineTo(MARGIN.left + wide, Math.round(y(tick)) + 0.5);
      pen.fillText(tickText(tick, axis.step), MARGIN.left - 5, y(tick));
    }
    pen.stroke();
    pen.textAlign = "center";
    pen.textBaseline = "alphabetic";
    const every = Math.max(1, Math.ceil(count / 6));
    for (let j = 0; j < count; j += every)
      pen.fillText(`${j + 1}`, MARGIN.left + (j + 0.5) * wide / count, frame.height - 5);
    pen.textAlign = "right";
    if (count > 1) pen.fillText("period", frame.width - 2, frame.height - 5);
  }

  function drawBars(pen, plan, k, slot, y) {
    if (!plan) return;
    const cars = history.cars.length, bar = Math.min(slot * 0.7 / cars, 22), zero = y(0);
    pen.fillStyle = pen.strokeStyle = palette.series[k % 6];
    pen.lineWidth = 1.5;
    for (let j = 0; j < plan.count; j++) {
      const x = MARGIN.left + (j + 0.5) * slot + (k - cars / 2) * bar, top = y(plan.values[j] * scale);
      if (k) pen.strokeRect(x + 1, Math.min(top, zero), Math.max(bar - 2, 1), Math.max(Math.abs(top - zero), 1));
      else pen.fillRect(x, Math.min(top, zero), bar - 1, Math.max(Math.abs(top - zero), 1.5));
    }
  }

  function drawMoveLimits(pen, limits, wide, y) {
    pen.strokeStyle = palette.warn;
    pen.lineWidth = 1.2;
    pen.setLineDash([10, 4]);
    pen.beginPath();
    for (const value of limits.flatMap(limit => [limit, -limit])) {
      if (Math.abs(value) > axis.high * 1.001) continue;
      pen.moveTo(MARGIN.left, y(value));
      pen.lineTo(MARGIN.left + wide, y(value));
    }
    pen.stroke();
    pen.setLineDash([]);
  }

  const inUnits = value => `${signed(value * scale, spec.digits)}°`;

  function tell() {
    history.cars.forEach((car, k) => {
      const plan = movesOf(car);
      write(values[k], plan ? inUnits(plan.values[0]) : "–");
    });
    write(frame.limit, limitsOfMoves().map((limit, k) => ` ${k ? "and" : "limit"} ±${inUnits(limit)}`).join(""));
    canvas.setAttribute("aria-label", describe());
  }

  function describe() {
    const texts = history.cars.map(car => {
      const plan = movesOf(car);
      if (!plan) return `${car.name} plans no moves`;
      const most = Math.max(...Array.from(plan.values.subarray(0, plan.count), Math.abs));
      const limit = Number.isFinite(plan.most) ? ` of at most ±${inUnits(plan.most)}` : "";
      const next = inUnits(plan.values[0]);
      return `${car.name} plans ${plan.count} moves, the next ${next}, the largest ${inUnits(most)}${limit}`;
    });
    return `${spec.title} at ${signed(clock.shown, 2)} s: ${texts.join("; ")}.`;
  }

  return plot;
}

// ---- pointer and keys of a plot

function listenTo(plot, clock, timeAt) {
  const {canvas} = plot, at = event => timeAt(event.clientX - canvas.getBoundingClientRect().left);
  let begun = null, dragging = false;
  const aside = event => Math.abs(event.clientX - begun.x) > Math.max(8, Math.abs(event.clientY - begun.y));
  canvas.addEventListener("pointermove", event => {
    const touch = event.pointerType === "touch";
    if (begun && touch && aside(event)) dragging = true;  // a finger that goes up or down scrolls the page
    if (dragging) clock.seek(at(event));
    else if (!touch) clock.hover(at(event), "plot");
  });
  canvas.addEventListener("pointerdown", event => {
    if (event.button !== 0) return;
    begun = {x: event.clientX, y: event.clientY};
    dragging = event.pointerType !== "touch";
    canvas.setPointerCapture(event.pointerId);
    clock.leave();
    if (dragging) clock.seek(at(event));
  });
  const end = () => {
    begun = null;
    dragging = false;
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("click", event => {
    clock.leave();
    clock.seek(at(event));
  });
  canvas.addEventListener("pointerleave", () => { if (clock.from === "plot" && !dragging) clock.leave(); });
  canvas.addEventListener("blur", () => { if (clock.from === "plot") clock.leave(); });
  canvas.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = event.shiftKey ? 1 : clock.period, to = t => clock.hover(t, "plot");
    const keys = {
      ArrowLeft: () => to(clock.shown - step), ArrowRight: () => to(clock.shown + step),
      ArrowDown: () => to(clock.shown - step), ArrowUp: () => to(clock.shown + step),
      PageDown: () => to(clock.shown - 10), PageUp: () => to(clock.shown + 10),
      Home: () => to(clock.start), End: () => to(clock.end),
      Enter: () => { clock.seek(clock.shown); clock.leave(); }, Escape: () => clock.leave(),
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });
}

// ---- all plots

const SPANS = [10, 20, 30, 60, 90, 120, 180, 300, 600, 900, 1200, 1800, 2700, 3600, 5400, 7200, 14400];
const STEPS = 300;  // of a window: what moves by less is not drawn anew while it plays
const TELL = 120;  // ms between two changes of the words while it plays
const AT_ONCE = 4, AT_ONCE_SLOW = 2, SLOW = 20;  // plots drawn anew in a frame; where frames take longer than SLOW ms

function makePlots(box, history, clock) {
  const plots = {list: [], show, setSpan, choose, describe, draw, span: 20};
  let chosen = null, from = 0, toldAt = -Infinity, told = NaN, painted = NaN, seen = null, before = 0, pace = 0;
  box.classList.add("plots");

  // The window: of so many seconds about the clock, moved only when the clock comes to its edge.
  function windowNow() {
    const start = clock.start, end = Math.max(clock.end, start + 1e-3);
    if (!plots.span) return [start, clock.live ? start + SPANS.find(span => span > end - start) : end];
    const span = clock.live ? plots.span : Math.min(plots.span, end - start), step = span / STEPS;
    if (clock.t > from + 0.96 * span) from = clock.t - 0.96 * span;
    if (clock.t < from) from = clock.t - 0.04 * span;
    from = start + Math.ceil((from - start) / step - 1e-6) * step;
    from = Math.max(start, clock.live ? from : Math.min(from, end - span));
    return [from, from + span];
  }

  function show(other) {
    history = other;
    build();
  }

  function choose(names) {
    chosen = names;
    build();
  }

  function setSpan(seconds) {
    plots.span = seconds;
    clock.ask();
  }

  function build() {
    observer.disconnect();
    from = clock.start;
    plots.list = specsFor(history, chosen).map(spec =>
      spec.kind === "moves" ? makeMovesPlot(spec, history, clock) : makeTimePlot(spec, history, clock, windowNow));
    box.replaceChildren(...plots.list.map(plot => plot.figure));
    for (const plot of plots.list) {
      plot.resize();
      observer.observe(plot.canvas);
    }
    draw();
  }

  const observer = new ResizeObserver(entries => {
    for (const plot of plots.list) if (entries.some(entry => entry.target === plot.canvas)) plot.resize();
    draw();
  });

  // What the lines depend on: as long as none of it changes they are not drawn again.
  function state([left, right]) {
    const step = clock.playing ? (right - left) / STEPS : 1e-9, known = Math.floor(Math.min(clock.end, right) / step);
    const truths = Object.values(history.truth ?? {}).reduce((n, each) => n + each.length, 0);
    return [left, right, known, palette.version, history.events.length, truths];
  }

  function paint(now) {
    const ends = windowNow(), next = state(ends);
    if (!seen || next.some((value, i) => value !== seen[i])) for (const plot of plots.list) plot.stale = true;
    seen = next;
    pace += 0.1 * (Math.min(now - before, 100) - pace);
    before = now;
    const drawn = plots.list.filter(plot => plot.stale).sort((a, b) => a.drawnAt - b.drawnAt);
    drawn.length = Math.min(drawn.length, clock.playing && pace > SLOW ? AT_ONCE_SLOW : AT_ONCE);
    for (const plot of drawn) {
      plot.paintStill(now);
      plot.stale = false;
    }
    const moved = !clock.playing || !(Math.abs(clock.t - painted) < 0.5 * (ends[1] - ends[0]) / STEPS);
    if (moved) painted = clock.t;
    for (const plot of moved ? plots.list : drawn) plot.paint();
    if (plots.list.some(plot => plot.stale)) clock.ask();
    if (clock.shown !== told && (!clock.playing || now - toldAt > TELL)) tell(now);
  }

  function tell(now) {
    told = clock.shown;
    toldAt = now;
    for (const plot of plots.list) plot.tell();
  }

  function draw() {
    const time = performance.now();
    for (const plot of plots.list) {
      plot.paintStill(time);
      plot.stale = false;
      plot.paint();
    }
    tell(time);
  }

  function describe() {
    return plots.list.map(plot => plot.describe()).join(" ");
  }

  onPaletteChange(clock.ask);
  build();
  clock.paint(paint);
  return plots;
}
