// Points of nodes: asked for node by node, uploaded a few each frame, given up when old.

import { VertexArray } from "../gpu.js";
import { NodeStore } from "./node_store.js";
import { POINT_BYTES, packedPoints } from "./potree_file.js";

const AT_ONCE = 4;
const UPLOAD_BYTES = 2 << 20;

/** The nodes that are on the GPU. */
export class CloudStore extends NodeStore {
  constructor(context, file, source) {
    super(context, file, source, { most: AT_ONCE, uploadBytes: UPLOAD_BYTES });
    this.held = new Map();
  }

  /** Ask for nodes, in their order; false where all are there. */
  want(nodes) {
    nodes.forEach((node) => {
      const held = this.held.get(node);
      if (held) held.frame = this.frame;
    });
    const left = nodes.filter((node) => !this.held.has(node) && !node.failed && !node.waiting);
    for (const node of left.slice(0, this.free)) this.#fetch(node);
    return left.length > 0;
  }

  #fetch(node) {
    node.waiting = true;
    this.ask(
      async (signal) => ({ node, buffer: await this.source.range(node.offset, node.bytes, { signal }) }),
      (why) => {
        node.failed = true;
        node.waiting = false;
        this.tell(`${why} This part is shown coarser.`);
      },
    );
  }

  /** Put what arrived on the GPU, not much at a time. */
  upload() {
    const { gl } = this;
    this.uploadArrived(({ node, buffer }) => {
      node.waiting = false;
      const { packed, gap } = packedPoints(this.file, node, buffer);
      const array = new VertexArray(gl, this.counts).vertices(packed, POINT_BYTES, [
        [0, 3, gl.UNSIGNED_SHORT, true, 0],
        [1, 3, gl.UNSIGNED_BYTE, true, 8],
        [2, 3, gl.BYTE, true, 12],
      ]);
      this.held.set(node, { array, gap, frame: this.frame });
      return packed.byteLength;
    });
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
    this.stop();
    [...this.held.keys()].forEach((node) => this.#drop(node));
  }

  #drop(node) {
    this.held.get(node).array.dispose();
    this.held.delete(node);
  }
}
