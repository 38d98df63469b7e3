"use strict";
// Time of a drive: a clock that paints, and the controls that move it.
//
//   clock = makeClock({start, end, period, live})
//     t, start, end       s; live: `end` grows, and the clock waits for it instead of stopping
//     limit               s, where a live drive ends; Infinity while unknown
//     playing, rate       rate: times real time; Infinity: always the newest instant
//     cursor              s under the pointer, or null; from: who set it ("road", "plot")
//     shown               s, the cursor's time where there is one, else t
//     reduced             steps of half a second instead of gliding (from prefers-reduced-motion)
//     seek(t), play(), pause(), toggle(), step(n) (n control periods), setRate(rate), faster(n),
//     hover(t, from), leave()
//     grow(end)           a live drive has come so far
//     restart({start, end, period, limit})   another drive
//     paint(f)            f(now, clock) is called before each picture; gives a function that ends it
//     ask()               a picture is wanted
//     onchange            called when t, playing or rate were changed by other than the passing of time
//   One requestAnimationFrame serves everybody; none is asked for while nothing moves.
//
//   transport = makeTransport(box, clock, {keys, rates, view})
//     Puts buttons, slider and rate into `box`. keys: element in which all keys work (focus inside, not in a field);
//     where nothing has the focus, all but home and end work as well, which scroll the page.
//     view: a road view, for + - f w. Parts carry data-part: first, back, play, on, last, slider, slower, rate,
//     faster, time.

const RATES = [0.25, 0.5, 1, 2, 5, 10, 20, Infinity];
const REDUCED_STEP = 0.5;  // s of the viewer's time between pictures

function makeClock({start = 0, end = 0, period = 0.05, live = false} = {}) {
  const painters = new Set(), calm = matchMedia("(prefers-reduced-motion: reduce)");
  let isRequested = false, before = 0;
  const clock = {
    t: start, start, end, period, live, limit: Infinity, playing: false, rate: 1, cursor: null, from: null,
    rates: RATES, reduced: calm.matches, onchange: null,
    get shown() { return clock.cursor ?? clock.t; },
    seek(t) {
      if (!Number.isFinite(+t)) return;
      clock.t = Math.min(Math.max(+t, clock.start), clock.end);
      changed();
    },
    play() {
      if (clock.t >= last() && !(clock.live && clock.end < clock.limit)) clock.t = clock.start;
      before = performance.now();
      clock.playing = true;
      changed();
    },
    pause() {
      clock.playing = false;
      changed();
    },
    toggle() { if (clock.playing) clock.pause(); else clock.play(); },
    step(n) {
      clock.playing = false;
      const k = (clock.t - clock.start) / clock.period;
      clock.seek(clock.start + clock.period * (n > 0 ? Math.floor(k + 1e-6) + n : Math.ceil(k - 1e-6) + n));
    },
    faster(n) {
      const {rates} = clock, at = rates.findIndex(rate => rate >= clock.rate);
      clock.rate = rates[Math.min(Math.max(at + n, 0), rates.length - 1)];
      changed();
    },
    setRate(rate) {
      clock.rate = rate;
      changed();
    },
    hover(t, from) {
      clock.cursor = Math.min(Math.max(t, clock.start), clock.end);
      clock.from = from;
      ask();
    },
    leave() {
      clock.cursor = clock.from = null;
      ask();
    },
    grow(to) {
      clock.end = Math.max(clock.end, to);
      ask();
    },
    restart({start: from = 0, end: to = from, period: each = clock.period, limit = Infinity}) {
      Object.assign(clock, {start: from, end: to, t: from, period: each, limit, cursor: null, from: null});
      changed();
    },
    paint(painter) {
      painters.add(painter);
      ask();
      return () => painters.delete(painter);
    },
    ask,
  };
  calm.addEventListener("change", () => { clock.reduced = calm.matches; });

  const last = () => Math.min(clock.end, clock.limit);

  function changed() {
    clock.onchange?.();
    ask();
  }

  function advance(now) {
    const passed = (now - before) / 1000;
    if (clock.reduced && passed < REDUCED_STEP) return;
    before = now;
    if (clock.rate === Infinity) clock.t = last();
    else clock.t = Math.min(clock.t + clock.rate * Math.min(passed, clock.reduced ? 1 : 0.25), last());
    if (clock.t >= last() && !(clock.live && clock.end < clock.limit)) clock.pause();
  }

  function frame(now) {
    isRequested = false;
    if (clock.playing) advance(now);
    for (const painter of painters) painter(now, clock);
    if (clock.playing) ask();
  }

  function ask() {
    if (isRequested) return;
    isRequested = true;
    requestAnimationFrame(frame);
  }

  return clock;
}

// ---- controls

const rateName = rate => rate === Infinity ? "fastest" : `×${rate}`;

function makeButton(part, text, label, action) {
  const button = document.createElement("button");
  button.type = "button";
  button.dataset.part = part;
  button.textContent = text;
  if (label) {
    button.setAttribute("aria-label", label);
    button.title = label;
  }
  button.onclick = action;
  return button;
}

function makeTransport(box, clock, {keys = box, rates = RATES, view = null} = {}) {
  box.classList.add("transport");
  clock.rates = rates;
  const first = makeButton("first", "|◀", "To the start", () => clock.seek(clock.start));
  const back = makeButton("back", "◀|", "One control period back", () => clock.step(-1));
  const play = makeButton("play", "Play", "", () => clock.toggle());
  const on = makeButton("on", "|▶", "One control period on", () => clock.step(1));
  const last = makeButton("last", "▶|", "To the end", () => clock.seek(clock.end));
  const slider = Object.assign(document.createElement("input"), {type: "range", min: 0, max: 1, step: "any"});
  slider.dataset.part = "slider";
  slider.setAttribute("aria-label", "Time of the drive");
  slider.oninput = () => clock.seek(slider.value);
  const time = document.createElement("span");
  time.dataset.part = "time";
  const slower = makeButton("slower", "−", "Slower", () => clock.faster(-1));
  const faster = makeButton("faster", "+", "Faster", () => clock.faster(1));
  const rate = document.createElement("select");
  rate.dataset.part = "rate";
  rate.setAttribute("aria-label", "Speed of the replay");
  for (const rateValue of rates) rate.add(new Option(rateName(rateValue), rateValue, rateValue === 1, rateValue === 1));
  rate.onchange = () => clock.setRate(+rate.value);
  const group = (...parts) => {
    const span = document.createElement("span");
    span.className = "together";
    span.append(...parts);
    return span;
  };
  box.append(group(first, back, play, on, last), slider, time, group(slower, rate, faster));

  function show() {
    play.textContent = clock.playing ? "Pause" : "Play";
    rate.value = clock.rate;
    if (+slider.min !== clock.start) slider.min = clock.start;
    if (+slider.max !== clock.end) slider.max = clock.end;
    slider.value = clock.t;
    const text = `${signed(clock.t, 2)} s`;
    if (time.textContent !== text) time.textContent = text;
    slider.setAttribute("aria-valuetext", transport.words?.() ?? text);
  }
  const transport = {show, words: null};
  clock.paint(show);
  document.addEventListener("keydown", event => {
    const free = event.target === document.body;
    if (keys.contains(event.target) || free && event.key !== "Home" && event.key !== "End") transportKey(event, clock, view);
  });
  return transport;
}

function transportKey(event, clock, view) {
  const {target} = event;
  if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
  if (target.tagName === "SELECT" || target.tagName === "TEXTAREA" || target.isContentEditable) return;
  if (target.tagName === "INPUT" && target.dataset.part !== "slider") return;
  const step = event.shiftKey ? 0.1 : 1;
  const actions = {
    ArrowLeft: () => clock.seek(clock.t - step), ArrowRight: () => clock.seek(clock.t + step),
    Home: () => clock.seek(clock.start), End: () => clock.seek(clock.end),
    ",": () => clock.step(-1), ".": () => clock.step(1), "[": () => clock.faster(-1), "]": () => clock.faster(1),
    "+": view && (() => view.zoom(1.4)), "-": view && (() => view.zoom(1 / 1.4)),
    " ": target.tagName === "BUTTON" || target.tagName === "SUMMARY" ? null : () => clock.toggle(),
  };
  if (!actions[event.key]) return;
  event.preventDefault();
  actions[event.key]();
}

const signed = (value, digits) => Number.isFinite(value) ? value.toFixed(digits).replace("-", "−") : "–";
