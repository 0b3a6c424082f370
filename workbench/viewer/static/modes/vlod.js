// Header and index of a file of voxel levels of detail, and what the bytes of its chunks mean.

import { crc32 } from "../crc32.js";
import { SourceError } from "../source.js";
import { unpacked } from "./zstd.js";

const MAGIC = "WBVOXLOD";
const VERSION = 1;
const HEADER_BYTES = 80;
const NODE_BYTES = 96;
const [COLORED, COMPRESSED] = [1, 2];

/** What is wrong with a file, in words for people. */
export const damaged = (why) => new SourceError(`The voxels are damaged: ${why}. Publish them again.`);

/** Levels of detail: their nodes from the root on, each with its children and its box in the user's coordinates. */
export async function readIndex(source) {
  const start = await source.range(0, HEADER_BYTES);
  const header = new DataView(start);
  if (new TextDecoder().decode(new Uint8Array(start, 0, 8)) !== MAGIC) throw damaged("another header");
  if (crc32(new Uint8Array(start, 0, HEADER_BYTES - 4)) !== header.getUint32(76, true)) throw damaged("a wrong checksum");
  if (header.getUint32(8, true) !== VERSION) throw damaged("another version");
  const flags = header.getUint32(12, true);
  const file = {
    colored: Boolean(flags & COLORED),
    compressed: Boolean(flags & COMPRESSED),
    level: header.getUint32(16, true),
    chunkLevel: header.getUint32(20, true),
    origin: [24, 32, 40].map((at) => header.getFloat64(at, true)),
    size: header.getFloat64(48, true),
    nodes: [],
  };
  file.stride = file.colored ? 12 : 8;
  const count = Number(header.getBigUint64(64, true));
  const index = await source.range(Number(header.getBigUint64(56, true)), count * NODE_BYTES);
  if (crc32(new Uint8Array(index)) !== header.getUint32(72, true)) throw damaged("a wrong checksum of the index");
  const view = new DataView(index);
  for (let row = 0; row < count; row++) file.nodes.push(nodeAt(view, row, file));
  for (const node of file.nodes) linked(node, file.nodes);
  return file;
}

function nodeAt(view, row, file) {
  const at = row * NODE_BYTES;
  const bytes = (offset) => [0, 1, 2].map((k) => view.getUint8(at + offset + k));
  const long = (offset) => Number(view.getBigUint64(at + offset, true));
  const word = (offset) => view.getUint32(at + offset, true);
  const part = (offset, crc) => ({ offset: long(offset), stored: long(offset + 8), plain: long(offset + 16), crc: word(crc) });
  const level = view.getUint8(at);
  const voxel = file.size / 2 ** level;
  const corner = [0, 1, 2].map((k) => file.origin[k] + view.getUint16(at + 8 + 2 * k, true) * voxel * 2 ** file.chunkLevel);
  const [low, high] = [bytes(2), bytes(5)];
  return {
    row,
    level,
    voxel,
    corner,
    // Of the voxels there are; and the whole cube of the chunk.
    lower: corner.map((value, k) => value + low[k] * voxel),
    upper: corner.map((value, k) => value + (high[k] + 1) * voxel),
    mask: view.getUint8(at + 1),
    firstChild: word(16),
    parent: null,
    octant: 0,
    children: [],
    voxels: word(20),
    sided: word(24),
    vertices: word(84),
    triangles: word(88),
    parts: { voxels: part(32, 28), surface: part(56, 80) },
  };
}

function linked(node, nodes) {
  let row = node.firstChild;
  for (let octant = 0; octant < 8; octant++) {
    if (!(node.mask & (1 << octant))) continue;
    const child = nodes[row++];
    if (!child || child.row <= node.row) throw damaged("children that are not there");
    Object.assign(child, { parent: node, octant });
    node.children.push(child);
  }
}

/** The unpacked bytes of a part of a node, checked. */
export function bodyOf(file, part, buffer) {
  const bytes = new Uint8Array(buffer);
  if (crc32(bytes) !== part.crc) throw damaged("a wrong checksum");
  const body = file.compressed ? unpacked(bytes, part.plain) : bytes;
  if (body.length !== part.plain) throw damaged("a part of another length");
  return body;
}

/** The original surface of a node: places from the chunk's corner, normals, colours, and triangles. */
export function surfaceOf(file, node, body) {
  const [places, colors] = [12 * node.vertices, file.colored ? 4 * node.vertices : 0];
  if (body.length !== places + colors + 12 * node.triangles) throw damaged("a surface of another length");
  const whole = body.slice().buffer;
  const position = new Float32Array(whole, 0, 3 * node.vertices);
  const index = new Uint32Array(whole, places + colors, 3 * node.triangles);
  if (index.some((corner) => corner >= node.vertices)) throw damaged("corners that are not there");
  return { position, normal: normalsOf(position, index), color: colors ? new Uint8Array(whole, places, colors) : null, index };
}

/** Of corners, those of their triangles weighted by area; four signed bytes each. */
function normalsOf(position, index) {
  const sums = new Float64Array(position.length);
  for (let t = 0; t < index.length; t += 3) {
    const [a, b, c] = [3 * index[t], 3 * index[t + 1], 3 * index[t + 2]];
    const u = [0, 1, 2].map((k) => position[b + k] - position[a + k]);
    const v = [0, 1, 2].map((k) => position[c + k] - position[a + k]);
    for (let k = 0; k < 3; k++) {
      const [i, j] = [(k + 1) % 3, (k + 2) % 3];
      const part = u[i] * v[j] - u[j] * v[i];
      for (const corner of [a, b, c]) sums[corner + k] += part;
    }
  }
  const normal = new Int8Array((4 * position.length) / 3);
  for (let k = 0; k < position.length / 3; k++) {
    const scale = 127 / (Math.hypot(sums[3 * k], sums[3 * k + 1], sums[3 * k + 2]) || 1);
    for (let axis = 0; axis < 3; axis++) normal[4 * k + axis] = Math.round(sums[3 * k + axis] * scale);
  }
  return normal;
}
