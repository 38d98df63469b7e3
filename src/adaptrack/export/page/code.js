"use strict";
// Out again: the Python lines and the command that do the same, the link, the drive as CSV.
//
//   setUpOut()                  buttons, and the code that follows the settings
//   pythonOf(setup), commandOf(setup)     text

const SCHEDULES = {"published-nn": "road-nn", "published-anfis": "road-anfis"};
const isSet = value => value !== null && value !== undefined;
const pythonNumber = value => Number.isFinite(value) ? String(+(+value).toPrecision(12)) : "float('inf')";
const text = value => JSON.stringify(String(value));
const pythonArguments = pairs => Object.entries(pairs).filter(([, value]) => isSet(value)).map(([name, value]) => `${name}=${pythonNumber(value)}`).join(", ");

function pythonOf(setup) {
  const {car, road, speed, truth, profile, seed} = setup, lines = ["import adaptrack as at", ""];
  const drive = pythonDrive(road, speed, truth), imports = drive.filter(line => line.startsWith("from "));
  lines.splice(1, 0, ...imports);
  lines.push(...pythonCar(car), ...pythonWorld(profile, truth), ...drive.filter(line => line && !imports.includes(line)));
  if (setup.planner) lines.splice(1, 0, "from adaptrack.drive.planner import PlannedController, SimulatedPlanner");
  setup.controllers.forEach((controller, i) => {
    const steering = pythonController(controller), {start, ...numbers} = setup.planner ?? {};
    const planned = setup.planner ? `PlannedController(${steering}, ${speedControlText(controller)}, SimulatedPlanner(${pythonArguments(numbers)}, start=${text(start)}))` : steering;
    const name = setup.controllers.length > 1 ? ` # ${i ? "second" : "first"}` : "";
    lines.push("", `controller = ${planned}${name && ` ${name}`}`,
      `run = at.simulate(at.DualTrack(${isSet(truth?.mass) ? `car.replace(mass=car.mass * ${pythonNumber(truth.mass)})` : "car"}), controller, drive, profile=world, seed=${seed}${setup.planner || !controller.speed_control ? "" : `, driver=${speedControlText(controller)}`})`,
      "print(run.failed, at.compute_metrics(run).mse ** 0.5)  # None, or why it ended; m, RMS");
  });
  return lines.join("\n");
}

const speedControlText = ({speed_control: {friction}}) => `at.SpeedControl(car, friction=${Array.isArray(friction) ? `(${friction.map(pythonNumber).join(", ")})` : pythonNumber(friction)})`;

function pythonCar({name, sheet, file}) {
  if (name) return [`car = at.load_vehicle(${text(name)})`];
  if (sheet) return [`car = at.vehicle_from_data_sheet("my-car", ${pythonArguments(sheet)})`];
  return [`car = at.load_vehicle(${text(`${file.name ?? "my-car"}.toml`)})`];
}

function pythonWorld(profile, truth = {}) {
  const lines = [`world = at.load_profile(${text(profile)})`];
  let steering = pythonArguments({lag: truth.lag, dead_time: truth.dead_time, bias: truth.bias});
  if (truth.lag === 0) steering += ", rate=float('inf')";
  if (steering) lines.push(`world = world.replace(steering=world.steering.replace(${steering}))  # the true steering`);
  if (isSet(truth.brake_lag)) lines.push(`world = world.replace(brakes=world.brakes.replace(lag=${pythonNumber(truth.brake_lag)}))  # the true brakes`);
  if (isSet(truth.noise) && truth.noise !== 1)
    lines.push(`noises = {n: ${pythonNumber(truth.noise)} * v for n, v in dict(world).items() if n.startswith("noise_") and v < float("inf")}`, "world = world.replace(**noises)");
  return lines;
}

// m, of a road that `generate_road` makes; else nothing
const generatedLength = ({name, points}) => points ? null : page.data.roads[name]?.generated ?? null;

function pythonRoad(road, surface) {
  if (road.points) return `at.road_through(${road.points.length > MOST_DRAWN ? "points" : JSON.stringify(road.points)}, closed=${road.closed ? "True" : "False"}${surface && `, ${surface}`})`;
  if (generatedLength(road)) return `at.generate_road(${text(road.name)}, length=${generatedLength(road)}${surface && `, ${surface}`})`;
  return `page_road(${text(road.name)})${surface && `.replace(${surface})`}`;
}

function pythonDrive(road, speed, truth = {}) {
  const wind = isSet(truth.wind) ? `wind=${pythonNumber(truth.wind)}` : "", friction = isSet(truth.friction) ? `friction=${pythonNumber(truth.friction)}` : "";
  if (road.test) {
    const changed = [friction, wind && `${wind}, wind_gain=1.0`].filter(Boolean).join(", ");
    return [`drive = at.load_scenario(${text(road.test)})${changed && `.replace(${changed})`}`];
  }
  const lines = [], planned = !isSet(speed?.constant);
  if (!road.points && !generatedLength(road)) lines.push("from adaptrack.export.page_setup import page_road");
  if (planned) lines.push("from adaptrack.road import Comfort");
  if (road.points?.length > MOST_DRAWN) lines.push("from adaptrack.road.points import read_points", `points = read_points(${text(`${road.name ?? "road"}.csv`)}).points`);
  lines.push(`road = ${pythonRoad(road, "")}`);
  if (planned) lines.push(`plan = at.plan_speed(road, car, Comfort(lateral=${pythonNumber(speed?.lateral ?? TOP.lateral)}))`);
  const surface = pythonArguments({friction: truth.friction, grade: truth.slope});
  if (surface) lines.push(`road = ${pythonRoad(road, surface)}  # as it is; the plan does not know`);
  const laps = road.points ? road.closed : road.name === "lap" || road.name === "oval";
  lines.push(`drive = at.RoadDrive(road, ${planned ? "plan" : pythonNumber(speed.constant)}${wind && `, ${wind}`})${laps ? "  # one lap; laps=... for more" : ""}`);
  return lines;
}

function pythonController({kind, tuning, belief}) {
  const tuned = tuning && TUNINGS.every(name => isSet(tuning[name])) ? `, at.Tuning(${pythonArguments(tuning)})` : "";
  const believed = belief && pythonArguments(belief) ? `, belief=at.Steering(${pythonArguments(belief)})` : "", profile = `profile=${text(page.setup.profile)}`;
  const schedule = SCHEDULES[kind] ? `, scheduler=at.load_scheduler(${text(SCHEDULES[kind])})` : "", loop = "period=world.period, preview=world.preview";
  if (kind.startsWith("published")) return `at.published_mpc(car${tuned}, ${loop}${schedule})`;
  if (kind === "learning") return `at.MPC(car${tuned}, ${profile}, learning=at.Learning())`;
  if (kind === "informed") return `at.MPC(car${tuned}, ${profile}${believed}, learning=None)`;
  return `${{"pure-pursuit": "at.PurePursuit", stanley: "at.Stanley", lqr: "at.LQR"}[kind]}(car, ${loop})`;
}

// What the command has options for; what it has not is named.
function commandOf(setup) {
  const {car, road, speed, truth = {}, profile, controllers, seed} = setup, missing = [];
  const first = [];
  let vehicle = car.name ?? "my-car.toml";
  if (car.sheet) first.push(`adaptrack car ${Object.entries(car.sheet).map(([name, value]) => `--${name.replaceAll("_", "-")} ${value}`).join(" ")} --out my-car.toml`);
  if (car.file) vehicle = `${car.file.name ?? "my-car"}.toml`;
  const parts = ["adaptrack drive", road.test || (road.points ? "road.csv" : road.name)];
  parts.push(`--vehicle ${vehicle}`, `--profile ${profile}`);
  if (!road.test) parts.push(isSet(speed?.constant) ? `--speed ${speed.constant}` : `--lateral-acceleration ${speed?.lateral ?? TOP.lateral}`);
  if (generatedLength(road)) parts.push(`--length ${generatedLength(road)}`);
  if (seed) parts.push(`--seed ${seed}`);
  const assumed = [...new Set(controllers.map(({speed_control}) => [speed_control?.friction].flat().join(":")))];
  if (assumed.length > 1) missing.push("the frictions that the speed controls assume");
  else if (assumed[0]) parts.push(`--speed-control --assumed-friction ${assumed[0]}`);
  if (setup.planner) parts.push(`--planner ${Object.entries(setup.planner).map(([name, value]) => `${name}=${value}`).join(",")}`);
  const names = {informed: "informed", learning: "informed", published: "standard", "pure-pursuit": "pure-pursuit", stanley: "stanley", lqr: "lqr"};
  for (const {kind, tuning, belief} of controllers) {
    if (names[kind]) parts.push(`--controller ${names[kind]}`);
    else if (road.test) parts.push(`--scheduler ${SCHEDULES[kind]}`);
    else missing.push("the schedule");
    if (kind === "learning") parts.push("--learn");
    if (belief) missing.push("what the controller believes");
    if (tuning && kind === "published" && road.test) parts.push(`--np ${tuning.Np} --nc ${tuning.Nc} --q ${tuning.Q} --r ${tuning.R}`);
    else if (tuning) missing.push("the tuning");
  }
  if (road.points) missing.push("the points of the road (write them to road.csv, x,y a line)");
  if (TRUTHS.some(name => isSet(truth[name]))) missing.push("the true car, steering, noise, friction, slope and wind (a profile of your own says the first two)");
  const lines = [...first, `${[...new Set(parts)].join(" ")} --out drive`];
  if (missing.length) lines.push(`# not in the command, see the Python lines: ${[...new Set(missing)].join(", ")}`);
  return lines.join("\n");
}

// ---- the clipboard, and files

async function copy(words, button) {
  const before = button.textContent;
  let copied = true;
  try {
    await navigator.clipboard.writeText(words);
  } catch {  // not from a file, or not allowed: the old way
    const field = Object.assign(document.createElement("textarea"), {value: words});
    document.body.append(field);
    field.select();
    copied = document.execCommand("copy");
    field.remove();
  }
  button.textContent = copied ? "Copied" : "Select and copy it by hand";
  setTimeout(() => { button.textContent = before; }, 2000);
}

async function saveCsv(i) {
  const {history} = page.drive, car = history.cars[i];
  const columns = Object.fromEntries(car.names.map(name => [name, car.columns[name].slice(0, car.count)]));
  try {
    const {text: content} = await page.engine.ask({type: "write", what: "csv", columns});
    save(`drive-${i + 1}.csv`, content, "text/csv");
  } catch (error) {
    page.notice(`The drive could not be written: ${error.message}`);
  }
}

async function saveCar() {
  const {car} = page.setup, {text: content} = await page.engine.ask({type: "write", what: "car", car});
  save(`${car.name ?? car.file?.name ?? "my-car"}.json`, content, "application/json");
}

function save(name, content, type) {
  const link = Object.assign(document.createElement("a"), {href: URL.createObjectURL(new Blob([content], {type})), download: name});
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function showCode() {
  setText(byId("code-python"), pythonOf(page.setup));
  setText(byId("code-command"), commandOf(page.setup));
  showAddress();
}

function showCsvButtons() {
  byId("csv-buttons").replaceChildren(...page.drive.history.cars.map((_, i, all) => {
    const button = Object.assign(document.createElement("button"), {type: "button", id: `csv-${i}`, textContent: all.length > 1 ? `Save the ${i ? "second" : "first"} drive as CSV` : "Save the drive as CSV"});
    button.onclick = () => saveCsv(i);
    return button;
  }));
}

function setUpOut() {
  for (const button of document.querySelectorAll("[data-copy]")) button.onclick = () => copy(byId(button.dataset.copy).textContent, button);
  byId("save-car").onclick = saveCar;
  byId("copy-link").onclick = event => {
    const {hash, notes} = addressOf(page.setup, page.drive?.touches ?? []);
    copy(location.href.replace(/#.*$/, "") + hash, event.target);
    setText(byId("link-words"), notes.join(" ") || "The link holds all settings.");
  };
  let later = 0;
  page.on("setup", showCode);
  page.on("started", showCsvButtons);
  page.on("touched", () => {
    clearTimeout(later);
    later = setTimeout(showCode, 300);
  });
}
