// Frames of zstd unpacked (RFC 8878), for browsers have no decoder of it that pages may use.

import { BackwardBits, States, broken, readStates } from "./zstd_bits.js";
import { readLiterals } from "./zstd_literals.js";

const MAGIC = 0xfd2fb528;
const few = (first, last) => Array.from({ length: last - first }, (_, k) => first + k);
const times = (...runs) => runs.flatMap(([value, count]) => Array(count).fill(value));

/** Lengths of literals, offsets and lengths of matches: their usual states, and what codes mean. */
const KINDS = [
  {
    most: 9,
    usual: new States([4, 3, ...times([2, 11], [1, 3], [2, 9]), 3, 2, ...times([1, 5], [-1, 4])], 6),
    base: [...few(0, 16), 16, 18, 20, 22, 24, 28, 32, 40, 48, ...few(6, 17).map((bits) => 2 ** bits)],
    bits: [...times([0, 16], [1, 4], [2, 2], [3, 2], [4, 1]), ...few(6, 17)],
  },
  {
    most: 8,
    usual: new States(times([1, 6], [2, 3], [1, 15], [-1, 5]), 5),
    base: few(0, 32).map((code) => 2 ** code),
    bits: few(0, 32),
  },
  {
    most: 9,
    usual: new States([1, 4, 3, ...times([2, 6], [1, 37], [-1, 7])], 6),
    base: [...few(3, 35), 35, 37, 39, 41, 43, 47, 51, 59, 67, 83, 99, ...few(7, 17).map((bits) => 3 + 2 ** bits)],
    bits: [...times([0, 32], [1, 4], [2, 2], [3, 2], [4, 2], [5, 1]), ...few(7, 17)],
  },
];

/** The bytes of a frame, of which there must be so many. */
export function unpacked(frame, length) {
  // What is read a few bytes at a time may look beyond the end.
  const bytes = new Uint8Array(frame.length + 8);
  bytes.set(frame);
  const view = new DataView(bytes.buffer);
  if (frame.length < 9 || view.getUint32(0, true) !== MAGIC) throw broken("no frame");
  const told = bytes[4];
  const single = (told >> 5) & 1;
  let at = 5 + (single ? 0 : 1) + [0, 1, 2, 4][told & 3] + [single, 2, 4, 8][told >> 6];
  const out = new Output(length);
  for (let last = 0; !last; ) {
    if (at + 3 > frame.length) throw broken("cut off");
    const header = bytes[at] | (bytes[at + 1] << 8) | (bytes[at + 2] << 16);
    const size = header >> 3;
    last = header & 1;
    at += 3;
    const kind = (header >> 1) & 3;
    if (at + (kind === 1 ? 1 : size) > frame.length) throw broken("cut off");
    if (kind === 0) out.literals(bytes.subarray(at, at + size));
    else if (kind === 1) out.literals(new Uint8Array(size).fill(bytes[at]));
    else if (kind === 2) out.block(bytes.subarray(0, at + size + 8), at, at + size);
    else throw broken("a block of no kind");
    at += kind === 1 ? 1 : size;
  }
  if (out.at !== length) throw broken("another length");
  return out.bytes;
}

/** What came so far, and what later blocks refer to. */
class Output {
  constructor(length) {
    this.bytes = new Uint8Array(length);
    this.at = 0;
    this.code = null;
    this.states = KINDS.map(() => null);
    this.offsets = [1, 4, 8];
  }

  literals(bytes) {
    if (this.at + bytes.length > this.bytes.length) throw broken("too long");
    this.bytes.set(bytes, this.at);
    this.at += bytes.length;
  }

  block(bytes, from, to) {
    const { literals, code, end } = readLiterals(bytes, from, this.code);
    this.code = code;
    let [count, at] = [bytes[end], end + 1];
    if (count === 255) [count, at] = [bytes[at] + (bytes[at + 1] << 8) + 0x7f00, at + 2];
    else if (count >= 128) [count, at] = [((count - 128) << 8) + bytes[at], at + 1];
    if (!count) {
      this.literals(literals);
      return;
    }
    const modes = bytes[at++];
    KINDS.forEach((kind, k) => {
      const mode = (modes >> (6 - 2 * k)) & 3;
      if (mode === 0) this.states[k] = kind.usual;
      else if (mode === 1) this.states[k] = States.of(bytes[at++]);
      else if (mode === 2) ({ states: this.states[k], end: at } = readStates(bytes, at, kind.most));
      if (!this.states[k]) throw broken("states that were never told");
    });
    const rest = this.#sequences(new BackwardBits(bytes, at, to), count, literals);
    this.literals(literals.subarray(rest));
  }

  /** Literals and copies by turns; how many literals were used. */
  #sequences(bits, count, literals) {
    const [L, O, M] = this.states;
    const [ofLiterals, ofOffsets, ofMatches] = KINDS;
    let [l, o, m] = [L.begin(bits), O.begin(bits), M.begin(bits)];
    let used = 0;
    const value = (kind, code) => kind.base[code] + bits.take(kind.bits[code]);
    for (let k = 0; k < count; k++) {
      const told = value(ofOffsets, O.symbols[o]);
      const match = value(ofMatches, M.symbols[m]);
      const plain = value(ofLiterals, L.symbols[l]);
      if (used + plain > literals.length || this.at + plain > this.bytes.length) throw broken("too few literals");
      for (const end = used + plain; used < end; ) this.bytes[this.at++] = literals[used++];
      this.#copy(this.#offset(told, plain), match);
      if (k + 1 < count) [l, m, o] = [L.after(l, bits), M.after(m, bits), O.after(o, bits)];
    }
    if (bits.left !== 0) throw broken("bits left over");
    return used;
  }

  /** How far back a match is; the last three can be told again. */
  #offset(told, plain) {
    const recent = this.offsets;
    if (told > 3) {
      this.offsets = [told - 3, recent[0], recent[1]];
      return told - 3;
    }
    const place = told - 1 + (plain ? 0 : 1);
    if (place === 0) return recent[0];
    const offset = place < 3 ? recent[place] : recent[0] - 1;
    this.offsets = [offset, recent[0], place === 1 ? recent[2] : recent[1]];
    return offset;
  }

  #copy(offset, length) {
    const { bytes, at } = this;
    if (offset < 1 || offset > at || at + length > bytes.length) throw broken("a copy from nowhere");
    if (offset >= length) bytes.copyWithin(at, at - offset, at - offset + length);
    else for (let k = at; k < at + length; k++) bytes[k] = bytes[k - offset];
    this.at += length;
  }
}
