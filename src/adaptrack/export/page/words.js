"use strict";
// In words what the pictures show, for who cannot see them or does not want to look: said on request, or every few seconds.
//
//   setUpWords()      the button, the checkbox and the live region
//   wordsOfPage()     what is shown now, in sentences

const SAY_EVERY = 6000;  // ms

const sideOf = value => Math.abs(value) < 0.005 ? "on its line" : `${lengthText(Math.abs(value))} to the ${leftRight(value)} of its line`;

function wordsOfPage() {
  const {drive, clock, setup} = page;
  if (!drive) return "Nothing is driving yet.";
  const {history} = drive, t = clock.shown;
  const begin = `${carName(setup.car)} on ${roadName(setup.road)}, ${t.toFixed(1)} s of ${Number.isFinite(clock.limit) ? clock.limit.toFixed(0) : clock.end.toFixed(0)} s.`;
  const cars = history.cars.map((car, i) => wordsOfCar(car, i, t));
  const latest = history.events.filter(({time}) => time <= t && time > t - WINDOW).map(({text}) => text);
  const touched = latest.length ? `In the last ${WINDOW} s: ${latest.join("; ")}.` : "";
  return [begin[0].toUpperCase() + begin.slice(1), ...cars, touched, byId("sweep-words").textContent].filter(Boolean).join(" ");
}

function wordsOfCar(car, i, t) {
  const carName = nameOfCarAt(i) + (page.setup.controllers.length > 1 ? `, ${nameOfCar(i)},` : "");
  if (hasFailed(car, t)) return failureSentence(car, i);
  const at = (name, step) => valueAt(car, name, t, step), whole = errorBetween(car, 0, t), last = errorBetween(car, t - WINDOW, t);
  const error = at(car.columns.error ? "error" : "offset"), wheels = degrees(at("wheel_angle"));
  const parts = [
    `${carName} is ${sideOf(error)} at ${at("vx").toFixed(1)} m/s, its wheels ${Math.abs(wheels) < 0.05 ? "straight" : `${Math.abs(wheels).toFixed(1)}° to the ${leftRight(wheels)}`}.`,
    `Its RMS error is ${lengthText(last.rms)} over the last ${WINDOW} s and ${lengthText(whole.rms)} over all.`,
  ];
  if (car.columns.grip_used) parts.push(
    `Its plan says ${at("planned_speed").toFixed(1)} m/s, its governor ${at("governed_speed").toFixed(1)} m/s, and it uses ${(100 * at("grip_used")).toFixed(0)} % of the grip that it assumes, with a friction of ${frictionText([at("friction_low"), at("friction_high")])}.`);
  if (car.columns.driven_by) parts.push(`Behind its planner: ${plannerText(car, t).trim()}.`);
  if (car.columns.belief_lag) parts.push(
    `It believes ${at("belief_lag").toFixed(2)} ± ${(2 * at("belief_lag_sigma")).toFixed(2)} s of lag; true are ${trueValue("lag").toFixed(2)} s.`);
  if (SCHEDULED(page.setup.controllers[i].kind)) parts.push(
    `Its schedule chooses Np ${at("Np", true)}, Nc ${at("Nc", true)}, R ${niceNumber(at("R", true))}.`);
  return parts.join(" ");
}

function setUpWords() {
  const say = () => { byId("said").textContent = wordsOfPage(); };
  byId("say").onclick = say;
  let timer = 0;
  byId("keep-saying").onchange = event => {
    clearInterval(timer);
    if (!event.target.checked) return;
    say();
    timer = setInterval(say, SAY_EVERY);
  };
}
