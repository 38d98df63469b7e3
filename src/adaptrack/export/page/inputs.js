// What a user gives: a car file, a data sheet, points of a road; and a drive as CSV. All else is refused in words.
//
//   inputs.readCarFile(text, given)      a car of JSON, as this page saves it and `adaptrack car FILE --json` writes it
//       under the key page_car: {name, description, numbers, steering, body, known_within (null: unknown), domain,
//       tyre: {name, numbers}}; what is unknown is null
//   inputs.checkedCar(car, given)        the same of such a car that comes from elsewhere, such as a link
//   inputs.readSheet(typed, given)       {name, mass, wheelbase, load, truck, known}, for the kernel complete_car
//   inputs.carOfSheet(sheet, car, within, given)     the car, of the rows that complete_car has written, by name
//   inputs.readPoints(text, given, {closed, name})   {name, points: Float64Array x, y, x, y, ..., count, lines, closed,
//       notes}; lines: of the file, of each point
//   inputs.writeDrive(history, car, given)           text of a CSV file that `identify` and `shadow` read
//   inputs.sheetFlaw(status, sheet, given), inputs.roadFlaw(status, place, road, given)
//       a sentence for what complete_car and path_through answer; null where all is well
//
// given: `export.page_inputs.car_fields()`, from the records that check the same in Python. Wrong input throws an
// InputError, whose message is whole sentences, and whose `problems` are {line, key, message}.
"use strict";

const inputs = (() => {
  class InputError extends Error {
    constructor(problems) {
      const shownOnes = problems.slice(0, MOST_SHOWN).map((problem) => problem.message);
      if (problems.length > MOST_SHOWN) shownOnes.push(`And ${problems.length - MOST_SHOWN} more.`);
      super(shownOnes.join("\n"));
      this.name = "InputError";
      this.problems = problems;
    }
  }

  const MOST_SHOWN = 20, LONGEST_SHOWN = 80;

  function refuse(message, line = null, key = null) {
    throw new InputError([problem(message, line, key)]);
  }

  function problem(message, line = null, key = null) {
    return { line, key, message: line === null ? message : `line ${line}: ${message}` };
  }

  /** A value in a message: quoted where it is text, and not longer than a line. */
  function shown(value) {
    const text = typeof value === "number" ? String(value) : JSON.stringify(value);
    return text.length <= LONGEST_SHOWN ? text : `${text.slice(0, 37)}...${text.slice(-40)}`;
  }

  const rounded = (x) => String(Number(x.toPrecision(3)));

  const listed = (names) => names.map((name) => `"${name}"`).join(", ");

  // -- numbers in their ranges --------------------------------------------------------------------------------------
  function isWithin(x, { gt, ge, lt, le }) {
    const above = (gt === undefined || x > gt) && (ge === undefined || x >= ge);
    return above && (lt === undefined || x < lt) && (le === undefined || x <= le);
  }

  function isAllowed(field, value, given) {
    if (field.kind === "choice") return Number.isInteger(value) && value in field.words;
    if (field.kind === "range") {
      const isPair = Array.isArray(value) && value.length === 2 && value.every(Number.isFinite);
      return isPair && value[0] > 0 && value[0] <= value[1] && value[1] <= given.most[field.key];
    }
    return Number.isFinite(value) && isWithin(value, field.bounds);
  }

  const requirement = (field) => `must be ${field.allowed} (${field.meaning}).`;
  const nameOf = (answers, status) => Object.keys(answers).find((answer) => answers[answer] === status);
  const byKey = (fields, value) => Object.fromEntries(fields.map((field) => [field.key, value(field)]));

  // -- a car ---------------------------------------------------------------------------------------------------------
  const PARTS = ["steering", "body", "known_within", "domain"];
  const COMMAND = "write one with \u201cadaptrack car my-car.toml --json > my-car.json\u201d.";

  function readCarFile(text, given) {
    let data = null;
    try {
      data = JSON.parse(text);
    } catch {
      refuse(`no JSON, or not all of it: ${COMMAND}`);
    }
    return checkedCar(data?.page_car, given);
  }

  function checkedCar(car, given) {
    if (!car?.numbers) refuse(`no car that this page can read: ${COMMAND}`);
    const problems = [], textOf = (value, other) => (typeof value === "string" && value ? value : other);
    const section = (name, values) => readSection(name, values, given, problems);
    const parts = PARTS.map((part) => [part, part !== "known_within" || car[part] ? section(part, car[part]) : null]);
    const result = {
      name: textOf(car.name, "car"), description: textOf(car.description, ""), numbers: section("", car.numbers),
      ...Object.fromEntries(parts),
      tyre: { name: textOf(car.tyre?.name, "own tyre"), numbers: section("tyre", car.tyre?.numbers) },
    };
    if (problems.length) throw new InputError(problems);
    return result;
  }

  /** The numbers of a section, defaults for those that are left out; what is wrong goes to problems. */
  function readSection(name, values, given, problems) {
    const section = {};
    for (const field of given.sections[name].filter((numeric) => !numeric.kind.startsWith("text"))) {
      const value = values?.[field.row] ?? field.default, place = name ? `${name}.${field.row}` : field.row;
      const isRight = value === null ? !field.required : isAllowed(field, value, given);
      if (!isRight) problems.push(problem(`${place} = ${shown(value)}: ${requirement(field)}`, null, place));
      section[field.row] = value;
    }
    return section;
  }

  // -- a data sheet --------------------------------------------------------------------------------------------------
  /** A number that was typed in, or what is wrong with it. */
  function typedNumber(value) {
    if (typeof value === "number") return { number: value };
    const text = String(value).trim();
    if (/^[+-]?\d+,\d+$/.test(text)) return { flaw: `write the decimal point: ${text.replace(",", ".")}.` };
    const isOne = /^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$/.test(text);
    return isOne ? { number: Number(text) } : { flaw: "is no number; give one, as 1500 or 2.7." };
  }

  function readSheet(typed, given) {
    const problems = [], say = (message, key) => problems.push(problem(message, null, key));
    const sheet = { name: "sheet", mass: null, wheelbase: null, load: 0, truck: 0, known: {} };
    const fields = given.sections[""].filter((field) => field.kind === "number" && field.key !== "mass");
    for (const [key, value] of Object.entries(typed)) {
      const field = fields.find((candidate) => candidate.key === key);
      if (value === null || value === undefined || value === "") continue;
      if (key === "name") sheet.name = String(value);
      else if (key === "body_style") sheet.truck = styleOf(value, given, problems);
      else if (key in given.sheet || key === "load" || field) readTyped(key, value, field, sheet, given, problems);
      else say(`${shown(key)}: unknown; give ${listed(["mass", "wheelbase", "load", "body_style"])}.`, key);
    }
    for (const key of ["mass", "wheelbase"]) {
      if (sheet[key] !== null || problems.some((problem) => problem.key === key)) continue;
      say(`${key}: missing; give ${key === "mass" ? "kg" : "m"}, ${given.sheet[key].join(" to ")}.`, key);
    }
    if (problems.length) throw new InputError(problems);
    return sheet;
  }

  function styleOf(value, given, problems) {
    const styles = given.sheet.body_styles, place = styles.indexOf(value);
    const message = `body_style = ${shown(value)}: unknown; give ${listed(styles)}.`;
    if (place < 0) problems.push(problem(message, null, "body_style"));
    return Math.max(place, 0);
  }

  function readTyped(key, value, field, sheet, given, problems) {
    const { number, flaw } = typedNumber(value);
    const say = (text) => problems.push(problem(`${key} = ${shown(value)}: ${text}`, null, key));
    if (flaw) say(flaw);
    else if (field) {
      if (isAllowed(field, number, given)) sheet.known[key] = number;
      else say(requirement(field));
    } else if (key === "load") {
      if (number >= 0 && number < Infinity) sheet.load = number;
      else say("must be a finite number >= 0 (kg of people and luggage beside the car).");
    } else {
      const [low, high] = given.sheet[key], range = `${low} to ${high} ${key === "mass" ? "kg" : "m"}`;
      if (number >= low && number <= high) sheet[key] = number;
      else say(`must be from ${range}: the estimates are of such cars; of another, give a car file.`);
    }
  }

  function sheetFlaw(status, sheet, given) {
    const answers = given.answers.complete_car, { mass, wheelbase, load } = sheet;
    const sentences = {
      OK: null,
      MASS_OUTSIDE: `mass = ${mass} kg: must be from ${given.sheet.mass.join(" to ")}.`,
      WHEELBASE_OUTSIDE: `wheelbase = ${wheelbase} m: must be from ${given.sheet.wheelbase.join(" to ")}.`,
      TOO_MUCH_LOAD: `load = ${load} kg: must not be more than the car itself, ${mass} kg.`,
      AXLES_DISAGREE: `lf and lr do not make the wheelbase of ${wheelbase} m: give one of them, or neither.`,
    };
    return sentences[nameOf(answers, status)];
  }

  function carOfSheet(sheet, car, within, given) {
    const numbers = {}, parts = {}, finite = (x) => (Number.isFinite(x) ? x : null);
    for (const field of given.sections[""]) {
      if (field.kind !== "number") continue;
      numbers[field.key] = finite(car[field.key]) ?? sheet.known[field.key] ?? field.default;
    }
    for (const part of PARTS) parts[part] = byKey(given.sections[part], (field) => field.default);
    parts.known_within = byKey(given.sections.known_within, ({ key }) => finite(within[key]));
    const description = `estimated from ${sheet.mass} kg and ${sheet.wheelbase} m of wheelbase`;
    const estimated = "drive_front" in sheet.known ? [] : ["drive_front"];
    return { name: sheet.name, description, numbers, ...parts, tyre: given.tyre, estimated };
  }

  // -- points of a road ----------------------------------------------------------------------------------------------
  function readPoints(text, given, { closed = null, name = "points" } = {}) {
    const rules = given.points, rows = rowsOf(text, rules), columns = columnsOf(rows, rules);
    const points = new Float64Array(2 * rows.cells.length), lines = [];
    let count = 0, repeated = 0;
    rows.cells.forEach((cells, k) => {
      const line = rows.lines[k];
      const [x, y] = ["x", "y"].map((name) => coordinate(cells, columns, name, line));
      if (count > 0 && x === points[2 * count - 2] && y === points[2 * count - 1]) repeated++;
      else {
        points[2 * count] = x;
        points[2 * count + 1] = y;
        lines[count++] = line;
      }
    });
    const comesBack = count > 1 && points[0] === points[2 * count - 2] && points[1] === points[2 * count - 1];
    if (comesBack) lines.length = --count;
    if (count < rules.fewest) refuse(`${count} points; a road needs at least ${rules.fewest}, x and y in metres.`);
    const notes = repeated ? [...columns.notes, `${repeated} repeated points are left out.`] : columns.notes;
    const road = { name, points: points.slice(0, 2 * count), count, lines, closed: closed ?? comesBack, notes };
    return lookAlikes(road, columns);
  }

  /** The cells of the lines of numbers, each with its line, and the header; see `read_points` in Python. */
  function rowsOf(text, rules) {
    const clean = text.replace(/^\uFEFF/, ""), cells = [], lines = [], remarks = [];
    let header = null, blanks = false;
    for (let at = 0, line = 1; at < clean.length; line++) {
      let end = clean.indexOf("\n", at);
      if (end < 0) end = clean.length;
      if (end - at > 10_000) refuse("a line of more than 10,000 characters: this is no table of points.", line);
      const content = clean.slice(at, end).trim(), remark = /^(#|%|\/\/)/.test(content);
      const plain = remark ? content.replace(/^[#%/\s]+/, "") : content, titles = cellsOf(plain);
      at = end + 1;
      if (plain === "" || (remark && cells.length) || (line === 1 && /^"?sep=.?"?$/i.test(plain))) continue;
      if (remark) remarks.push({ line, titles, marked: separatorOf(plain) !== BLANKS });
      else if (!cells.length && !header && !isNumber(titles[0])) header = { line, titles, commented: false };
      else {
        if (cells.length >= rules.most) {
          refuse(`more than ${rules.most} points: leave out every second, or more.`, line);
        }
        cells.push(titles);
        lines.push(line);
        blanks = separatorOf(plain) === BLANKS;
      }
    }
    if (!cells.length) refuse("no line of numbers: a road is a table of x and y in metres, a point a line.");
    return { header: header ?? commentedHeader(remarks, cells[0].length, blanks, rules), cells, lines };
  }

  /** The commented line that names the columns: the last with x and y, or else the last whose cells are names. */
  function commentedHeader(remarks, columns, blanks, rules) {
    const isName = (title) => new RegExp(`^(?:${rules.name})$`).test(plainTitle(title));
    const headers = remarks.map(({ line, titles, marked }) => {
      const fits = titles.length === columns, named = titles.map((title) => titleOf(title, rules));
      const complete = fits && named.includes("x") && named.includes("y");
      const incomplete = titles.length > 1 && titles.every(isName) && (marked || (fits && blanks));
      return { line, titles, commented: true, complete, incomplete };
    });
    return headers.findLast((header) => header.complete) ?? headers.findLast((header) => header.incomplete) ?? null;
  }

  const BLANKS = /\s+/;

  function separatorOf(content) {
    return [";", "\t", "|", ","].find((sign) => content.includes(sign)) ?? BLANKS;
  }

  function cellsOf(content) {
    return content.split(separatorOf(content)).map((cell) => cell.trim().replace(/^"+|"+$/g, ""));
  }

  const NO_NUMBER = /^[+-]?(nan|inf(inity)?)$/i, DECIMAL = /^[+-]?(\d+([.,]\d*)?|\.\d+)([eE][+-]?\d+)?$/;
  const isNumber = (cell) => DECIMAL.test(cell) || NO_NUMBER.test(cell);
  const plainTitle = (title) => title.replace(/\s*[[(].*/, "").trim().toLowerCase();

  function titleOf(title, rules) {
    return Object.keys(rules.columns).find((column) => rules.columns[column].includes(plainTitle(title))) ?? null;
  }

  /** Which columns hold x and y, and notes. */
  function columnsOf({ header, cells }, rules) {
    const count = cells[0].length, names = header?.titles ?? rules.without_header[count];
    if (!names) refuse(`${count} columns without a header; give x,y or ${rules.without_header[4]}, or name them.`);
    const degrees = names.find((title) => rules.degrees.includes(plainTitle(title)));
    if (degrees) {
      const remedy = "convert them to x (east) and y (north) in metres first";
      refuse(`column ${shown(degrees)}: latitude and longitude; ${remedy}.`, header.line);
    }
    const [x, y] = ["x", "y"].map((name) => columnOf(name, names, header, rules));
    const left = names.filter((title, k) => k !== x && k !== y).join(", ");
    const inMetres = [x, y].some((k) => unitOf(names[k]) === "m");
    return { x, y, count: names.length, said: inMetres, notes: left ? [`Columns left out: ${left.slice(0, 200)}.`] : [] };
  }

  function columnOf(name, names, header, rules) {
    const places = [...names.keys()].filter((k) => titleOf(names[k], rules) === name);
    if (places.length !== 1) {
      const hint = places.length ? "there are two." : `there are ${listed(names)}.`;
      const remedy = header.commented ? " If this line is a remark, remove it." : "";
      refuse(`one column must be "${name}" or "${name}_m": ${hint}${remedy}`, header.line);
    }
    const title = names[places[0]], unit = unitOf(title).toLowerCase(), times = unit === "km" ? " (times 1000)" : "";
    if (unit !== "" && !rules.units.includes(unit)) {
      refuse(`column ${shown(title)}: metres are needed, not ${shown(unit)}; convert them${times}.`, header.line);
    }
    return places[0];
  }

  function unitOf(title) {
    return /[[(]\s*([^\])]*?)\s*[\])]/.exec(title)?.[1] ?? (/_m$/.test(plainTitle(title)) ? "m" : "");
  }

  function coordinate(cells, columns, name, line) {
    if (cells.length !== columns.count) refuse(`${cells.length} columns, where ${columns.count} are expected.`, line);
    const cell = cells[columns[name]], value = isNumber(cell) ? Number(cell.replace(",", ".")) : NaN;
    if (Number.isFinite(value)) return value;
    return refuse(`${name} = ${shown(cell)} is not a finite number; correct or remove the line.`, line);
  }

  /** Refuses degrees; says it where metres may be kilometres. */
  function lookAlikes(road, columns) {
    const ends = [Infinity, -Infinity, Infinity, -Infinity];
    for (let k = 0; k < road.points.length; k++) {
      const at = 2 * (k % 2);
      ends[at] = Math.min(ends[at], road.points[k]);
      ends[at + 1] = Math.max(ends[at + 1], road.points[k]);
    }
    const width = ends[1] - ends[0], high = ends[3] - ends[2], size = Math.max(width, high);
    const isFar = Math.max(...ends.map(Math.abs)) > 20 * size;
    const globe = Math.abs(ends[0]) <= 180 && Math.abs(ends[2]) <= 180;
    const spans = `${rounded(width)} m by ${rounded(high)} m`;
    if (!columns.said && size < 2 && isFar && globe) {
      refuse(`x and y span ${spans}, far from 0, as degrees of longitude and latitude do: convert them to metres.`);
    }
    const note = `The road spans ${spans}: if x and y are in km, multiply them by 1000.`;
    if (!columns.said && size < 20) road.notes.push(note);
    return road;
  }

  function roadFlaw(status, place, road, given) {
    const answers = given.answers.path_through, rules = given.points;
    const at = road.lines?.[place] === undefined ? `point ${place + 1}` : `line ${road.lines[place]}`;
    const sentences = {
      TOO_FEW: `${place} points apart from each other: a road needs at least ${rules.fewest}.`,
      POINT_NOT_FINITE: `${at}: x or y is not a finite number; correct or remove the point.`,
      POINT_TOO_FAR:
        `${at}: lies more than ${rules.widest} m from the next point, or ${rules.farthest} m from the origin; ` +
        "correct it, or leave it out.",
      TOO_SHORT: "The points are too near one another: are x and y in metres?",
      PATH_KINK:
        `${at}: the points fold back on themselves behind it, no smooth road goes through them; ` +
        "leave out or move the points there.",
      TOO_SMALL: `${at}: the road bends too much between two points; give more points there.`,
    };
    const name = nameOf(answers, status);
    return name === "OK" ? null : sentences[name] ?? `The points make no road (${status}); correct them.`;
  }

  // -- a drive as a table --------------------------------------------------------------------------------------------
  function writeDrive(history, car, given) {
    const { columns, count } = history.cars[car];
    const names = Object.keys(given.drive).filter((name) => columns[given.drive[name]]);
    const chosenColumns = names.map((name) => columns[given.drive[name]]), rows = [names.join(",")];
    const cell = (x) => (Number.isFinite(x) ? String(x) : "");
    for (let k = 0; k < count; k++) rows.push(chosenColumns.map((values) => cell(values[k])).join(","));
    return `${rows.join("\n")}\n`;
  }

  return { InputError, readCarFile, checkedCar, readSheet, carOfSheet, readPoints, writeDrive, sheetFlaw, roadFlaw };
})();
