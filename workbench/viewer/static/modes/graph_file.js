// A sparse voxel graph as its file has it, checked, and how many voxels stand below each node.

import { crc32 } from "../crc32.js";
import { SourceError } from "../source.js";

const MAGIC = "VOXGRAPH";
const VERSION = 1;
const SSVDAG = 4;
const HEADER_BYTES = 80;
const [COARSEST, FINEST] = [3, 21];
const [SHORT_OFFSETS, LOW_29] = [8191, 0x1fffffff];

const damaged = (why) => new SourceError(`The voxel graph is damaged: ${why}. Publish it again.`);

/** How many bits of a word are set. */
function bitsOf(word) {
  let bits = word - ((word >>> 1) & 0x55555555);
  bits = (bits & 0x33333333) + ((bits >>> 2) & 0x33333333);
  return (((bits + (bits >>> 4)) & 0x0f0f0f0f) * 0x01010101) >>> 24;
}

/** The graph in a buffer that holds the whole file. */
export function readGraph(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < HEADER_BYTES) throw damaged("it is cut off");
  if (new TextDecoder().decode(new Uint8Array(buffer, 0, 8)) !== MAGIC) throw damaged("another header");
  if (view.getUint32(8, true) !== VERSION) throw damaged("another version");
  if (crc32(new Uint8Array(buffer, 16)) !== view.getUint32(12, true)) throw damaged("a wrong checksum");
  const [encoding, level, rootTurn, kind] = [16, 17, 18, 19].map((at) => view.getUint8(at));
  if (encoding !== SSVDAG || level < COARSEST || level > FINEST) throw damaged("an encoding this page does not know");
  const long = (at) => Number(view.getBigUint64(at, true));
  const [voxels, nodes, bricks] = [long(56), long(64), long(72)];
  let at = HEADER_BYTES;
  const taken = (Kind, count) => {
    const values = new Kind(buffer, at, count);
    at += values.byteLength;
    return values;
  };
  const graph = {
    level,
    rootTurn,
    voxels,
    origin: [24, 32, 40].map((place) => view.getFloat64(place, true)),
    size: view.getFloat64(48, true),
    starts: [...taken(BigUint64Array, level + 1)].map(Number),
    bricks: taken(Uint32Array, 2 * bricks),
    halves: taken(Uint16Array, nodes),
  };
  at += -(2 * nodes) & 7;
  const palette = taken(Uint8Array, 3 * view.getUint32(20, true));
  graph.colors = colorsOf(kind, palette, kind === 1 ? taken(Uint8Array, 3 * voxels) : kind === 2 ? taken(Uint8Array, voxels) : null,
    () => new Uint16Array(buffer.slice(at, at + 2 * voxels)));
  graph.below = countsBelow(graph);
  return graph;
}

/** Three bytes sRGB for each voxel, or null. */
function colorsOf(kind, palette, bytes, shorts) {
  if (kind < 2) return bytes;
  const places = bytes ?? shorts();
  const colors = new Uint8Array(3 * places.length);
  places.forEach((place, k) => {
    for (let c = 0; c < 3; c++) colors[3 * k + c] = palette[3 * place + c];
  });
  return colors;
}

/** Voxels below the node at each half-word; 0 where no node begins. Every pointer is followed. */
function countsBelow({ level, starts, bricks, halves, voxels }) {
  const below = new Uint32Array(halves.length);
  const ofBrick = (place) => {
    if (2 * place + 1 >= bricks.length) throw damaged("a brick that is not there");
    return bitsOf(bricks[2 * place]) + bitsOf(bricks[2 * place + 1]);
  };
  const ofNode = (depth) => (place) => {
    const count = place < starts[depth + 1] - starts[depth] ? below[starts[depth] + place] : 0;
    if (!count) throw damaged("a node that is not there");
    return count;
  };
  for (let depth = level - 3; depth >= 0; depth--) {
    const count = depth === level - 3 ? ofBrick : ofNode(depth + 1);
    for (let at = starts[depth]; at < starts[depth + 1]; ) {
      const node = at++;
      for (let child = 0; child < 8; child++) {
        const code = (halves[node] >> (2 * child)) & 3;
        if (code === 1) below[node] += count(halves[at] & SHORT_OFFSETS);
        if (code > 1) below[node] += count((((halves[at] << 16) | halves[at + 1]) & LOW_29) + (code & 1) * (LOW_29 + 1));
        at += Math.min(code, 2);
      }
    }
  }
  if (below[0] !== voxels) throw damaged("another number of voxels");
  return below;
}
