// What a view shows of the tree of surfels, and what it lacks (Brandt 2019, 4 and 4.1).

import { boxInPlanes, frustumPlanes, length } from "../vectors.js";
import { finestRadius, prefixFor, radiusFor } from "./surfel_file.js";

/** As far from the middle of the picture, in halves of its height, all is as fine as asked for. */
const SHARP = 0.3;

/** How far a place is from a box; 0 inside. */
function away(eye, low, high) {
  return length(eye.map((value, k) => Math.max(low[k] - value, 0, value - high[k])));
}

/**
 * Prefixes to draw and to ask for.
 *
 * Where the surfels of a node do not suffice, its children are shown. Over a range in which a
 * node has less than it needs, but half of it, first the children's surfels come and then the
 * node's go (Brandt 2019, 4). In the place of a child that is not there the node is drawn.
 */
export class SurfelCut {
  /**
   * from: what is taken off coordinates of the file; size of surfels in pixels, across, and how
   * many times as much it grows from the middle of the picture on with every half of its height.
   */
  constructor(store, view, from, size, falloff = 0) {
    this.store = store;
    this.view = view;
    this.from = from;
    this.size = size;
    this.falloff = falloff;
    this.planes = frustumPlanes(view.clip);
    this.shown = [];
    this.wanted = [];
  }

  /** From the root on. */
  of(root) {
    if (this.#near(root)) this.#visit(root, 1);
    return this;
  }

  #box(node) {
    const margin = node.radius;
    return [
      node.lower.map((value, k) => value - this.from[k] - margin),
      node.upper.map((value, k) => value - this.from[k] + margin),
    ];
  }

  #near(node) {
    return boxInPlanes(this.planes, ...this.#box(node)) >= 0;
  }

  /** Side of a pixel at the place of the node that is nearest to the camera. */
  #pixel(node) {
    const local = [node.lower, node.upper].map((corner) => corner.map((value, k) => value - this.from[k]));
    return away(this.view.eye, ...local) / this.view.pixelsPerUnit;
  }

  /** Pixels across the surfels of a node: more where it lies wholly aside (Brandt 2019, 4.3). */
  #sizeOf(node) {
    if (!this.falloff) return this.size;
    const { eye, fromWorld, pixelsPerUnit, height } = this.view;
    const middle = node.lower.map((value, k) => 0.5 * (value + node.upper[k]) - this.from[k] - eye[k]);
    const reach = 0.5 * length(node.upper.map((value, k) => value - node.lower[k]));
    const far = length(middle);
    if (far <= reach) return this.size;
    const ahead = -(middle[0] * fromWorld[2] + middle[1] * fromWorld[6] + middle[2] * fromWorld[10]);
    const angle = Math.max(Math.acos(Math.max(-1, Math.min(1, ahead / far))) - Math.asin(reach / far), 0);
    const aside = (Math.tan(Math.min(angle, 1.5)) * pixelsPerUnit) / (height / 2);
    return this.size * (1 + this.falloff * Math.max(aside - SHARP, 0));
  }

  #visit(node, share) {
    const { store } = this;
    const pixel = this.#pixel(node);
    const radius = 0.5 * this.#sizeOf(node) * pixel;
    const need = prefixFor(node, radius);
    const loaded = store.loaded(node);
    const coarsest = radiusFor(node, loaded);
    if (need <= node.surfels || !node.children.length) {
      this.#want(node, need, coarsest, pixel);
      this.#show(node, share, radius, need);
      return;
    }
    // 0 where the surfels of the node just suffice, 1 where it has half of what it takes.
    const lack = Math.min(need / node.surfels - 1, 1);
    const children = node.children.filter((child) => this.#near(child));
    const whole = lack < 1 || children.some((child) => child.failed);
    this.#want(node, whole ? need : 1, coarsest, pixel);
    for (const child of children) {
      if (store.loaded(child) && radiusFor(child, store.loaded(child)) <= Math.max(coarsest, finestRadius(node))) {
        this.#visit(child, Math.min(2 * lack, 1) * share);
        continue;
      }
      const childPixel = this.#pixel(child);
      const finer = Math.max(coarsest, finestRadius(node), 0.5 * this.#sizeOf(child) * childPixel);
      this.#want(child, prefixFor(child, finer), coarsest, childPixel);
      if (lack >= 0.5) this.#show(node, 1, radius, need, child);
    }
    if (lack < 1) this.#show(node, Math.min(2 - 2 * lack, 1) * share, radius, need);
  }

  /** Ask for a prefix where discs of a radius are shown now. */
  #want(node, count, now, pixel) {
    this.wanted.push({ node, count: Math.min(count, node.surfels), error: pixel > 0 ? now / pixel : Infinity });
  }

  /** A share of the prefix that a node needs, of what there is of it; in another's box alone. */
  #show(node, share, radius, need, within = null) {
    const there = Math.min(need, this.store.loaded(node));
    if (!there) return;
    let covering = radius;
    if (there < need) covering = Math.max(radius, there === node.surfels ? finestRadius(node) : radiusFor(node, there));
    this.shown.push({ node, count: Math.max(1, Math.ceil(share * there)), radius: covering, within });
  }
}
