// What zstd is made of: bits read from the end, and states of finite-state entropy (RFC 8878, 4).

/** Something that is no zstd frame. */
export const broken = (why) => new Error(`A compressed part is damaged: ${why}`);

const highest = (value) => 31 - Math.clz32(value);

/** Bits of bytes[from, to), read from the last one on; below the first are zeros. */
export class BackwardBits {
  constructor(bytes, from, to) {
    if (to <= from || !bytes[to - 1]) throw broken("bits without an end");
    this.bytes = bytes;
    this.from = from;
    // Above the last bit that counts is a 1.
    this.left = 8 * (to - from - 1) + highest(bytes[to - 1]);
  }

  /** The next bits, at most 16, without taking them. */
  peek(count) {
    const at = this.left - count;
    if (at >= 0) return this.#cut(at, count);
    return this.left > 0 ? this.#cut(0, this.left) << -at : 0;
  }

  #cut(at, count) {
    const { bytes } = this;
    const byte = this.from + (at >> 3);
    const word = bytes[byte] | (bytes[byte + 1] << 8) | (bytes[byte + 2] << 16);
    return (word >>> (at & 7)) & ((1 << count) - 1);
  }

  take(count) {
    if (count > 16) return this.take(count - 16) * 65536 + this.take(16);
    const value = this.peek(count);
    this.left -= count;
    return value;
  }
}

/** A table of states: the symbol of each, and how the next one is found. */
export class States {
  /** counts: how often each symbol comes, −1 for less than once; of 2^accuracy together. */
  constructor(counts, accuracy) {
    const size = 1 << accuracy;
    this.accuracy = accuracy;
    this.symbols = new Uint8Array(size);
    this.bits = new Uint8Array(size);
    this.base = new Uint16Array(size);
    let end = size;
    counts.forEach((count, symbol) => {
      if (count < 0) this.symbols[--end] = symbol;
    });
    const step = (size >> 1) + (size >> 3) + 3;
    let at = 0;
    counts.forEach((count, symbol) => {
      for (let k = 0; k < count; k++) {
        this.symbols[at] = symbol;
        do at = (at + step) & (size - 1);
        while (at >= end);
      }
    });
    const next = counts.map((count) => Math.abs(count));
    for (let state = 0; state < size; state++) {
      const number = next[this.symbols[state]]++;
      this.bits[state] = accuracy - highest(number);
      this.base[state] = (number << this.bits[state]) - size;
    }
  }

  /** The table of one symbol alone. */
  static of(symbol) {
    const states = new States([1], 0);
    states.symbols[0] = symbol;
    return states;
  }

  begin(bits) {
    return bits.take(this.accuracy);
  }

  after(state, bits) {
    return this.base[state] + bits.take(this.bits[state]);
  }
}

/** A table as a frame describes it from a byte on, and the byte after it. */
export function readStates(bytes, from, most) {
  let at = 8 * from;
  const take = (count) => {
    const byte = at >> 3;
    const word = bytes[byte] | (bytes[byte + 1] << 8) | (bytes[byte + 2] << 16);
    const value = (word >>> (at & 7)) & ((1 << count) - 1);
    at += count;
    return value;
  };
  const accuracy = 5 + take(4);
  if (accuracy > most) throw broken("a table too large");
  const counts = [];
  let left = 1 << accuracy;
  while (left > 0 && counts.length < 256) {
    const wide = highest(left + 1) + 1;
    const low = (1 << (wide - 1)) - 1;
    const short = (1 << wide) - 2 - left;
    let value = take(wide);
    if ((value & low) < short) {
      at -= 1;
      value &= low;
    } else if (value > low) value -= short;
    const count = value - 1;
    counts.push(count);
    left -= Math.abs(count);
    for (let zeros = count === 0 ? 3 : 0; zeros === 3; ) {
      zeros = take(2);
      for (let k = 0; k < zeros; k++) counts.push(0);
    }
  }
  if (left !== 0) throw broken("a table that does not add up");
  return { states: new States(counts, accuracy), end: (at + 7) >> 3 };
}
