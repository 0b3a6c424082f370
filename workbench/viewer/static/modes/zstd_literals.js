// Literals of a zstd block: as they are, one byte again and again, or in Huffman's code (RFC 8878, 4.2).

import { BackwardBits, broken, readStates } from "./zstd_bits.js";

const MOST_BITS = 11;

/** The code that weights of symbols tell; the last one's is what is left. */
function codeOf(weights) {
  const sum = weights.reduce((total, weight) => total + (weight ? 1 << (weight - 1) : 0), 0);
  if (!sum) throw broken("a code without symbols");
  const bits = 32 - Math.clz32(sum);
  const left = (1 << bits) - sum;
  if (bits > MOST_BITS || left & (left - 1)) throw broken("a code that does not add up");
  const all = [...weights, 32 - Math.clz32(left)];
  const [symbols, lengths] = [new Uint8Array(1 << bits), new Uint8Array(1 << bits)];
  let at = 0;
  for (let weight = 1; weight <= bits; weight++) {
    all.forEach((own, symbol) => {
      if (own !== weight) return;
      const next = at + (1 << (weight - 1));
      symbols.fill(symbol, at, next);
      lengths.fill(bits + 1 - weight, at, next);
      at = next;
    });
  }
  return { bits, symbols, lengths };
}

/** The code described from a byte on, and the byte after it. */
function readCode(bytes, from) {
  const header = bytes[from];
  if (header >= 128) {
    const count = header - 127;
    const weights = Array.from({ length: count }, (_, k) => (bytes[from + 1 + (k >> 1)] >> (k & 1 ? 0 : 4)) & 15);
    return { code: codeOf(weights), end: from + 1 + ((count + 1) >> 1) };
  }
  const end = from + 1 + header;
  const { states, end: begin } = readStates(bytes, from + 1, 6);
  const bits = new BackwardBits(bytes, begin, end);
  const weights = [];
  // Two states take turns; when the bits are used up, the other one has the last word.
  let [one, other] = [states.begin(bits), states.begin(bits)];
  while (weights.length < 255) {
    weights.push(states.symbols[one]);
    one = states.after(one, bits);
    if (bits.left < 0) break;
    [one, other] = [other, one];
  }
  weights.push(states.symbols[other]);
  return { code: codeOf(weights), end };
}

function decode({ bits: wide, symbols, lengths }, bytes, from, to, out, first, last) {
  const bits = new BackwardBits(bytes, from, to);
  for (let k = first; k < last; k++) {
    const word = bits.peek(wide);
    out[k] = symbols[word];
    bits.left -= lengths[word];
  }
  if (bits.left !== 0) throw broken("a stream of another length");
}

/** Literals that begin at a byte, the code they are in, and the byte after them. */
export function readLiterals(bytes, from, codeBefore) {
  const kind = bytes[from] & 3;
  const form = (bytes[from] >> 2) & 3;
  const word = bytes[from] | (bytes[from + 1] << 8) | (bytes[from + 2] << 16);
  if (kind < 2) {
    const header = form === 1 ? 2 : form === 3 ? 3 : 1;
    const count = header === 1 ? (word & 255) >> 3 : (word & (2 ** (8 * header) - 1)) >> 4;
    const at = from + header;
    if (kind === 0) return { literals: bytes.subarray(at, at + count), code: codeBefore, end: at + count };
    return { literals: new Uint8Array(count).fill(bytes[at]), code: codeBefore, end: at + 1 };
  }
  const wide = [10, 10, 14, 18][form];
  const header = [3, 3, 4, 5][form];
  // Up to 40 bits, more than numbers keep as whole ones in bit operations.
  const long = word + bytes[from + 3] * 2 ** 24 + bytes[from + 4] * 2 ** 32;
  const count = Math.floor(long / 16) % 2 ** wide;
  const end = from + header + (Math.floor(long / 2 ** (4 + wide)) % 2 ** wide);
  let [code, at] = [codeBefore, from + header];
  if (kind === 2) ({ code, end: at } = readCode(bytes, at));
  if (!code || end > bytes.length) throw broken("literals without a code");
  const literals = new Uint8Array(count);
  if (form === 0) {
    decode(code, bytes, at, end, literals, 0, count);
    return { literals, code, end };
  }
  const quarter = (count + 3) >> 2;
  let begin = at + 6;
  for (let stream = 0; stream < 4; stream++) {
    const stop = stream < 3 ? begin + (bytes[at + 2 * stream] | (bytes[at + 2 * stream + 1] << 8)) : end;
    decode(code, bytes, begin, stop, literals, stream * quarter, Math.min((stream + 1) * quarter, count));
    begin = stop;
  }
  return { literals, code, end };
}
