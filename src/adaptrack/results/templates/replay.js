// A replay page: unpacks the JSON in #replay-data (see adaptrack/results/replay.py) into a history, and shows it with
// the road view, the plots and the transport of adaptrack/export/page, which stand before this in the same scope.

const root = document.getElementById("replay-view");
const data = JSON.parse(document.getElementById("replay-data").textContent);
const part = name => root.querySelector(`[data-replay="${name}"]`);

// ---- the data

// A column: running sums of whole steps, times the unit.
function unpack({first, unit, size, bytes}) {
  const raw = Uint8Array.from(atob(bytes), letter => letter.charCodeAt(0));
  const steps = new {1: Int8Array, 2: Int16Array, 4: Int32Array}[size](raw.buffer);
  const values = new Float64Array(steps.length);
  for (let i = 0, sum = first; i < steps.length; i++) values[i] = (sum += steps[i]) * unit;
  return values;
}

const unpackAll = columns => Object.fromEntries(Object.entries(columns).map(([name, each]) => [name, unpack(each)]));

function unpackCar({name, failed, outline, columns: packed, predicted}) {
  const {steering, ...columns} = unpackAll(packed);
  columns.wheel_angle = steering;
  const car = {name, failed, outline, columns, count: columns.time.length, moves: () => null};
  car.predicted = predicted ? predictedPaths(predicted, columns) : () => null;
  return car;
}

// The path that was predicted last at or before a sample; points are kept in the axes that the car had then.
function predictedPaths({at: samples, points: packed, every}, {x, y, yaw}) {
  const at = unpack(samples), points = packed.map(unpackAll);
  const path = {x: new Float64Array(points.length), y: new Float64Array(points.length), count: points.length};
  return i => {
    const k = indexAt(at, at.length, i), then = at[k];
    if (then > i || i - then > every) return null;
    const c = Math.cos(yaw[then]), s = Math.sin(yaw[then]);
    points.forEach(({ahead, left}, j) => {
      path.x[j] = x[then] + c * ahead[k] - s * left[k];
      path.y[j] = y[then] + s * ahead[k] + c * left[k];
    });
    return path;
  };
}

const {name: roadName, closed, ...roadLines} = data.road;
const history = {
  road: {name: roadName, closed, ...unpackAll(roadLines)}, top: data.top, shades: data.shades, period: data.period,
  cars: data.cars.map(unpackCar), events: [], patches: [], truth: {},
};

// ---- the page

const clock = makeClock({start: firstTime(history), end: lastTime(history), period: data.period});
const view = makeRoadView(part("canvas"), history, clock);
const rates = RATES.filter(rate => rate <= (clock.end - clock.start > 300 ? 20 : 10));
const transport = makeTransport(part("transport"), clock, {keys: root, view, rates});
const plots = makePlots(part("plots"), history, clock);

part("follow").onclick = view.followCar;
part("whole").onclick = view.showWhole;
part("in").onclick = () => view.zoom(1.4);
part("out").onclick = () => view.zoom(1 / 1.4);
part("span").onchange = event => plots.setSpan(+event.target.value);
if (part("car")) part("car").onchange = event => view.choose(+event.target.value);
view.onview = () => {
  part("follow").setAttribute("aria-pressed", view.follow);
  part("whole").setAttribute("aria-pressed", view.whole);
};

// ---- the words below the picture

const degrees = angle => angle * 180 / Math.PI;

function words() {
  const car = history.cars[view.chosen], t = clock.shown, at = column => valueAt(car, column, t);
  const failed = view.place(view.chosen).failed, steering = at("wheel_angle");
  return {
    t: `${signed(t, 2)} s${failed ? " failed" : ""}`,
    s: `${signed(at("station"), 1)} m`,
    e: `${signed(at("offset"), 3)} m`,
    v: `${signed(at("speed"), 2)} m/s`,
    steering: `${signed(degrees(steering), 2)}° · ${signed(steering, 4)} rad`,
  };
}

function say() {
  const text = words();
  for (const name in text) write(part(name), text[name]);
  part("t").classList.toggle("failed", text.t.endsWith("failed"));
}

transport.words = () => {
  const {t, s, e} = words();
  return `${t}, station ${s}, offset ${e}`;
};
part("aloud").onclick = () => { part("spoken").textContent = `${view.describe()} ${plots.describe()}`; };

// index.html#t=12.5 opens at 12.5 s.
function seekLink() {
  const match = /^#t=([\d.]+)$/.exec(location.hash);
  if (match) clock.seek(match[1]);
}

clock.paint(say);
addEventListener("hashchange", seekLink);
seekLink();

window.adaptrackReplay = {
  seek: clock.seek, play: clock.play, pause: clock.pause, start: clock.start, end: clock.end,
  zoom: view.zoom, followCar: view.followCar, showWhole: view.showWhole, clock, view, plots, history,
  // What is shown: time (s), and each car's place (m, m/s, rad) with the pixel of the canvas (CSS px) of its centre of
  // mass.
  state() {
    view.draw();
    transport.show();
    say();
    return {
      t: clock.t, playing: clock.playing, rate: clock.rate, follow: view.follow, whole: view.whole, scale: view.scale,
      width: view.width, height: view.height,
      cars: history.cars.map((car, k) => {
        const {index, share, wheel_angle, ...place} = view.place(k), at = column => valueAt(car, column, clock.t);
        const along = {station: at("station"), speed: at("speed"), offset: at("offset"), steering: wheel_angle};
        return {name: car.name, ...place, ...along, pixel: view.toScreen(place.x, place.y)};
      }),
    };
  },
};
