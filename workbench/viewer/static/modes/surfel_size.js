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

  /**
   * Pixels across a surfel of a view, at least `wanted`.
   *
   * While it is `waiting`, pictures are to follow each other: only then the time from one to the
   * next tells how long they take.
   */
  sizeFor(view, wanted) {
    const now = performance.now();
    if (this.clip !== null && view.clip.some((value, k) => value !== this.clip[k])) this.moved = now;
    const active = now - this.moved < REST_MS;
    if (!active) this.recent = [];
    else if (!this.waiting) this.recent = [wanted];
    else this.recent = [...this.recent.slice(1 - FRAMES), this.#next(now - this.drawn, wanted)];
    this.waiting = active;
    this.clip = view.clip;
    this.drawn = now;
    return this.recent.at(-1) ?? wanted;
  }

  #next(frame, wanted) {
    const old = this.recent.reduce((sum, size) => sum + size, 0) / this.recent.length;
    const off = frame / TARGET_MS;
    const size = Math.abs(off - 1) > TOLERANCE ? (3 * old + old * off) / 4 : old;
    return Math.min(Math.max(size, wanted), Math.max(LARGEST, wanted));
  }
}
