"use strict";
// Touching while it drives: sliders, a push, the wheel, ice, sensors. Each touch is a change told to the engine, an
// event in road and plots, and a line of "What you did". What a slider sets belongs to the setup: a new drive has it.
//
//   setUpTouching()                makes the controls
//   trueValue(name)                what is true now of lag, dead_time, bias, noise, friction, wind; null: not known
//   believedValue(name, i)         what the i-th controller was told of lag or dead_time; null: nothing

const degrees = value => value * 180 / Math.PI;
const SLIDERS = [
  {id: "lag", box: "main", kind: "truth", name: "lag", label: "True lag of the steering", unit: "s", least: 0, most: 1, step: 0.01, digits: 2},
  {id: "belief-lag", box: "main", kind: "belief", name: "lag", label: "Lag that the controller believes", unit: "s", least: 0, most: 1, step: 0.01, digits: 2},
  {id: "friction", box: "main", kind: "truth", name: "friction", label: "Friction of the road", unit: "", least: 0.1, most: 1.2, step: 0.01, digits: 2},
  {id: "assumed-friction", box: "main", kind: "speed_control", name: 0, label: "Lowest friction that the speed control assumes", unit: "", least: 0.1, most: 1.2, step: 0.01, digits: 2},
  {id: "assumed-friction-high", box: "main", kind: "speed_control", name: 1, label: "Highest friction that the speed control assumes", unit: "", least: 0.1, most: 1.2, step: 0.01, digits: 2},
  {id: "dead-time", box: "world", kind: "truth", name: "dead_time", label: "True dead time of the steering", unit: "s", least: 0, most: 0.5, step: 0.01, digits: 2},
  {id: "bias", box: "world", kind: "truth", name: "bias", label: "Wheels turned beyond the command", unit: "°", least: -3, most: 3, step: 0.1, digits: 1, scale: Math.PI / 180},
  {id: "noise", box: "world", kind: "truth", name: "noise", label: "Noise of the sensors, times the usual", unit: "×", least: 0, most: 5, step: 0.1, digits: 1},
  {id: "wind", box: "world", kind: "truth", name: "wind", label: "Wind along y", unit: "m/s", least: -30, most: 30, step: 1, digits: 0},
  {id: "brake-lag", box: "world", kind: "truth", name: "brake_lag", label: "True lag of the brakes", unit: "s", least: 0.01, most: 1, step: 0.01, digits: 2, forces: true},
  {id: "slope", box: "world", kind: "truth", name: "slope", label: "Slope of the road, positive uphill", unit: "%", least: -12, most: 12, step: 0.5, digits: 1, scale: 0.01, forces: true},
  {id: "mass", box: "world", kind: "truth", name: "mass", label: "True mass, times that of the car", unit: "×", least: 0.7, most: 1.6, step: 0.05, digits: 2},
  {id: "planner-period", box: "planner", kind: "planner", name: "period", label: "Period of its trajectories", unit: "s", least: 0.05, most: 1, step: 0.05, digits: 2},
  {id: "planner-delay", box: "planner", kind: "planner", name: "delay", label: "Delay of its trajectories", unit: "s", least: 0, most: 1, step: 0.05, digits: 2},
  {id: "planner-noise", box: "planner", kind: "planner", name: "noise", label: "Noise of its points", unit: "m", least: 0, most: 0.2, step: 0.01, digits: 2},
  {id: "belief-dead-time", box: "controller", kind: "belief", name: "dead_time", label: "Dead time that the controller believes", unit: "s", least: 0, most: 0.5, step: 0.01, digits: 2},
  {id: "np", box: "controller", kind: "tuning", name: "Np", label: "Horizon Np", unit: "periods", least: 2, most: 60, step: 1, digits: 0},
  {id: "nc", box: "controller", kind: "tuning", name: "Nc", label: "Moves Nc", unit: "", least: 1, most: 20, step: 1, digits: 0},
  {id: "q", box: "controller", kind: "tuning", name: "Q", label: "Weight Q of the error (1/m²)", unit: "", least: -3, most: 4, step: 0.05, log: true},
  {id: "r", box: "controller", kind: "tuning", name: "R", label: "Weight R of the moves (1/rad²)", unit: "", least: -3, most: 6, step: 0.05, log: true},
];
const SENSORS = {
  y: "Position", yaw: "Heading", yaw_rate: "Yaw rate", vy: "Lateral velocity", wheel_angle: "Wheel angle", lateral_acceleration: "Lateral acceleration",
};
const PUSH = 1.0, MOST_PUSH = 3;  // m/s sideways
const PULL = {angle: 2 * Math.PI / 180, duration: 1};
const ICE = {behind: 12, length: 40, friction: 0.2};  // m ahead of the car
const PREDICTS = new Set(["informed", "learning", "published", "published-nn", "published-anfis"]);
const BELIEVES = "informed";  // the kind whose belief about the steering can be set
const SCHEDULED = kind => /-(nn|anfis)$/.test(kind);

let chosenCar = 0;  // whose belief and tuning the sliders set

// ---- what is so now

const USUAL = {noise: 1, wind: 0, slope: 0, mass: 1};
const OF_TESTS = new Set(["friction", "wind"]);  // a test of the paper says them, and they change
const steeringOf = profile => page.data.profiles[profile]?.actuator ?? {};

function trueValue(name) {
  const {truth, profile, road} = page.setup, given = truth?.[name];
  if (given !== null && given !== undefined) return given;
  if (road.test && OF_TESTS.has(name)) return null;
  if (name === "friction") return (page.data.roads[road.name] ?? page.data.road_defaults)?.friction ?? null;
  if (name === "brake_lag") return page.data.profiles[profile]?.settings.brake_lag ?? null;
  return USUAL[name] ?? steeringOf(profile)[name] ?? null;
}

function believedValue(name, i) {
  const controller = page.setup.controllers[i];
  if (!controller || controller.kind !== BELIEVES) return null;
  return controller.belief?.[name] ?? steeringOf(page.setup.profile)[name] ?? null;
}

function tuningValue(name, i) {
  const {controllers, profile} = page.setup, {kind, tuning} = controllers[i] ?? {};
  return tuning?.[name] ?? page.data.controllers[kind]?.[profile]?.usual?.[name] ?? null;
}

function valueOf(slider) {
  if (slider.kind === "truth") return trueValue(slider.name);
  if (slider.kind === "planner") return page.setup.planner?.[slider.name] ?? PLANNER[slider.name];
  if (slider.kind === "belief") return believedValue(slider.name, chosenCar);
  if (slider.kind === "speed_control") return frictionEnds(controllerNow().speed_control?.friction ?? null)[slider.name];
  return tuningValue(slider.name, chosenCar);
}

// Why a slider has nothing to set, "" where it has.
function unused({kind, forces}) {
  const controller = controllerNow();
  if (forces && !page.setup.controllers.some(({speed_control}) => speed_control)) return "The speed is kept exactly.";
  if (kind === "speed_control" && !controller.speed_control) return "The speed of this car is kept exactly.";
  if (kind === "belief" && controller.kind === "learning") return "It learns this by itself: see the plot of its belief.";
  if (kind === "belief" && controller.kind !== BELIEVES) return "This controller has no belief about the steering.";
  if (kind === "tuning" && !PREDICTS.has(controller.kind)) return "This controller has no horizon and no weights.";
  if (kind === "tuning" && SCHEDULED(controller.kind)) return "The schedule chooses this.";
  return "";
}

// ---- sliders

const written = (slider, value) => slider.log ? niceNumber(value) : (value / (slider.scale ?? 1)).toFixed(slider.digits).replace("-", "−");
const withUnit = (slider, value) => `${written(slider, value)}${slider.unit && slider.unit !== "°" && slider.unit !== "×" ? " " : ""}${slider.unit}`;
const niceNumber = value => value < 1e-2 ? value.toExponential(0).replace("e-", "e−") : (+value.toPrecision(2)).toLocaleString("en").replaceAll(",", "\u202f");
const toSlider = (slider, value) => slider.log ? Math.log10(value) : value / (slider.scale ?? 1);
const fromSlider = (slider, value) => slider.log ? +(10 ** value).toPrecision(3) : +(value * (slider.scale ?? 1)).toPrecision(6);

function makeSlider(slider) {
  const box = document.createElement("div");
  box.className = "slider";
  box.innerHTML = `<label for="touch-${slider.id}"></label><output id="value-${slider.id}" for="touch-${slider.id}"></output>
<input type="range" id="touch-${slider.id}" data-touch="${slider.id}" min="${slider.least}" max="${slider.most}" step="${slider.step}">
<p class="hint" id="hint-${slider.id}" hidden></p>`;
  box.querySelector("label").textContent = slider.label;
  const input = box.querySelector("input");
  input.setAttribute("aria-describedby", `hint-${slider.id}`);
  input.oninput = () => slide(slider, fromSlider(slider, +input.value));
  byId(`touch-${slider.box}`).append(box);
}

function showSlider(slider) {
  const input = byId(`touch-${slider.id}`), hint = byId(`hint-${slider.id}`), value = valueOf(slider), why = unused(slider);
  input.disabled = Boolean(why);
  hint.hidden = !why;
  setText(hint, why);
  const text = value === null || !Number.isFinite(value) ? "as in the test" : withUnit(slider, value);
  setText(byId(`value-${slider.id}`), why ? "" : text);
  if (value !== null && document.activeElement !== input) input.value = toSlider(slider, value);
  input.setAttribute("aria-valuetext", text);
}

function showSliders() {
  if (!page.setup) return;
  SLIDERS.forEach(showSlider);
  showTold();
}

// Of touches that wait for one on its way, the last of each kind is sent.
const waiting = new Map();
let sending = false;
async function send(touch) {
  waiting.set(touch.said.key, touch);
  if (sending) return;
  sending = true;
  while (waiting.size) {
    const [key, {car, what, said}] = waiting.entries().next().value;
    waiting.delete(key);
    await change(car, what, said);
  }
  sending = false;
}

function slide(slider, value) {
  const {setup} = page, {kind, name} = slider, isOfAll = kind === "truth" || kind === "planner";
  const carText = setup.controllers.length > 1 && !isOfAll ? `, ${chosenCar ? "second" : "first"} car` : "";
  const message = {text: `${slider.label}${carText}: ${withUnit(slider, value)}`, key: `${slider.id}-${isOfAll ? "" : chosenCar}`};
  const path = set(setup, kind, name, value);
  page.setup = copyOf(setup);
  if (kind === "truth") tellTruth(name, value);
  if (kind === "belief") controllerNow().told = false;
  SLIDERS.filter(candidate => candidate.kind === kind).forEach(showSlider);
  byId(`touch-${slider.id}`).setAttribute("aria-valuetext", withUnit(slider, value));
  send({car: isOfAll ? null : chosenCar, what: path, said: message});
  if (kind === "truth") page.setup.controllers.forEach((_, i) => tellController(i, name));
  showTold();
  page.tell("touched", slider, value);
}

// Who is told of every change believes what is true.
function tellController(i, name) {
  const controller = page.setup.controllers[i];
  if (!controller.told || controller.kind !== BELIEVES || !(name in {lag: 0, dead_time: 0})) return;
  controller.belief = {lag: trueValue("lag"), dead_time: trueValue("dead_time")};
  send({car: i, what: {belief: {...controller.belief}}, said: {key: `told-${i}`}});
  SLIDERS.filter(({kind}) => kind === "belief").forEach(showSlider);
}

const controllerNow = () => page.setup.controllers[chosenCar] ?? page.setup.controllers[0];

function showTold() {
  const {kind, told} = controllerNow();
  byId("told").checked = Boolean(told) && kind === BELIEVES;
  byId("told").disabled = kind !== BELIEVES;
}

function makeTold() {
  const label = document.createElement("label");
  label.innerHTML = '<input type="checkbox" id="told" data-touch="told"> it is told the truth at every change';
  byId("touch-belief-lag").after(label);
  label.firstChild.onchange = event => {
    page.setup = copyOf(page.setup);
    controllerNow().told = event.target.checked;
    if (event.target.checked) tellController(chosenCar, "lag");
    page.tell("touched", {id: "told"}, event.target.checked);
  };
}

// Write it into the setup; gives what the engine is told.
function set(setup, kind, name, value) {
  if (kind === "truth") {
    setup.truth = {...setup.truth, [name]: value};
    return {truth: {[name]: value}};
  }
  if (kind === "planner") {
    setup.planner = {...setup.planner, [name]: value};
    return {planner: {[name]: value}};
  }
  const controller = setup.controllers[chosenCar];
  if (kind === "belief") {
    controller.belief = {lag: believedValue("lag", chosenCar), dead_time: believedValue("dead_time", chosenCar), ...controller.belief, [name]: value};
    return {belief: {...controller.belief}};
  }
  if (kind === "speed_control") {
    const ends = [...frictionEnds(controller.speed_control.friction)];
    ends[name] = value;
    ends[1 - name] = Math[name ? "min" : "max"](ends[1 - name], value);
    controller.speed_control = {friction: ends[0] === ends[1] ? value : ends};
    return {speed_control: controller.speed_control};
  }
  const current = Object.fromEntries(["Np", "Nc", "Q", "R"].map(entry => [entry, tuningValue(entry, chosenCar)]));
  controller.tuning = {...current, [name]: value};
  if (name === "Np") controller.tuning.Nc = Math.min(current.Nc, value);
  if (name === "Nc") controller.tuning.Np = Math.max(current.Np, value);
  return {tuning: {...controller.tuning}};
}

// The line of what is true, beside what is believed.
const TRUE_LINES = {lag: "belief_lag", dead_time: "belief_dead_time", bias: "belief_bias"};
function tellTruth(name, value, time = page.clock.end) {
  const line = TRUE_LINES[name], {history} = page.drive ?? {};
  if (!line || !history || value === null) return;
  const values = (history.truth[line] ??= []);
  if (values.at(-1)?.time === time) values.at(-1).value = value;
  else values.push({time, value});
}

// ---- a push, a pull, ice, sensors

// Whether it was done.
function once(what, text, car = null) {
  page.drive?.touches.push(what);
  const changed = change(car, what, {text});
  page.tell("touched", {id: Object.keys(what)[0]}, what);
  return changed;
}

const leftRight = value => value > 0 ? "left" : "right";
const push = vy => once({push: {vy, yaw_rate: 0}}, `Pushed to the ${leftRight(vy)}, ${Math.abs(vy).toFixed(1)} m/s`);
// A car that was dragged so far (m, in its axes): a metre to the left is a push of half a metre a second.
function pushByDrag(car, {y}) {
  const vy = +Math.max(-MOST_PUSH, Math.min(MOST_PUSH, 0.5 * y)).toFixed(2);
  if (Math.abs(vy) > 0.1) once({push: {vy, yaw_rate: 0}}, `${nameOfCarAt(car)} pushed to the ${leftRight(vy)}, ${Math.abs(vy).toFixed(1)} m/s`, car);
}
const nameOfCarAt = car => page.setup.controllers.length > 1 ? `The ${car ? "second" : "first"} car` : "The car";
const pull = sign => once({pull: {angle: sign * PULL.angle, duration: PULL.duration}}, `Wheel pulled to the ${leftRight(sign)}, 2° for 1 s`);

async function layIce() {
  const {history} = page.drive ?? {};
  if (!history) return;
  const stations = history.cars.map(car => car.count ? car.columns.station?.[car.count - 1] : NaN).filter(Number.isFinite);
  const from = Math.max(0, ...stations) + ICE.behind, to = from + ICE.length;
  const patch = {from, to, friction: ICE.friction};
  if (await once({ice: {...patch}}, `Ice laid ${ICE.behind} m ahead, ${ICE.length} m long, friction ${ICE.friction}`)) history.patches.push(patch);
}

function makeSensors() {
  const box = byId("touch-sensors");
  for (const [name, label] of Object.entries(SENSORS)) {
    const part = document.createElement("label");
    part.innerHTML = `<input type="checkbox" checked id="sensor-${name}" data-touch="sensor-${name}"> `;
    part.append(label);
    part.firstChild.onchange = event => {
      const on = event.target.checked;
      once({sensors: {[name]: on}}, `${label} ${on ? "measured again" : "no longer measured"}`);
    };
    box.append(part);
  }
}

// ---- whom the sliders touch

function showWho() {
  const box = byId("touch-who"), {controllers} = page.setup;
  chosenCar = Math.min(chosenCar, controllers.length - 1);
  box.replaceChildren();
  if (controllers.length < 2) return;
  const field = document.createElement("fieldset");
  field.innerHTML = "<legend>These belong to</legend>";
  controllers.forEach((_, i) => {
    const label = document.createElement("label");
    label.innerHTML = `<input type="radio" name="who" id="who-${i}" data-touch="who-${i}" ${i === chosenCar ? "checked" : ""}> `;
    label.append(nameOfCar(i));
    label.firstChild.onchange = () => {
      chosenCar = i;
      showSliders();
    };
    field.append(label);
  });
  box.append(field);
}

function showTouches() {
  const events = page.drive?.history.events ?? [], list = byId("touches");
  while (list.children.length > events.length) list.lastChild.remove();
  events.forEach(({time, text}, i) => {
    const item = list.children[i] ?? list.appendChild(document.createElement("li"));
    setText(item, `${time.toFixed(1)} s: ${text}`);
  });
  byId("no-touches").hidden = events.length > 0;
}

function setUpTouching() {
  SLIDERS.forEach(makeSlider);
  makeTold();
  makeSensors();
  byId("push-left").onclick = () => push(PUSH);
  byId("push-right").onclick = () => push(-PUSH);
  byId("pull-left").onclick = () => pull(1);
  byId("pull-right").onclick = () => pull(-1);
  byId("ice").onclick = layIce;
  byId("silence").onchange = ({target: {checked}}) => once({planner: {silent: checked}}, checked ? "The planner falls silent" : "The planner sends again");
  page.on("setup", () => { showWho(); showSliders(); byId("more-planner").hidden = !page.setup.planner; });
  page.on("started", () => {
    byId("silence").checked = false;
    for (const name of Object.keys(SENSORS)) byId(`sensor-${name}`).checked = true;
    for (const name of Object.keys(TRUE_LINES)) tellTruth(name, trueValue(name), 0);
    showTouches();
  });
  page.on("changed", showTouches);
  setUpSweep();
}
