// Texturing: the colour of every fragment out of the photograph of its label.

import { FRAGMENT_GLSL, PLACE_GLSL, Pass, bindAll, setPlace } from "./stitch_screen.js";

// Photographs of one pass; a card reads at least 16 textures at once.
const TOGETHER = 8;
const every = (text) => Array.from({ length: TOGETHER }, (_, k) => text.replaceAll("#", k)).join("\n");

const TEXTURED = (levelled) => `
uniform usampler2D u_shown;
${every("uniform sampler2D u_photo#;")}
uniform int u_count;
uniform uint u_labels[${TOGETHER}];      // number + 1
uniform mat4 u_cameras[${TOGETHER}];
uniform vec4 u_lenses[${TOGETHER * 3}];  // fx fy cx cy, k1 k2 p1 p2, k3 k4 k5 k6
uniform bool u_fisheye[${TOGETHER}];
uniform float u_epsilon;
layout(location = 0) out vec4 o_own;
${levelled ? "layout(location = 1) out vec4 o_others;" : ""}
${FRAGMENT_GLSL}
${PLACE_GLSL}

ivec2 sizeOf(int k) {
  ${every("if (k == #) return textureSize(u_photo#, 0);")}
  return ivec2(1);
}

vec4 texel(int k, ivec2 at) {
  ${every("if (k == #) return texelFetch(u_photo#, at, 0);")}
  return vec4(0.0);
}

// Where a place is in a photograph, pixels; outside of it where it is behind the camera.
vec2 imaged(int k, vec3 place) {
  vec3 p = (u_cameras[k] * vec4(place, 1.0)).xyz;
  if (p.z <= 0.0) return vec2(-1.0);
  vec2 x = p.xy / p.z;
  vec4 f = u_lenses[3 * k], d = u_lenses[3 * k + 1], e = u_lenses[3 * k + 2];
  if (u_fisheye[k]) {
    float r = length(x);
    float theta = atan(r), t = theta * theta;
    if (r > 0.0) x *= theta * (1.0 + t * (d.x + t * (d.y + t * (d.z + t * d.w)))) / r;
    return f.xy * x + f.zw;
  }
  float r2 = dot(x, x);
  float radial = (1.0 + r2 * (d.x + r2 * (d.y + r2 * e.x))) / (1.0 + r2 * (e.y + r2 * (e.z + r2 * e.w)));
  vec2 tangential = 2.0 * d.zw * x.x * x.y + d.wz * (r2 + 2.0 * x * x);
  return f.xy * (x * radial + tangential) + f.zw;
}

// Between the texels that may be used; alpha is 0 where they have less than half of the weight.
vec4 photographed(int k, vec3 place) {
  ivec2 size = sizeOf(k);
  vec2 at = imaged(k, place);
  if (any(lessThan(at, vec2(0.0))) || any(greaterThan(at, vec2(size)))) return vec4(0.0);
  at = clamp(at - 0.5, vec2(0.0), vec2(size - 1));
  ivec2 low = ivec2(at), high = min(low + 1, size - 1);
  vec2 share = at - vec2(low);
  vec4 sum = vec4(0.0);
  for (int corner = 0; corner < 4; corner++) {
    bvec2 far = bvec2(corner % 2 == 1, corner > 1);
    vec4 t = texel(k, ivec2(far.x ? high.x : low.x, far.y ? high.y : low.y));
    vec2 w = mix(1.0 - share, share, vec2(far));
    if (t.a > 0.5) sum += w.x * w.y * vec4(t.rgb, 1.0);
  }
  return sum.a < 0.5 ? vec4(0.0) : vec4(sum.rgb / sum.a, 1.0);
}

int which(uint label) {
  for (int k = 0; k < u_count; k++) if (u_labels[k] == label) return k;
  return -1;
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  o_own = vec4(0.0);
  ${levelled ? "o_others = vec4(0.0);" : ""}
  uvec4 f = texelFetch(u_shown, at, 0);
  if (!isThere(f)) return;
  float deep = uintBitsToFloat(f.x);
  vec3 place = placeOf(at, deep);
  uint label = labelOf(f.y);
  int own = label == 0u ? -1 : which(label);
  if (own >= 0) o_own = photographed(own, place);
${levelled ? `
  ivec2 last = textureSize(u_shown, 0) - 1;
  for (int side = 0; side < 4; side++) {
    ivec2 beside = at + (side < 2 ? ivec2(2 * side - 1, 0) : ivec2(0, 2 * side - 5));
    if (any(lessThan(beside, ivec2(0))) || any(greaterThan(beside, last))) continue;
    uvec4 g = texelFetch(u_shown, beside, 0);
    uint other = labelOf(g.y);
    if (!isThere(g) || other == label || other == 0u || abs(uintBitsToFloat(g.x) - deep) > u_epsilon) continue;
    int k = which(other);
    if (k >= 0) o_others += photographed(k, place);
  }` : ""}
}`;

/** told of stitched.json; shift added to stored positions gives local coordinates. */
export class Texturing {
  constructor(gl, told, shift, levelled) {
    Object.assign(this, { gl, told });
    this.pass = new Pass(gl, TEXTURED(levelled));
    // Matrices in columns, for local coordinates.
    this.cameras = told.photos.map(({ from_positions: m }) => {
      const moved = (row) => m[4 * row + 3] - [0, 1, 2].reduce((sum, k) => sum + m[4 * row + k] * shift[k], 0);
      return [0, 1, 2, 3].flatMap((column) => [0, 1, 2, 3].map((row) => {
        if (row === 3) return column === 3 ? 1 : 0;
        return column === 3 ? moved(row) : m[4 * row + column];
      }));
    });
  }

  /** Colours of fragments, and, in the target's second picture, of neighbours' photographs. */
  draw(shown, view, photos, target) {
    const { gl, told } = this;
    target.bind();
    target.sheets.forEach((_, k) => gl.clearBufferfv(gl.COLOR, k, [0, 0, 0, 0]));
    const numbers = [...photos.keys()].sort((a, b) => a - b);
    // No pixel is written twice but with neighbours of several labels, which are summed.
    gl.enable(gl.BLEND);
    gl.blendEquation(gl.FUNC_ADD);
    gl.blendFunc(gl.ONE, gl.ONE);
    for (let first = 0; first < numbers.length; first += TOGETHER) {
      const some = numbers.slice(first, first + TOGETHER);
      const padded = Array.from({ length: TOGETHER }, (_, k) => some[k] ?? some[0]);
      const uniforms = this.pass.begin(target, { u_shown: shown.texture });
      const textures = padded.map((number, k) => [`u_photo${k}`, photos.get(number).texture]);
      bindAll(gl, uniforms, Object.fromEntries(textures), 1);
      gl.uniform1i(uniforms.u_count, some.length);
      gl.uniform1uiv(uniforms.u_labels, padded.map((number) => number + 1));
      gl.uniformMatrix4fv(uniforms.u_cameras, false, padded.flatMap((number) => this.cameras[number]));
      gl.uniform4fv(uniforms.u_lenses, padded.flatMap((number) => told.photos[number].lens));
      gl.uniform1iv(uniforms.u_fisheye, padded.map((number) => Number(told.photos[number].fisheye)));
      gl.uniform1f(uniforms.u_epsilon, told.epsilon);
      setPlace(gl, uniforms, view, target);
      this.pass.end();
    }
    gl.disable(gl.BLEND);
  }

  dispose() {
    this.pass.dispose();
  }
}
