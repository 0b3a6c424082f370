// The faces of a chunk's voxels that can be seen, sorted by where they look.

import { damaged } from "./vlod.js";

const SIDED = 128;
/** Which faces are opposite those of a mask. */
const opposite = (mask) => ((mask & 21) << 1) | ((mask & 42) >> 1);

/** Which cells of a chunk are voxels, a bit each. */
class Cells {
  constructor(level, body, end, stride) {
    this.level = level;
    this.bits = new Uint32Array(Math.max(1, 2 ** (3 * level - 5)));
    for (let at = 0; at < end; at += stride) {
      const cell = this.#number(body[at], body[at + 1], body[at + 2]);
      this.bits[cell >> 5] |= 1 << (cell & 31);
    }
  }

  #number(x, y, z) {
    return x | (y << this.level) | (z << (2 * this.level));
  }

  /** The sides of a cell, a bit each, beyond which is another voxel; nothing is known beyond the chunk. */
  covered(x, y, z) {
    const last = 2 ** this.level - 1;
    const there = (cell) => (this.bits[cell >> 5] >>> (cell & 31)) & 1;
    const own = this.#number(x, y, z);
    let mask = 0;
    [x, y, z].forEach((value, axis) => {
      const step = 1 << (axis * this.level);
      if (value > 0) mask |= there(own - step) << (2 * axis);
      if (value < last) mask |= there(own + step) << (2 * axis + 1);
    });
    return mask;
  }
}

/**
 * Records of faces, of a voxel each as the file has it, with the normal and colour of the face
 * where it has its own.
 *
 * First those that the file shows, by where they look: −x, +x, −y, +y, −z, +z; then those that
 * one sees from inside, in the same order: opposite a face that is shown. Where two voxels touch,
 * nothing is seen. starts[k] is where the k-th of the twelve lists begins.
 */
export function facesOf(file, node, body) {
  const { stride } = file;
  const words = stride / 4;
  const plain = node.voxels * stride;
  const own = file.colored ? 8 : 4;
  if (body.length < plain + 4 * node.sided) throw damaged("a chunk of another length");
  const cells = new Cells(file.chunkLevel, body, plain, stride);
  const shown = new Uint16Array(node.voxels);
  const starts = new Uint32Array(13);
  for (let k = 0, at = 0; at < plain; k++, at += stride) {
    const mask = body[at + 3] & 63;
    const open = ~cells.covered(body[at], body[at + 1], body[at + 2]);
    shown[k] = (mask & open) | ((opposite(mask) & ~mask & open) << 6);
    for (let list = 0; list < 12; list++) starts[list + 1] += (shown[k] >> list) & 1;
  }
  for (let list = 0; list < 12; list++) starts[list + 1] += starts[list];
  const table = new DataView(body.buffer, body.byteOffset, body.length);
  const records = new Uint32Array(starts[12] * words);
  const next = starts.slice(0, 12);
  let told = plain + 4 * node.sided;
  for (let k = 0, at = 0; at < plain; k++, at += stride) {
    const places = Array(6).fill(at + 4);
    if (body[at + 3] & SIDED) told = ownPlaces(body[at + 3], told, own, places);
    if (told > body.length) throw damaged("faces of another number");
    for (let list = 0; list < 12; list++) {
      if (!((shown[k] >> list) & 1)) continue;
      const to = words * next[list]++;
      records[to] = table.getUint32(at, true);
      // What is seen from inside looks as its other side does.
      const from = places[list < 6 ? list : (list - 6) ^ 1];
      for (let word = 1; word < words; word++) records[to + word] = table.getUint32(from + 4 * (word - 1), true);
    }
  }
  if (told !== body.length) throw damaged("faces of another number");
  return { records, starts };
}

/** Fill where the faces of a mask have what is their own, one after another; where the next would be. */
function ownPlaces(mask, told, own, places) {
  for (let side = 0; side < 6; side++) {
    if (!((mask >> side) & 1)) continue;
    places[side] = told;
    told += own;
  }
  return told;
}
