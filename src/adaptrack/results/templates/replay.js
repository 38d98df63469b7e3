// Replay of drives along a road. Reads the JSON in #replay-data, see adaptrack/report/replay.py; draws on one canvas.
// World: x forward, y left, m, rad. Screen: px, y down.
(() => {
"use strict";

const root = document.getElementById("replay-view");
const data = JSON.parse(document.getElementById("replay-data").textContent);
const part = name => root.querySelector(`[data-replay="${name}"]`);
const canvas = part("canvas"), pen = canvas.getContext("2d"), slider = part("slider");

// ---- the data

// A column: running sums of whole steps, times the unit.
function unpack({first, unit, size, bytes}) {
  const raw = Uint8Array.from(atob(bytes), letter => letter.charCodeAt(0));
  const steps = new {1: Int8Array, 2: Int16Array, 4: Int32Array}[size](raw.buffer);
  const values = new Float64Array(steps.length);
  for (let i = 0, sum = first; i < steps.length; i++) values[i] = (sum += steps[i]) * unit;
  return values;
}

const road = {closed: data.road.closed};
for (const name of ["x", "y", "left_x", "left_y", "right_x", "right_y"]) road[name] = unpack(data.road[name]);

const cars = data.cars.map(({name, failed, outline, columns}) => {
  const car = {name, failed, outline};
  for (const column in columns) car[column] = unpack(columns[column]);
  car.shade = Uint8Array.from(car.offset, e => Math.round(Math.min(Math.abs(e) / data.top, 1) * (data.shades.length - 1)));
  return car;
});
const start = Math.min(...cars.map(car => car.time[0]));
const end = Math.max(...cars.map(car => car.time[car.time.length - 1]));

// The last sample at or before t.
function indexAt(time, t) {
  let low = 0, high = time.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (time[middle] <= t) low = middle; else high = middle - 1;
  }
  return low;
}

// Where a car is at t, between two samples on the straight line; before the first and behind the last it stands.
function placeAt(car, t) {
  const i = indexAt(car.time, t), j = Math.min(i + 1, car.time.length - 1);
  const share = j > i ? Math.min(Math.max((t - car.time[i]) / (car.time[j] - car.time[i]), 0), 1) : 0;
  const place = {index: i};
  for (const name of ["station", "x", "y", "yaw", "speed", "offset", "steering"])
    place[name] = car[name][i] + share * (car[name][j] - car[name][i]);
  place.failed = car.failed !== null && t >= Math.min(car.failed, car.time[car.time.length - 1]);
  return place;
}

// ---- the view: centre (m), scale (px/m), and whether it follows the chosen car

const view = {x: 0, y: 0, scale: 10, width: 1, height: 1, follow: true, whole: false};
const LEAST = 0.002, MOST = 200;
let t = start, playing = false, rate = 1, chosen = 0, before = 0, asked = false, colours = {};

const toScreen = (x, y) => [(x - view.x) * view.scale + view.width / 2, view.height / 2 - (y - view.y) * view.scale];
const toWorld = (px, py) => [(px - view.width / 2) / view.scale + view.x, (view.height / 2 - py) / view.scale + view.y];

function showWhole() {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  const widen = (xs, ys) => {
    for (let i = 0; i < xs.length; i++) {
      box[0] = Math.min(box[0], xs[i]); box[1] = Math.min(box[1], ys[i]);
      box[2] = Math.max(box[2], xs[i]); box[3] = Math.max(box[3], ys[i]);
    }
  };
  widen(road.left_x, road.left_y);
  widen(road.right_x, road.right_y);
  for (const car of cars) widen(car.x, car.y);
  view.x = (box[0] + box[2]) / 2;
  view.y = (box[1] + box[3]) / 2;
  const fits = Math.min((view.width - 40) / Math.max(box[2] - box[0], 1), (view.height - 40) / Math.max(box[3] - box[1], 1));
  view.scale = Math.min(Math.max(fits, LEAST), MOST);
  setMode(false, true);
}

function followCar() {
  view.scale = Math.min(Math.max(view.width / 80, 7), 14);
  setMode(true, false);
}

function setMode(follow, whole) {
  view.follow = follow;
  view.whole = whole;
  part("follow").setAttribute("aria-pressed", follow);
  part("whole").setAttribute("aria-pressed", whole);
  ask();
}

// Zoom about a point of the screen, which stays where it is; about the car while it is followed.
function zoom(factor, px = view.width / 2, py = view.height / 2) {
  const [x, y] = toWorld(px, py);
  view.scale = Math.min(Math.max(view.scale * factor, LEAST), MOST);
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

// ---- the drawing

function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["ink", "muted", "grid", "ground", "warn"]) colours[name] = style.getPropertyValue(`--${name}`).trim();
  colours.cars = cars.map((_, i) => style.getPropertyValue(`--series-${i % 6}`).trim());
}

function trace(xs, ys, backwards = false, joined = false) {
  for (let k = 0; k < xs.length; k++) {
    const i = backwards ? xs.length - 1 - k : k;
    const [px, py] = toScreen(xs[i], ys[i]);
    if (k || joined) pen.lineTo(px, py); else pen.moveTo(px, py);
  }
}

function drawRoad() {
  pen.beginPath();
  trace(road.left_x, road.left_y);
  trace(road.right_x, road.right_y, true, true);
  pen.closePath();
  pen.fillStyle = colours.grid;
  pen.fill();
  pen.strokeStyle = colours.muted;
  pen.lineWidth = 1.2;
  pen.beginPath();
  trace(road.left_x, road.left_y);
  trace(road.right_x, road.right_y);
  pen.stroke();
  if (view.scale > 3) {  // the centre line, from where it does not hide the trail
    pen.setLineDash([6, 8]);
    pen.lineWidth = 1;
    pen.beginPath();
    trace(road.x, road.y);
    pen.stroke();
    pen.setLineDash([]);
  }
}

// The driven line up to now: the last minute where the car is followed, at most 3000 pieces.
function drawTrail(car, place) {
  const first = view.follow ? indexAt(car.time, t - 60) : 0;
  const stride = Math.max(1, Math.ceil((place.index - first) / 3000));
  pen.lineWidth = view.follow ? 3 : 2.5;
  let i = first;
  while (i < place.index) {
    const shade = car.shade[i];
    pen.strokeStyle = data.shades[shade];
    pen.beginPath();
    pen.moveTo(...toScreen(car.x[i], car.y[i]));
    do {
      i = Math.min(i + stride, place.index);
      pen.lineTo(...toScreen(car.x[i], car.y[i]));
    } while (i < place.index && car.shade[i] === shade);
    pen.stroke();
  }
  pen.strokeStyle = data.shades[car.shade[place.index]];
  pen.beginPath();
  pen.moveTo(...toScreen(car.x[place.index], car.y[place.index]));
  pen.lineTo(...toScreen(place.x, place.y));
  pen.stroke();
}

// A rectangle about (x, y) in the car's axes (m), turned by an angle (rad).
function block(x, y, length, width, angle = 0) {
  pen.save();
  pen.translate(x, y);
  pen.rotate(angle);
  pen.fillRect(-length / 2, -width / 2, length, width);
  pen.restore();
}

function drawCar(car, place, colour) {
  const {front, rear, width, lf, lr, track_front, track_rear} = car.outline;
  pen.save();
  pen.translate(...toScreen(place.x, place.y));
  pen.scale(view.scale, -view.scale);
  pen.rotate(place.yaw);
  pen.fillStyle = colour;
  pen.strokeStyle = colours.ink;
  pen.lineWidth = 1.2 / view.scale;
  pen.beginPath();
  pen.roundRect(-rear, -width / 2, front + rear, width, 0.35);
  pen.globalAlpha = 0.82;
  pen.fill();
  pen.globalAlpha = 1;
  pen.stroke();
  pen.fillStyle = colours.ground;
  block(0.25 * front, 0, 0.18 * (front + rear), 0.78 * width);  // the windscreen says where it looks
  pen.fillStyle = colours.ink;
  const wheel = 0.24 * (lf + lr), tyre = 0.09 * width + 0.06;
  for (const side of [-0.5, 0.5]) {
    block(lf, side * track_front, wheel, tyre, place.steering);
    block(-lr, side * track_rear, wheel, tyre);
  }
  pen.restore();
  const size = view.scale * (front + rear);
  if (size < 16) drawArrow(place, colour);
}

// Where a car to scale could not be seen: an arrow of fixed size.
function drawArrow(place, colour) {
  pen.save();
  pen.translate(...toScreen(place.x, place.y));
  pen.rotate(-place.yaw);
  pen.beginPath();
  pen.moveTo(10, 0);
  pen.lineTo(-7, 6.5);
  pen.lineTo(-7, -6.5);
  pen.closePath();
  pen.fillStyle = colour;
  pen.strokeStyle = colours.ink;
  pen.lineWidth = 1.5;
  pen.fill();
  pen.stroke();
  pen.restore();
}

function drawCross(place) {
  const [px, py] = toScreen(place.x, place.y);
  pen.strokeStyle = colours.warn;
  pen.lineWidth = 4;
  pen.beginPath();
  for (const side of [-1, 1]) {
    pen.moveTo(px - 11, py - 11 * side);
    pen.lineTo(px + 11, py + 11 * side);
  }
  pen.stroke();
}

// A bar of a round length, at the lower left.
function drawBar() {
  const wanted = 110 / view.scale, decade = 10 ** Math.floor(Math.log10(wanted));
  const length = [5, 2, 1].find(step => step * decade <= wanted) * decade;
  const y = view.height - 16;
  pen.strokeStyle = colours.ink;
  pen.fillStyle = colours.ink;
  pen.lineWidth = 2;
  pen.beginPath();
  pen.moveTo(16, y - 4);
  pen.lineTo(16, y);
  pen.lineTo(16 + length * view.scale, y);
  pen.lineTo(16 + length * view.scale, y - 4);
  pen.stroke();
  pen.font = "13px system-ui, sans-serif";
  pen.fillText(length >= 1000 ? `${length / 1000} km` : `${+length.toPrecision(1)} m`, 18, y - 8);
}

function draw() {
  const places = cars.map(car => placeAt(car, t));
  if (view.follow) {
    view.x = places[chosen].x;
    view.y = places[chosen].y;
  }
  const dense = window.devicePixelRatio || 1;
  pen.setTransform(dense, 0, 0, dense, 0, 0);
  pen.clearRect(0, 0, view.width, view.height);
  pen.lineJoin = pen.lineCap = "round";
  drawRoad();
  cars.forEach((car, i) => drawTrail(car, places[i]));
  cars.forEach((car, i) => { if (i !== chosen) drawCar(car, places[i], colours.cars[i]); });
  drawCar(cars[chosen], places[chosen], colours.cars[chosen]);
  places.filter(place => place.failed).forEach(drawCross);
  drawBar();
  say(places[chosen]);
}

const signed = (value, digits) => value.toFixed(digits).replace("-", "−");

function say(place) {
  const degrees = place.steering * 180 / Math.PI;
  const texts = {
    t: `${signed(t, 2)} s${place.failed ? " failed" : ""}`, s: `${signed(place.station, 1)} m`,
    e: `${signed(place.offset, 3)} m`, v: `${signed(place.speed, 2)} m/s`,
    steering: `${signed(degrees, 2)}° · ${signed(place.steering, 4)} rad`,
  };
  for (const name in texts) part(name).textContent = texts[name];
  part("t").classList.toggle("failed", place.failed);
  slider.value = t;
  slider.setAttribute("aria-valuetext", `${texts.t}, station ${texts.s}, offset ${texts.e}`);
}

// ---- time

function ask() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(now => {
    asked = false;
    if (playing) {
      t = Math.min(t + rate * Math.min((now - before) / 1000, 0.25), end);
      before = now;
      if (t >= end) pause();
    }
    draw();
    if (playing) ask();
  });
}

function play() {
  if (t >= end) t = start;
  before = performance.now();
  playing = true;
  part("play").textContent = "Pause";
  ask();
}

function pause() {
  playing = false;
  part("play").textContent = "Play";
  ask();
}

function seek(when) {
  if (!Number.isFinite(+when)) return;
  t = Math.min(Math.max(+when, start), end);
  ask();
}

// ---- buttons, keys, pointers

part("play").onclick = () => playing ? pause() : play();
part("follow").onclick = followCar;
part("whole").onclick = showWhole;
part("in").onclick = () => zoom(1.4);
part("out").onclick = () => zoom(1 / 1.4);
part("rate").onchange = event => { rate = +event.target.value; };
if (part("car")) part("car").onchange = event => { chosen = +event.target.value; ask(); };
slider.min = start;
slider.max = end;
slider.oninput = () => seek(slider.value);

root.addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
  const step = event.shiftKey ? 0.1 : 1;
  const keys = {
    ArrowLeft: () => seek(t - step), ArrowRight: () => seek(t + step), Home: () => seek(start), End: () => seek(end),
    "+": () => zoom(1.4), "-": () => zoom(1 / 1.4),
    " ": event.target.tagName === "BUTTON" ? null : () => playing ? pause() : play(),
  };
  if (!keys[event.key]) return;
  event.preventDefault();
  keys[event.key]();
});

const here = event => {
  const box = canvas.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
};
canvas.addEventListener("wheel", event => {
  event.preventDefault();
  zoom(Math.exp(-0.0015 * event.deltaY * (event.deltaMode ? 30 : 1)), ...here(event));
}, {passive: false});
for (const kind of ["touchstart", "touchmove"])  // two fingers are ours, one may scroll the page
  canvas.addEventListener(kind, event => { if (event.touches.length > 1) event.preventDefault(); }, {passive: false});

const fingers = new Map();
canvas.addEventListener("pointerdown", event => {
  fingers.set(event.pointerId, here(event));
  canvas.setPointerCapture(event.pointerId);
});
canvas.addEventListener("pointermove", event => {
  if (!fingers.has(event.pointerId)) return;
  const [oldX, oldY] = fingers.get(event.pointerId), [newX, newY] = here(event);
  const other = [...fingers].filter(([id]) => id !== event.pointerId).map(([, at]) => at)[0];
  fingers.set(event.pointerId, [newX, newY]);
  if (other) {
    const apart = (x, y) => Math.max(Math.hypot(x - other[0], y - other[1]), 1);
    zoom(apart(newX, newY) / apart(oldX, oldY), (newX + other[0]) / 2, (newY + other[1]) / 2);
  } else if (event.pointerType !== "touch" || !view.follow) {  // a finger that scrolls the page does not end following
    pan(newX - oldX, newY - oldY);
  }
});
for (const kind of ["pointerup", "pointercancel"])
  canvas.addEventListener(kind, event => fingers.delete(event.pointerId));

// ---- start

function resize() {
  const dense = window.devicePixelRatio || 1;
  view.width = canvas.clientWidth;
  view.height = canvas.clientHeight;
  canvas.width = Math.round(view.width * dense);
  canvas.height = Math.round(view.height * dense);
  if (view.whole) showWhole();
  draw();  // a canvas of another size is empty
}

// index.html#t=12.5 opens at 12.5 s.
function seekLink() {
  const found = /^#t=([\d.]+)$/.exec(location.hash);
  if (found) seek(found[1]);
}

readColours();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { readColours(); ask(); });
addEventListener("hashchange", seekLink);
resize();
followCar();
seekLink();
new ResizeObserver(resize).observe(canvas);

window.adaptrackReplay = {
  seek, play, pause, zoom, followCar, showWhole,
  start, end,
  // What is shown: time (s), and each car's place (m, m/s, rad) with the pixel of the canvas (CSS px) of its centre of mass.
  state() {
    draw();
    return {
      t, playing, rate, follow: view.follow, whole: view.whole, scale: view.scale, width: view.width, height: view.height,
      cars: cars.map(car => {
        const {index, ...place} = placeAt(car, t);
        return {name: car.name, ...place, pixel: toScreen(place.x, place.y)};
      }),
    };
  },
};
})();
