// The distance between two places, drawn over the picture.

import { length, projected, sub } from "./vectors.js";

const SVG = "http://www.w3.org/2000/svg";

/** A length in the scene's unit, in words. */
export function lengthInWords(value, unit) {
  if (unit !== "m") return `${Number(value.toPrecision(4))} ${unit || "units"}`;
  if (value < 0.01) return `${Number((1000 * value).toPrecision(3))} mm`;
  if (value < 1) return `${Number((1000 * value).toPrecision(4))} mm`;
  return `${Number(value.toPrecision(5))} m`;
}

export class Measuring {
  constructor(drawn, unit) {
    this.drawn = drawn;
    this.unit = unit;
    this.active = false;
    this.places = [];
  }

  /** A place was clicked; a third one begins anew. Returns the distance once there are two. */
  add(place) {
    if (this.places.length === 2) this.places = [];
    this.places.push(place);
    return this.distance;
  }

  get distance() {
    return this.places.length === 2 ? length(sub(this.places[0], this.places[1])) : null;
  }

  clear() {
    this.places = [];
  }

  /** Draw it as seen in a view over an element of a size in CSS pixels. */
  draw(view, width, height) {
    const seen = this.places.map((place) => {
      const [x, y, , w] = projected(view.clip, place);
      return w > 0 ? [((x + 1) / 2) * width, ((1 - y) / 2) * height] : null;
    });
    const parts = [];
    const shape = (name, values, text) => {
      const made = document.createElementNS(SVG, name);
      for (const [key, value] of Object.entries(values)) made.setAttribute(key, value);
      if (text) made.textContent = text;
      parts.push(made);
    };
    if (seen.length === 2 && seen[0] && seen[1]) {
      const [[x1, y1], [x2, y2]] = seen;
      shape("line", { x1, y1, x2, y2 });
      shape("text", { x: (x1 + x2) / 2, y: (y1 + y2) / 2 - 8 }, lengthInWords(this.distance, this.unit));
    }
    seen.filter(Boolean).forEach(([cx, cy]) => shape("circle", { cx, cy, r: 4.5 }));
    this.drawn.replaceChildren(...parts);
  }
}
