// Header and index of a surfel file, and where the bytes of its nodes are.

import { crc32 } from "../crc32.js";
import { SourceError } from "../source.js";

const MAGIC = "WBSURFEL";
const VERSION = 1;
const HEADER_BYTES = 40;
const NODE_BYTES = 112;
const COLORED = 1;
const EXACT = 2;
const FEWEST_COARSE = 64;

const damaged = (why) => new SourceError(`The surfels are damaged: ${why}. Publish them again.`);

/** Lengths of the lists of coarser colours of a node, longest first. */
export function coarseCounts(surfels) {
  const counts = [];
  for (let left = surfels; left > FEWEST_COARSE; ) {
    left = Math.ceil(left / 4);
    counts.push(left);
  }
  return counts;
}

/** The nodes of a file, level by level from the root, and what a surfel of it is like. */
export async function readIndex(source) {
  const start = await source.range(0, HEADER_BYTES);
  const header = new DataView(start);
  if (new TextDecoder().decode(new Uint8Array(start, 0, 8)) !== MAGIC) throw damaged("another header");
  if (crc32(new Uint8Array(start, 0, HEADER_BYTES - 4)) !== header.getUint32(36, true)) throw damaged("a wrong checksum");
  if (header.getUint32(8, true) !== VERSION) throw damaged("another version");
  const flags = header.getUint32(12, true);
  const count = header.getUint32(24, true);
  const index = await source.range(Number(header.getBigUint64(16, true)), count * NODE_BYTES);
  if (crc32(new Uint8Array(index)) !== header.getUint32(32, true)) throw damaged("a wrong checksum of the index");
  const [colored, exact] = [Boolean(flags & COLORED), Boolean(flags & EXACT)];
  const view = new DataView(index);
  const nodes = Array.from({ length: count }, (_, row) => node(view, row * NODE_BYTES, row));
  nodes.forEach((one) => (one.children = nodes.slice(one.firstChild, one.firstChild + one.childCount)));
  return { nodes, colored, exact, stride: (exact ? 16 : 8) + (colored ? 4 : 0) };
}

function node(view, at, row) {
  const number = (offset) => view.getFloat64(at + offset, true);
  const lower = [32, 40, 48].map(number);
  const size = [56, 64, 72].map(number);
  return {
    row,
    level: view.getUint8(at),
    childCount: view.getUint8(at + 1),
    firstChild: view.getUint32(at + 4, true),
    surfels: view.getUint32(at + 8, true),
    prefix: view.getUint32(at + 12, true),
    distance: number(16),
    radius: number(24),
    lower,
    size,
    upper: lower.map((value, k) => value + size[k]),
    offset: Number(view.getBigUint64(at + 80, true)),
    bytes: Number(view.getBigUint64(at + 88, true)),
    crc: view.getUint32(at + 104, true),
  };
}

/** Surfels of a node whose discs of a radius cover it; may be more than there are. */
export const prefixFor = (node, radius) =>
  radius > 0 ? Math.max(1, Math.ceil(node.prefix * (node.distance / radius) ** 2 - 0.001)) : Infinity;

/** The radius at which the discs of a prefix cover a node. */
export const radiusFor = (node, prefix) => node.distance * Math.sqrt(node.prefix / Math.max(prefix, 1));

/** The radius that all surfels of a node are drawn with where that does not suffice. */
export const finestRadius = (node) => Math.max(radiusFor(node, node.surfels), node.radius);
