const {plots, clock, history, view} = replay, named = name => plots.list.find(plot => plot.name === name);
const frame = () => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
const error = named("error"), [car, other] = history.cars, {columns} = car;
found.plots = plots.list.map(plot => plot.name);
plots.setSpan(0);
plots.draw();

// pixels
found.round = plots.list.map(plot => [[3.5, 0.1], [17, -0.02]].map(([t, value]) => {
  const there = plot.toValue(...plot.toPixel(t, value));
  return [there[0] - t, there[1] - value];
}));
found.thinned = error.lines.map(line => {
  const drawn = [...error.decimated(line)], values = line.car.columns[line.column], kept = drawn.map(i => values[i]);
  return {
    drawn: drawn.length, low: Math.min(...kept), high: Math.max(...kept),
    grows: drawn.every((i, k) => !k || i > drawn[k - 1]),
    all: [line.car.count, Math.min(...values), Math.max(...values)],
  };
});

// the cursor: under the pointer of one plot, in all of them and on the road
replay.seek(4);
const box = error.canvas.getBoundingClientRect(), [px, py] = error.toPixel(9.13, 0);
const point = kind => error.canvas.dispatchEvent(new PointerEvent(kind, {
  pointerId: 7, pointerType: "mouse", bubbles: true, clientX: box.left + px, clientY: box.top + py,
}));
error.canvas.setPointerCapture = () => {};
point("pointermove");
await frame();
found.cursor = {
  shown: clock.shown, t: clock.t, texts: plots.list.map(plot => plot.values.map(value => value.textContent)),
  now: plots.list.map(plot => +plot.canvas.getAttribute("aria-valuenow")), place: {...view.place(0)},
  words: part("t").textContent,
};
point("pointerleave");
await frame();
found.left = {shown: clock.shown, x: view.place(0).x};
point("pointerdown");
point("pointerup");
await frame();
found.clicked = replay.state().t;

// by keyboard
error.canvas.focus();
const key = (name, more = {}) => error.canvas.dispatchEvent(
  new KeyboardEvent("keydown", {key: name, bubbles: true, cancelable: true, ...more}));
key("End");
key("ArrowLeft", {shiftKey: true});
await frame();
found.byKey = {shown: clock.shown, t: clock.t, told: error.canvas.getAttribute("aria-valuetext")};
key("Enter");
found.entered = clock.t;

// on the driven line, too
replay.seek(8);
replay.state();
const k = columns.time.findIndex(t => t >= 6), [rx, ry] = view.toScreen(columns.x[k], columns.y[k]);
const road = canvas.getBoundingClientRect(), where = {clientX: road.left + rx, clientY: road.top + ry};
canvas.dispatchEvent(new PointerEvent("pointermove", {pointerId: 9, pointerType: "mouse", ...where}));
found.onRoad = clock.shown;

// words, and the predicted path
clock.leave();
replay.seek(5);
found.said = [view.describe(), error.describe()];
part("aloud").click();
found.aloud = part("spoken").textContent;
const path = car.predicted(columns.time.findIndex(t => t >= 5));
found.predicted = {x: [...path.x], y: [...path.y]};
found.none = other.predicted(50);
found.late = car.predicted(car.count - 1);
