// The camera: where it is, how hands move it, and how it goes into a link.

import { add, cross, dot, length, perspective, product, scaled, sub, turned, unit, viewMatrix } from "./vectors.js";

const STEEPEST = 0.995;
const KEY_TURN = 0.06;

/** A place to look from. All in the scene's local coordinates. */
export class Camera {
  /** bounds [low, high], up a unit axis, home {eye, to, fov} with fov in degrees over the height. */
  constructor(bounds, up, home) {
    this.low = bounds[0];
    this.high = bounds[1];
    this.size = length(sub(bounds[1], bounds[0])) || 1;
    this.up = up;
    this.home = home;
    this.walking = false;
    this.reset();
  }

  reset() {
    this.eye = [...this.home.eye];
    this.to = [...this.home.to];
    this.fov = this.home.fov;
  }

  get distance() {
    return length(sub(this.to, this.eye));
  }

  /** Clip planes around what there is, as seen from here. */
  #planes() {
    const middle = scaled(add(this.low, this.high), 0.5);
    const away = length(sub(middle, this.eye));
    const far = away + 0.55 * this.size;
    return [Math.max(away - 0.55 * this.size, 1e-4 * this.size, far * 1e-4), far];
  }

  /** Everything a frame needs to know, for a picture of so many pixels. */
  view(width, height) {
    const [near, far] = this.#planes();
    const fovY = (this.fov * Math.PI) / 180;
    const fromWorld = viewMatrix(this.eye, this.to, this.up);
    const projection = perspective(fovY, width / height, near, far);
    return {
      eye: [...this.eye],
      forward: unit(sub(this.to, this.eye)),
      width,
      height,
      near,
      far,
      fromWorld,
      projection,
      clip: product(projection, fromWorld),
      // Pixels that a length of 1 at distance 1 covers.
      pixelsPerUnit: height / (2 * Math.tan(fovY / 2)),
    };
  }

  /** Turn by so many radians to the side and upwards: around what is looked at, or on the spot. */
  turn(side, upwards) {
    const pivot = this.walking ? this.eye : this.to;
    const moving = this.walking ? this.to : this.eye;
    let arm = turned(sub(moving, pivot), this.up, side);
    const right = unit(cross(this.up, this.walking ? scaled(arm, -1) : arm));
    const tilted = turned(arm, right, this.walking ? upwards : -upwards);
    if (Math.abs(dot(unit(tilted), this.up)) < STEEPEST) arm = tilted;
    if (this.walking) this.to = add(pivot, arm);
    else this.eye = add(pivot, arm);
  }

  /** Shift the picture by shares of its height. */
  pan(right, upwards) {
    const back = unit(sub(this.eye, this.to));
    const side = unit(cross(this.up, back));
    const above = cross(back, side);
    const reach = 2 * this.distance * Math.tan((this.fov * Math.PI) / 360);
    this.#shift(add(scaled(side, -right * reach), scaled(above, -upwards * reach)));
  }

  /** Nearer by a factor below 1, further by one above it. */
  zoom(factor) {
    const arm = scaled(sub(this.eye, this.to), factor);
    const reach = length(arm);
    if (reach > 1e-4 * this.size && reach < 50 * this.size) this.eye = add(this.to, arm);
  }

  /** Walk by shares of the scene's size. */
  walk(forward, right, upwards) {
    const ahead = unit(sub(this.to, this.eye));
    const side = unit(cross(ahead, this.up));
    const step = add(add(scaled(ahead, forward), scaled(side, right)), scaled(this.up, upwards));
    this.#shift(scaled(step, this.size));
  }

  /** Look at a point from the side one looks from now. */
  lookAt(point) {
    this.eye = add(point, sub(this.eye, this.to));
    this.to = [...point];
  }

  #shift(by) {
    this.eye = add(this.eye, by);
    this.to = add(this.to, by);
  }

  /** As a link holds it. */
  text() {
    const digits = Math.max(0, 4 - Math.floor(Math.log10(this.size)));
    const words = (values) => values.map((value) => Number(value.toFixed(digits))).join(",");
    return { eye: words(this.eye), to: words(this.to), fov: String(Number(this.fov.toFixed(3))) };
  }

  /** From a link; what it does not say, or says wrongly, stays as it is. */
  read({ eye, to, fov }) {
    const numbers = (words) => {
      const values = String(words ?? "").split(",").map(Number);
      return values.length === 3 && values.every(Number.isFinite) ? values : null;
    };
    const [from, at, angle] = [numbers(eye), numbers(to), Number(fov)];
    if (from && at && length(sub(from, at)) > 0) [this.eye, this.to] = [from, at];
    if (fov && angle > 1 && angle < 150) this.fov = angle;
  }
}

/** Hands on the camera: mouse, pen, one and two fingers, wheel and keyboard. */
export class Hands {
  /** changed is called after every movement; clicked with the place of a click in pixels. */
  constructor(canvas, camera, changed, clicked) {
    this.canvas = canvas;
    this.camera = camera;
    this.changed = changed;
    this.clicked = clicked;
    this.pointers = new Map();
    this.travelled = 0;
    this.keys = new Set();
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => this.#up(event));
    }
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("keydown", (event) => this.#key(event));
  }

  #down(event) {
    this.canvas.focus();
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.pointers.size === 1) this.travelled = 0;
  }

  #move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const dx = now[0] - before[0];
    const dy = now[1] - before[1];
    this.travelled += Math.abs(dx) + Math.abs(dy);
    const height = this.canvas.clientHeight;
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const spread = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]);
      this.camera.zoom(Math.max(spread(before), 1) / Math.max(spread(now), 1));
      this.camera.pan(dx / height / 2, -dy / height / 2);
    } else if (event.shiftKey || event.buttons & 6) {
      this.camera.pan(dx / height, -dy / height);
    } else {
      this.camera.turn((-dx / height) * Math.PI, (dy / height) * Math.PI);
    }
    this.pointers.set(event.pointerId, now);
    this.changed();
  }

  #up(event) {
    if (this.pointers.delete(event.pointerId) && this.travelled < 4 && event.type === "pointerup") {
      const box = this.canvas.getBoundingClientRect();
      this.clicked(event.clientX - box.left, event.clientY - box.top);
    }
  }

  #wheel(event) {
    event.preventDefault();
    const step = Math.max(-1, Math.min(1, event.deltaY / 240));
    if (this.camera.walking) this.camera.walk(-0.05 * step, 0, 0);
    else this.camera.zoom(1.25 ** step);
    this.changed();
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const { camera } = this;
    const step = event.shiftKey ? 0.05 : 0.01;
    const doings = {
      ArrowLeft: () => camera.turn(-KEY_TURN, 0),
      ArrowRight: () => camera.turn(KEY_TURN, 0),
      ArrowUp: () => camera.turn(0, KEY_TURN),
      ArrowDown: () => camera.turn(0, -KEY_TURN),
      "+": () => camera.zoom(0.9),
      "=": () => camera.zoom(0.9),
      "-": () => camera.zoom(1 / 0.9),
      w: () => camera.walk(step, 0, 0),
      s: () => camera.walk(-step, 0, 0),
      a: () => camera.walk(0, -step, 0),
      d: () => camera.walk(0, step, 0),
      e: () => camera.walk(0, 0, step),
      q: () => camera.walk(0, 0, -step),
      Home: () => camera.reset(),
    };
    const doing = doings[event.key] ?? doings[event.key.toLowerCase()];
    if (!doing) return;
    event.preventDefault();
    doing();
    this.changed();
  }
}
