// A mask at the full size of its picture: one byte a pixel, 255 = keep, 0 = clutter.

export class Mask {
  constructor(width, height, data = new Uint8Array(width * height)) {
    this.width = width;
    this.height = height;
    this.data = data;
    // What the last finished change left: the next is told as the difference from it.
    this.settled = data.slice();
    this.touched = null;
  }

  // Everything within `radius` of the line from (x0, y0) to (x1, y1); pixel (i, j) has its
  // centre at (i + ½, j + ½).
  stroke(x0, y0, x1, y1, radius, value) {
    const top = Math.max(0, Math.ceil(Math.min(y0, y1) - radius - 0.5));
    const bottom = Math.min(this.height - 1, Math.floor(Math.max(y0, y1) + radius - 0.5));
    for (let row = top; row <= bottom; row++) {
      const span = capsuleSpan(x0, y0, x1, y1, radius, row + 0.5);
      if (span) this.#fillRow(row, span[0], span[1], value);
    }
  }

  // A closed polygon of [x, y] corners by the even-odd rule.
  polygon(corners, value) {
    const ys = corners.map((corner) => corner[1]);
    const top = Math.max(0, Math.ceil(Math.min(...ys) - 0.5));
    const bottom = Math.min(this.height - 1, Math.floor(Math.max(...ys) - 0.5));
    for (let row = top; row <= bottom; row++) {
      const crossings = polygonCrossings(corners, row + 0.5);
      for (let k = 0; k + 1 < crossings.length; k += 2) {
        this.#fillRow(row, crossings[k], crossings[k + 1], value);
      }
    }
  }

  // Rows of a smaller mask in the rectangle [left, top, right, bottom], the ends exclusive.
  paste([left, top, right, bottom], rows) {
    const width = right - left;
    for (let row = top; row < bottom; row++) {
      const from = (row - top) * width;
      this.data.set(rows.subarray(from, from + width), row * this.width + left);
    }
    this.#touch(left, top, right, bottom);
  }

  replace(data) {
    this.data.set(data);
    this.#touchAll();
  }

  fill(value) {
    this.data.fill(value);
    this.#touchAll();
  }

  invert() {
    for (let k = 0; k < this.data.length; k++) this.data[k] ^= 255;
    this.#touchAll();
  }

  // Ends a change: what it did, or null where it did nothing.
  settle() {
    if (!this.touched) return null;
    const { left, top, right, bottom } = this.touched;
    this.touched = null;
    const runs = [];
    let differs = false;
    let length = 0;
    for (let row = top; row < bottom; row++) {
      const end = row * this.width + right;
      for (let k = row * this.width + left; k < end; k++) {
        if ((this.data[k] !== this.settled[k]) !== differs) {
          runs.push(length);
          length = 0;
          differs = !differs;
        }
        length++;
      }
      const start = end - (right - left);
      this.settled.set(this.data.subarray(start, end), start);
    }
    if (!runs.length) return null;
    runs.push(length);
    return { left, top, right, bottom, runs: Uint32Array.from(runs) };
  }

  // Takes back a change under way.
  revert() {
    if (!this.touched) return;
    const { left, top, right, bottom } = this.touched;
    for (let row = top; row < bottom; row++) {
      const start = row * this.width + left;
      this.data.set(this.settled.subarray(start, start + right - left), start);
    }
    this.touched = null;
  }

  // Turns the pixels of a change over: undoes it where it was done, does it where it was undone.
  turnOver({ left, top, right, runs }) {
    const width = right - left;
    let position = 0;
    runs.forEach((length, index) => {
      const end = position + length;
      if (index % 2 === 1) {
        for (let k = position; k < end; k++) {
          const at = (top + Math.floor(k / width)) * this.width + left + (k % width);
          this.data[at] ^= 255;
          this.settled[at] ^= 255;
        }
      }
      position = end;
    });
  }

  keptShare() {
    let kept = 0;
    for (let k = 0; k < this.data.length; k++) kept += this.data[k] >> 7;
    return kept / this.data.length;
  }

  // Pixels whose centres lie in from ≤ x < to.
  #fillRow(row, from, to, value) {
    const left = Math.max(0, Math.ceil(from - 0.5));
    const right = Math.min(this.width, Math.ceil(to - 0.5));
    if (left >= right) return;
    this.data.fill(value, row * this.width + left, row * this.width + right);
    this.#touch(left, row, right, row + 1);
  }

  #touchAll() {
    this.#touch(0, 0, this.width, this.height);
  }

  #touch(left, top, right, bottom) {
    const t = this.touched;
    this.touched = t
      ? {
          left: Math.min(t.left, left),
          top: Math.min(t.top, top),
          right: Math.max(t.right, right),
          bottom: Math.max(t.bottom, bottom),
        }
      : { left, top, right, bottom };
  }
}

// Where the row at height y meets a capsule; null where it does not. The capsule is convex, so
// its row is the hull of the rows of its two discs and of the rectangle between them.
function capsuleSpan(x0, y0, x1, y1, radius, y) {
  let from = Infinity;
  let to = -Infinity;
  const include = (a, b) => {
    from = Math.min(from, a);
    to = Math.max(to, b);
  };
  for (const [cx, cy] of [[x0, y0], [x1, y1]]) {
    const half = radius * radius - (y - cy) * (y - cy);
    if (half >= 0) include(cx - Math.sqrt(half), cx + Math.sqrt(half));
  }
  const length = Math.hypot(x1 - x0, y1 - y0);
  if (length > 0) {
    const nx = ((y0 - y1) / length) * radius;
    const ny = ((x1 - x0) / length) * radius;
    const sides = [[x0 + nx, y0 + ny], [x1 + nx, y1 + ny], [x1 - nx, y1 - ny], [x0 - nx, y0 - ny]];
    const crossings = polygonCrossings(sides, y);
    if (crossings.length) include(crossings[0], crossings[crossings.length - 1]);
  }
  return from <= to ? [from, to] : null;
}

function polygonCrossings(corners, y) {
  const crossings = [];
  for (let k = 0; k < corners.length; k++) {
    const [ax, ay] = corners[k];
    const [bx, by] = corners[(k + 1) % corners.length];
    if (ay <= y !== by <= y) crossings.push(ax + ((y - ay) / (by - ay)) * (bx - ax));
  }
  return crossings.sort((a, b) => a - b);
}
