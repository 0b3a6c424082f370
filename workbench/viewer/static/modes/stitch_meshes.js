// Labelled depth meshes, loaded one after the other; what of them is in the picture is drawn.

import { crc32 } from "../crc32.js";
import { VertexArray } from "../gpu.js";
import { SourceError } from "../source.js";
import { add, boxInPlanes } from "../vectors.js";

const STRIDE = 20;
const AT_ONCE = 3;
// Bytes given to the GPU for one picture.
const AT_A_TIME = 4 << 20;

/**
 * Vertices and triangles of a block, so that every triangle has a last corner of its own.
 *
 * What is told of a triangle is told by that corner. A corner that is taken already by another
 * triangle is doubled; half of them are, for a mesh has about two triangles for each vertex.
 */
export function unpacked(buffer, n, m) {
  const wide = n > 65536;
  const positions = new Float32Array(buffer, 0, 3 * n);
  const colors = new Uint32Array(buffer, 12 * n, n);
  const labels = new Uint16Array(buffer, 16 * n, m);
  const costs = new Uint16Array(buffer, 16 * n + 2 * m, m);
  const corners = new (wide ? Uint32Array : Uint16Array)(buffer, 16 * n + 4 * m, 3 * m);
  const reach = new Uint8Array(buffer, corners.byteOffset + corners.byteLength, m);
  const triangles = new Uint32Array(3 * m);
  const taken = new Uint8Array(n);
  const doubled = [];
  for (let t = 0; t < m; t++) {
    let last = 2;
    for (let k = 0; k < 3; k++) if (!taken[corners[3 * t + k]]) last = k;
    for (let k = 0; k < 3; k++) triangles[3 * t + k] = corners[3 * t + ((last + 1 + k) % 3)];
    const own = triangles[3 * t + 2];
    if (taken[own]) {
      triangles[3 * t + 2] = n + doubled.length;
      doubled.push(own);
    }
    taken[own] = 1;
  }
  const vertices = new ArrayBuffer(STRIDE * (n + doubled.length));
  const [places, packed, told] = [new Float32Array(vertices), new Uint32Array(vertices), new Uint16Array(vertices)];
  const bytes = new Uint8Array(vertices);
  for (let v = 0; v < n + doubled.length; v++) {
    const from = v < n ? v : doubled[v - n];
    for (let k = 0; k < 3; k++) places[5 * v + k] = positions[3 * from + k];
    packed[5 * v + 3] = colors[from];
  }
  for (let t = 0; t < m; t++) {
    const v = triangles[3 * t + 2];
    told[10 * v + 8] = labels[t];
    told[10 * v + 9] = costs[t];
    bytes[STRIDE * v + 15] = reach[t]; // where colours have their opacity
  }
  return { vertices, triangles: n + doubled.length > 65536 ? triangles : new Uint16Array(triangles) };
}

export class Meshes {
  /** told as stitched.json has them; shift added to stored positions gives local coordinates. */
  constructor(context, source, told, shift) {
    Object.assign(this, { context, source, told, shift });
    this.made = told.map(() => null);
    this.ready = [];
    this.left = told.map((_, k) => k);
    this.running = 0;
    this.answered = false;
    this.there = 0;
    this.closed = false;
  }

  get triangles() {
    return this.told.reduce((sum, { triangles }) => sum + triangles, 0);
  }

  get pending() {
    return this.left.length > 0 || this.running > 0 || this.ready.length > 0;
  }

  /** Ask for further meshes; the first alone, for a server that knows no parts sends all at once. */
  load() {
    const most = this.answered ? AT_ONCE : 1;
    while (this.left.length && this.running < most && this.ready.length < AT_ONCE) this.#one(this.left.shift());
  }

  async #one(number) {
    this.running += 1;
    const { offset, bytes, crc, vertices, triangles } = this.told[number];
    try {
      const block = await this.source.range(offset, bytes);
      if (block.byteLength !== bytes || crc32(new Uint8Array(block)) !== crc) throw new SourceError("the file is damaged");
      this.ready.push([number, unpacked(block, vertices, triangles)]);
    } catch (error) {
      this.context.tell(`A part of the surface is left out: ${error.message}`);
    } finally {
      this.running -= 1;
      this.answered = true;
      // A server that knows no parts has sent the whole file, which is no longer needed.
      if (!this.left.length && !this.running) this.source = null;
      if (!this.closed) this.context.redraw();
    }
  }

  /** Give meshes that have come to the GPU, a few at a time, while there is room. */
  upload(roomBytes) {
    for (let bytes = 0; this.ready.length && bytes < AT_A_TIME; ) {
      const [number, made] = this.ready.shift();
      bytes += made.vertices.byteLength + made.triangles.byteLength;
      if (bytes <= roomBytes) this.#given(number, made);
      else this.context.tell("The graphics memory allowed is too small for all meshes: parts of the surface are left out.");
    }
  }

  #given(number, { vertices, triangles }) {
    const { gl, counts } = this.context;
    const array = new VertexArray(gl, counts);
    array.vertices(vertices, STRIDE, [
      [0, 3, gl.FLOAT, false, 0],
      [1, 4, gl.UNSIGNED_BYTE, true, 12],
      [2, 2, gl.UNSIGNED_SHORT, false, 16, true],
    ]);
    array.indices(triangles);
    const type = triangles instanceof Uint16Array ? gl.UNSIGNED_SHORT : gl.UNSIGNED_INT;
    this.made[number] = { array, type, count: triangles.length };
    this.there += 1;
  }

  /** Draw all that the planes [a, b, c, d] of a view let in; before is called with the number of each. */
  draw(planes, before) {
    const { gl, counts } = this.context;
    let triangles = 0;
    this.made.forEach((mesh, number) => {
      const { low, high } = this.told[number];
      if (!mesh || boxInPlanes(planes, add(low, this.shift), add(high, this.shift)) < 0) return;
      before(number);
      mesh.array.bind();
      gl.drawElements(gl.TRIANGLES, mesh.count, mesh.type, 0);
      counts.drew(0);
      triangles += mesh.count / 3;
    });
    return triangles;
  }

  dispose() {
    this.closed = true;
    this.left = [];
    this.made.forEach((mesh) => mesh?.array.dispose());
  }
}
