"use strict";
// Small plots over time, one cursor through all of them and the road. Needs history.js, viewer.js (palette) and a clock.
//
//   plots = makePlots(box, history, clock, specs, options)
//     options: span: s of the window, 0: all
//     show(history)          another drive
//     setSpan(seconds)       10, 20, 60, ...; 0: all
//     choose(names)          which of the specs are shown, by name; null: all that the drive has columns for
//     list                   the plots shown; each: {name, toPixel(t, value), toValue(px, py), describe(), decimated(line)}
//     describe()             what all plots show at the cursor, in sentences
//     draw()                 now, all of them
//
//   spec = {name, title, unit, digits, scale (factor to the unit), least (smallest span of the axis), log, around0,
//           lines: [{column, label, step}],       of each car; a second car has its own colour and dashes
//           limits: [{value, label}] | history => [...],   drawn where within the axis; reach: always within
//           band: {column, sigma, k, ratio},      value +- k sigma, or times exp(+-k sigma) (ratio)
//           truth: name,                          in history.truth, or a column of the cars
//           marks: {column, label}}               where a count grows: a mark below
//        or {name, kind: "moves", title, unit, digits, scale}     the planned moves at the cursor against their limits
//   PLOTS holds those of the house; `specsFor(history)` those that a drive has the columns for.
//
//   A plot is a slider of time: arrows, page up/down, home, end move the cursor, Enter and a click seek, Escape leaves.

const DEGREES = 180 / Math.PI;

const PLOTS = [
  {name: "error", title: "Error", unit: "m", digits: 3, least: 0.1, around0: true, lines: [{column: "error", or: "offset", label: "error"}]},
  {
    name: "steering", title: "Steering", unit: "°", digits: 2, scale: DEGREES, least: 2, around0: true,
    lines: [{column: "command", label: "command"}, {column: "wheel_angle", label: "wheels"}],
    limits: history => limitsOf(history, "angle", "limit"),
  },
  {
    name: "moves", kind: "moves", title: "Planned moves", unit: "°", digits: 2, scale: DEGREES,
  },
  {
    name: "speed", title: "Speed", unit: "m/s", digits: 2, least: 2,
    lines: [{column: "vx", or: "speed", label: "speed"}, {column: "planned_speed", label: "planned"}],
  },
  {name: "acceleration", title: "Lateral acceleration", unit: "m/s²", digits: 2, least: 1, around0: true, lines: [{column: "lateral_acceleration", label: "lateral"}]},
  ...[
    ["lag", "Believed lag", "s", 3, 0.1, false], ["dead_time", "Believed dead time", "s", 3, 0.1, false],
    ["stiffness", "Believed stiffness", "", 2, 0.2, true], ["bias", "Believed steering bias", "rad", 4, 0.01, false],
    ["friction", "Believed friction", "", 2, 0.2, true],
  ].map(([name, title, unit, digits, least, ratio]) => ({
    name, title, unit, digits, least, truth: name, lines: [{column: `belief_${name}`, label: "belief"}],
    band: {column: `belief_${name}`, sigma: `belief_${name}_sigma`, k: 2, ratio},
  })),
  {
    name: "horizons", title: "Horizons chosen", unit: "periods", digits: 0, least: 4,
    lines: [{column: "Np", label: "Np", step: true}, {column: "Nc", label: "Nc", step: true}], marks: {column: "guard", label: "guard"},
  },
  {
    name: "weights", title: "Weights chosen", unit: "", digits: 3, log: true, least: 1,
    lines: [{column: "Q", label: "Q", step: true}, {column: "R", label: "R", step: true}], marks: {column: "guard", label: "guard"},
  },
];
