"use strict";
// The lessons: each sets the page, says two sentences, and has one thing to do, which ticks itself when it is done.
//
//   setUpLessons()        the list of links
//   lessonOf(hash)        the lesson of a link (#lesson=lag), or null
//   showLesson(lesson)    its card beside the drive; null: none
//
// Every claim was measured with the setup that the lesson sets; tests/export/test_page_lessons.py measures them again.

const tune = (Np, Nc, Q, R) => ({Np, Nc, Q, R});

const LESSONS = [
  {
    id: "lag", short: "Lag", title: "A controller that does not know the lag swings",
    text: "Both cars have the same steering, and its lag can be moved. The first controller is told of every change; the second believes 0.05 s, which is true now, and is told nothing.",
    todo: "Raise the true lag to 0.4 s.", does: "Raise it for me",
    setup: () => makeSetup({
      truth: {lag: 0.05}, controllers: [oneController("informed", {belief: {lag: 0.05, dead_time: 0}, told: true}), oneController("informed", {belief: {lag: 0.05, dead_time: 0}})],
    }),
    act: () => touchSlider("lag", 0.4),
    done: () => trueValue("lag") >= 0.3,
    after: "The second car swings about its road, half a metre and more; the first stays within centimetres.",
  },
  {
    id: "horizon", short: "Horizon", title: "What the horizon does",
    text: "The dotted line is how far the controller looks ahead: 30 periods of 0.05 s. A horizon that ends before the steering has answered cannot choose, while what lies beyond half a second gains millimetres.",
    todo: "Lower Np to 5.", does: "Lower it for me",
    setup: () => makeSetup({road: {name: "oval"}, controllers: [oneController("informed", {tuning: tune(30, 10, 1, 4)})]}),
    open: "more-controller",
    act: () => touchSlider("np", 5),
    done: () => tuningValue("Np", 0) <= 5,
    after: "With 0.25 s of foresight it swings itself off the road; 8 periods, 0.4 s, would hold it within centimetres.",
  },
  {
    id: "weights", short: "Q against R", title: "Q against R: error against steering",
    text: "Q weighs the error, R the moves of the wheel; only their ratio counts. Both cars drive the same road with the same noise: the first with R 4, the second with R 1000, whose wheel moves a sixth as much.",
    todo: "Give the second car R 1 000 000.", does: "Raise it for me",
    setup: () => makeSetup({road: {name: "oval"}, controllers: [oneController("informed", {tuning: tune(30, 10, 1, 4)}), oneController("informed", {tuning: tune(30, 10, 1, 1000)})]}),
    open: "more-controller", car: 1,
    act: () => touchSlider("r", 1e6),
    done: () => tuningValue("R", 1) >= 9e5,
    after: "Its wheel moves a fifteenth as much as the first car’s, and it strays by tens of centimetres.",
  },
  {
    id: "adaptation", short: "Adaptation", title: "The paper’s adaptation, and what it gains",
    text: "Speed, wind and friction change along the paper’s general trajectory, behind a steering with lag. The first car has the best constant tuning for such drives, the second a network that chooses Np, Nc and R for each moment.",
    todo: "Let them drive to the end, and compare the errors.", does: "As fast as it can",
    setup: () => makeSetup({
      car: {name: "paper"}, road: {test: "general-trajectory"}, speed: {constant: 15},
      controllers: [oneController("published", {tuning: tune(26, 5, 1, 2303.4294964410715)}), oneController("published-nn")],
    }),
    plots: "schedule",
    act: () => { page.clock.setRate(Infinity); page.clock.play(); },
    done: () => page.drive?.over,
    after: "5.1 cm against 3.4 cm. The informed MPC needs no schedule for 1.8 cm: try it as the second car.",
  },
  {
    id: "learning", short: "Unknown car", title: "An unknown car, learned in a minute",
    text: "Nobody told the first controller how slow this van’s steering is: 0.3 s of lag behind 0.1 s of dead time. It begins with a wide belief and closes in on the truth while it drives; the second believes 0.15 s and no dead time, and stays with it.",
    todo: "Watch the belief until 20 s.", does: "Play",
    setup: () => makeSetup({
      car: {name: "van"}, truth: {lag: 0.3, dead_time: 0.1},
      controllers: [oneController("learning"), oneController("informed", {belief: {lag: 0.15, dead_time: 0}})],
    }),
    plots: "belief", span: 0,
    act: () => page.clock.play(),
    done: () => page.clock.t >= 20,
    after: "The first car has stayed within 7 cm from its first metre; the second swings by half a metre and is about to leave the road.",
  },
  {
    id: "grip", short: "Grip", title: "Near the grip",
    text: "This speed is planned for 3 m/s² in the bends, with peaks near 4. On this friction of 0.5 the tyres can give 4.9, and the controller hardly notices.",
    todo: "Lower the friction to 0.3.", does: "Lower it for me",
    setup: () => makeSetup({road: {name: "oval"}, truth: {friction: 0.5}}),
    act: () => touchSlider("friction", 0.3),
    done: () => trueValue("friction") <= 0.3,
    after: "2.9 m/s² are less than the next bend asks for, and no steering can help: only driving more slowly does.",
  },
  {
    id: "slippery", short: "Assumed friction", title: "The road is more slippery than assumed",
    text: "A speed control drives and brakes both cars. It lowers the planned speed to what the friction that it assumes allows: the first car assumes 0.9, which is true now, and the second 0.4. In a lap the second loses two seconds.",
    todo: "Lower the friction of the road to 0.5.", does: "Lower it for me",
    setup: () => makeSetup({
      road: {name: "oval"}, truth: {friction: 0.9},
      controllers: [0.9, 0.4].map(friction => oneController("informed", {speed_control: {friction}})),
    }),
    plots: "speed",
    act: () => touchSlider("friction", 0.5),
    done: () => trueValue("friction") <= 0.5,
    after: "The first car asks its tyres for more than they have, and is lost within a lap; the second stays within a decimetre. Assume the lowest friction that the road may have.",
  },
];
const PAPER_TESTS = [
  {
    id: "triple-lane-change", short: "Triple lane change", title: "The paper’s triple lane change",
    text: "Three lane changes at changing speed, with gusts, on changing friction: the paper’s first test, with its own ideal steering. The dashed line is the reference, the plots have it over time as the paper does.",
    todo: "Take “nothing in the way” off: choose a lag and noisy sensors.", does: "Choose it for me",
    setup: () => makeSetup({car: {name: "paper"}, road: {test: "triple-lane-change"}, profile: "paper", speed: {constant: 15}, controllers: [oneController("published")]}),
    plots: "paper", span: 0,
    act: () => choose({profile: "road"}),
    done: () => page.setup?.profile === "road",
    after: "Within seconds the paper’s controller loses a car whose steering has 0.15 s of lag.",
  },
  {
    id: "general-trajectory", short: "General trajectory", title: "The paper’s general trajectory",
    text: "200 s of a winding drive up to 155 m aside: the paper’s second test. Without preview every controller runs after the reference.",
    todo: "Add the informed MPC.", does: "Add it",
    setup: () => makeSetup({car: {name: "paper"}, road: {test: "general-trajectory"}, profile: "paper", speed: {constant: 15}, controllers: [oneController("published")]}),
    plots: "paper", span: 0,
    act: () => chooseController(1, "informed"),
    done: () => page.setup?.controllers[1]?.kind === "informed",
    after: "Both have 35 cm: on an ideal car there is nothing to know.",
  },
];
const ALL_LESSONS = [...LESSONS, ...PAPER_TESTS];
let lesson = null, lessonDone = false;

const lessonOf = hash => ALL_LESSONS.find(({id}) => hash === `#lesson=${id}`) ?? null;

// As if the slider had been moved by hand.
function touchSlider(id, value) {
  const slider = SLIDERS.find(candidate => candidate.id === id);
  slide(slider, value);
  byId(`touch-${id}`).value = toSlider(slider, value);
  if (!page.clock.playing) page.clock.play();
}

function setUpLessons() {
  const list = byId("lessons");
  const label = text => Object.assign(document.createElement("li"), {className: "label", textContent: text});
  const link = ({id, short, title}, number) => {
    const item = document.createElement("li");
    const a = Object.assign(document.createElement("a"), {href: `#lesson=${id}`, id: `lesson-link-${id}`, title});
    a.dataset.lesson = id;
    a.textContent = number ? `${number} ${short}` : short;
    a.onclick = event => {
      event.preventDefault();
      openLesson(ALL_LESSONS.find(lesson => lesson.id === id));
    };
    item.append(a);
    return item;
  };
  list.append(label("Seven lessons:"), ...LESSONS.map((lesson, i) => link(lesson, i + 1)), label("The paper’s tests:"), ...PAPER_TESTS.map(lesson => link(lesson, 0)));
  byId("lesson-do").onclick = () => lesson?.act();
  byId("lesson-next").onclick = () => openLesson(ALL_LESSONS[(ALL_LESSONS.indexOf(lesson) + 1) % ALL_LESSONS.length]);
  page.on("tick", tickLesson);
}

async function openLesson(next) {
  showLesson(next);
  page.clock.setRate(1);
  await start(next.setup(), {playing: !page.clock.reduced}).catch(() => {});
  showLesson(next);
}

function showLesson(next) {
  lesson = next;
  lessonDone = false;
  for (const a of document.querySelectorAll("[data-lesson]")) {
    if (a.dataset.lesson === next?.id) a.setAttribute("aria-current", "true");
    else a.removeAttribute("aria-current");
  }
  byId("lesson").hidden = !next;
  if (!next) return;
  setText(byId("lesson-title"), next.title);
  setText(byId("lesson-text"), next.text);
  setText(byId("lesson-todo"), next.todo);
  setText(byId("lesson-do"), next.does);
  setText(byId("lesson-done"), "");
  byId("lesson-mark").classList.remove("done");
  if (next.open) byId(next.open).open = true;
  if (next.car !== undefined) chosenCar = next.car;
  choosePlots(next.plots ?? "few");
  chooseSpan(next.span ?? 20);
}

function tickLesson() {
  if (!lesson || lessonDone || !page.drive || !lesson.done()) return;
  lessonDone = true;
  byId("lesson-mark").classList.add("done");
  setText(byId("lesson-todo"), lesson.after);
  setText(byId("lesson-done"), "Done.");
}
