// Vectors of three numbers and 4×4 matrices in columns, in float64 until they go to the GPU.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = (a) => Math.hypot(a[0], a[1], a[2]);
export const unit = (a) => scaled(a, 1 / (length(a) || 1));
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

/** b turned about a unit axis by an angle in radians (Rodrigues). */
export function turned(b, axis, angle) {
  const c = Math.cos(angle);
  const s = Math.sin(angle);
  return add(add(scaled(b, c), scaled(cross(axis, b), s)), scaled(axis, dot(axis, b) * (1 - c)));
}

/** a·b of two matrices. */
export function product(a, b) {
  const out = new Float64Array(16);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += a[4 * k + row] * b[4 * column + k];
      out[4 * column + row] = sum;
    }
  }
  return out;
}

/** Camera (x right, y up, looking along −z) from the world. */
export function viewMatrix(eye, to, up) {
  const back = unit(sub(eye, to));
  const right = unit(cross(up, back));
  const above = cross(back, right);
  return Float64Array.of(
    right[0], above[0], back[0], 0,
    right[1], above[1], back[1], 0,
    right[2], above[2], back[2], 0,
    -dot(right, eye), -dot(above, eye), -dot(back, eye), 1,
  );
}

/** Perspective projection; fovY in radians over the height. */
export function perspective(fovY, aspect, near, far) {
  const f = 1 / Math.tan(fovY / 2);
  return Float64Array.of(
    f / aspect, 0, 0, 0,
    0, f, 0, 0,
    0, 0, (far + near) / (near - far), -1,
    0, 0, (2 * far * near) / (near - far), 0,
  );
}

/** Inverse of a matrix; null where there is none. */
export function inverse(m) {
  const a = Array.from({ length: 4 }, (_, row) => [
    ...[0, 1, 2, 3].map((column) => m[4 * column + row]),
    ...[0, 1, 2, 3].map((column) => (row === column ? 1 : 0)),
  ]);
  for (let k = 0; k < 4; k++) {
    let pivot = k;
    for (let row = k + 1; row < 4; row++) if (Math.abs(a[row][k]) > Math.abs(a[pivot][k])) pivot = row;
    if (!a[pivot][k]) return null;
    [a[k], a[pivot]] = [a[pivot], a[k]];
    for (let row = 0; row < 4; row++) {
      const share = row === k ? 0 : a[row][k] / a[k][k];
      for (let column = k; column < 8; column++) a[row][column] -= share * a[k][column];
    }
    const scale = 1 / a[k][k];
    for (let column = k; column < 8; column++) a[k][column] *= scale;
  }
  const out = new Float64Array(16);
  for (let row = 0; row < 4; row++) for (let column = 0; column < 4; column++) out[4 * column + row] = a[row][4 + column];
  return out;
}

/** A point through a matrix, with the division by w. */
export function projected(m, p) {
  const out = [0, 1, 2, 3].map((row) => m[row] * p[0] + m[4 + row] * p[1] + m[8 + row] * p[2] + m[12 + row]);
  return [out[0] / out[3], out[1] / out[3], out[2] / out[3], out[3]];
}

/** The six planes [a, b, c, d] of what a clip matrix shows; inside where a·x + b·y + c·z + d ≥ 0. */
export function frustumPlanes(m) {
  const row = (k) => [m[k], m[4 + k], m[8 + k], m[12 + k]];
  const w = row(3);
  const planes = [];
  for (let k = 0; k < 3; k++) {
    const r = row(k);
    planes.push(w.map((value, i) => value + r[i]), w.map((value, i) => value - r[i]));
  }
  return planes;
}

/** Where a box lies to planes: −1 outside, 0 across, 1 inside. */
export function boxInPlanes(planes, low, high) {
  let inside = true;
  for (const [a, b, c, d] of planes) {
    const far = a * (a > 0 ? high[0] : low[0]) + b * (b > 0 ? high[1] : low[1]) + c * (c > 0 ? high[2] : low[2]) + d;
    if (far < 0) return -1;
    const near = a * (a > 0 ? low[0] : high[0]) + b * (b > 0 ? low[1] : high[1]) + c * (c > 0 ? low[2] : high[2]) + d;
    if (near < 0) inside = false;
  }
  return inside ? 1 : 0;
}
