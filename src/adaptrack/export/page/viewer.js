"use strict";
// The road from above with the cars on it, drawn on one canvas. Needs history.js and transport.js (a clock).
// World: x forward, y left, m, rad. Screen: CSS px, y down.
//
//   view = makeRoadView(canvas, history, clock, options)
//     options: onpush(car, {x, y})   a car was dragged aside, m in its axes (x ahead, y to the left); without it a drag
//                                    on a car moves the picture
//     show(history)          another drive
//     followCar(), showWhole(), look({x, y, scale}), zoom(factor, px?, py?), pan(dx, dy), choose(car)
//     follow, whole, chosen, scale, x, y, width, height   what is shown (read only)
//     onview                 called when follow, whole or the chosen car change
//     place(car)             where a car is now: {index, x, y, yaw, wheel_angle, failed}
//     toScreen(x, y), toWorld(px, py)
//     startDrawing(done)     a road is drawn by hand: done(points [[x, y], ...] m, closed) or done(null) on Escape;
//                            with the pointer in one stroke, with the keyboard arrows and Enter, C closes, D is done
//     stopDrawing()
//     describe()             what the picture shows, in words
//     draw()                 now, without waiting for a frame
//
//   Hovering the driven line sets the clock's cursor, a click on it seeks. While the cursor is set by a plot, the
//   picture shows that instant: the car itself where the drive stands still, a ghost where it plays.
//   Colours: CSS variables --ink --muted --grid --ground --raised --road --warn --ice --series-0..5 of the document;
//   refreshPalette() reads them anew after a change of theme.

// ---- colours, shared with the plots

const palette = {version: 0, series: []};

function refreshPalette() {
  const style = getComputedStyle(document.documentElement);
  const read = (name, otherwise) => style.getPropertyValue(`--${name}`).trim() || otherwise;
  for (const name of ["ink", "muted", "grid", "ground", "warn"]) palette[name] = read(name, "#777");
  palette.raised = read("raised", palette.ground);
  palette.road = read("road", palette.grid);
  palette.ice = read("ice", "#9fd4f5");
  palette.font = read("font", "system-ui, sans-serif");
  palette.series = [0, 1, 2, 3, 4, 5].map(i => read(`series-${i}`, "#0072b2"));
  palette.version++;
}

function onPaletteChange(then) {
  if (!palette.version) refreshPalette();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    refreshPalette();
    then();
  });
}

// ---- lines that are mostly outside of the picture

const CHUNK = 64;

// The bounds of each CHUNK pieces of a line that may grow.
function makeBounds() {
  let boxes = new Float64Array(4 * 64), known = 0;
  return {
    forget() { known = 0; },
    chunks: count => Math.max(0, Math.ceil((count - 1) / CHUNK)),
    update(xs, ys, count) {
      const last = Math.max(0, Math.ceil((count - 1) / CHUNK));
      while (boxes.length < 4 * last) boxes = grown(boxes);
      for (let c = Math.floor(known / CHUNK); c < last; c++) {
        let left = Infinity, right = -Infinity, low = Infinity, high = -Infinity;
        const end = Math.min((c + 1) * CHUNK, count - 1);
        for (let i = c * CHUNK; i <= end; i++) {
          if (xs[i] < left) left = xs[i];
          if (xs[i] > right) right = xs[i];
          if (ys[i] < low) low = ys[i];
          if (ys[i] > high) high = ys[i];
        }
        boxes[4 * c] = left;
        boxes[4 * c + 1] = low;
        boxes[4 * c + 2] = right;
        boxes[4 * c + 3] = high;
      }
      known = Math.max(count - 1, 0);
    },
    meets(c, left, low, right, high) {
      return boxes[4 * c] <= right && boxes[4 * c + 2] >= left && boxes[4 * c + 1] <= high && boxes[4 * c + 3] >= low;
    },
  };
}

// ---- the view

const LEAST_SCALE = 0.002, MOST_SCALE = 200;  // px/m
const RING = 60;  // s of trail while the car is followed

function makeRoadView(canvas, history, clock, options = {}) {
  const screen = canvas.getContext("2d"), still = document.createElement("canvas"), stillPen = still.getContext("2d");
  const view = {x: 0, y: 0, scale: 10, width: 1, height: 1, follow: true, whole: false, chosen: 0, onview: null};
  const drawn = {x: NaN, y: NaN, scale: NaN, width: 0, height: 0, version: -1, history: null, patches: 0, upTo: []};
  const bounds = {left: makeBounds(), right: makeBounds(), trails: []};
  let pen = screen, places = [], ghosts = [], push = null, sketch = null;

  // -- what is where

  const toScreen = (x, y) => [view.width / 2 + (x - view.x) * view.scale, view.height / 2 - (y - view.y) * view.scale];
  const toWorld = (px, py) => [
    view.x + (px - view.width / 2) / view.scale, view.y + (view.height / 2 - py) / view.scale,
  ];
  const clampScale = scale => Math.min(Math.max(scale, LEAST_SCALE), MOST_SCALE);

  function show(other) {
    history = other;
    view.chosen = Math.min(view.chosen, history.cars.length - 1);
    const {road} = history;
    if (!road.s) road.s = stationsOf(road);
    bounds.left.forget();
    bounds.right.forget();
    bounds.left.update(road.left_x, road.left_y, road.x.length);
    bounds.right.update(road.right_x, road.right_y, road.x.length);
    bounds.trails = history.cars.map(makeBounds);
    places = history.cars.map(() => ({}));
    ghosts = history.cars.map(() => ({}));
    drawn.history = null;
    if (view.whole) showWhole();
    clock.ask();
  }

  // Lengths along the chords, scaled to the road's length.
  function stationsOf({x, y, length}) {
    const s = new Float64Array(x.length);
    for (let i = 1; i < s.length; i++) s[i] = s[i - 1] + Math.hypot(x[i] - x[i - 1], y[i] - y[i - 1]);
    const scale = length > 0 && s.length > 1 ? length / s[s.length - 1] : 1;
    return s.map(length => length * scale);
  }

  function setMode(follow, whole) {
    const changed = view.follow !== follow || view.whole !== whole;
    view.follow = follow;
    view.whole = whole;
    if (changed) view.onview?.();
    clock.ask();
  }

  function showWhole() {
    const {road} = history, box = [Infinity, Infinity, -Infinity, -Infinity];
    const widen = (xs, ys, count) => {
      for (let i = 0; i < count; i++) {
        if (xs[i] < box[0]) box[0] = xs[i];
        if (ys[i] < box[1]) box[1] = ys[i];
        if (xs[i] > box[2]) box[2] = xs[i];
        if (ys[i] > box[3]) box[3] = ys[i];
      }
    };
    widen(road.left_x, road.left_y, road.left_x.length);
    widen(road.right_x, road.right_y, road.right_x.length);
    for (const car of history.cars) widen(car.columns.x, car.columns.y, car.count);
    view.x = (box[0] + box[2]) / 2;
    view.y = (box[1] + box[3]) / 2;
    const width = Math.max(box[2] - box[0], 1), high = Math.max(box[3] - box[1], 1);
    view.scale = clampScale(Math.min((view.width - 40) / width, (view.height - 56) / high));
    setMode(false, true);
  }

  function followCar() {
    view.scale = Math.min(Math.max(view.width / 80, 7), 14);
    setMode(true, false);
  }

  function look({x = view.x, y = view.y, scale = view.scale}) {
    Object.assign(view, {x, y, scale: clampScale(scale)});
    setMode(false, false);
  }

  // About a point of the screen, which stays where it is; about the car while it is followed.
  function zoom(factor, px = view.width / 2, py = view.height / 2) {
    const [x, y] = toWorld(px, py);
    view.scale = clampScale(view.scale * factor);
    if (!view.follow) {
      const [newX, newY] = toWorld(px, py);
      view.x += x - newX;
      view.y += y - newY;
    }
    setMode(view.follow, false);
  }

  function pan(dx, dy) {
    view.x -= dx / view.scale;
    view.y += dy / view.scale;
    setMode(false, false);
  }

  function choose(car) {
    view.chosen = Math.min(Math.max(car, 0), history.cars.length - 1);
    view.onview?.();
    clock.ask();
  }

  // -- the road

  const inView = (box, c, margin = 0) => {
    const width = (view.width / 2 + margin) / view.scale, high = (view.height / 2 + margin) / view.scale;
    return box.meets(c, view.x - width, view.y - high, view.x + width, view.y + high);
  };

  // Points [from, to] of a line; those nearer than `least` px to the one before are left out.
  function trace(xs, ys, from, to, least, begin) {
    const {scale} = view, ox = view.width / 2 - view.x * scale, oy = view.height / 2 + view.y * scale;
    const step = from <= to ? 1 : -1;
    let oldX = ox + xs[from] * scale, oldY = oy - ys[from] * scale;
    if (begin) pen.moveTo(oldX, oldY); else pen.lineTo(oldX, oldY);
    for (let i = from + step; step * (to - i) >= 0; i += step) {
      const px = ox + xs[i] * scale, py = oy - ys[i] * scale;
      if (i !== to && Math.abs(px - oldX) < least && Math.abs(py - oldY) < least) continue;
      pen.lineTo(px, py);
      oldX = px;
      oldY = py;
    }
  }

  // The runs of the road's points that may be in the picture.
  function eachVisibleRun(then) {
    const n = history.road.x.length, chunks = bounds.left.chunks(n);
    for (let c = 0; c < chunks; c++) {
      const first = c;
      while (c < chunks && (inView(bounds.left, c, 40) || inView(bounds.right, c, 40))) c++;
      if (c > first) then(first * CHUNK, Math.min(c * CHUNK, n - 1));
    }
  }

  function drawGrid() {
    const step = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000].find(length => length * view.scale >= 70);
    if (!step) return;
    const [left, top] = toWorld(0, 0), [right, bottom] = toWorld(view.width, view.height);
    pen.strokeStyle = palette.grid;
    pen.globalAlpha = 0.55;
    pen.lineWidth = 1;
    pen.beginPath();
    for (let x = Math.ceil(left / step) * step; x < right; x += step) {
      const px = Math.round((x - view.x) * view.scale + view.width / 2) + 0.5;
      pen.moveTo(px, 0);
      pen.lineTo(px, view.height);
    }
    for (let y = Math.ceil(bottom / step) * step; y < top; y += step) {
      const py = Math.round(view.height / 2 - (y - view.y) * view.scale) + 0.5;
      pen.moveTo(0, py);
      pen.lineTo(view.width, py);
    }
    pen.stroke();
    pen.globalAlpha = 1;
  }

  function drawRoad() {
    const {road} = history;
    eachVisibleRun((from, to) => {
      pen.beginPath();
      trace(road.left_x, road.left_y, from, to, 0.7, true);
      trace(road.right_x, road.right_y, to, from, 0.7, false);
      pen.closePath();
      pen.fillStyle = palette.road;
      pen.fill();
    });
    drawPatches();
    eachVisibleRun((from, to) => {
      pen.strokeStyle = palette.muted;
      pen.lineWidth = 1.2;
      pen.beginPath();
      trace(road.left_x, road.left_y, from, to, 0.7, true);
      trace(road.right_x, road.right_y, from, to, 0.7, true);
      pen.stroke();
      if (view.scale <= 3) return;  // from where the centre line does not hide the trail
      pen.setLineDash([6, 8]);
      pen.lineDashOffset = (road.s[from] * view.scale) % 14;
      pen.lineWidth = 1;
      pen.beginPath();
      trace(road.x, road.y, from, to, 0.7, true);
      pen.stroke();
      pen.setLineDash([]);
    });
  }

  // Ice: a colour and hatching, so that it is told apart without colours.
  function drawPatches() {
    for (const patch of history.patches) {
      pen.save();
      pen.beginPath();
      tracePatch(patch);
      pen.fillStyle = pen.strokeStyle = palette.ice;
      pen.lineWidth = 6;
      if (view.scale < 1.5) pen.stroke();  // of a road that is a few pixels wide
      pen.fill();
      pen.clip();
      hatch();
      pen.restore();
    }
  }

  function tracePatch({from, to}) {
    const {road} = history, {length} = road, whole = road.closed && length > 0;
    const start = whole ? from - length * Math.floor(from / length) : from, end = start + (to - from);
    traceBetween(road, start, Math.min(end, whole ? length : Infinity));
    if (whole && end > length) traceBetween(road, 0, end - length);
  }

  // The surface between two stations.
  function traceBetween(road, start, end) {
    const n = road.s.length, i = indexAt(road.s, n, start), j = indexAt(road.s, n, end);
    const at = (line, k, s) => {
      const next = Math.min(k + 1, n - 1), gap = road.s[next] - road.s[k];
      const share = gap > 0 ? Math.min(Math.max((s - road.s[k]) / gap, 0), 1) : 0;
      return line[k] + share * (line[next] - line[k]);
    };
    const point = (side, k, s, begin) => {
      const [px, py] = toScreen(at(road[`${side}_x`], k, s), at(road[`${side}_y`], k, s));
      if (begin) pen.moveTo(px, py); else pen.lineTo(px, py);
    };
    point("left", i, start, true);
    if (j > i) trace(road.left_x, road.left_y, i + 1, j, 0, false);
    point("left", j, end, false);
    point("right", j, end, false);
    if (j > i) trace(road.right_x, road.right_y, j, i + 1, 0, false);
    point("right", i, start, false);
    pen.closePath();
  }

  function hatch() {
    const gap = 9, reach = view.width + view.height;
    pen.strokeStyle = palette.ink;
    pen.globalAlpha = 0.35;
    pen.lineWidth = 1;
    pen.beginPath();
    const shift = ((view.width / 2 - view.x * view.scale) + (view.height / 2 + view.y * view.scale)) % gap;
    for (let d = shift - gap; d < reach; d += gap) {
      pen.moveTo(d, 0);
      pen.lineTo(d - view.height, view.height);
    }
    pen.stroke();
    pen.globalAlpha = 1;
  }

  // -- the driven line

  function shadeOf(error) {
    const {shades, top} = history;
    return Math.round(Math.min(Math.abs(error) / top, 1) * (shades.length - 1)) || 0;
  }

  // Samples [from, to]: each colour's pieces as one line, points nearer than a pixel left out.
  function drawTrail(car, k, from, to) {
    if (to <= from) return;
    const {x, y} = car.columns;
    bounds.trails[k].update(x, y, car.count);
    if (history.cars.length > 1) drawCasing(car, k, from, to);
    const errors = errorOf(car), {scale} = view, wide = view.follow ? 3 : 2.5;
    const ox = view.width / 2 - view.x * scale, oy = view.height / 2 + view.y * scale;
    pen.lineWidth = wide;
    for (let i = from; i < to;) {
      const c = Math.floor(i / CHUNK), end = Math.min((c + 1) * CHUNK, to);
      if (!inView(bounds.trails[k], c, 10)) {
        i = end;
        continue;
      }
      let oldX = ox + x[i] * scale, oldY = oy - y[i] * scale, shade = shadeOf(errors[i]), worst = errors[i];
      pen.strokeStyle = history.shades[shade] ?? palette.series[k];
      pen.beginPath();
      pen.moveTo(oldX, oldY);
      for (i++; i <= end; i++) {
        if (Math.abs(errors[i]) > Math.abs(worst)) worst = errors[i];
        const px = ox + x[i] * scale, py = oy - y[i] * scale;
        if (i < end && Math.abs(px - oldX) < 1 && Math.abs(py - oldY) < 1) continue;
        pen.lineTo(px, py);
        oldX = px;
        oldY = py;
        const next = shadeOf(worst);
        worst = errors[i];
        if (next === shade) continue;
        pen.stroke();
        shade = next;
        pen.strokeStyle = history.shades[shade] ?? palette.series[k];
        pen.beginPath();
        pen.moveTo(px, py);
      }
      pen.stroke();
      i = end;
    }
  }

  // Whose line it is, where there are two: an edge in the car's colour.
  function drawCasing(car, k, from, to) {
    pen.strokeStyle = palette.series[k % 6];
    pen.lineWidth = view.follow ? 6 : 5.5;
    pen.globalAlpha = 0.45;
    pen.beginPath();
    for (let i = from; i < to;) {
      const c = Math.floor(i / CHUNK), end = Math.min((c + 1) * CHUNK, to);
      if (inView(bounds.trails[k], c, 10)) trace(car.columns.x, car.columns.y, i, end, 1, true);
      i = end;
    }
    pen.stroke();
    pen.globalAlpha = 1;
  }

  function drawLastPiece(car, place) {
    const {x, y} = car.columns, i = place.index;
    pen.strokeStyle = history.shades[shadeOf(errorOf(car)[i])] ?? palette.ink;
    pen.lineWidth = view.follow ? 3 : 2.5;
    pen.beginPath();
    pen.moveTo(...toScreen(x[i], y[i]));
    pen.lineTo(...toScreen(place.x, place.y));
    pen.stroke();
  }

  const trailStart = (car, t) => view.follow ? indexAt(car.columns.time, car.count, t - RING) : 0;

  // What does not change while the picture stands still: kept, and only added to.
  function drawStill(t) {
    const stale = drawn.x !== view.x || drawn.y !== view.y || drawn.scale !== view.scale || drawn.history !== history
      || drawn.width !== canvas.width || drawn.height !== canvas.height || drawn.version !== palette.version
      || drawn.patches !== history.patches.length || places.some((place, k) => place.index < drawn.upTo[k]);
    pen = stillPen;
    if (stale) {
      still.width = canvas.width;
      still.height = canvas.height;
      prepare();
      drawGrid();
      drawRoad();
      Object.assign(drawn, {
        x: view.x, y: view.y, scale: view.scale, history, width: canvas.width, height: canvas.height,
        version: palette.version, patches: history.patches.length, upTo: places.map(() => 0),
      });
    }
    history.cars.forEach((car, k) => {
      if (places[k].index < 0) return;
      drawTrail(car, k, drawn.upTo[k], places[k].index);
      drawn.upTo[k] = Math.max(places[k].index, 0);
    });
    pen = screen;
    screen.setTransform(1, 0, 0, 1, 0, 0);
    screen.clearRect(0, 0, canvas.width, canvas.height);
    screen.drawImage(still, 0, 0);
    prepare();
  }

  function drawMoving(t) {
    drawn.x = NaN;
    prepare();
    pen.clearRect(0, 0, view.width, view.height);
    drawGrid();
    drawRoad();
    history.cars.forEach((car, k) => {
      if (places[k].index >= 0) drawTrail(car, k, trailStart(car, t), places[k].index);
    });
  }

  function prepare() {
    const dense = canvas.width / Math.max(view.width, 1);
    pen.setTransform(dense, 0, 0, dense, 0, 0);
    pen.lineJoin = pen.lineCap = "round";
  }

  // -- what the controller expects

  function drawPredicted(car, k, place) {
    const path = car.predicted?.(place.index);
    if (!path) return;
    const {scale} = view, ahead = Math.cos(place.yaw), aside = Math.sin(place.yaw);
    const ox = view.width / 2 - view.x * scale, oy = view.height / 2 + view.y * scale;
    for (let pass = 0; pass < 2; pass++) {  // on an edge of the ground's colour, so that it shows on every trail
      pen.strokeStyle = pass ? palette.series[k % 6] : palette.ground;
      pen.lineWidth = pass ? 2.5 : 5;
      pen.setLineDash(pass ? [1, 6] : []);
      pen.globalAlpha = pass ? 1 : 0.6;
      pen.beginPath();
      pen.moveTo(ox + place.x * scale, oy - place.y * scale);
      for (let i = 0; i < path.count; i++) {
        if ((path.x[i] - place.x) * ahead + (path.y[i] - place.y) * aside <= 0) continue;  // passed already
        pen.lineTo(ox + path.x[i] * scale, oy - path.y[i] * scale);
      }
      pen.stroke();
    }
    pen.setLineDash([]);
    pen.globalAlpha = 1;
    const px = ox + path.x[path.count - 1] * scale, py = oy - path.y[path.count - 1] * scale;
    pen.fillStyle = palette.ground;
    pen.strokeStyle = palette.series[k % 6];
    pen.lineWidth = 2;
    pen.beginPath();
    pen.arc(px, py, 4, 0, 2 * Math.PI);
    pen.fill();
    pen.stroke();
  }

  // A thin line with its points: where the planner wants the car.
  function drawTrajectory(car, place) {
    const points = car.trajectory?.(place.index)?.points;
    if (!points) return;
    pen.strokeStyle = pen.fillStyle = palette.ink;
    pen.lineWidth = 1;
    const line = new Path2D(), dots = new Path2D();
    for (let i = 0; i < points.length; i += 5) {
      const [px, py] = toScreen(points[i + 1], points[i + 2]);
      line.lineTo(px, py);
      dots.moveTo(px + 2, py);
      dots.arc(px, py, 2, 0, 2 * Math.PI);
    }
    pen.stroke(line);
    pen.fill(dots);
  }

  // -- the cars

  // A rectangle about (x, y) in the car's axes (m), turned by an angle (rad).
  function block(x, y, length, width, angle = 0) {
    pen.save();
    pen.translate(x, y);
    pen.rotate(angle);
    pen.fillRect(-length / 2, -width / 2, length, width);
    pen.restore();
  }

  function drawCar(car, k, place, ghost = false) {
    if (place.index < 0) return;
    const {front, rear, width, lf, lr, track_front, track_rear} = car.outline, colour = palette.series[k % 6];
    if (view.scale * (front + rear) < 16) return drawArrow(place, colour, ghost);
    pen.save();
    pen.translate(...toScreen(place.x, place.y));
    pen.scale(view.scale, -view.scale);
    pen.rotate(place.yaw);
    pen.fillStyle = palette.ink;
    const wheel = 0.24 * (lf + lr), tyre = 0.09 * width + 0.06;
    if (!ghost) for (const side of [-0.5, 0.5]) {
      block(lf, side * track_front, wheel, tyre, place.wheel_angle);
      block(-lr, side * track_rear, wheel, tyre);
    }
    pen.fillStyle = colour;
    pen.strokeStyle = palette.ink;
    pen.lineWidth = 1.2 / view.scale;
    if (ghost || k) pen.setLineDash(k || ghost ? [0.5, 0.25] : []);
    pen.beginPath();
    pen.roundRect(-rear, -width / 2, front + rear, width, [0.25, 0.55, 0.55, 0.25]);
    pen.globalAlpha = ghost ? 0.3 : 0.85;
    pen.fill();
    pen.globalAlpha = 1;
    pen.stroke();
    pen.setLineDash([]);
    pen.fillStyle = palette.ground;
    pen.globalAlpha = ghost ? 0.5 : 1;
    block(0.25 * front, 0, 0.18 * (front + rear), 0.78 * width);  // the windscreen says where it looks
    block(-0.62 * rear, 0, 0.1 * (front + rear), 0.7 * width);
    pen.fillStyle = palette.ink;
    if (!ghost) for (const side of [-0.5, 0.5]) block(lf, side * track_front, wheel, tyre, place.wheel_angle);
    pen.restore();
    if (history.cars.length > 1 && !ghost) drawNumber(k, place, colour);
  }

  // Which car it is, not by colour alone.
  function drawNumber(k, place, colour) {
    const [px, py] = toScreen(place.x, place.y), reach = Math.max(1.6 * view.scale, 15);
    const x = px + reach * Math.sin(place.yaw) * (k ? -1 : 1), y = py + reach * Math.cos(place.yaw) * (k ? -1 : 1);
    pen.beginPath();
    pen.arc(x, y, 8, 0, 2 * Math.PI);
    pen.fillStyle = palette.ground;
    pen.strokeStyle = colour;
    pen.lineWidth = 2;
    pen.fill();
    pen.stroke();
    pen.fillStyle = palette.ink;
    pen.font = `600 11px ${palette.font}`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(`${k + 1}`, x, y + 0.5);
    pen.textAlign = "start";
    pen.textBaseline = "alphabetic";
  }

  // Where a car to scale could not be seen: an arrow of fixed size.
  function drawArrow(place, colour, ghost) {
    pen.save();
    pen.translate(...toScreen(place.x, place.y));
    pen.rotate(-place.yaw);
    pen.beginPath();
    pen.moveTo(11, 0);
    pen.lineTo(-7, 7);
    pen.lineTo(-4, 0);
    pen.lineTo(-7, -7);
    pen.closePath();
    pen.fillStyle = colour;
    pen.strokeStyle = palette.ink;
    pen.lineWidth = 1.5;
    pen.globalAlpha = ghost ? 0.5 : 1;
    pen.fill();
    pen.stroke();
    pen.restore();
  }

  function drawCross(place) {
    const [px, py] = toScreen(place.x, place.y);
    pen.strokeStyle = palette.warn;
    pen.lineWidth = 4;
    pen.beginPath();
    for (const side of [-1, 1]) {
      pen.moveTo(px - 11, py - 11 * side);
      pen.lineTo(px + 11, py + 11 * side);
    }
    pen.stroke();
  }

  // -- words on the picture

  function drawLabel(text, px, py) {
    pen.font = `13px ${palette.font}`;
    const width = pen.measureText(text).width + 12, x = Math.min(Math.max(px + 14, 4), view.width - width - 4);
    const y = Math.min(Math.max(py - 26, 14), view.height - 14);
    pen.fillStyle = palette.ground;
    pen.globalAlpha = 0.88;
    pen.beginPath();
    pen.roundRect(x, y - 11, width, 22, 5);
    pen.fill();
    pen.globalAlpha = 1;
    pen.fillStyle = palette.ink;
    pen.fillText(text, x + 6, y + 4.5);
  }

  const eventPlace = {};

  // A mark for each; words of the newest alone.
  function drawEvents(t) {
    const past = history.events.filter(event => event.time <= t + 1e-9);
    for (const event of past) {
      placeAt(history.cars[view.chosen], event.time, eventPlace);
      const [px, py] = toScreen(eventPlace.x, eventPlace.y);
      if (px < -20 || py < -20 || px > view.width + 20 || py > view.height + 20) continue;
      pen.fillStyle = palette.ground;
      pen.strokeStyle = palette.ink;
      pen.lineWidth = 1.5;
      pen.beginPath();
      pen.moveTo(px, py - 6);
      pen.lineTo(px + 6, py);
      pen.lineTo(px, py + 6);
      pen.lineTo(px - 6, py);
      pen.closePath();
      pen.fill();
      pen.stroke();
      if (event === past[past.length - 1] && t - event.time < 6) drawLabel(event.text, px, py);
    }
  }

  // A bar of a round length, at the lower left.
  function drawBar() {
    const target = 110 / view.scale, decade = 10 ** Math.floor(Math.log10(target));
    const length = [5, 2, 1].find(step => step * decade <= target) * decade, y = view.height - 16;
    pen.strokeStyle = pen.fillStyle = palette.ink;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(16, y - 4);
    pen.lineTo(16, y);
    pen.lineTo(16 + length * view.scale, y);
    pen.lineTo(16 + length * view.scale, y - 4);
    pen.stroke();
    pen.font = `13px ${palette.font}`;
    pen.fillText(length >= 1000 ? `${length / 1000} km` : `${+length.toPrecision(1)} m`, 18, y - 8);
  }

  // -- the picture

  function draw() {
    const previewed = !clock.playing && clock.from === "plot" && clock.cursor !== null;
    const t = previewed ? clock.cursor : clock.t;
    history.cars.forEach((car, k) => placeAt(car, t, places[k]));
    const followed = places[view.chosen];
    if (view.follow && followed && followed.index >= 0) {
      view.x = followed.x;
      view.y = followed.y;
    }
    if (view.follow) drawMoving(t); else drawStill(t);
    history.cars.forEach((car, k) => { if (places[k].index >= 0) drawLastPiece(car, places[k]); });
    drawEvents(t);
    if (!previewed && clock.cursor !== null)
      history.cars.forEach((car, k) => drawCar(car, k, placeAt(car, clock.cursor, ghosts[k]), true));
    history.cars.forEach((car, k) => drawTrajectory(car, places[k]));
    history.cars.forEach((car, k) => drawPredicted(car, k, places[k]));
    history.cars.forEach((car, k) => { if (k !== view.chosen) drawCar(car, k, places[k]); });
    if (followed) drawCar(history.cars[view.chosen], view.chosen, followed);
    for (const place of places) if (place.failed) drawCross(place);
    if (clock.cursor !== null) drawCursorLabel();
    if (push) drawPush();
    if (sketch) drawSketch();
    drawBar();
  }

  function drawCursorLabel() {
    const {x, y} = placeAt(history.cars[view.chosen], clock.cursor, eventPlace), [px, py] = toScreen(x, y);
    if (px > 0 && py > 0 && px < view.width && py < view.height) drawLabel(`${signed(clock.cursor, 2)} s`, px, py);
  }

  // -- pointers

  const position = event => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };

  // The instant at which the driven line passes a point of the screen, within 14 px; NaN: none.
  function instantAt(px, py) {
    const [wx, wy] = toWorld(px, py);
    let best = (14 / view.scale) ** 2, when = NaN;
    history.cars.forEach((car, k) => {
      const {x, y, time} = car.columns;
      for (let i = trailStart(car, clock.t); i <= places[k].index; i++) {
        const distance = (x[i] - wx) ** 2 + (y[i] - wy) ** 2;
        if (distance < best) {
          best = distance;
          when = time[i];
        }
      }
    });
    return when;
  }

  function carAt(px, py) {
    let nearest = -1, best = Infinity;
    history.cars.forEach((car, k) => {
      const [x, y] = toScreen(places[k].x, places[k].y), far = Math.hypot(px - x, py - y);
      if (places[k].index >= 0 && far < best && far < Math.max(22, car.outline.front * view.scale)) {
        best = far;
        nearest = k;
      }
    });
    return nearest;
  }

  // The drag from the car to the pointer, in the car's axes.
  function pushVector() {
    const {x, y, yaw} = places[push.car], [wx, wy] = toWorld(push.px, push.py), dx = wx - x, dy = wy - y;
    return {x: dx * Math.cos(yaw) + dy * Math.sin(yaw), y: dy * Math.cos(yaw) - dx * Math.sin(yaw)};
  }

  function drawPush() {
    const [px, py] = toScreen(places[push.car].x, places[push.car].y);
    const angle = Math.atan2(push.py - py, push.px - px), {y} = pushVector();
    pen.strokeStyle = pen.fillStyle = palette.warn;
    pen.lineWidth = 4;
    pen.beginPath();
    pen.moveTo(px, py);
    pen.lineTo(push.px, push.py);
    for (const turn of [2.6, -2.6]) {
      pen.moveTo(push.px, push.py);
      pen.lineTo(push.px + 12 * Math.cos(angle + turn), push.py + 12 * Math.sin(angle + turn));
    }
    pen.stroke();
    drawLabel(`push to the ${y >= 0 ? "left" : "right"}`, push.px, push.py);
  }

  const fingers = new Map();
  let moved = 0;

  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    zoom(Math.exp(-0.0015 * event.deltaY * (event.deltaMode ? 30 : 1)), ...position(event));
  }, {passive: false});
  const ours = touch => sketch || options.onpush && carAt(...position(touch)) >= 0;
  for (const kind of ["touchstart", "touchmove"])  // two fingers are ours, and one on a car; one elsewhere may scroll
    canvas.addEventListener(kind, event => {
      if (event.touches.length > 1 || push || ours(event.touches[0])) event.preventDefault();
    }, {passive: false});

  canvas.addEventListener("pointerdown", event => {
    const at = position(event);
    fingers.set(event.pointerId, at);
    canvas.setPointerCapture(event.pointerId);
    moved = 0;
    if (sketch) return beginStroke(at);
    const car = options.onpush && fingers.size === 1 ? carAt(...at) : -1;
    push = car >= 0 ? {car, id: event.pointerId, px: at[0], py: at[1]} : null;
  });

  canvas.addEventListener("pointermove", event => {
    const at = position(event);
    if (!fingers.has(event.pointerId)) return hoverRoad(at);
    const [oldX, oldY] = fingers.get(event.pointerId);
    moved += Math.abs(at[0] - oldX) + Math.abs(at[1] - oldY);
    const other = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place)[0];
    fingers.set(event.pointerId, at);
    if (other) {
      const distance = (x, y) => Math.max(Math.hypot(x - other[0], y - other[1]), 1);
      zoom(distance(...at) / distance(oldX, oldY), (at[0] + other[0]) / 2, (at[1] + other[1]) / 2);
    } else if (sketch) {
      continueStroke(at);
    } else if (push) {
      [push.px, push.py] = at;
      clock.ask();
    } else if (event.pointerType !== "touch" || !view.follow) {  // a finger that scrolls the page goes on following
      pan(at[0] - oldX, at[1] - oldY);
    }
  });

  function hoverRoad(at) {
    if (sketch) return;
    const t = instantAt(...at);
    canvas.classList.toggle("on-car", Boolean(options.onpush) && carAt(...at) >= 0);
    if (Number.isFinite(t)) clock.hover(t, "road");
    else if (clock.from === "road") clock.leave();
  }

  function released(event) {
    const at = fingers.get(event.pointerId);
    fingers.delete(event.pointerId);
    if (!at) return;
    if (sketch) return endStroke();
    if (push?.id === event.pointerId) {
      const {car} = push, vector = pushVector();
      push = null;
      if (event.type === "pointerup" && moved > 8) options.onpush(car, vector);
      clock.ask();
    } else if (event.type === "pointerup" && moved < 4) {
      const t = instantAt(...at);
      if (Number.isFinite(t)) clock.seek(t);
    }
  }
  for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, released);
  canvas.addEventListener("pointerleave", () => { if (clock.from === "road") clock.leave(); });

  // -- drawing a road by hand

  function startDrawing(done) {
    sketch = {points: [], done, pen: toWorld(view.width / 2, view.height / 2), stroke: false};
    canvas.classList.add("drawing");
    setMode(false, false);
    canvas.focus();
  }

  function stopDrawing() {
    sketch = null;
    canvas.classList.remove("drawing");
    clock.ask();
  }

  function finishDrawing(points, closed) {
    const {done} = sketch;
    stopDrawing();
    done(points, closed);
  }

  function beginStroke(at) {
    sketch.stroke = true;
    sketch.points = [toWorld(...at)];
    clock.ask();
  }

  function continueStroke(at) {
    const last = toScreen(...sketch.points[sketch.points.length - 1]);
    if (Math.hypot(at[0] - last[0], at[1] - last[1]) < 4) return;
    sketch.points.push(toWorld(...at));
    sketch.pen = sketch.points[sketch.points.length - 1];
    clock.ask();
  }

  function endStroke() {
    sketch.stroke = false;
    if (sketch.points.length < 3) return clock.ask();  // a tap is no road
    const first = toScreen(...sketch.points[0]), last = toScreen(...sketch.points[sketch.points.length - 1]);
    finishDrawing(sketch.points, sketch.points.length > 10 && Math.hypot(first[0] - last[0], first[1] - last[1]) < 24);
  }

  function drawSketch() {
    pen.strokeStyle = palette.series[0];
    pen.lineWidth = 3;
    pen.beginPath();
    sketch.points.forEach(([x, y], i) => { if (i) pen.lineTo(...toScreen(x, y)); else pen.moveTo(...toScreen(x, y)); });
    if (!sketch.stroke && sketch.points.length) pen.lineTo(...toScreen(...sketch.pen));
    pen.stroke();
    if (sketch.stroke) return;
    const [px, py] = toScreen(...sketch.pen);
    pen.strokeStyle = palette.ink;
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(px - 10, py);
    pen.lineTo(px + 10, py);
    pen.moveTo(px, py - 10);
    pen.lineTo(px, py + 10);
    pen.stroke();
  }

  const DIRECTIONS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};

  function sketchKey(event) {
    const {points} = sketch, step = (event.shiftKey ? 40 : 10) / view.scale, way = DIRECTIONS[event.key];
    if (way) sketch.pen = [sketch.pen[0] + way[0] * step, sketch.pen[1] + way[1] * step];
    else if (event.key === "Enter") points.push([...sketch.pen]);
    else if (event.key === "Backspace") points.pop();
    else if (event.key === "Escape") finishDrawing(null, false);
    else if ("cCdD".includes(event.key) && points.length > 2) finishDrawing(points, "cC".includes(event.key));
    else return false;
    clock.ask();
    return true;
  }

  canvas.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const keys = {f: followCar, w: showWhole};
    if (sketch ? sketchKey(event) : keys[event.key] && (keys[event.key](), true)) event.preventDefault();
  });

  // -- words

  function describeCar(car, k) {
    const at = name => valueAt(car, name, clock.shown), e = at(car.columns.error ? "error" : "offset");
    const offsetText = `${Math.abs(e).toFixed(2)} m to the ${e > 0 ? "left" : "right"} of its line`;
    const where = Math.abs(e) < 0.005 ? "on its line" : offsetText;
    const s = car.columns.station ? ` at station ${Math.round(at("station"))} m` : "";
    const speed = signed(at(car.columns.speed ? "speed" : "vx"), 1);
    return `${car.name} is ${where}${s}, at ${speed} m/s.${places[k].failed ? " It has failed." : ""}`;
  }

  function describe() {
    const part = view.follow ? `The road about ${history.cars[view.chosen]?.name}` : "A part of the road";
    const subject = view.whole ? "The whole road from above" : part;
    return `${subject}, at ${signed(clock.shown, 1)} s. ${history.cars.map(describeCar).join(" ")}`;
  }

  // -- start

  function resize() {
    const dense = window.devicePixelRatio || 1;
    view.width = Math.max(canvas.clientWidth, 1);
    view.height = Math.max(canvas.clientHeight, 1);
    canvas.width = Math.round(view.width * dense);
    canvas.height = Math.round(view.height * dense);
    if (view.whole) showWhole();
    draw();  // a canvas of another size is empty
  }

  onPaletteChange(clock.ask);
  show(history);
  resize();
  followCar();
  clock.paint(draw);
  new ResizeObserver(resize).observe(canvas);
  return Object.assign(view, {
    show, followCar, showWhole, look, zoom, pan, choose, toScreen, toWorld, startDrawing, stopDrawing, describe, draw,
    place: k => places[k],
  });
}
