// How large surfels are while the camera moves: as the time a picture takes allows.

const TARGET_MS = 1000 / 30;
const LARGEST = 8;
const TOLERANCE = 0.1;
const FRAMES = 3;
const REST_MS = 150;

/** Keeps a frame rate by the size of surfels (Brandt 2019, 4.3); at rest all detail is shown. */
export class SizeControl {
  constructor() {
    this.recent = [];
    this.clip = null;
    this.drawn = 0;
    this.moved = -Infinity;
    this.waiting = false;
  }

  /** Pixels across a surfel of a view, at least `wanted`. */
  sizeFor(view, wanted) {
    const now = performance.now();
    const frame = now - this.drawn;
    const moving = this.clip !== null && view.clip.some((value, k) => value !== this.clip[k]);
    // After a rest there is no telling what the picture before it took.
    if (moving && now - this.moved < REST_MS) this.recent = [...this.recent.slice(1 - FRAMES), this.#next(frame, wanted)];
    else if (moving) this.recent = [wanted];
    if (moving) this.moved = now;
    this.clip = view.clip;
    this.drawn = now;
    const size = this.recent.at(-1) ?? wanted;
    this.waiting = now - this.moved < REST_MS && size > wanted;
    return this.waiting ? size : wanted;
  }

  #next(frame, wanted) {
    const old = this.recent.reduce((sum, size) => sum + size, 0) / this.recent.length;
    const off = frame / TARGET_MS;
    const size = Math.abs(off - 1) > TOLERANCE ? (3 * old + old * off) / 4 : old;
    return Math.min(Math.max(size, wanted), Math.max(LARGEST, wanted));
  }
}
