"use strict";
// Settings as the page's address and back. The part after # is plain: car=van&road=mountain&lateral=3&lag=0.3&c1=informed...
//
//   addressOf(setup, touches)   {hash, notes: [sentences on what does not fit]}
//   setupOf(hash)               {setup, notes}; setup null where there is none, notes on what was not understood
//   setupOfAddress()            of this page's own address; a lesson's link opens the lesson; same: it is shown already

const LONGEST_LINK = 7500;  // letters
const TRUTHS = ["lag", "dead_time", "bias", "noise", "friction", "wind", "brake_lag", "slope", "mass"];
const TUNINGS = ["Np", "Nc", "Q", "R"];
const BELIEFS = ["lag", "dead_time"];
const PLANNER_NUMBERS = ["period", "delay", "noise"];
const shortNumber = value => String(+(+value).toPrecision(12));

function addressOf(setup, touches = []) {
  const words = new URLSearchParams(), notes = [], {car, road, speed, truth, controllers} = setup;
  if (car.name) words.set("car", car.name);
  else if (car.sheet) for (const [name, value] of Object.entries(car.sheet)) words.set(`car.${name}`, shortNumber(value));
  else words.set("car.file", JSON.stringify(car.file));
  if (road.test) words.set("test", road.test);
  else if (road.points) linkPoints(words, notes, road);
  else words.set("road", road.name);
  for (const [kind, value] of Object.entries(speed ?? {})) words.set(kind, shortNumber(value));
  words.set("profile", setup.profile);
  if (setup.seed) words.set("seed", setup.seed);
  for (const name of TRUTHS) if (truth?.[name] != null) words.set(name, shortNumber(truth[name]));
  if (setup.planner) words.set("planner", setup.planner.start);
  for (const name of PLANNER_NUMBERS) if (setup.planner) words.set(`planner.${name}`, shortNumber(setup.planner[name]));
  controllers.forEach(({kind, tuning, belief, told, speed_control}, i) => {
    words.set(`c${i + 1}`, kind);
    if (told) words.set(`c${i + 1}.told`, "1");
    if (speed_control) [speed_control.friction].flat().forEach((end, k) => words.set(`c${i + 1}.friction${k ? ".high" : ""}`, shortNumber(end)));
    for (const name of TUNINGS) if (tuning?.[name] != null) words.set(`c${i + 1}.${name}`, shortNumber(tuning[name]));
    for (const name of BELIEFS) if (belief?.[name] != null) words.set(`c${i + 1}.belief.${name}`, shortNumber(belief[name]));
  });
  let hash = `#${words}`.replaceAll("%2C", ",").replaceAll("%3B", ";");
  if (hash.length > LONGEST_LINK && car.file) {
    words.delete("car.file");
    words.set("car", "midsize-sedan");
    hash = `#${words}`.replaceAll("%2C", ",").replaceAll("%3B", ";");
    notes.push(`The car of the file ${car.file.name ?? ""} does not fit into a link: send its file along.`);
  }
  const kinds = {push: "pushes", pull: "pulls of the wheel", ice: "ice", sensors: "sensors switched off"};
  const left = Object.keys(kinds).filter(kind => touches.some(touch => touch[kind])).map(kind => kinds[kind]);
  if (left.length) notes.push(`What was done while it drove is not in it: ${left.join(", ")}.`);
  return {hash, notes};
}

function linkPoints(words, notes, {points, closed, name}) {
  if (points.length > MOST_DRAWN) {
    notes.push(`The road ${name ?? ""} has ${points.length} points, a link holds ${MOST_DRAWN}: it is left out, send its file along.`);
    words.set("road", "mountain");
    return;
  }
  words.set("points", points.map(point => point.map(coordinate => +(+coordinate).toFixed(2)).join(",")).join(";"));
  if (closed) words.set("closed", "1");
  if (name) words.set("road-name", name);
}

function setupOf(hash) {
  if (!/^#.*=/.test(hash) || /^#(t|lesson)=/.test(hash)) return {setup: null, notes: []};
  const words = new URLSearchParams(hash.slice(1)), notes = [], setup = makeSetup();
  const number = (word, least = -Infinity) => {
    if (!words.has(word)) return null;
    const value = Number(words.get(word));
    if (Number.isFinite(value) && words.get(word).trim() && value >= least) return value;
    notes.push(`The link says ${word}=${words.get(word)}, which is no number that can be: the usual value is taken.`);
    return null;
  };
  carOfLink(words, setup, number, notes);
  roadOfLink(words, setup, notes);
  const constant = number("constant", 1e-3), lateral = number("lateral", 1e-3);
  if (constant !== null) setup.speed = {constant};
  else if (lateral !== null) setup.speed = {lateral};
  if (words.has("profile")) setup.profile = words.get("profile");
  setup.seed = Math.floor(number("seed", 0) ?? 0);
  for (const name of TRUTHS) setup.truth[name] = number(name);
  const controllers = ["c1", "c2"].filter(key => words.has(key)).map(key => {
    const some = (names, prefix) => {
      const values = Object.fromEntries(names.map(name => [name, number(`${prefix}.${name}`, 0)]).filter(([, value]) => value !== null));
      return Object.keys(values).length ? values : null;
    };
    const low = number(`${key}.friction`, 0.05), high = low === null ? null : number(`${key}.friction.high`, low);
    const friction = high > low ? [low, high] : low;
    return oneController(words.get(key), {...(friction === null ? {} : {speed_control: {friction}}), tuning: some(TUNINGS, key), belief: some(BELIEFS, `${key}.belief`), ...(words.get(`${key}.told`) === "1" ? {told: true} : {})});
  });
  for (const {kind} of controllers) if (!CONTROLLERS[kind]) notes.push(`The link names a controller ${kind}, which this page does not have.`);
  const supported = controllers.filter(({kind}) => CONTROLLERS[kind]);
  if (supported.length) setup.controllers = supported;
  if (["line", "pose"].includes(words.get("planner"))) {
    const numbers = PLANNER_NUMBERS.map(name => [name, number(`planner.${name}`, 0)]).filter(([, value]) => value !== null);
    Object.assign(setup, plannerChoice({...setup, planner: Object.fromEntries(numbers)}, words.get("planner")));
  }
  return {setup, notes};
}

function carOfLink(words, setup, number, notes) {
  const sheet = Object.fromEntries([...words.keys()].filter(key => /^car\.(?!file)/.test(key)).map(key => [key.slice(4), number(key)]).filter(([, value]) => value !== null));
  if (words.has("car.file")) {
    try {
      setup.car = {file: JSON.parse(words.get("car.file"))};
    } catch {
      notes.push("The car in the link is cut off: drop its file on the page.");
    }
  } else if (Object.keys(sheet).length) setup.car = {sheet};
  else if (words.has("car")) setup.car = {name: words.get("car")};
}

function roadOfLink(words, setup, notes) {
  if (words.has("test")) setup.road = {test: words.get("test")};
  else if (words.has("points")) {
    const points = words.get("points").split(";").map(point => point.split(",").map(Number));
    if (points.length >= 2 && points.every(point => point.length === 2 && point.every(Number.isFinite)))
      setup.road = {points, closed: words.get("closed") === "1", name: words.get("road-name") || "a road drawn by hand"};
    else notes.push("The road in the link is cut off: the mountain road is taken.");
  } else if (words.has("road")) setup.road = {name: words.get("road")};
}

let shownHash = null;

function setupOfAddress() {
  if (location.hash === shownHash) return {same: true};
  const lesson = lessonOf(location.hash);
  if (lesson) {
    showLesson(lesson);
    return {setup: lesson.setup(), notes: []};
  }
  return setupOf(location.hash);
}

// The address follows the settings; a lesson's stays while nothing else was chosen.
function showAddress() {
  const {hash} = addressOf(page.setup);
  const current = lesson && JSON.stringify(page.setup) === JSON.stringify(lesson.setup()) ? `#lesson=${lesson.id}` : hash;
  shownHash = current;
  try {
    history.replaceState(null, "", current);
  } catch {  // a browser that refuses it for files: the button still copies the link
  }
}
