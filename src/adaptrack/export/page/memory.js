// The memory of the kernels, with records in it whose fields are read and written by name.
//
//   const memory = new Memory(exports, layouts, calls)   exports: of the module; layouts, calls: as Python writes them
//   memory.make(name, given)        a record at a place of its own, with all its arrays, zero but for what is given
//   memory.array(kind, shape)       an array at a place of its own; kind: "F" of float64, "I" of int64
//   memory.free(each)               give the place of one of these back
//   memory.call(kernel, ...)        call a kernel with records, arrays and numbers; several answers come as an array
//   memory.link(kernel)             its address, as records hold it
//
// Of a record: fields are numbers, records, or arrays; what is not a field begins with $: record.$at is its place,
// record.$set({...}) writes fields, record.$copy(other) all of them. Of an array: at, shape, values (a view, valid
// until memory is made next), row(i) where it holds rows.
"use strict";

const WORD = 8, PAGE = 65536, APART = 64;

/** Values of what Python wrote in base64, as float64 or as int64. */
function unpackedNumbers(text, whole) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return whole ? new BigInt64Array(bytes.buffer) : new Float64Array(bytes.buffer);
}

/** How many numbers a shape has. */
const countOf = (shape) => shape.reduce((product, each) => product * each, 1);
const roundedUp = (bytes) => Math.max(APART, Math.ceil(bytes / APART) * APART);

class Block {
  constructor(memory, at, kind, shape) {
    Object.assign(this, { memory, at, kind, shape });
  }
  get values() {
    const view = this.kind === "I" ? this.memory.whole : this.memory.real;
    return view.subarray(this.at / WORD, this.at / WORD + this.words);
  }
  get words() {
    return countOf(this.shape) * (this.kind === "F" || this.kind === "I" ? 1 : this.memory.layouts[this.kind].words);
  }
  row(i) {
    return this.memory.at(this.kind, this.at + WORD * i * this.memory.layouts[this.kind].words);
  }
}

class Memory {
  constructor(exports, layouts, calls) {
    Object.assign(this, { exports, layouts, calls, table: exports.__indirect_function_table });
    this.end = exports.memory.buffer.byteLength; // behind what is in use
    this.spare = []; // places that were given back
    this.linked = new Map();
    this.kinds = new Map();
    this.answers = this.array("F", [16]);
  }

  get real() {
    this._look();
    return this._real;
  }
  get whole() {
    this._look();
    return this._whole;
  }
  _look() {
    const buffer = this.exports.memory.buffer;
    if (buffer === this._buffer) return;
    this._buffer = buffer;
    this._real = new Float64Array(buffer);
    this._whole = new BigInt64Array(buffer);
  }

  // -- places
  /** A place for so many bytes, all zero. */
  _take(bytes) {
    const size = roundedUp(bytes);
    const k = this.spare.findIndex((block) => block.size >= size);
    let at = this.end;
    if (k >= 0) {
      const place = this.spare[k];
      at = place.at;
      if (place.size === size) this.spare.splice(k, 1);
      else Object.assign(place, { at: at + size, size: place.size - size });
    } else {
      const missing = this.end + size - this.exports.memory.buffer.byteLength;
      if (missing > 0) this.exports.memory.grow(Math.ceil(missing / PAGE));
      this.end += size;
    }
    this.real.fill(0, at / WORD, (at + size) / WORD);
    return { at, size };
  }
  free(each) {
    const key = each instanceof Row ? "$place" : "place";
    if (!each?.[key]) return;
    this.spare.push(each[key]);
    each[key] = null;
    this.spare.sort((a, b) => a.at - b.at);
    this.spare = this.spare.reduce((merged, next) => {
      const last = merged.at(-1);
      if (last && last.at + last.size === next.at) last.size += next.size;
      else merged.push(next);
      return merged;
    }, []);
    const last = this.spare.at(-1);
    if (last.at + last.size === this.end) this.end = this.spare.pop().at;
  }
  /** Bytes that are in use. */
  get used() {
    return this.end - this.spare.reduce((sum, each) => sum + each.size, 0);
  }

  array(kind, shape, values) {
    const block = new Block(this, 0, kind, shape);
    block.place = this._take(WORD * block.words);
    block.at = block.place.at;
    if (values) block.values.set(values);
    return block;
  }
  /** One row of a record of numbers, with what is given. */
  row(name, given = {}) {
    const block = this.array(name, [1]), row = block.row(0);
    row.$place = block.place;
    this._fill(row, given);
    return row;
  }

  // -- records
  /** The record that lies at a place. */
  at(name, at) {
    const Kind = this._kind(name);
    return new Kind(this, at);
  }

  make(name, given = {}) {
    const { words } = this.layouts[name];
    const place = this._take(roundedUp(WORD * words) + this._room(name, given));
    const record = this.at(name, place.at);
    record.$place = place;
    this._lay(record, given, place.at + roundedUp(WORD * words));
    return record;
  }

  /** Bytes of all arrays of a record. */
  _room(name, given) {
    let room = 0;
    for (const [field, [, kind, more]] of Object.entries(this.layouts[name].fields)) {
      const value = given[field];
      if (kind === "r") room += this._room(more, value ?? {});
      else if (value?.share) continue;
      else if ("FIR".includes(kind)) {
        const count = countOf(shapeOf(value, more, kind));
        room += roundedUp(WORD * count * this._each(kind, more));
      }
    }
    return room;
  }
  _each(kind, more) {
    return kind === "R" ? this.layouts[more].words : 1;
  }

  /** Write a record and lay its arrays from a place on; the place behind them. */
  _lay(record, given, free) {
    const { real, whole } = this;
    for (const [field, [place, kind, more]] of Object.entries(record.$layout.fields)) {
      const value = given[field], word = record.$at / WORD + place;
      if (kind === "r") free = this._lay(record[field], value ?? {}, free);
      else if ("FIR".includes(kind)) {
        const shape = shapeOf(value, more, kind);
        whole[word] = BigInt(value?.share?.at ?? free);
        shape.forEach((size, k) => (whole[word + 1 + k] = BigInt(size)));
        if (value?.share) continue;
        const words = countOf(shape) * this._each(kind, more);
        if (value) this._copy(value, free, words, kind);
        free += roundedUp(WORD * words);
      } else if (value !== undefined) this._set(record, field, value);
    }
    return free;
  }
  _copy(value, at, words, kind) {
    const target = (kind === "I" ? this.whole : this.real).subarray(at / WORD, at / WORD + words);
    if (value.words !== undefined && typeof value.words === "string")
      this.whole.set(unpackedNumbers(value.words, true), at / WORD);
    else if (value.f8) target.set(unpackedNumbers(value.f8));
    else if (value.i8) target.set(unpackedNumbers(value.i8, true));
    else if (value instanceof Block) target.set(value.values);
    else if (value.values) target.set(value.values);
  }

  /** Write fields of a record of numbers. */
  _fill(record, given) {
    if (typeof given.words === "string") this.whole.set(unpackedNumbers(given.words, true), record.$at / WORD);
    else for (const [field, value] of Object.entries(given)) this._set(record, field, value);
  }
  _set(record, field, value) {
    const entry = record.$layout.fields[field];
    if (!entry) throw new Error(`${record.$name}: no field ${field}`);
    const [place, kind] = entry, word = record.$at / WORD + place;
    if (value?.function !== undefined) this.whole[word] = this.link(value.function);
    else if (kind === "r") value instanceof Row ? record[field].$copy(value) : this._fill(record[field], value);
    else if (kind === "W") record[field].set(value.f8 ? unpackedNumbers(value.f8) : value);
    else if (kind === "i") this.whole[word] = BigInt(value);
    else this.real[word] = value?.f8 ? unpackedNumbers(value.f8)[0] : value;
  }

  /** The class of the records of a name. */
  _kind(name) {
    if (this.kinds.has(name)) return this.kinds.get(name);
    const layout = this.layouts[name];
    if (!layout) throw new Error(`no record ${name}`);
    const Kind = class extends Row {};
    Object.assign(Kind.prototype, { $layout: layout, $name: name });
    for (const [field, [place, kind, more]] of Object.entries(layout.fields))
      Object.defineProperty(Kind.prototype, field, accessors(field, place, kind, more));
    this.kinds.set(name, Kind);
    return Kind;
  }

  // -- kernels
  link(kernel) {
    if (!kernel) return 0n;
    if (!this.linked.has(kernel)) {
      const place = this.table.grow(1);
      this.table.set(place, this.exports[`adaptrack_${kernel}`]);
      this.linked.set(kernel, BigInt(place));
    }
    return this.linked.get(kernel);
  }

  call(kernel, ...given) {
    const signature = this.calls[kernel], found = this.exports[`adaptrack_${kernel}`];
    if (!signature || !found) throw new Error(`the kernels lack ${kernel}`);
    const [takes, returns] = signature, words = [];
    [...takes].forEach((kind, k) => {
      const value = given[k];
      if (kind === "i") words.push(BigInt(value));
      else if (kind === "f") words.push(Number(value));
      else if (kind === "r") words.push(value.$at);
      else words.push(value.at, ...value.shape.map(BigInt));
    });
    if (returns.length < 2) {
      const answer = found(...words);
      return returns === "i" ? Number(answer) : answer;
    }
    found(...words, this.answers.at);
    const first = this.answers.at / WORD;
    return [...returns].map((kind, k) => (kind === "i" ? Number(this.whole[first + k]) : this.real[first + k]));
  }
}

/** An array of a record that is not laid behind it: another record may have it, too. */
const share = (block) => ({ share: block, shape: block.shape });

/** The shape that is given for an array; nothing given: without entries. */
function shapeOf(value, more, kind) {
  return value?.shape ?? new Array(kind === "R" ? 1 : more).fill(0);
}

class Row {
  constructor(memory, at) {
    Object.assign(this, { $memory: memory, $at: at, $parts: {} });
  }
  /** Take over all numbers of another record of this kind. */
  $copy(other) {
    const { whole } = this.$memory, first = other.$at / WORD;
    whole.copyWithin(this.$at / WORD, first, first + this.$layout.words);
    return this;
  }
  $set(given) {
    this.$memory._fill(this, given);
    return this;
  }
  /** All numbers by name. */
  get $numbers() {
    return Object.fromEntries(Object.keys(this.$layout.fields).map((field) => [field, this[field]]));
  }
}

/** How a field is read and written. */
function accessors(field, place, kind, more) {
  const word = (row) => row.$at / WORD + place;
  const withMemory = (make) => function () {
    return (this.$parts[field] ??= make(this));
  };
  const set = function (value) {
    this.$memory._set(this, field, value);
  };
  if (kind === "f") return { get() { return this.$memory.real[word(this)]; }, set };
  if (kind === "i") return { get() { return Number(this.$memory.whole[word(this)]); }, set };
  if (kind === "r") return { get: withMemory((row) => row.$memory.at(more, row.$at + WORD * place)), set };
  if (kind === "W") return { get() { return this.$memory.real.subarray(word(this), word(this) + more); }, set };
  if (kind === "S") return { get: withMemory((row) => new Block(row.$memory, row.$at + WORD * place, more[0], [more[1]])) };
  return {
    get: withMemory((row) => {
      const sizes = kind === "R" ? 1 : more, first = word(row), { whole } = row.$memory;
      const shape = Array.from({ length: sizes }, (_, k) => Number(whole[first + 1 + k]));
      return new Block(row.$memory, Number(whole[first]), kind === "R" ? more : kind, shape);
    }),
  };
}
