// What a user gives: a car file, a data sheet, points of a road; and a drive as CSV. All else is refused in words.
//
//   inputs.readCarFile(text, given, {name, others})  a car: {name, description, numbers, estimated, steering, body,
//       known_within (null: no such section), domain, tyre: {name, numbers}}; what is not known is null. others: texts
//       of other files that were dropped with it, by name, among which its tyre may be.
//   inputs.checkedCar(car, given)        the same of such a car that comes from elsewhere, such as a link
//   inputs.readSheet(typed, given)       {name, mass, wheelbase, load, truck, known}, for the kernel complete_car
//   inputs.carOfSheet(sheet, car, within, given)     the car, of the rows that complete_car has written, by name
//   inputs.readPoints(text, given, {closed, name})   {name, points: Float64Array x, y, x, y, ..., count, lines, closed,
//       notes}; lines: of the file, of each point
//   inputs.writeDrive(history, car, given)           text of a CSV file that `identify` and `shadow` read
//   inputs.tooLarge(bytes, what, given)  a sentence, or null; what: "car file", "csv". Ask before a file is read
//   inputs.textOf(file, what, given)     a promise of the text of a File that is not too large
//   inputs.carFlaw(status, ratio, car, loads, given), inputs.outlineFlaw(status, front, rear, car, given),
//   inputs.sheetFlaw(status, sheet, given), inputs.roadFlaw(status, place, road, given)
//       a sentence for what car_flaw, overhangs, complete_car and path_through answer; null where all is well
//
// given: `export.page_inputs.car_fields()`, from the records that check the same in Python. Wrong input throws an
// InputError, whose message is whole sentences, and whose `problems` are {line, key, message}.
"use strict";

const inputs = (() => {
  class InputError extends Error {
    constructor(problems) {
      const shownOnes = problems.slice(0, MOST_SHOWN).map((each) => each.message);
      if (problems.length > MOST_SHOWN) shownOnes.push(`And ${problems.length - MOST_SHOWN} more.`);
      super(shownOnes.join("\n"));
      this.name = "InputError";
      this.problems = problems;
    }
  }

  const MOST_SHOWN = 20, LONGEST_SHOWN = 80, DEEPEST = 64;

  function refuse(message, line = null, key = null) {
    throw new InputError([problem(message, line, key)]);
  }

  function problem(message, line = null, key = null) {
    return { line, key, message: line === null ? message : `line ${line}: ${message}` };
  }

  /** A value in a message: quoted where it is text, and not longer than a line. */
  function shown(value) {
    let text = typeof value === "string" ? JSON.stringify(value) : String(value);
    if (value instanceof Map) text = "a section";
    if (Array.isArray(value)) text = `[${value.slice(0, 10).map((each) => shown(each.value)).join(", ")}]`;
    return text.length <= LONGEST_SHOWN ? text : `${text.slice(0, 37)}...${text.slice(-40)}`;
  }

  const rounded = (x) => String(Number(x.toPrecision(3)));

  // -- names that are nearly right -----------------------------------------------------------------------------------
  /** The share of letters that two names have in common, in their order. */
  function likeness(a, b) {
    let row = new Array(b.length + 1).fill(0);
    for (const letter of a) {
      const next = [0];
      for (let j = 1; j <= b.length; j++) {
        next.push(letter === b[j - 1] ? row[j - 1] + 1 : Math.max(row[j], next[j - 1]));
      }
      row = next;
    }
    return (2 * row[b.length]) / Math.max(a.length + b.length, 1);
  }

  function nearest(name, known) {
    const asked = name.slice(0, LONGEST_SHOWN).toLowerCase();
    const found = known.map((each) => [likeness(asked, each.toLowerCase()), each]).sort((a, b) => b[0] - a[0])[0];
    return found && found[0] >= 0.6 ? found[1] : null;
  }

  function didYouMean(name, known) {
    const near = nearest(name, known);
    return near ? `Did you mean "${near}"?` : `Known: ${known.map((each) => `"${each}"`).join(", ")}.`;
  }

  // -- TOML: what car files are written in ---------------------------------------------------------------------------
  const NUMBER = /^[+-]?(0|[1-9](_?\d)*)(\.\d(_?\d)*)?([eE][+-]?\d(_?\d)*)?$/;
  const OTHER_BASE = /^0(x[0-9a-fA-F](_?[0-9a-fA-F])*|o[0-7](_?[0-7])*|b[01](_?[01])*)$/;
  const ESCAPES = { b: "\b", t: "\t", n: "\n", f: "\f", r: "\r", '"': '"', "\\": "\\" };

  /** The tables of a text: Maps of {value, line, text}; a value is a number, a text, true, false, an Array or a Map. */
  function readToml(text) {
    const clean = withoutSigns(text);
    const reader = { text: clean, at: 0, line: 1, opened: new Set(), closed: new Set() };
    const root = new Map();
    let table = root;
    for (skipLines(reader); reader.at < clean.length; skipLines(reader)) {
      if (clean[reader.at] === "[") table = readHeader(reader, root);
      else readPair(reader, table);
      endLine(reader);
    }
    return root;
  }

  /** The text without its byte order mark; refused where it is no text. */
  function withoutSigns(text) {
    const clean = text.replace(/^\uFEFF/, "").replace(/\r\n/g, "\n");
    // eslint-disable-next-line no-control-regex
    const at = clean.search(/[\u0000-\u0008\u000b-\u001f\u007f\uFFFD]/);
    if (at < 0) return clean;
    const line = clean.slice(0, at).split("\n").length;
    if (clean[at] === "\uFFFD") refuse("not UTF-8 text; save the file as UTF-8.", line);
    return refuse("holds a control character: is this a text file? Remove it.", line);
  }

  function skipSpaces(reader) {
    while (reader.text[reader.at] === " " || reader.text[reader.at] === "\t") reader.at++;
  }

  function skipComment(reader) {
    skipSpaces(reader);
    if (reader.text[reader.at] !== "#") return;
    const end = reader.text.indexOf("\n", reader.at);
    reader.at = end < 0 ? reader.text.length : end;
  }

  function skipLines(reader) {
    for (;;) {
      skipComment(reader);
      if (reader.text[reader.at] !== "\n") return;
      reader.at++;
      reader.line++;
    }
  }

  function restOfLine(reader) {
    const end = reader.text.indexOf("\n", reader.at);
    return reader.text.slice(reader.at, end < 0 ? reader.at + 200 : Math.min(end, reader.at + 200)).trim();
  }

  function endLine(reader) {
    skipComment(reader);
    if (reader.at >= reader.text.length || reader.text[reader.at] === "\n") return;
    const rest = restOfLine(reader);
    if (/^,\d/.test(rest)) refuse(`${shown(rest)} behind a number: write a decimal point, not a comma.`, reader.line);
    refuse(`${shown(rest)} behind the value: one key = value a line; a remark begins with #.`, reader.line);
  }

  function readKeys(reader) {
    const keys = [];
    for (;;) {
      skipSpaces(reader);
      const sign = reader.text[reader.at];
      if (sign === '"' || sign === "'") keys.push(readQuoted(reader));
      else {
        const found = /^[A-Za-z0-9_-]+/.exec(reader.text.slice(reader.at, reader.at + 300));
        if (!found) refuse(`${shown(restOfLine(reader))} is no key: write key = value, or [section].`, reader.line);
        keys.push(found[0]);
        reader.at += found[0].length;
      }
      if (keys.length > DEEPEST) refuse(`more than ${DEEPEST} tables in one another; flatten them.`, reader.line);
      skipSpaces(reader);
      if (reader.text[reader.at] !== ".") return keys;
      reader.at++;
    }
  }

  function readHeader(reader, root) {
    const line = reader.line;
    reader.at++;
    if (reader.text[reader.at] === "[") refuse("[[...]]: a list of sections; no car file has one: write [...].", line);
    const keys = readKeys(reader);
    if (reader.text[reader.at] !== "]") refuse(`[${keys.join(".")}: the bracket "]" is missing.`, line);
    reader.at++;
    const table = tableAt(reader, root, keys, line);
    if (reader.opened.has(table)) refuse(`[${keys.join(".")}] comes twice: put its keys into one section.`, line);
    reader.opened.add(table);
    return table;
  }

  /** The table under keys, made where it is missing. */
  function tableAt(reader, root, keys, line) {
    let table = root;
    for (const key of keys) {
      if (!table.has(key)) table.set(key, { value: new Map(), line, text: "a section" });
      const { value } = table.get(key);
      if (!(value instanceof Map) || reader.closed.has(value)) {
        refuse(`${key} is a value already, in line ${table.get(key).line}: it can be no section as well.`, line);
      }
      table = value;
    }
    return table;
  }

  function readPair(reader, into) {
    const line = reader.line, keys = readKeys(reader), key = keys[keys.length - 1];
    if (reader.text[reader.at] !== "=") refuse(`${keys.join(".")}: "=" and a value are missing.`, line, key);
    reader.at++;
    const table = tableAt(reader, into, keys.slice(0, -1), line);
    if (table.has(key)) refuse(`${key} comes twice, first in line ${table.get(key).line}; remove one.`, line, key);
    table.set(key, readValue(reader, key, 0));
  }

  function readValue(reader, key, depth) {
    if (depth > DEEPEST) refuse(`more than ${DEEPEST} brackets in one another; flatten them.`, reader.line);
    skipSpaces(reader);
    const line = reader.line, first = reader.at, sign = reader.text[first];
    let value;
    if (sign === '"' || sign === "'") value = readQuoted(reader);
    else if (sign === "[") value = readArray(reader, key, depth);
    else if (sign === "{") value = readInline(reader, key, depth);
    else value = readWord(reader, key);
    return { value, line, text: reader.text.slice(first, Math.min(reader.at, first + LONGEST_SHOWN)) };
  }

  function readWord(reader, key) {
    const end = reader.text.slice(reader.at).search(/[\s,\]}#]/);
    const word = reader.text.slice(reader.at, end < 0 ? undefined : reader.at + end);
    if (word === "") refuse(`${key}: the value is missing.`, reader.line, key);
    const value = valueOf(word);
    if (value === undefined) refuse(`${key} = ${shown(word).slice(1, -1)}: ${whyNoValue(word)}`, reader.line, key);
    reader.at += word.length;
    return value;
  }

  function valueOf(word) {
    if (word === "true" || word === "false") return word === "true";
    if (/^[+-]?(inf|nan)$/.test(word)) return word.endsWith("nan") ? NaN : word[0] === "-" ? -Infinity : Infinity;
    if (NUMBER.test(word) || OTHER_BASE.test(word)) return Number(word.replace(/_/g, ""));
    return undefined;
  }

  function whyNoValue(word) {
    if (/^[+-]?(\.\d|\d+\.($|[eE]))/.test(word)) return "a number needs digits on both sides of its point, as 0.5.";
    if (/^[+-]?0\d/.test(word)) return "a number does not begin with 0.";
    if (/^\d{4}-\d\d/.test(word)) return "a date; no key of a car has one.";
    return "neither a number, nor true or false; text stands in quotes.";
  }

  function readQuoted(reader) {
    const sign = reader.text[reader.at], line = reader.line;
    if (reader.text.startsWith(sign.repeat(3), reader.at)) {
      refuse("a text over several lines (three quotes): write it in one line, in single ones.", line);
    }
    let found = "";
    for (reader.at++; ; reader.at++) {
      const here = reader.text[reader.at];
      if (here === undefined || here === "\n") refuse(`a quote ${sign} is missing at the end of a text.`, line);
      if (here === sign) break;
      if (here === "\\" && sign === '"') found += readEscape(reader);
      else found += here;
    }
    reader.at++;
    return found;
  }

  function readEscape(reader) {
    const name = reader.text[++reader.at];
    if (name in ESCAPES) return ESCAPES[name];
    const digits = { u: 4, U: 8 }[name];
    const code = digits ? reader.text.slice(reader.at + 1, reader.at + 1 + digits) : "";
    const number = new RegExp(`^[0-9a-fA-F]{${digits || 9}}$`).test(code) ? parseInt(code, 16) : -1;
    if (number <= 0 || number > 0x10ffff || (number >= 0xd800 && number < 0xe000)) {
      const remedy = "write \\\\ for a backslash, or the text in '...'.";
      refuse(`"\\${name ?? ""}${code}" is no character: ${remedy}`, reader.line);
    }
    reader.at += digits;
    return String.fromCodePoint(number);
  }

  function readArray(reader, key, depth) {
    const found = [], line = reader.line;
    reader.at++;
    for (;;) {
      skipLines(reader);
      if (reader.at >= reader.text.length) refuse(`${key}: the bracket "]" of a list is missing.`, line, key);
      if (reader.text[reader.at] === "]") break;
      found.push(readValue(reader, key, depth + 1));
      skipLines(reader);
      const sign = reader.text[reader.at];
      if (sign === ",") reader.at++;
      else if (sign && sign !== "]") refuse(`${key}: a comma or "]" is missing in a list.`, reader.line, key);
    }
    reader.at++;
    return found;
  }

  function readInline(reader, key, depth) {
    const table = new Map();
    reader.at++;
    skipSpaces(reader);
    while (reader.text[reader.at] !== "}") {
      const line = reader.line, keys = readKeys(reader), own = keys[keys.length - 1];
      if (reader.text[reader.at] !== "=") refuse(`${key}: a key in {...} without "=" and a value.`, line, key);
      reader.at++;
      const inner = tableAt(reader, table, keys.slice(0, -1), line);
      if (inner.has(own)) refuse(`${key}: ${own} comes twice; remove one.`, line, key);
      inner.set(own, readValue(reader, own, depth + 1));
      skipSpaces(reader);
      if (reader.text[reader.at] === ",") reader.at++;
      else if (reader.text[reader.at] !== "}") refuse(`${key}: a comma or "}" is missing.`, line, key);
      skipSpaces(reader);
    }
    reader.at++;
    reader.closed.add(table);
    return table;
  }

  // -- a section against its fields ----------------------------------------------------------------------------------
  function bracketed(field) {
    return field.meaning ? ` (${field.meaning})` : "";
  }

  function isWithin(x, { gt, ge, lt, le }) {
    const above = (gt === undefined || x > gt) && (ge === undefined || x >= ge);
    return above && (lt === undefined || x < lt) && (le === undefined || x <= le);
  }

  /** What is wrong with a value, as the end of a sentence; null: nothing. */
  function flawOf(field, value, given) {
    const wanted = `must be ${field.allowed}${bracketed(field)}.`;
    if (field.kind === "number") {
      if (typeof value !== "number") return `${wanted}${typeof value === "string" ? " Leave out the quotes." : ""}`;
      if (Number.isNaN(value) || (Math.abs(value) === Infinity && !field.infinite)) return wanted;
      return isWithin(value, field.bounds) ? null : wanted;
    }
    if (field.kind === "choice") return field.words.includes(value) ? null : `${wanted} ${choiceHint(field, value)}`;
    if (field.kind === "range") return flawOfRange(field, value, given.most[field.key]);
    if (field.kind === "texts") return flawOfNames(value, given);
    if (typeof value !== "string") return "must be text, in quotes.";
    return field.key === "name" && value === "" ? "must be text of at least one letter." : null;
  }

  function choiceHint(field, value) {
    return typeof value === "string" ? didYouMean(value, field.words) : "In quotes.";
  }

  function flawOfRange(field, value, most) {
    const ends = Array.isArray(value) ? value.map((each) => each.value) : [];
    const risen = ends.length === 2 && ends.every((x) => typeof x === "number") && ends[0] > 0 && ends[0] <= ends[1];
    if (risen && ends[1] <= most) return null;
    return `must be two numbers that rise, [lowest, highest], above 0 and up to ${most}${bracketed(field)}.`;
  }

  function flawOfNames(value, given) {
    if (!Array.isArray(value)) return "must be a list of keys, in brackets.";
    const known = given.sections[""].filter((each) => each.kind === "number").map((each) => each.key);
    const wrong = value.find((each) => !known.includes(each.value));
    if (wrong === undefined) return null;
    return `${shown(wrong.value)} is no number of a car. ${didYouMean(String(wrong.value), known)}`;
  }

  const byKey = (fields, value) => Object.fromEntries(fields.map((each) => [each.key, value(each)]));
  const nameOf = (answers, status) => Object.keys(answers).find((each) => answers[each] === status);
  const plain = (value) => (Array.isArray(value) ? value.map((each) => plain(each.value)) : value);

  /** The values of a section by key, defaults for what is left out; what is wrong goes to problems. */
  function readSection(name, table, given, problems, others = []) {
    const fields = given.sections[name], found = {}, keys = fields.map((each) => each.key);
    for (const [key, { line }] of table) {
      if (keys.includes(key) || others.includes(key)) continue;
      const silent = problems.length >= MOST_SHOWN; // seeking what was meant takes time, and nobody will read it
      problems.push(problem(silent ? "unknown key." : unknownKey(name, key, [...keys, ...others], given), line, key));
    }
    for (const field of fields) {
      const node = table.get(field.key), place = name ? `${name}.${field.key}` : field.key;
      found[field.key] = node ? plain(node.value) : field.default;
      if (!node && field.required) {
        problems.push(problem(`${place}: missing; give ${field.allowed}${bracketed(field)}.`, null, place));
      }
      const flaw = node ? flawOf(field, node.value, given) : null;
      if (flaw) problems.push(problem(`${place} = ${shownNode(node)}: ${flaw}`, node.line, place));
    }
    return found;
  }

  function shownNode(node) {
    return node.value instanceof Map ? "a section" : node.text.replace(/\s+/g, " ");
  }

  function unknownKey(name, key, known, given) {
    const place = name ? `${name}.${key}` : key;
    const has = (section) => given.sections[section].some((field) => field.key === key);
    const home = Object.keys(given.sections).find((each) => each && each !== name && has(each));
    if (home && !nearest(key, known)) return `${shown(place)}: unknown key; it belongs into the section [${home}].`;
    return `${shown(place)}: unknown key. ${didYouMean(key, known)}`;
  }

  // -- a car file ----------------------------------------------------------------------------------------------------
  const PARTS = ["steering", "body", "known_within", "domain"];

  function readCarFile(text, given, { name = "car", others = {} } = {}) {
    return carOfTable(readToml(text), given, name, others);
  }

  function carOfTable(table, given, name, others) {
    const problems = [], car = readSection("", withoutSection(table, "tyre"), given, problems, PARTS);
    const made = { name: car.name ?? name, description: car.description, estimated: car.estimated, numbers: {} };
    for (const field of given.sections[""]) if (field.kind === "number") made.numbers[field.key] = car[field.key];
    for (const part of PARTS) made[part] = readPart(part, table.get(part), given, problems);
    checkSteering(made.steering, table.get("steering"), given, problems);
    made.tyre = readTyre(table.get("tyre"), given, others, problems);
    if (problems.length) throw new InputError(problems.sort((a, b) => (a.line ?? Infinity) - (b.line ?? Infinity)));
    return made;
  }

  function checkedCar(car, given) {
    const table = tableOf({ ...car, ...car?.numbers }), tyre = table.get("tyre")?.value;
    for (const key of ["numbers", "name"]) table.delete(key);
    if (tyre instanceof Map) table.set("tyre", keysOfTyre(tyre, given));
    return carOfTable(table, given, typeof car?.name === "string" ? car.name : "car", {});
  }

  /** Plain data as `readToml` gives it; what is null is left out. */
  function tableOf(data, depth = 0) {
    const found = new Map();
    for (const [key, value] of Object.entries(data ?? {})) {
      if (value === null || value === undefined) continue;
      found.set(key, nodeOf(value, depth));
    }
    return found;
  }

  function nodeOf(value, depth) {
    if (depth > DEEPEST) refuse(`more than ${DEEPEST} tables in one another.`);
    if (Array.isArray(value)) return { value: value.map((each) => nodeOf(each, depth + 1)), line: null, text: "[...]" };
    if (typeof value === "object" && value) return { value: tableOf(value, depth + 1), line: null, text: "a section" };
    return { value, line: null, text: shown(value) };
  }

  /** A tyre's row as a section with the keys of its file; its name where it has no numbers of its own. */
  function keysOfTyre(tyre, given) {
    const rows = tyre.get("numbers")?.value, found = new Map([...tyre].filter(([key]) => key === "name"));
    const section = { value: found, line: null, text: "a section" };
    if (!(rows instanceof Map)) return (rows === undefined && tyre.get("name")) || section;
    for (const field of given.sections.tyre) {
      const node = rows.get(field.row);
      if (node && field.kind === "number") found.set(field.key, node);
      const word = node && field.kind === "choice" ? field.words[node.value] ?? node.value : null;
      if (word !== null) found.set(field.key, { ...node, value: word });
    }
    return section;
  }

  function withoutSection(table, key) {
    return new Map([...table].filter(([name, node]) => name !== key || !(node.value instanceof Map)));
  }

  function readPart(part, node, given, problems) {
    if (node && !(node.value instanceof Map)) {
      problems.push(problem(`${part} = ${shownNode(node)}: must be a section, [${part}].`, node.line, part));
      return null;
    }
    if (!node && part === "known_within") return null;
    return readSection(part, node ? node.value : new Map(), given, problems);
  }

  function checkSteering(steering, node, given, problems) {
    const rate = steering?.rate, said = node?.value instanceof Map ? node.value.get("rate") : null;
    if (!said || typeof rate !== "number" || !(rate > given.fastest_rate)) return;
    problems.push(problem(
      `steering.rate = ${said.text}: no road wheels turn so fast; cars have 0.3 to 1 rad/s. Of degrees per second ` +
        `give ${rounded((rate * Math.PI) / 180)}; of a rate at the steering wheel, that over the ratio.`,
      said.line, "steering.rate",
    ));
  }

  /** {name, numbers}: ours by its name, another file's that is at hand, or a section's with the keys of a tyre file. */
  function readTyre(node, given, others, problems) {
    const field = given.sections[""].find((each) => each.key === "tyre");
    const named = node ? node.value : field.default;
    if (named instanceof Map) return ownTyre(named, "own tyre", given, problems, node.line);
    if (typeof named !== "string") return null; // said already
    if (named in given.tyres) return { name: named, numbers: given.tyres[named] };
    if (!/\.toml$|[/\\]/.test(named)) {
      const hint = didYouMean(named, Object.keys(given.tyres));
      problems.push(problem(`tyre = ${shown(named)}: unknown tyre. ${hint}`, node.line, "tyre"));
      return null;
    }
    const file = named.split(/[/\\]/).pop();
    if (!Object.hasOwn(others, file)) {
      const remedy = `drop ${shown(file)} together with this file, or write its keys here, in a section [tyre]`;
      problems.push(problem(`tyre = ${shown(named)}: another file, which is not here: ${remedy}.`, node.line, "tyre"));
      return null;
    }
    return tyreOfFile(file, others[file], given, problems);
  }

  function tyreOfFile(file, text, given, problems) {
    try {
      return ownTyre(readToml(text), file.replace(/\.toml$/, ""), given, problems, null);
    } catch (error) {
      if (!(error instanceof InputError)) throw error;
      problems.push(problem(`${file}: ${error.message}`, null, "tyre"));
      return null;
    }
  }

  function ownTyre(table, name, given, problems, line) {
    const found = readSection("tyre", table, given, problems), before = problems.length, numbers = {};
    if (found.stiffness_load === "digressive" && found.digressive_load_ratio === null) {
      const why = "a digressive stiffness needs the load ratio at which it peaks (2 for many car tyres)";
      problems.push(problem(`tyre.digressive_load_ratio: missing: ${why}.`, line, "tyre.digressive_load_ratio"));
    }
    if (found.stiffness_load !== "digressive" && found.digressive_load_ratio !== null && before === problems.length) {
      const at = table.get("digressive_load_ratio").line, key = "tyre.digressive_load_ratio";
      problems.push(problem(`${key}: only stiffness_load = "digressive" has a use for it: leave it out.`, at, key));
    }
    for (const field of given.sections.tyre) {
      const value = found[field.key];
      if (field.kind === "number") numbers[field.row] = value;
      if (field.kind === "choice") numbers[field.row] = field.words.indexOf(value);
    }
    return { name: found.name ?? name, numbers };
  }

  // -- what kernels say of a car -------------------------------------------------------------------------------------
  function carFlaw(status, ratio, car, loads, given) {
    const { ONE_CAR, INERTIA_ODD, FRONT_ODD } = given.answers.car_flaw, { numbers } = car;
    const [low, high] = status === INERTIA_ODD ? given.flaws.inertias : given.flaws.stiffnesses;
    if (status === ONE_CAR) return null;
    if (status === INERTIA_ODD) {
      return `yaw_inertia = ${numbers.yaw_inertia} kg m^2 and mass = ${numbers.mass} kg do not belong together: ` +
        `yaw_inertia/(mass lf lr) = ${rounded(ratio)}, where cars have about 1 (${low} to ${high} is allowed). Give ` +
        "the mass in kg, lengths in m, the inertia in kg m^2.";
    }
    const [key, load] = status === FRONT_ODD ? ["stiffness_front", loads[0]] : ["stiffness_rear", loads[1]];
    return `${key} = ${numbers[key]} N/rad is ${rounded(ratio)} times the load of its wheel, ` +
      `${load.toFixed(0)} N; tyres have 5 to 30 (${low} to ${high} is allowed). Give it in N/rad for one tyre: N/deg ` +
      "times 57.3, kN/rad times 1000.";
  }

  function outlineFlaw(status, front, rear, car, given) {
    const { HOLDS, AXLE_OUTSIDE } = given.answers.overhangs;
    if (status === HOLDS) return null;
    if (status === AXLE_OUTSIDE) {
      return `body.length = ${car.body.length} m does not hold wheelbase and overhangs: give a longer one.`;
    }
    return `body.length = ${car.body.length} m is not overhang, wheelbase and overhang, ${rounded(front)} m and ` +
      `${rounded(rear)} m about the axles: leave one of the three out.`;
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
    const fields = given.sections[""].filter((each) => each.kind === "number" && each.key !== "mass");
    for (const [key, value] of Object.entries(typed)) {
      const field = fields.find((each) => each.key === key);
      if (value === null || value === undefined || value === "") continue;
      if (key === "name") sheet.name = String(value);
      else if (key === "body_style") sheet.truck = styleOf(value, given, problems);
      else if (key in given.sheet || key === "load" || field) readTyped(key, value, field, sheet, given, problems);
      else say(`${shown(key)}: unknown. ${didYouMean(key, ["mass", "wheelbase", "load", "body_style"])}`, key);
    }
    for (const key of ["mass", "wheelbase"]) {
      if (sheet[key] !== null || problems.some((each) => each.key === key)) continue;
      say(`${key}: missing; give ${key === "mass" ? "kg" : "m"}, ${given.sheet[key].join(" to ")}.`, key);
    }
    if (problems.length) throw new InputError(problems);
    return sheet;
  }

  function styleOf(value, given, problems) {
    const known = given.sheet.body_styles, place = known.indexOf(value);
    const message = `body_style = ${shown(value)}: unknown. ${didYouMean(String(value), known)}`;
    if (place < 0) problems.push(problem(message, null, "body_style"));
    return Math.max(place, 0);
  }

  function readTyped(key, value, field, sheet, given, problems) {
    const { number, flaw } = typedNumber(value);
    const say = (text) => problems.push(problem(`${key} = ${shown(value)}: ${text}`, null, key));
    if (flaw) say(flaw);
    else if (field) {
      const wrong = flawOf(field, number, given);
      if (wrong) say(wrong);
      else sheet.known[key] = number;
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
      COMPLETE: null,
      MASS_OUTSIDE: `mass = ${mass} kg: must be from ${given.sheet.mass.join(" to ")}.`,
      WHEELBASE_OUTSIDE: `wheelbase = ${wheelbase} m: must be from ${given.sheet.wheelbase.join(" to ")}.`,
      TOO_MUCH_LOAD: `load = ${load} kg: must not be more than the car itself, ${mass} kg.`,
      AXLES_DISAGREE: `lf and lr do not make the wheelbase of ${wheelbase} m: give one of them, or neither.`,
    };
    return sentences[nameOf(answers, status)];
  }

  function carOfSheet(sheet, car, within, given) {
    const numbers = {}, parts = {};
    for (const field of given.sections[""]) {
      if (field.kind !== "number") continue;
      numbers[field.key] = car[field.key] ?? sheet.known[field.key] ?? field.default;
    }
    for (const part of PARTS) parts[part] = byKey(given.sections[part], (each) => each.default);
    const finite = (x) => (Number.isFinite(x) ? x : null);
    parts.known_within = byKey(given.sections.known_within, ({ key }) => finite(within[key]));
    const tyre = given.sections[""].find((each) => each.key === "tyre").default;
    const description = `estimated from ${sheet.mass} kg and ${sheet.wheelbase} m of wheelbase`;
    const own = { name: tyre, numbers: given.tyres[tyre] };
    return { name: sheet.name, description, estimated: [], numbers, ...parts, tyre: own };
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
    const found = { name, points: points.slice(0, 2 * count), count, lines, closed: closed ?? comesBack, notes };
    return lookAlikes(found, columns);
  }

  /** The cells of the lines of numbers, each with its line, and the header; see `read_points` in Python. */
  function rowsOf(text, rules) {
    const clean = text.replace(/^\uFEFF/, ""), cells = [], lines = [], remarks = [];
    let header = null, blanks = false;
    for (let at = 0, line = 1; at < clean.length; line++) {
      let end = clean.indexOf("\n", at);
      if (end < 0) end = clean.length;
      if (end - at > 10_000) refuse("a line of more than 10,000 characters: this is no table of points.", line);
      const content = clean.slice(at, end).trim(), plain = content.replace(/^[#\s]+/, ""), titles = cellsOf(plain);
      at = end + 1;
      if (plain === "" || (content[0] === "#" && cells.length)) continue;
      if (content[0] === "#") remarks.push({ line, titles, marked: separatorOf(plain) !== BLANKS });
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
    return headers.findLast((each) => each.complete) ?? headers.findLast((each) => each.incomplete) ?? null;
  }

  const BLANKS = /\s+/;

  function separatorOf(content) {
    return [";", "\t", ","].find((sign) => content.includes(sign)) ?? BLANKS;
  }

  function cellsOf(content) {
    return content.split(separatorOf(content)).map((cell) => cell.trim().replace(/^"+|"+$/g, ""));
  }

  const NO_NUMBER = /^[+-]?(nan|inf(inity)?)$/i, DECIMAL = /^[+-]?(\d+([.,]\d*)?|\.\d+)([eE][+-]?\d+)?$/;
  const isNumber = (cell) => DECIMAL.test(cell) || NO_NUMBER.test(cell);
  const plainTitle = (title) => title.replace(/\s*[[(].*/, "").trim().toLowerCase();

  function titleOf(title, rules) {
    return Object.keys(rules.columns).find((each) => rules.columns[each].includes(plainTitle(title))) ?? null;
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
    const said = [x, y].some((k) => unitOf(names[k]) === "m");
    return { x, y, count: names.length, said, notes: left ? [`Columns left out: ${left.slice(0, 200)}.`] : [] };
  }

  function columnOf(name, names, header, rules) {
    const places = [...names.keys()].filter((k) => titleOf(names[k], rules) === name);
    if (places.length !== 1) {
      const hint = places.length ? "there are two." : didYouMean(name, names);
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
    const wide = ends[1] - ends[0], high = ends[3] - ends[2], size = Math.max(wide, high);
    const far = Math.max(...ends.map(Math.abs)) > 20 * size;
    const globe = Math.abs(ends[0]) <= 180 && Math.abs(ends[2]) <= 180;
    const spans = `${rounded(wide)} m by ${rounded(high)} m`;
    if (!columns.said && size < 2 && far && globe) {
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
      TOO_FEW: `${road.count} points: a road needs at least ${rules.fewest}.`,
      NOT_FINITE: `${at}: x or y is not a finite number; correct or remove the point.`,
      TOO_FAR:
        `${at}: lies more than ${rules.widest} m from the next point, or ${rules.farthest} m from the origin; ` +
        "correct it, or leave it out.",
      TWICE: `${at}: the point comes twice; leave one out.`,
      TOO_SHORT: "The points are too near one another: are x and y in metres?",
      KINK:
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
    const kept = names.map((name) => columns[given.drive[name]]), rows = [names.join(",")];
    const cell = (x) => (Number.isFinite(x) ? String(x) : "");
    for (let k = 0; k < count; k++) rows.push(kept.map((values) => cell(values[k])).join(","));
    return `${rows.join("\n")}\n`;
  }

  // -- sizes ---------------------------------------------------------------------------------------------------------
  function tooLarge(bytes, what, given) {
    const most = given.largest[what];
    if (bytes <= most) return null;
    return `The file has ${(bytes / 1e6).toFixed(1)} MB; a ${what} has at most ${most / 1e6} MB: give a smaller one.`;
  }

  async function textOf(file, what, given) {
    const flaw = tooLarge(file.size, what, given);
    if (flaw) refuse(flaw);
    return file.text();
  }

  return {
    InputError, readCarFile, checkedCar, readSheet, carOfSheet, readPoints, writeDrive, tooLarge, textOf,
    carFlaw, outlineFlaw, sheetFlaw, roadFlaw,
  };
})();
