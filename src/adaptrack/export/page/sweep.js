"use strict";
// "How much lag does it bear?": the same drive again and again with growing lag, in a worker of its own, as fast as it can.
//
//   setUpSweep()      the button
//   runSweep()        -> [{name, borne, lost, tried: [{lag, rms, most, failed}]}], for each controller shown

const LAGS = [0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1];
const HALVINGS = 3;  // between the last lag that is borne and the first that is not
const TRIED = 40;  // s of each drive
const BORNE = 0.5;  // m, from its line at most
let sweeping = null;

function setUpSweep() {
  const button = byId("sweep"), named = button.textContent;
  button.onclick = async () => {
    if (sweeping) {
      sweeping.stop = true;
      return;
    }
    button.textContent = "Stop";
    try {
      await runSweep();
    } catch (error) {
      setText(byId("sweep-words"), asSentence(error.message));
    }
    button.textContent = named;
  };
  const forget = () => {
    if (sweeping) sweeping.stop = true;
    byId("sweep-found").hidden = true;
    setText(byId("sweep-words"), "");
  };
  page.on("setup", forget);
  page.on("touched", ({id, kind}) => { if (kind && id !== "lag" || id === "told") forget(); });  // of another controller or world
}

// The setup with so much lag; who is told of every change believes it.
const withLag = (setup, lag) => ({
  ...setup, truth: {...setup.truth, lag},
  controllers: setup.controllers.map(controller => controller.told ? {...controller, belief: {...controller.belief, lag}} : controller),
});

async function runSweep() {
  const setup = copyOf(page.setup), sweep = sweeping = {stop: false};
  const results = setup.controllers.map((_, i) => ({name: nameOfCar(i), tried: [], borne: 0, lost: Infinity}));
  const engine = await makeEngine();
  byId("sweep-found").hidden = false;
  const tryLag = async lag => {
    const drives = await driveOnce(engine, withLag(setup, lag));
    drives.forEach((drive, i) => {
      results[i].tried.push({lag, ...drive});
      if (drive.failed || drive.most > BORNE) results[i].lost = Math.min(results[i].lost, lag);
    });
    for (const result of results) {
      result.tried.sort((a, b) => a.lag - b.lag);
      result.borne = Math.max(0, ...result.tried.filter(trial => trial.lag < result.lost).map(trial => trial.lag));
    }
    if (!sweep.stop) showSweep(results, lag);
  };
  try {
    for (const lag of LAGS) {
      if (sweep.stop || results.every(result => lag > 1.8 * result.lost)) break;
      await tryLag(lag);
    }
    for (let k = 0; k < HALVINGS; k++)
      for (const result of results) if (!sweep.stop && result.lost < Infinity && result.borne > 0) await tryLag(+((result.borne + result.lost) / 2).toFixed(3));
  } finally {
    engine.end();
    sweeping = null;
  }
  if (!sweep.stop) showSweep(results, null);
  return results;
}

async function driveOnce(engine, setup) {
  const started = await engine.ask({type: "start", setup}), history = makeHistory(started);
  const periods = Math.ceil(Math.min(TRIED, started.duration) / started.period);
  let left = periods;
  while (left > 0 && !history.cars.every(car => car.ended)) {
    const frames = await engine.ask({type: "advance", periods: Math.min(left, 400)});
    if (!frames.count) break;
    takeFrames(history, frames);
    left -= frames.count;
  }
  return history.cars.map(car => {
    const {rms, most} = errorBetween(car, 0, Infinity);
    return {rms, most, failed: car.failed !== null};
  });
}

// ---- what was found

function sentenceOf({name, borne, lost, tried}, alone) {
  const subject = alone ? "This controller" : `“${name}”`, to = lengthText(BORNE);
  if (borne === 0 && lost < Infinity) return `${subject} bears not even ${lost.toFixed(2)} s of lag: it strays further than ${to}.`;
  const best = tried.find(trial => trial.lag === borne);
  if (lost === Infinity) return `${subject} bears all that was tried, ${borne.toFixed(2)} s of lag: it stays within ${lengthText(best.most)} of its line.`;
  const off = tried.find(trial => trial.failed);
  return `${subject} bears ${borne.toFixed(2)} s of lag: to there it stays within ${to} of its line, at ${lost.toFixed(2)} s no more` +
    `${off ? `, and at ${off.lag.toFixed(2)} s the drive fails` : ""}.`;
}

function showSweep(found, lag) {
  byId("sweep-plot").innerHTML = sweepPicture(found);
  setText(byId("sweep-words"), lag === null ? found.map(result => sentenceOf(result, found.length === 1)).join(" ") : `Driving ${TRIED} s with ${lag.toFixed(2)} s of lag …`);
}

// Error over lag, logarithmic; a ring for the first car, a square for the second, a cross where the car was lost.
function sweepPicture(found) {
  const [width, height, left, right, top, bottom] = [360, 190, 44, 14, 8, 34];
  const x = lag => left + lag * (width - left - right), least = -2.3, most = 1;
  const y = value => top + (most - Math.min(Math.max(Math.log10(value), least), most)) / (most - least) * (height - top - bottom);
  const words = (px, py, said, more = "") => `<text x="${px}" y="${py}" font-size="12" fill="var(--muted)" ${more}>${said}</text>`;
  const parts = [`<svg viewBox="0 0 ${width} ${height}" role="img" aria-label="Largest error over lag; the sentence below says what it shows">`];
  for (const [value, said] of [[0.01, "1 cm"], [0.1, "10 cm"], [1, "1 m"], [10, "10 m"]])
    parts.push(`<line x1="${left}" x2="${width - right}" y1="${y(value)}" y2="${y(value)}" stroke="var(--grid)"/>`, words(left - 5, y(value) + 4, said, 'text-anchor="end"'));
  parts.push(`<line x1="${left}" x2="${width - right}" y1="${y(BORNE)}" y2="${y(BORNE)}" stroke="var(--warn)" stroke-dasharray="2 3"/>`, words(width - right, y(BORNE) - 4, lengthText(BORNE), 'text-anchor="end"'));
  for (const lag of [0, 0.2, 0.4, 0.6, 0.8, 1]) parts.push(words(x(lag), height - bottom + 15, lag.toFixed(1), 'text-anchor="middle"'));
  parts.push(words((left + width - right) / 2, height - 4, "true lag (s); largest error", 'text-anchor="middle"'));
  found.forEach(({tried}, i) => {
    const colour = `var(--series-${i})`;
    parts.push(`<polyline fill="none" stroke="${colour}" stroke-width="2" ${i ? 'stroke-dasharray="6 4"' : ""} points="${tried.map(trial => `${x(trial.lag)},${y(trial.most)}`).join(" ")}"/>`);
    for (const {lag, most: reach, failed} of tried) {
      const [px, py] = [x(lag), y(reach)];
      parts.push(failed
        ? `<path d="M${px - 4.5} ${py - 4.5}l9 9m0 -9l-9 9" stroke="var(--warn)" stroke-width="2.5"/>`
        : i ? `<rect x="${px - 3.5}" y="${py - 3.5}" width="7" height="7" fill="${colour}"/>` : `<circle cx="${px}" cy="${py}" r="4" fill="${colour}"/>`);
    }
  });
  return `${parts.join("")}</svg>`;
}
