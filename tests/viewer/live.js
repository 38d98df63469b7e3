const {history, frames, clock, view, plots, pushed, drawn, appendFrames, lastTime} = live, [a, b] = history.cars;
const at = (kind, x, y) => {
  const box = canvas.getBoundingClientRect(), where = {clientX: box.left + x, clientY: box.top + y};
  canvas.dispatchEvent(new PointerEvent(kind, {pointerId: 1, bubbles: true, pointerType: "mouse", ...where}));
};
canvas.setPointerCapture = () => {};
found.plots = plots.list.map(plot => plot.name);

// it grows
found.gap = appendFrames(history, frames(99, 5));
clock.seek(5.9);
clock.play();
await new Promise(done => setTimeout(done, 150));
found.waits = [clock.t, clock.playing];
for (let n = 60; n < 6000; n += 500) appendFrames(history, frames(n, 500));
clock.grow(lastTime(history));
await until(() => clock.t > 5.95);
clock.pause();
found.count = a.count;
found.last = a.columns.time[a.count - 1];
const begins = i => a.predicted(i).x[0] - 1 - 10 * a.columns.time[i];
found.recent = begins(a.count - 3);
found.old = [8 * 100 + 5, 8 * 100].map(begins);
found.predicted = [a.predicted(50).count, b.predicted(50).count];
const plan = a.moves(50);
found.moves = [[...plan.values.slice(0, plan.count)], plan.least, plan.most];

// it glides, or goes in steps
const instants = async milliseconds => {
  const seen = new Set(), end = clock.paint(() => seen.add(clock.t));
  clock.seek(0);
  clock.play();
  await new Promise(done => setTimeout(done, milliseconds));
  clock.pause();
  end();
  return seen.size - 1;
};
found.times = [await instants(700)];
clock.reduced = true;
found.times.push(await instants(1200));
clock.reduced = false;

// ice, a push, words
clock.seek(6);
view.draw();
found.ice = colourAt(view.toScreen(60.3, 2.4));
found.tar = colourAt(view.toScreen(53, 2.2));
const [px, py] = view.toScreen(view.place(0).x, view.place(0).y);
at("pointerdown", px, py);
at("pointermove", px + 20, py - 30);
at("pointerup", px + 20, py - 30);
Object.assign(found, {pushed, scale: view.scale, follows: view.follow});
found.told = plots.list.find(plot => plot.name === "lag").describe();
found.guarded = plots.list.find(plot => plot.name === "horizons").describe();
found.movesTold = plots.list.find(plot => plot.name === "moves").describe();

// a road drawn by hand, and by keyboard
const draw = () => view.startDrawing((points, closed) => drawn.push([points, closed]));
view.look({x: 0, y: 0, scale: 2});
draw();
at("pointerdown", 100, 100);
for (let i = 1; i <= 20; i++) at("pointermove", 100 + 10 * i, 100);
at("pointerup", 300, 100);
found.expected = view.toWorld(300, 100);
draw();
["Enter", "ArrowRight", "Enter", "ArrowUp", "Enter", "c"].forEach(press);
draw();
press("Escape");
found.drawn = drawn;
