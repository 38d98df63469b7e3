"use strict";
// Choosing what drives where: the sentence above the road, a data sheet, dropped files, a road drawn by hand.
//
//   firstSetup()            what the page begins with
//   setUpChoosing()         fills the choices and listens
//   nameOfCar(i), nameOfController(kind), roadName(road), carName(car)      in words
//   MOST_BYTES              a larger file is refused before it is read

const MOST_BYTES = 5e6;
const MOST_DRAWN = 100;  // points of a drawn road, all of which a link holds
const CONTROLLERS = {
  informed: "the informed MPC", learning: "the informed MPC with learning", published: "the paper’s MPC",
  "published-nn": "the paper’s MPC scheduled by a network (NN)", "published-anfis": "the paper’s MPC scheduled by fuzzy rules (ANFIS)",
  "pure-pursuit": "pure pursuit", stanley: "Stanley", lqr: "an LQR",
};
const SHORT = {
  informed: "informed MPC", learning: "informed MPC + learning", published: "paper’s MPC", "published-nn": "paper’s MPC + NN",
  "published-anfis": "paper’s MPC + ANFIS", "pure-pursuit": "pure pursuit", stanley: "Stanley", lqr: "LQR",
};
const TESTS = {"triple-lane-change": "the paper’s triple lane change", "general-trajectory": "the paper’s general trajectory"};
const CARS = {
  "midsize-sedan": "midsize sedan", "small-car": "small car", "compact-ev": "compact electric car", "sports-car": "sports car",
  van: "van", "model-car": "model car", paper: "car of the paper",
};
const ROADS = {mountain: "a mountain road", country: "a country road", town: "a town road", motorway: "a motorway", lap: "a closed lap", oval: "an oval"};
const TOP = {lateral: 3, constant: 15};

const noTruth = () => ({lag: null, dead_time: null, bias: null, noise: null, friction: null, wind: null, brake_lag: null, slope: null, mass: null});
const oneController = (kind, more = {}) => ({kind, tuning: null, belief: null, ...more});
const ASSUMED_FRICTION = 0.9;  // of a speed control
const frictionEnds = friction => Array.isArray(friction) ? friction : [friction, friction];
const frictionText = (friction, digits = 2) => [...new Set(frictionEnds(friction))].map(end => end.toFixed(digits)).join(" to ");
const withSpeedControl = (controllers, friction = ASSUMED_FRICTION) => controllers.map(controller => ({...controller, speed_control: {friction}}));
const PLANNER = {period: 0.1, delay: 0.3, noise: 0};
// Behind a planner a car needs a speed control: the changes of a setup; start: "line", "pose", "" without a planner.
const plannerChoice = ({planner, controllers}, start) => !start ? {planner: null} : {
  planner: {...PLANNER, ...planner, start},
  controllers: controllers.map(controller => controller.speed_control ? controller : withSpeedControl([controller])[0]),
};
const withoutSpeedControl = controllers => controllers.map(({speed_control, ...controller}) => controller);

function makeSetup(more = {}) {
  return {
    car: {name: "midsize-sedan"}, road: {name: "mountain"}, speed: {lateral: 3}, profile: "road", seed: 0,
    controllers: [oneController("informed")], ...more, truth: {...noTruth(), ...more.truth},
  };
}
const firstSetup = () => makeSetup();
const copyOf = value => structuredClone(value);

// ---- names

const nameOfController = kind => SHORT[kind] ?? kind;
const carName = car => car.name ? CARS[car.name] ?? car.name
  : car.sheet ? `car of ${car.sheet.mass} kg` : `car of the file ${car.file?.name ?? ""}`.trim();
const roadName = road => road.test ? TESTS[road.test] ?? road.test
  : road.name && !road.points ? ROADS[road.name] ?? road.name : road.name || "a road of its own";

// What tells it from the one beside it.
function nameOfCar(i) {
  const {controllers} = page.setup, {kind, belief, told, tuning, speed_control} = controllers[i] ?? {}, other = controllers[1 - i];
  const short = nameOfController(kind), own = kind === "informed" ? "MPC" : short;
  if (told) return `${own} that is told the lag`;
  if (isSet(belief?.lag)) return `${own} that believes ${belief.lag.toFixed(2)} s of lag`;
  if (other?.kind !== kind) return short;
  if (speed_control && String(speed_control.friction) !== String(other.speed_control?.friction)) return `${own} that assumes a friction of ${frictionText(speed_control.friction)}`;
  const differs = tuning && TUNINGS.filter(name => tuning[name] !== other.tuning?.[name]);
  return differs?.length ? `${own}, ${differs.map(name => `${name} ${niceNumber(tuning[name])}`).join(", ")}` : `${short} (${i ? "second" : "first"})`;
}

// ---- the sentence

function fill(select, choices, chosen) {
  select.replaceChildren(...choices.map(([value, text]) => new Option(text, value, value === chosen, value === chosen)));
}

function showChoices() {
  const {setup, data} = page, {car, road} = setup;
  const cars = Object.keys(data.cars).map(name => [name, CARS[name] ?? name]);
  if (!car.name) cars.unshift(["own", carName(car)]);
  fill(byId("setup-car"), [...cars, ["sheet", "car of your own: mass, wheelbase …"], ["file", "car from a file …"]], car.name ?? "own");
  const roads = Object.keys(data.roads).map(name => [`name:${name}`, ROADS[name] ?? name]);
  if (road.points) roads.unshift(["own", road.name || "your own road"]);
  const tests = Object.entries(TESTS).map(([name, text]) => [`test:${name}`, text]);
  fill(byId("setup-road"), [...roads, ...tests, ["draw", "a road drawn by hand …"], ["file", "a road from a CSV file …"]],
    road.points ? "own" : road.test ? `test:${road.test}` : `name:${road.name}`);
  const kinds = Object.entries(CONTROLLERS);
  fill(byId("setup-controller-0"), kinds, setup.controllers[0].kind);
  fill(byId("setup-controller-1"), [["", "nobody"], ...kinds], setup.controllers[1]?.kind ?? "");
  byId("setup-profile").value = setup.profile;
  const constant = setup.speed?.constant != null, field = byId("setup-speed");
  byId("setup-speed-kind").value = constant ? "constant" : "lateral";
  field.value = constant ? setup.speed.constant : setup.speed?.lateral ?? TOP.lateral;
  byId("setup-speed-control").value = setup.controllers.some(controller => controller.speed_control) ? "on" : "";
  byId("setup-planner").value = setup.planner?.start ?? "";
  const prescribed = Boolean(road.test);  // a test says its own speed
  for (const id of ["setup-speed", "setup-speed-kind", "setup-speed-control", "setup-planner"]) byId(id).disabled = prescribed;
  for (const id of ["sheet", "file-car", "file-road", "draw"]) byId(id).hidden = true;
  if (!CSS.supports("field-sizing", "content")) document.querySelectorAll("#setup select").forEach(fit);
}

// A select as wide as what is chosen in it, where the browser does not do that itself.
function fit(select) {
  select.style.width = `${(select.selectedOptions[0]?.text.length ?? 6) + 3}ch`;
}

// A drive of another setup; what was refused leaves the old drive and says why.
async function choose(more) {
  const setup = {...copyOf(page.setup), ...more};
  try {
    await start(setup, {playing: page.clock.playing || !page.clock.reduced});
  } catch {
    showChoices();
  }
}

function setUpChoosing() {
  page.on("setup", showChoices);
  const form = byId("setup");
  form.addEventListener("submit", event => event.preventDefault());
  byId("setup-car").onchange = event => chooseCar(event.target.value);
  byId("setup-road").onchange = event => chooseRoad(event.target.value);
  byId("setup-speed").onchange = byId("setup-speed-kind").onchange = chooseSpeed;
  byId("setup-speed-control").onchange = event =>
    choose(event.target.value ? {controllers: withSpeedControl(page.setup.controllers)} : {planner: null, controllers: withoutSpeedControl(page.setup.controllers)});
  byId("setup-planner").onchange = event => choose(plannerChoice(page.setup, event.target.value));
  byId("setup-profile").onchange = event => choose({profile: event.target.value, truth: {...page.setup.truth, lag: null, dead_time: null, bias: null}});
  for (const i of [0, 1]) byId(`setup-controller-${i}`).onchange = event => chooseController(i, event.target.value);
  byId("again").onclick = () => choose({});
  byId("sheet-drive").onclick = chooseSheet;
  byId("car-file").onchange = event => takeFile(event.target.files[0], "car");
  byId("road-file").onchange = event => takeFile(event.target.files[0], "road");
  listenForDrops();
  setUpDrawing();
}

function open(id) {
  byId(id).hidden = false;
  byId(id).querySelector("input").focus();
}

function chooseCar(value) {
  if (value === "sheet") open("sheet");
  else if (value === "file") open("file-car");
  else if (value !== "own") choose({car: {name: value}});
}

function chooseRoad(value) {
  const [kind, name] = value.split(":");
  if (kind === "name") choose({road: {name}});
  else if (kind === "test") choose({road: {test: name}, car: page.setup.car, planner: null, controllers: withoutSpeedControl(page.setup.controllers), truth: {...page.setup.truth, slope: null}});
  else if (kind === "draw") openDrawing();
  else if (kind === "file") open("file-road");
}

function chooseSpeed(event) {
  const kind = byId("setup-speed-kind").value, field = byId("setup-speed");
  if (event.target !== field) field.value = TOP[kind];
  const value = +field.value;
  if (!(value > 0)) {
    page.notice("The speed: give a number above 0, 3 m/s² or 15 m/s for instance.");
    return;
  }
  choose({speed: {[kind]: value}});
}

function chooseController(i, kind) {
  const controllers = copyOf(page.setup.controllers);
  const {speed_control} = controllers[i] ?? controllers[0];
  if (kind) controllers[i] = oneController(kind, speed_control ? {speed_control} : {});
  else controllers.length = 1;
  choose({controllers});
}

function chooseSheet() {
  const mass = +byId("sheet-mass").value, wheelbase = +byId("sheet-wheelbase").value;
  if (!(mass > 0 && wheelbase > 0)) {
    page.notice("The car: give mass in kg and wheelbase in m, both above 0; 1450 and 2.65 for instance.");
    return;
  }
  choose({car: {sheet: {mass, wheelbase}}});
}

// ---- files

function listenForDrops() {
  const {documentElement: whole} = document;
  let inside = 0;
  const carries = event => event.dataTransfer?.types.includes("Files");
  const mark = by => {
    inside = Math.max(0, inside + by);
    whole.classList.toggle("dropping", inside > 0);
  };
  addEventListener("dragenter", event => { if (carries(event)) mark(1); });
  addEventListener("dragleave", event => { if (carries(event)) mark(-1); });
  addEventListener("dragover", event => { if (carries(event)) event.preventDefault(); });
  addEventListener("drop", event => {
    if (!carries(event)) return;
    event.preventDefault();
    mark(-Infinity);
    takeFile(event.dataTransfer.files[0], "");
  });
}

const megabytes = bytes => `${(bytes / 1e6).toFixed(bytes < 1e7 ? 1 : 0)} MB`;

// A file that was chosen or dropped: a car (.json) or a road (anything else, as CSV).
async function takeFile(file, what) {
  if (!file) return;
  const name = file.name.replace(/\.[^.]*$/, ""), kind = what || (/\.json$/i.test(file.name) ? "car" : "road");
  if (/\.toml$/i.test(file.name)) {
    page.notice(`${file.name}: write the car as JSON with “adaptrack car ${file.name} --json > ${name}.json”, and give that file.`);
    return;
  }
  if (file.size > MOST_BYTES) {
    page.notice(`${file.name} has ${megabytes(file.size)}: at most ${megabytes(MOST_BYTES)} are read. ` +
      (kind === "car" ? "A car file has a few kB." : "Take fewer points: one every metre is plenty."));
    return;
  }
  try {
    await takeText(await file.text(), kind, name);
  } catch (error) {
    page.notice(`${file.name}: ${asSentence(error.message)}`);
  }
}

async function takeText(text, kind, name) {
  if (kind === "car") {
    const {car} = await page.engine.ask({type: "read", what: "car file", text});
    await choose({car: {file: car}});
  } else {
    const {points, closed} = await page.engine.ask({type: "read", what: "csv", text, name});
    await choose({road: {points, closed: Boolean(closed), name}});
  }
}

// ---- a road drawn by hand, in the picture of the road

const DRAWN_WIDTH = 400;  // m that the picture shows
const TREMBLE = 10;  // m, least distance of two points: a hand's tremble makes no bends

function setUpDrawing() {
  byId("draw-cancel").onclick = leaveDrawing;
  byId("draw-drive").onclick = () => driveOn(pointsIn(byId("draw-points").value), byId("draw-closed").checked);
}

function openDrawing() {
  const {view, clock} = page, {points, closed} = page.setup.road;
  clock.pause();
  byId("draw").hidden = false;
  byId("draw-points").value = (points ?? []).slice(0, MOST_DRAWN).map(([x, y]) => `${x}, ${y}`).join("\n");
  byId("draw-closed").checked = Boolean(closed);
  view.look({x: 0, y: 0, scale: view.width / DRAWN_WIDTH});
  view.startDrawing((drawn, isClosed) => drawn ? driveOn(thinned(drawn), isClosed) : leaveDrawing());
}

function leaveDrawing() {
  page.view.stopDrawing();
  page.view.followCar();
  showChoices();
  byId("setup-road").focus();
}

const pointsIn = text => text.split("\n").map(line => line.trim()).filter(Boolean).map(line => line.split(/[,;\s]+/).map(Number));

// Points along a drawn line, evenly, no more than a link holds; m, to the decimetre.
function thinned(line) {
  let length = 0;
  for (let i = 1; i < line.length; i++) length += Math.hypot(line[i][0] - line[i - 1][0], line[i][1] - line[i - 1][1]);
  const spacing = Math.max(TREMBLE, 1.05 * length / (MOST_DRAWN - 1)), spaced = [line[0]];
  for (const point of line) if (Math.hypot(point[0] - spaced.at(-1)[0], point[1] - spaced.at(-1)[1]) >= spacing) spaced.push(point);
  return spaced.map(point => point.map(coordinate => Math.round(10 * coordinate) / 10));
}

async function driveOn(points, closed) {
  try {
    await start({...copyOf(page.setup), road: {points, closed, name: "a road drawn by hand"}}, {playing: true});
    page.view.stopDrawing();
    page.view.followCar();
  } catch {  // what is wrong is said above the picture, which can be drawn in again
    openDrawing();
  }
}
