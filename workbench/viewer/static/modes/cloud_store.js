// Points of nodes: asked for node by node, uploaded a few each frame, given up when old.

import { VertexArray } from "../gpu.js";
import { POINT_BYTES, packedPoints } from "./potree_file.js";

const AT_ONCE = 4;
const UPLOAD_BYTES = 2 << 20;

/** The nodes that are on the GPU. */
export class CloudStore {
  constructor({ gl, counts, redraw, tell }, file, source) {
    this.gl = gl;
    this.counts = counts;
    this.redraw = redraw;
    this.tell = tell;
    this.file = file;
    this.source = source;
    this.held = new Map();
    this.arrived = [];
    this.running = 0;
    this.stopping = new AbortController();
    this.frame = 0;
  }

  /** Bytes on their way, or still to be uploaded. */
  get busy() {
    return this.running > 0 || this.arrived.length > 0;
  }

  /** Ask for nodes, in their order; false where all are there. */
  want(nodes) {
    nodes.forEach((node) => {
      const held = this.held.get(node);
      if (held) held.frame = this.frame;
    });
    const left = nodes.filter((node) => !this.held.has(node) && !node.failed && !node.waiting);
    for (const node of left.slice(0, AT_ONCE - this.running)) this.#fetch(node);
    return left.length > 0;
  }

  async #fetch(node) {
    const { signal } = this.stopping;
    node.waiting = true;
    this.running += 1;
    try {
      const buffer = await this.source.range(node.offset, node.bytes, { signal });
      if (!signal.aborted) this.arrived.push({ node, buffer });
    } catch (error) {
      node.failed = true;
      node.waiting = false;
      if (!signal.aborted) this.tell(`${error.message} This part is shown coarser.`);
    } finally {
      this.running -= 1;
      if (!signal.aborted) this.redraw();
    }
  }

  /** Put what arrived on the GPU, not much at a time. */
  upload() {
    const { gl } = this;
    this.frame += 1;
    let bytes = 0;
    while (this.arrived.length && bytes < UPLOAD_BYTES) {
      const { node, buffer } = this.arrived.shift();
      node.waiting = false;
      const { packed, gap } = packedPoints(this.file, node, buffer);
      const array = new VertexArray(gl, this.counts).vertices(packed, POINT_BYTES, [
        [0, 3, gl.UNSIGNED_SHORT, true, 0],
        [1, 3, gl.UNSIGNED_BYTE, true, 8],
        [2, 3, gl.BYTE, true, 12],
      ]);
      this.held.set(node, { array, gap, frame: this.frame });
      bytes += packed.byteLength;
    }
  }

  /** Keep below a budget: what was not wanted for longest goes first. */
  evict(budget) {
    if (this.counts.bytes <= budget) return;
    const old = [...this.held].filter(([, held]) => held.frame < this.frame).sort((a, b) => a[1].frame - b[1].frame);
    for (const [node] of old) {
      if (this.counts.bytes <= 0.95 * budget) return;
      this.#drop(node);
    }
  }

  dispose() {
    this.stopping.abort();
    [...this.held.keys()].forEach((node) => this.#drop(node));
  }

  #drop(node) {
    this.held.get(node).array.dispose();
    this.held.delete(node);
  }
}
