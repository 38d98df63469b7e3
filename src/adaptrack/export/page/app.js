"use strict";
// The page: it owns the engine, the drive and the clock, and tells every other part what has changed.
//
//   page = {data, engine, setup, drive, clock, view}     drive: {history, over, busy, touches}, or null
//     start(setup)      a drive from its start; the setup is kept, also as the page's address
//     advance(n)        n control periods more, as fast as they come
//     change(car, what) a touch; car: 0, 1, or null for the world
//     notice(text)      a sentence above the drive, "" for none
//     on(name, f)       name: "setup" (another one), "started", "frames", "changed" (a touch), "over", "tick" (five a second)
//
//   makeEngine(died)    a worker: {ask(message) -> answer, end()}; what it refuses is thrown as Refusal
//
// Statistics of a driven error are made here, for display; all else comes from the kernels.

const byId = id => document.getElementById(id);
const LEAST_AHEAD = 3;  // control periods that are driven before they are shown
const AHEAD = 0.2;  // s of the viewer's time: what is touched acts so much later
const MOST_AT_ONCE = 100;  // control periods a message
const SILENT = 20;  // s after which a worker that says nothing has died
const LONGEST = 3700;  // s of a drive that are kept

const ANSWER = {start: "started", advance: "frames", change: "changed", write: "written"};

class Refusal extends Error {
  constructor({message, where}) {
    super(message);
    this.where = where ?? "";
  }
}

// ---- the engine

async function makeEngine(died) {
  const {engine: worker, data} = await begin();
  const waiting = [];  // in the order in which they were asked
  let drives = 0, texts = 0, over = false;

  function die(why) {
    if (over) return;
    end();
    for (const {fail} of waiting.splice(0)) fail(new Error(why));
    died?.(why);
  }
  function end() {
    over = true;
    worker.terminate();
    for (const {watch} of waiting) clearTimeout(watch);
  }
  function answered(answer) {
    const at = waiting.findIndex(({id, answer: type}) => id === answer.id && (type === answer.type || answer.type === "refused"));
    if (at < 0) return;
    const [{take, fail, watch}] = waiting.splice(at, 1);
    clearTimeout(watch);
    if (answer.type === "refused") fail(new Refusal(answer));
    else take(answer);
  }
  // What was asked of a drive that another one has replaced gets no answer.
  function forget() {
    for (const {watch, fail} of waiting.splice(0)) {
      clearTimeout(watch);
      fail(new Refusal({message: "another drive was begun", where: "replaced"}));
    }
  }
  worker.onmessage = ({data: answer}) => answered(answer);
  worker.onerror = event => {
    event.preventDefault?.();
    die(event.message || "the simulation stopped");
  };
  return {
    data, end, die,
    get dead() { return over; },
    ask(message, seconds = SILENT) {
      if (over) return Promise.reject(new Error("the simulation has ended"));
      if (message.type === "start") forget();
      if (message.type === "start") drives++;
      const id = ["read", "write", "memory"].includes(message.type) ? `text ${++texts}` : drives;
      return new Promise((take, fail) => {
        const watch = setTimeout(() => die("the simulation gave no answer"), 1000 * seconds);
        waiting.push({id, answer: ANSWER[message.type] ?? message.type, take, fail, watch});
        worker.postMessage({...message, id});
      });
    },
  };
}

// ---- the page

const listeners = {};
const page = {
  data: null, engine: null, setup: null, drive: null, clock: null, view: null, plots: null,
  on(name, f) { (listeners[name] ??= []).push(f); },
  tell(name, ...words) { for (const f of listeners[name] ?? []) f(...words); },
  notice(text) {
    byId("notice").textContent = shortened(text);
    byId("notice").hidden = !text;
  },
};

// A sentence, with its full stop.
const asSentence = text => text.replace(/\.?$/, ".");

// As many sentences of a long message as one reads.
const MOST_LETTERS = 300;
function shortened(text) {
  const lines = text.split("\n");
  let firstLine = lines[0].length > MOST_LETTERS ? `${lines[0].slice(0, MOST_LETTERS)} ….` : lines[0], count = 1;
  while (count < lines.length && firstLine.length + lines[count].length < MOST_LETTERS) firstLine += ` ${lines[count++]}`;
  return count < lines.length ? `${firstLine} And ${lines.length - count} more.` : firstLine;
}

async function engineOfPage() {
  if (page.engine && !page.engine.dead) return page.engine;
  page.engine = await makeEngine(engineDied);
  page.data = page.engine.data;
  return page.engine;
}

// A worker that dies is begun anew, with the same setup; if that one dies at once as well, it stays so.
let deaths = [];
function engineDied(why) {
  const time = performance.now();
  deaths = [...deaths.filter(death => time - death < 30000), time];
  if (page.drive) page.drive.over = true;
  if (deaths.length > 2) {
    page.notice(`The simulation stopped three times (${why}). Choose another car, road or controller, or reload the page.`);
    return;
  }
  const {setup} = page;
  start(setup).then(() => page.notice(`The simulation stopped (${why}) and was begun anew: the drive starts again.`), () => {});
}

let requests = 0;
async function start(setup, {playing = null} = {}) {
  const number = ++requests, plays = playing ?? page.clock.playing, before = page.setup;
  page.notice("");
  try {
    return await begun(setup, number, plays);
  } catch (error) {
    if (number !== requests) return null;
    // the engine has ended the drive that was; it begins anew, the first of the page where there was none
    if (error instanceof Refusal) await begun(before ?? firstSetup(), number, plays).catch(() => {});
    if (number === requests) refused(error, setup);
    throw error;
  }
}

// Null where another drive was asked for meanwhile.
let beginning = 0;  // drives that were asked for: meanwhile none goes on, as its frames would be the next one's

async function begun(setup, number, plays) {
  const engine = await engineOfPage();
  beginning++;
  const started = await engine.ask({type: "start", setup}).finally(() => { beginning--; });
  if (number !== requests) return null;
  page.setup = setup;
  page.drive = beginDrive(started);
  page.clock.restart({start: 0, end: 0, period: started.period, limit: Math.min(started.duration ?? Infinity, LONGEST)});
  page.tell("setup");
  page.tell("started");
  if (plays) page.clock.play();
  return started;
}

function beginDrive(started) {
  const history = makeHistory(started, {shades: TRAIL});
  history.cars.forEach((car, i) => { car.name = nameOfController(page.setup.controllers[i].kind); });
  return {history, busy: false, over: false, touches: []};
}

const WHERE = {
  car: "The car", road: "The road", speed: "The speed", profile: "The profile", "controller 1": "The first controller",
  "controller 2": "The second controller",
};
function refused(error, setup) {
  const sentence = asSentence(error.message);
  page.notice(error instanceof Refusal && WHERE[error.where] ? `${WHERE[error.where]}: ${sentence}` : sentence);
  page.tell("refused", error, setup);
}

// ---- driving on

async function advance(periods) {
  const {drive} = page;
  if (!drive || drive.over || beginning) return 0;
  drive.busy = true;
  try {
    const frames = await page.engine.ask({type: "advance", periods});
    if (drive !== page.drive) return 0;
    take(drive, frames);
    return frames.count;
  } catch (error) {
    if (error.where !== "replaced") drive.over = true;
    if (drive === page.drive && error instanceof Refusal && error.where !== "replaced") page.notice(error.message);
    return 0;
  } finally {
    drive.busy = false;
  }
}

function take(drive, frames) {
  const {history} = drive, {top} = history;
  if (!takeFrames(history, frames)) return;
  if (history.top !== top) showKey();
  const end = lastTime(history);
  page.clock.grow(end);
  if (history.cars.every(car => car.ended) || !frames.count || end >= page.clock.limit - 0.5 * history.period) {
    drive.over = true;
    page.clock.limit = end;
  }
  page.tell("frames");
  if (drive.over) page.tell("over");
}

// Who came to the end of the road has not failed.
function takeFrames(history, frames) {
  for (const car of frames.cars) if (car.ended?.kind === 0) car.ended.why = null;
  return appendFrames(history, frames);
}

// Before each picture: what will be shown soon is asked for.
function driveAhead(now, clock) {
  const {drive} = page;
  if (!drive || drive.busy || drive.over || waiting.size) return;  // what was touched acts first
  const {period} = drive.history;
  const lead = !clock.playing ? LEAST_AHEAD * period
    : clock.rate === Infinity ? Infinity
      : Math.max(LEAST_AHEAD * period, AHEAD * clock.rate, clock.reduced ? 1.2 * clock.rate : 0);
  const periods = Math.ceil((clock.t + lead - clock.end) / period - 1e-6);
  if (periods > 0) advance(Math.min(periods, MOST_AT_ONCE));
}

// n control periods more, for tests and for who wants the end at once.
async function advanceBy(periods) {
  let left = periods;
  while (left > 0 && page.drive && !page.drive.over) {
    if (page.drive.busy || waiting.size) {
      await new Promise(resolve => setTimeout(resolve, 2));
      continue;
    }
    const count = await advance(Math.min(left, MOST_AT_ONCE));
    if (!count) break;
    left -= count;
  }
  return periods - left;
}

// ---- what is touched

// what: as in the engine's message; said: the event in words, {key} joins the touches of one gesture. Whether it was done.
async function change(car, what, {text, key = null} = {}) {
  const {drive, clock} = page;
  if (!drive || beginning) return false;
  if (drive.over) {  // the drive is over: what was touched acts on the next one
    if (page.driveOver === drive) return false;
    page.driveOver = drive;
    await start(page.setup, {playing: true}).catch(() => {});
    return false;
  }
  if (clock.t < clock.end - 2) clock.seek(clock.end);
  try {
    const answer = await page.engine.ask({type: "change", car, what});
    if (drive !== page.drive) return false;
    mark(drive, answer.at ?? clock.end, text, key);
    page.tell("changed", car, what);
    return true;
  } catch (error) {
    if (drive === page.drive && error.where !== "replaced") page.notice(asSentence(error.message));
  }
  return false;
}

function mark(drive, time, text, key) {
  if (!text) return;
  const {events} = drive.history, before = events.at(-1);
  if (key && before?.key === key && time - before.time < 2) {
    before.text = text;
    before.latest = time;
  } else {
    events.push({time, text, key});
  }
}

// ---- the error, for display

// RMS and largest |error| (m) of a car between two times; whether it is as many as one value.
function errorBetween(car, from, to) {
  const values = errorOf(car), {time} = car.columns;
  let sum = 0, count = 0, most = 0;
  if (!values) return {rms: NaN, most: NaN, count};
  for (let i = indexAt(time, car.count, from); i < car.count && time[i] <= to; i++) {
    if (!(time[i] >= from) || !Number.isFinite(values[i])) continue;
    sum += values[i] * values[i];
    most = Math.max(most, Math.abs(values[i]));
    count++;
  }
  return {rms: Math.sqrt(sum / count), most, count};
}

// A length as one reads it: [number, unit].
function asLength(metres) {
  if (!Number.isFinite(metres)) return ["–", ""];
  if (metres >= 0.9995) return [metres.toFixed(2), "m"];
  return [(100 * metres).toFixed(metres < 0.0995 ? 1 : 0), "cm"];
}
const lengthText = metres => asLength(metres).join(" ");

const WINDOW = 10;  // s
function makeScore() {
  const box = byId("score");
  box.replaceChildren();
  const {cars} = page.drive.history;
  const parts = cars.map((car, i) => {
    const part = document.createElement("div");
    part.id = `score-${i}`;
    part.innerHTML = `<span class="who"><i style="background: var(--series-${i})">${cars.length > 1 ? i + 1 : ""}</i><span id="who-drives-${i}"></span></span>
<strong class="number" id="error-${i}" data-score="error"></strong><span class="rest" id="rest-${i}" data-score="rest"></span>`;
    box.append(part);
    return part;
  });
  const verdict = Object.assign(document.createElement("p"), {className: "verdict", id: "verdict", hidden: true});
  verdict.setAttribute("role", "status");
  box.append(verdict);
  return parts;
}

// Who drives a car behind a planner, and how late it is; "" without one.
const DRIVEN_BY = {nobody: "no trajectory yet", planner: "the planner drives", fallback: "the fallback drives", stop: "no trajectory comes: it stops"};
function plannerText(car, t) {
  if (!car.columns.driven_by) return "";
  const driver = page.data.tracker.drivers[valueAt(car, "driven_by", t, true)], late = valueAt(car, "late", t, true);
  const lateness = Math.abs(late) < 0.005 ? ", on time" : `, ${Math.abs(late).toFixed(2)} s ${late < 0 ? "early" : "late"}`;
  return `\n${DRIVEN_BY[driver]}${Number.isFinite(late) ? lateness : ""}`;
}

function showScore() {
  const {drive, clock} = page;
  if (!drive) return;
  const t = clock.t;
  const sentences = [];
  drive.history.cars.forEach((car, i) => {
    const failed = hasFailed(car, t);
    const last = errorBetween(car, t - WINDOW, t), whole = errorBetween(car, 0, t);
    const [number, unit] = asLength(last.rms);
    setText(byId(`who-drives-${i}`), nameOfCar(i));
    byId(`score-${i}`).classList.toggle("failed", failed);
    setText(byId(`error-${i}`), failed ? `${wordsOfEnd(car)}` : `${number} ${unit}`);
    setText(byId(`rest-${i}`), failed
      ? `at ${car.failed.toFixed(1)} s\nRMS error until then ${lengthText(whole.rms)}`
      : `RMS error, last ${WINDOW} s\nwhole drive ${lengthText(whole.rms)}, largest ${lengthText(whole.most)}${plannerText(car, t)}`);
    if (failed) sentences.push(failureSentence(car, i));
  });
  const verdict = byId("verdict"), over = drive.over && t >= clock.limit - 1e-6;
  if (over && !sentences.length) sentences.push(`The drive is over after ${clock.limit.toFixed(0)} s.`);
  verdict.classList.toggle("plain", !drive.history.cars.some(car => car.failed !== null));
  verdict.hidden = !sentences.length;
  setText(verdict, sentences.join(" "));
}

// As the picture has it: from its last instant on.
const hasFailed = (car, t) => car.failed !== null && t >= Math.min(car.failed, car.columns.time[car.count - 1]) - 1e-9;

function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

const wordsOfEnd = car => String(car.ended?.why ?? "failed").replace(/^it /i, "").replace(/\.$/, "");

// What happened, and what helps.
function failureSentence(car, i) {
  const {setup} = page, controller = setup.controllers[i] ?? {};
  return `${nameOfCarAt(i)} ${wordsOfEnd(car)} at ${car.failed.toFixed(1)} s: ${remedy(setup, controller, i)}.`;
}

function remedy(setup, controller, i) {
  const lag = trueValue("lag"), believed = believedValue("lag", i), friction = trueValue("friction");
  const sensorsOff = page.drive.touches.some(touch => touch.sensors);
  if (sensorsOff) return "give it its sensors back";
  if (frictionEnds(controller.speed_control?.friction)[0] > friction) return "let its speed control assume the friction of this road";
  if (friction !== null && friction < 0.5) return "drive more slowly, or with more friction";
  if (controller.kind?.startsWith("published")) return "take a controller that knows the lag of the steering, or drive without lag";
  if (believed !== null && lag !== null && lag > believed + 0.03) return "let the controller know the lag, or take one that learns it";
  if (controller.tuning?.Np && controller.tuning.Np < 8) return "let it look further ahead, Np 10 or more";
  if (["pure-pursuit", "stanley", "lqr"].includes(controller.kind)) return "drive more slowly, or take a controller that knows the lag";
  return "drive more slowly";
}

// ---- pictures

const PLOT_SETS = {
  few: ["error", "steering", "late"], speed: ["speed", "late", "grip", "assumed_friction", "error", "steering"], belief: ["error", "lag", "dead_time", "stiffness", "bias", "steering"], schedule: ["error", "horizons", "weights", "steering"],
  paper: ["path", "error", "steering"], all: null,
};
let plotSet = "few";

function showPictures() {
  const {history} = page.drive, {clock} = page;
  if (page.view) {
    page.view.show(history);
    page.plots.show(history);
  } else {
    page.view = makeRoadView(byId("road-canvas"), history, clock, {onpush: pushByDrag});
    page.plots = makePlots(byId("plots"), history, clock);
    makeTransport(byId("transport"), clock, {keys: byId("drive"), view: page.view});
    setUpLooks();
  }
  choosePlots(plotSet);
  chooseSpan(span);
  showKey();
  page.view.followCar();
}

function choosePlots(wanted) {
  const name = wanted === "paper" && !page.setup?.road.test ? "few" : wanted;
  plotSet = wanted;
  byId("plot-choice").value = name;
  byId("plot-choice").querySelector("[value=paper]").disabled = !page.setup?.road.test;
  page.plots?.choose(PLOT_SETS[name]);
}

let span = 20;

function chooseSpan(seconds) {
  span = seconds;
  page.plots?.setSpan(seconds);
  for (const button of document.querySelectorAll("[data-span]")) button.setAttribute("aria-pressed", +button.dataset.span === seconds);
}

function setUpLooks() {
  const {view} = page, looks = {follow: view.followCar, whole: view.showWhole, out: () => view.zoom(1 / 1.4), in: () => view.zoom(1.4)};
  for (const button of document.querySelectorAll("[data-look]")) button.onclick = looks[button.dataset.look];
  view.onview = () => {
    byId("look-follow").setAttribute("aria-pressed", view.follow);
    byId("look-whole").setAttribute("aria-pressed", view.whole);
  };
  for (const button of document.querySelectorAll("[data-span]")) button.onclick = () => chooseSpan(+button.dataset.span);
  byId("plot-choice").onchange = event => choosePlots(event.target.value);
}

function showKey() {
  const {top, shades, cars} = page.drive.history;
  byId("key").innerHTML = `driven line: error 0 <span class="shades">${shades.map(shade => `<i style="background:${shade}"></i>`).join("")}</span> ${top} m${cars.some(car => car.failed !== null) ? " and more" : ""} · dotted: what the controller foresees${page.setup.planner ? " · thin line with points: the planner’s trajectory" : ""}`;
}

// ---- everything together

const TRAIL = ["#2c7bb6", "#4b9ac0", "#7fbcc9", "#b9d8c4", "#e8e0a6", "#f5b866", "#e88047", "#d1422f"];
let ticked = 0, ready = false, later = 0;

function tick(now) {
  clearTimeout(later);
  if (now - ticked < 180) {
    later = setTimeout(page.clock.ask, 200);
    return;
  }
  ticked = now;
  showScore();
  page.tell("tick");
}

async function main() {
  page.clock = makeClock({live: true});
  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  page.clock.paint(driveAhead);
  page.clock.paint(tick);
  setUpLessons();
  let linked = {setup: null, notes: []};
  try {
    await engineOfPage();
    page.on("started", showPictures);
    setUpChoosing();
    setUpTouching();
    setUpOut();
    setUpWords();
    linked = setupOfAddress();
    page.on("started", makeScore);
    await start(linked.setup ?? page.data.setup ?? firstSetup(), {playing: !calm.matches});
    if (linked.notes.length) page.notice(linked.notes.join(" "));
  } catch (error) {
    page.notice(error instanceof Refusal ? byId("notice").textContent || error.message : `The page could not begin: ${error.message}`);
  }
  addEventListener("hashchange", followAddress);
  ready = true;
}

async function followAddress() {
  const linked = setupOfAddress();
  if (linked.same) return;
  await start(linked.setup ?? firstSetup(), {playing: !page.clock.reduced}).catch(() => {});
  if (linked.notes.length) page.notice(linked.notes.join(" "));
}

// For tests, and for who looks inside.
window.adaptrackPage = {
  get ready() { return ready; },
  start: (setup, options) => start(setup, options),
  advance: advanceBy,
  change: (car, what, said) => change(car, what, said),
  play: () => page.clock.play(),
  pause: () => page.clock.pause(),
  seek: t => page.clock.seek(t),
  get page() { return page; },
  sweep: () => runSweep(),
  state() {
    const {drive, clock, setup} = page;
    return {
      setup, t: clock.t, end: clock.end, playing: clock.playing, rate: clock.rate, over: drive?.over ?? null, touching: sending,
      notice: byId("notice").hidden ? "" : byId("notice").textContent,
      events: drive?.history.events.map(({time, text}) => ({time, text})) ?? [],
      cars: drive?.history.cars.map(car => ({
        name: car.name, count: car.count, failed: car.failed, ended: car.ended, ...errorBetween(car, 0, clock.end),
        last: Object.fromEntries(car.names.map(name => [name, car.columns[name][car.count - 1]])),
      })) ?? [],
    };
  },
};

main();
