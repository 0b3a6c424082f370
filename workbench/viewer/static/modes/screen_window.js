// The part of a picture that a box can be seen in.

import { projected } from "../vectors.js";

/** [x, y, width, height] in pixels around a box as a clip matrix shows it; all where it comes too near. */
export function windowOf(clip, low, high, width, height) {
  const [lowest, highest] = [[1, 1], [-1, -1]];
  for (let corner = 0; corner < 8; corner++) {
    const place = [0, 1, 2].map((k) => ((corner >> k) & 1 ? high[k] : low[k]));
    const [x, y, , w] = projected(clip, place);
    if (w <= 0) return [0, 0, width, height];
    [x, y].forEach((value, k) => {
      lowest[k] = Math.min(lowest[k], value);
      highest[k] = Math.max(highest[k], value);
    });
  }
  const pixel = (value, size) => Math.min(Math.max((value + 1) / 2, 0), 1) * size;
  // The card rounds otherwise: a pixel more on every side.
  const from = [Math.floor(pixel(lowest[0], width)) - 1, Math.floor(pixel(lowest[1], height)) - 1];
  const to = [Math.ceil(pixel(highest[0], width)) + 1, Math.ceil(pixel(highest[1], height)) + 1];
  return [...from, Math.max(to[0] - from[0], 0), Math.max(to[1] - from[1], 0)];
}
