// Surfels of nodes: asked for a prefix at a time, uploaded a little each frame, given up when old.

import { crc32 } from "../crc32.js";
import { NodeStore } from "./node_store.js";
import { coarseCounts } from "./surfel_file.js";

const FIRST_SURFELS = 1024;
const AT_ONCE = 4;
const UPLOAD_BYTES = 2 << 20;

/** The prefixes of nodes that are on the GPU. */
export class SurfelStore extends NodeStore {
  constructor(context, file, source) {
    super(context, file, source, { most: AT_ONCE, uploadBytes: UPLOAD_BYTES });
    this.held = new Map();
  }

  /** How many surfels of a node can be drawn. */
  loaded(node) {
    return this.held.get(node)?.loaded ?? 0;
  }

  /** Ask for prefixes [{node, count, error}], the largest error first; false where all is there. */
  want(wanted) {
    const left = wanted
      .filter(({ node, count }) => !node.failed && this.loaded(node) < count && !node.waiting)
      .sort((a, b) => b.error - a.error);
    for (const { node, count } of left.slice(0, this.free)) this.#fetch(node, count);
    return left.length > 0;
  }

  #fetch(node, count) {
    const { stride, colored } = this.file;
    const from = this.loaded(node);
    const to = Math.min(node.surfels, stepAbove(count));
    node.waiting = true;
    const read = async (signal) => {
      const part = this.source.range(node.offset + from * stride, (to - from) * stride, { signal });
      const plain = node.surfels * stride;
      // The colours of short prefixes come with the first of them: they are a twelfth of all.
      const tail = colored && !from ? this.source.range(node.offset + plain, node.bytes - plain, { signal }) : null;
      const [surfels, coarse] = await Promise.all([part, tail]);
      return { node, from, to, surfels, coarse };
    };
    this.ask(read, (why) => this.#fail(node, why));
  }

  /** Put what arrived on the GPU, not much at a time. */
  upload() {
    this.uploadArrived(({ node, from, to, surfels, coarse }) => {
      node.waiting = false;
      const held = this.held.get(node) ?? new HeldNode(this.gl, this.counts, this.file, node);
      if (held.loaded !== from) return 0;
      this.held.set(node, held);
      held.frame = this.frame;
      held.add(surfels, coarse && new Uint8Array(coarse), to);
      if (held.damaged) {
        this.#drop(node);
        this.#fail(node, "Some surfels are damaged");
      }
      return surfels.byteLength;
    });
  }

  /**
   * Keep below a budget: what was not needed for longest goes first, then what is beyond the
   * prefixes [{node, count}] that this picture needs.
   */
  evict(budget, wanted) {
    const needed = new Map();
    for (const { node, count } of wanted) needed.set(node, Math.max(count, needed.get(node) ?? 0));
    const old = [];
    for (const [node, held] of this.held) {
      if (needed.has(node)) held.frame = this.frame;
      else old.push([node, held.frame]);
    }
    const over = () => this.counts.bytes > 0.95 * budget;
    if (this.counts.bytes <= budget) return;
    for (const [node] of old.sort((a, b) => a[1] - b[1])) if (over()) this.#drop(node);
    for (const [node, count] of needed) if (over()) this.held.get(node)?.keep(Math.min(node.surfels, stepAbove(count)));
  }

  dispose() {
    this.stop();
    [...this.held.keys()].forEach((node) => this.#drop(node));
  }

  #drop(node) {
    this.held.get(node)?.dispose();
    this.held.delete(node);
  }

  #fail(node, why) {
    node.failed = true;
    node.waiting = false;
    this.tell(`${why}. This part is shown coarser.`);
  }
}

/** Prefixes are read in steps, each twice as long as the one before. */
function stepAbove(count) {
  return FIRST_SURFELS * 2 ** Math.max(0, Math.ceil(Math.log2(count / FIRST_SURFELS)));
}

/** Bytes on the GPU of a node with a prefix of so many surfels. */
export function bytesOf(file, node, count) {
  const coarse = file.colored ? 4 * coarseCounts(node.surfels).reduce((sum, one) => sum + one, 0) : 0;
  return Math.min(node.surfels, stepAbove(count)) * file.stride + coarse;
}

/** A prefix of a node on the GPU. */
class HeldNode {
  constructor(gl, counts, file, node) {
    this.gl = gl;
    this.counts = counts;
    this.file = file;
    this.node = node;
    this.loaded = 0;
    this.bytes = 0;
    // Null where parts of it were given up since.
    this.crc = 0;
    this.tail = new Uint8Array(0);
    this.array = gl.createVertexArray();
    this.surfels = null;
    this.coarse = null;
    this.coarseLists = [];
  }

  /** Surfels that follow those that are there, up to the number `to`. */
  add(buffer, coarse, to) {
    const { gl } = this;
    this.#resize(this.loaded, to);
    gl.bindBuffer(gl.COPY_WRITE_BUFFER, this.surfels);
    gl.bufferSubData(gl.COPY_WRITE_BUFFER, this.loaded * this.file.stride, new Uint8Array(buffer));
    this.loaded = to;
    if (this.crc !== null) this.crc = crc32(new Uint8Array(buffer), this.crc);
    if (coarse) this.#addCoarse(coarse);
  }

  /** Give up all but a prefix. */
  keep(count) {
    if (count >= this.loaded) return;
    this.#resize(count, count);
    this.loaded = count;
    this.crc = null;
  }

  /** A buffer for so many surfels, with the first of those that are there. */
  #resize(kept, count) {
    const { gl, file } = this;
    const other = gl.createBuffer();
    gl.bindBuffer(gl.COPY_WRITE_BUFFER, other);
    gl.bufferData(gl.COPY_WRITE_BUFFER, count * file.stride, gl.STATIC_DRAW);
    if (kept) {
      gl.bindBuffer(gl.COPY_READ_BUFFER, this.surfels);
      gl.copyBufferSubData(gl.COPY_READ_BUFFER, gl.COPY_WRITE_BUFFER, 0, 0, kept * file.stride);
    }
    gl.deleteBuffer(this.surfels);
    this.surfels = other;
    this.#count((count - this.loaded) * file.stride);
    this.drawnAs = null;
  }

  #addCoarse(bytes) {
    const { gl } = this;
    this.tail = bytes;
    const padded = new Uint8Array((bytes.length / 3) * 4);
    for (let k = 0; k < bytes.length / 3; k++) padded.set(bytes.subarray(3 * k, 3 * k + 3), 4 * k);
    this.coarse = gl.createBuffer();
    gl.bindBuffer(gl.COPY_WRITE_BUFFER, this.coarse);
    gl.bufferData(gl.COPY_WRITE_BUFFER, padded, gl.STATIC_DRAW);
    this.#count(padded.length);
    let offset = 0;
    for (const count of coarseCounts(this.node.surfels)) {
      this.coarseLists.push({ count, offset });
      offset += 4 * count;
    }
  }

  /** Whether what came is what was written; known once all of it came. */
  get damaged() {
    return this.crc !== null && this.loaded === this.node.surfels && crc32(this.tail, this.crc) !== this.node.crc;
  }

  /** Make ready to draw a prefix; each surfel is an instance, or a vertex. */
  bind(count, instanced) {
    const { gl, file } = this;
    gl.bindVertexArray(this.array);
    const list = this.coarseLists.findLast((one) => one.count >= count);
    const as = `${list?.offset} ${instanced}`;
    if (this.drawnAs === as) return;
    this.drawnAs = as;
    const [places, normals] = file.exact ? [gl.FLOAT, gl.SHORT] : [gl.UNSIGNED_SHORT, gl.BYTE];
    const after = file.exact ? 12 : 6;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.surfels);
    gl.vertexAttribPointer(0, 3, places, !file.exact, file.stride, 0);
    gl.vertexAttribPointer(1, 2, normals, false, file.stride, after);
    if (file.colored && !list) gl.vertexAttribPointer(2, 3, gl.UNSIGNED_BYTE, true, file.stride, file.stride - 4);
    if (list) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.coarse);
      gl.vertexAttribPointer(2, 3, gl.UNSIGNED_BYTE, true, 4, list.offset);
    }
    for (let place = 0; place < (file.colored ? 3 : 2); place++) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribDivisor(place, instanced ? 1 : 0);
    }
  }

  #count(bytes) {
    this.bytes += bytes;
    this.counts.bytes += bytes;
  }

  dispose() {
    const { gl } = this;
    [this.surfels, this.coarse].forEach((buffer) => gl.deleteBuffer(buffer));
    gl.deleteVertexArray(this.array);
    this.#count(-this.bytes);
  }
}
