// Potree 2: what a folder says of its points, and the tree of its nodes.

import { SourceError } from "../source.js";

const NODE_BYTES = 22;
const PROXY = 2;

const damaged = (why) => new SourceError(`The cloud is damaged: ${why}. Publish it again.`);

/** Where each attribute that is drawn begins in the record of a point. */
function places(attributes) {
  const found = {};
  let offset = 0;
  for (const { name, size } of attributes) {
    found[name] = offset;
    offset += size;
  }
  return { found, stride: offset };
}

/**
 * The nodes of a cloud, the root first, and how to read their points.
 *
 * A node has level, lower (corner in the user's coordinates), side, spacing (of its points),
 * points, offset and bytes in octree.bin, and children, of which each knows its octant.
 */
export async function readPotree(metadata, hierarchy) {
  let told;
  try {
    told = JSON.parse(new TextDecoder().decode(await metadata.all()));
  } catch (error) {
    if (error instanceof SourceError) throw error;
    throw damaged("what tells of it is no JSON");
  }
  if (told.encoding !== "DEFAULT" || !told.version?.startsWith("2.")) throw damaged("it is of another kind");
  const { found, stride } = places(told.attributes);
  const bytes = await hierarchy.range(0, told.hierarchy.firstChunkSize);
  return { nodes: tree(new DataView(bytes), told), places: found, stride, scale: told.scale, offset: told.offset };
}

function tree(view, told) {
  const { min, max } = told.boundingBox;
  const nodes = [{ level: 0, lower: min, side: max[0] - min[0] }];
  for (let row = 0; row < nodes.length; row++) {
    const node = nodes[row];
    if ((row + 1) * NODE_BYTES > view.byteLength) throw damaged("its tree ends too early");
    const at = row * NODE_BYTES;
    if (view.getUint8(at) === PROXY) throw damaged("its tree is in several parts");
    const mask = view.getUint8(at + 1);
    Object.assign(node, {
      spacing: told.spacing / 2 ** node.level,
      points: view.getUint32(at + 2, true),
      offset: Number(view.getBigUint64(at + 6, true)),
      bytes: Number(view.getBigUint64(at + 14, true)),
      children: [],
    });
    const side = node.side / 2;
    for (let octant = 0; octant < 8; octant++) {
      if (!(mask & (1 << octant))) continue;
      // x is the highest bit of an octant's number.
      const lower = node.lower.map((value, k) => value + ((octant >> (2 - k)) & 1) * side);
      node.children.push({ level: node.level + 1, octant, lower, side });
    }
    nodes.push(...node.children);
  }
  return nodes;
}

/** Cells along a side of a node by which it is told how much surface its points lie on. */
const CELLS = 16;

/** Bytes of a point as it is drawn. */
export const POINT_BYTES = 16;

/**
 * Points of a node, and the gap between them in the unit of the cloud.
 *
 * packed is for the GPU: places as 65535ths of the node's cube (3 uint16 and a pad), colours
 * (3 bytes and a pad), normals (3 signed bytes and a pad; 0 where there are none).
 */
export function packedPoints(file, node, buffer) {
  const from = new DataView(buffer);
  const packed = new ArrayBuffer(node.points * POINT_BYTES);
  const [wide, bytes, signed] = [new Uint16Array(packed), new Uint8Array(packed), new Int8Array(packed)];
  const { position, rgb, NormalX } = file.places;
  const steps = file.scale.map((scale) => (scale * 65535) / node.side);
  const shift = node.lower.map((value, k) => ((file.offset[k] - value) * 65535) / node.side);
  const met = new Uint8Array(CELLS ** 3);
  for (let i = 0; i < node.points; i++) {
    const at = i * file.stride;
    const to = i * POINT_BYTES;
    let cell = 0;
    for (let k = 0; k < 3; k++) {
      const exact = from.getInt32(at + position + 4 * k, true) * steps[k] + shift[k];
      const place = Math.max(0, Math.min(65535, Math.round(exact)));
      wide[to / 2 + k] = place;
      cell = cell * CELLS + ((place * CELLS) >> 16);
      if (rgb !== undefined) bytes[to + 8 + k] = from.getUint16(at + rgb + 2 * k, true) >> 8;
      if (NormalX !== undefined) signed[to + 12 + k] = Math.round(127 * from.getFloat32(at + NormalX + 4 * k, true));
    }
    met[cell] = 1;
  }
  // Where the cloud ends, its points are farther apart than those of its level would be.
  const cells = met.reduce((sum, one) => sum + one, 0);
  const gap = (node.side / CELLS) * Math.sqrt(cells / Math.max(node.points, 1));
  return { packed, gap: Math.max(gap, node.spacing) };
}
