// Chunks of voxels and of the original surface: asked for, uploaded a little each frame, given up when old.

import { Texture, VertexArray } from "../gpu.js";
import { NodeStore } from "./node_store.js";
import { bodyOf, surfaceOf } from "./vlod.js";
import { facesOf } from "./voxel_lists.js";

const AT_ONCE = 6;
const UPLOAD_BYTES = 4 << 20;
const ROW = 1024;
const CORNER_BYTES = 20;
/** Faces that a voxel of a surface has, about. */
const FACES = 2.2;

/** What of the nodes is on the card. */
export class VoxelStore extends NodeStore {
  constructor(context, file, source) {
    super(context, file, source, { most: AT_ONCE, uploadBytes: UPLOAD_BYTES });
    this.held = { voxels: new Map(), surface: new Map() };
    this.failed = { voxels: new Set(), surface: new Set() };
    this.waiting = new Set();
    this.told = false;
  }

  /** What is on the card of a node, undefined where it is not; it counts as used. */
  get(node, kind) {
    const held = this.held[kind].get(node);
    if (held) held.frame = this.frame;
    return held;
  }

  /** Bytes on the card of a node's voxels or surface, as far as known. */
  bytesOf(node, kind) {
    const held = this.held[kind].get(node);
    if (held) return held.bytes;
    return kind === "voxels" ? FACES * node.voxels * this.file.stride : CORNER_BYTES * node.vertices + 12 * node.triangles;
  }

  /** Whether a node's voxels or surface cannot be read. */
  lost(node, kind) {
    return this.failed[kind].has(node);
  }

  /** Ask for the first of [{node, kind}] that are neither there nor on their way; whether there are any. */
  want(wanted) {
    const left = wanted.filter(({ node, kind }) => !this.held[kind].has(node) && !this.lost(node, kind));
    const next = left.filter(({ node, kind }) => !this.waiting.has(node.parts[kind]));
    for (const { node, kind } of next.slice(0, this.free)) this.#fetch(node, kind);
    return left.length > 0;
  }

  #fetch(node, kind) {
    const part = node.parts[kind];
    this.waiting.add(part);
    this.ask(
      async (signal) => ({ node, kind, buffer: await this.source.range(part.offset, part.stored, { signal }) }),
      (why) => this.#fail(node, kind, why),
    );
  }

  /** Put what arrived on the card, not much at a time. */
  upload() {
    this.uploadArrived(({ node, kind, buffer }) => {
      this.waiting.delete(node.parts[kind]);
      try {
        const body = bodyOf(this.file, node.parts[kind], buffer);
        const held = kind === "voxels" ? this.#voxels(node, body) : this.#surface(node, body);
        held.frame = this.frame;
        this.held[kind].set(node, held);
        return held.bytes;
      } catch (error) {
        this.#fail(node, kind, error.message);
        return 0;
      }
    });
  }

  #voxels(node, body) {
    const { gl, counts, file } = this;
    const { records, starts } = facesOf(file, node, body);
    const height = Math.max(1, Math.ceil(starts[12] / ROW));
    const words = new Uint32Array((height * ROW * file.stride) / 4);
    words.set(records);
    const [internal, format] = file.colored ? [gl.RGB32UI, gl.RGB_INTEGER] : [gl.RG32UI, gl.RG_INTEGER];
    const texture = new Texture(gl, counts).data(ROW, height, internal, format, gl.UNSIGNED_INT, words);
    return { texture, starts, bytes: words.byteLength, dispose: () => texture.dispose() };
  }

  #surface(node, body) {
    const { gl, counts, file } = this;
    const { position, normal, color, index } = surfaceOf(file, node, body);
    const array = new VertexArray(gl, counts)
      .vertices(position, 12, [[0, 3, gl.FLOAT, false, 0]])
      .vertices(normal, 4, [[1, 3, gl.BYTE, true, 0]]);
    if (color) array.vertices(color, 4, [[2, 3, gl.UNSIGNED_BYTE, true, 0]]);
    array.indices(index);
    return { array, count: index.length, bytes: array.bytes, dispose: () => array.dispose() };
  }

  /**
   * Keep below a budget: what was not used for longest goes first, children before their parent,
   * so that something is there in every place always.
   */
  evict(budget) {
    if (this.counts.bytes <= budget) return;
    const old = [];
    for (const kind of ["surface", "voxels"]) {
      for (const [node, held] of this.held[kind]) if (held.frame < this.frame) old.push({ node, kind, held });
    }
    old.sort((a, b) => a.held.frame - b.held.frame || b.node.level - a.node.level);
    for (const { node, kind } of old) {
      if (this.counts.bytes <= 0.95 * budget) return;
      const needed = kind === "voxels" && node.children.some((child) => this.held.voxels.has(child));
      if (!needed) this.#drop(node, kind);
    }
  }

  dispose() {
    this.stop();
    for (const kind of ["voxels", "surface"]) for (const node of [...this.held[kind].keys()]) this.#drop(node, kind);
  }

  #drop(node, kind) {
    this.held[kind].get(node)?.dispose();
    this.held[kind].delete(node);
  }

  #fail(node, kind, why) {
    this.waiting.delete(node.parts[kind]);
    this.failed[kind].add(node);
    if (this.told) return;
    this.told = true;
    this.tell(`${why.replace(/\.?$/, ".")} Parts of the model are shown coarser.`);
  }
}
