// Which nodes of the octree a view shows, and which it lacks (Chajdas 2014, section 4).

import { boxInPlanes, frustumPlanes, length } from "../vectors.js";

const ALL_OCTANTS = 255;

/** How far a place is from a box; 0 inside. */
const away = (eye, [low, high]) => length(eye.map((value, k) => Math.max(low[k] - value, 0, value - high[k])));

/**
 * Parts to draw [{node, kind, octants, distance, coarse}] and to ask for [{node, kind, …}].
 *
 * A node is refined until its voxels are smaller than the error allowed, or until nothing of it
 * is seen; below the finest voxels is the surface itself. Children that are not there are
 * replaced by the octants of their parent, or, where the picture should not change bit by bit,
 * all by the whole parent.
 */
export class VoxelCut {
  /** from: what is taken off coordinates of the file; refinement is gradual or whole. */
  constructor(store, sight, view, from, refinement) {
    Object.assign(this, { store, sight, view, from, refinement });
    this.planes = frustumPlanes(view.clip);
    this.shown = [];
    this.wanted = [];
  }

  /** From the root on, with errors in pixels; coarser where the budget asks for it. */
  of(root, error, budget) {
    this.error = error;
    while (this.#bytes(root) > budget && this.error < 1000) this.error *= 1.25;
    if (this.#inside(root)) {
      this.#want(root, "voxels");
      if (this.store.get(root, "voxels")) this.#visit(root);
    }
    this.shown.sort((a, b) => Number(b.kind === "surface") - Number(a.kind === "surface") || a.distance - b.distance);
    this.wanted.sort((a, b) => a.late - b.late || a.node.level - b.node.level || a.distance - b.distance);
    return this;
  }

  #box(node) {
    return [node.lower, node.upper].map((corner) => corner.map((value, k) => value - this.from[k]));
  }

  #inside(node) {
    return boxInPlanes(this.planes, ...this.#box(node)) >= 0;
  }

  #distance(node) {
    return away(this.view.eye, this.#box(node));
  }

  /** Whether the voxels of a node are larger in the picture than they may be. */
  #large(node) {
    return node.voxel * this.view.pixelsPerUnit > this.error * this.#distance(node);
  }

  #refined(node) {
    return node.children.length > 0 && this.#large(node) && !this.sight.hidden(node);
  }

  /** Whether the surface itself is to be shown. */
  #close(node) {
    return !node.children.length && node.triangles > 0 && this.#large(node) && !this.sight.hidden(node);
  }

  /** On the card when all is there that the picture needs. */
  #bytes(node) {
    if (!this.#inside(node)) return 0;
    let sum = this.store.bytesOf(node, "voxels");
    if (this.#close(node)) sum += this.store.bytesOf(node, "surface");
    if (this.#refined(node)) for (const child of node.children) sum += this.#bytes(child);
    return sum;
  }

  #visit(node) {
    const { store } = this;
    this.sight.visited(node);
    if (!this.#refined(node)) {
      this.#showFinest(node);
      return;
    }
    const children = node.children.filter((child) => this.#inside(child));
    let [lacking, coming] = [0, false];
    for (const child of children) {
      this.#want(child, "voxels");
      if (store.get(child, "voxels")) continue;
      lacking |= 1 << child.octant;
      coming ||= !store.lost(child, "voxels");
    }
    if (coming && this.refinement === "whole") lacking = ALL_OCTANTS;
    for (const child of children) if (!(lacking & (1 << child.octant))) this.#visit(child);
    if (lacking) this.#show(node, "voxels", lacking);
  }

  #showFinest(node) {
    if (this.#close(node)) {
      this.#want(node, "surface");
      if (this.store.get(node, "surface")) {
        this.#show(node, "surface", ALL_OCTANTS);
        return;
      }
    }
    this.#show(node, "voxels", ALL_OCTANTS);
  }

  #show(node, kind, octants) {
    const coarse = kind === "voxels" && this.#large(node) && (node.children.length > 0 || node.triangles > 0);
    this.shown.push({ node, kind, octants, distance: this.#distance(node), coarse });
  }

  #want(node, kind) {
    const over = kind === "surface" ? node : node.parent;
    this.wanted.push({ node, kind, late: over && !this.sight.seen(over) ? 1 : 0, distance: this.#distance(node) });
  }
}
