// From where rays ended to a picture: normals of the depths around, light, and depth (Jaspe 2018, 5.5.2).

import { LOOK_GLSL } from "../shading.js";
import { RAYS } from "./graph_trace.js";

/** The light of pixels that were traced. */
export const SHADING = `
precision highp usampler2D;
uniform usampler2D u_met;
uniform float u_pixel;     // pixels of the picture along one of these
uniform float u_voxel;
uniform int u_overlay;     // 0 colour, 1 none, 2 size of cells
uniform vec3 u_tints[6];
out vec4 o_color;
${LOOK_GLSL}
${RAYS}
float sizeOf(uvec2 told) { return float(1u << (told.y >> 24 & 31u)); }

// One over the depth of what was met; 0 where nothing was.
float inverseDepth(ivec2 at) {
  uint told = texelFetch(u_met, at, 0).r;
  return told == 0u ? 0.0 : 1.0 / uintBitsToFloat(told);
}

// The plane that depths around a pixel lie in: one over depth is linear over its picture.
vec3 normalAt(ivec2 at, uvec2 told) {
  float middle = inverseDepth(at);
  float slope = u_pixel / u_focal;
  float cell = sizeOf(told) * middle;
  int radius = int(clamp(ceil(2.0 * cell / slope), 2.0, 12.0));
  int stride = (radius + 3) / 4;
  float step = 2.0 * middle * max(cell, slope);
  ivec2 last = textureSize(u_met, 0) - 1;
  float n = 0.0;
  vec3 sums = vec3(0.0);     // x, y, one over depth
  vec3 squares = vec3(0.0);  // xx, xy, yy
  vec2 mixed = vec2(0.0);
  for (int j = -4; j <= 4; j++) {
    for (int i = -4; i <= 4; i++) {
      ivec2 by = ivec2(i, j) * stride;
      if (max(abs(by.x), abs(by.y)) > radius) continue;
      ivec2 other = at + by;
      if (any(lessThan(other, ivec2(0))) || any(greaterThan(other, last))) continue;
      float w = inverseDepth(other);
      if (w == 0.0 || abs(w - middle) > step * float(1 + max(abs(by.x), abs(by.y)))) continue;
      vec2 d = vec2(by);
      float v = (w - middle) / middle;
      n += 1.0;
      sums += vec3(d, v);
      squares += vec3(d.x * d.x, d.x * d.y, d.y * d.y);
      mixed += d * v;
    }
  }
  vec3 s = squares - vec3(sums.x * sums.x, sums.x * sums.y, sums.y * sums.y) / n;
  vec2 m = mixed - sums.xy * sums.z / n;
  float det = s.x * s.z - s.y * s.y;
  if (n < 4.0 || det < 1e-3 * s.x * s.z || det <= 0.0) return -rayOf((vec2(at) + 0.5) * u_pixel);
  // Change of one over depth along the picture, for a pixel; then for a slope of 1.
  vec2 g = vec2(s.z * m.x - s.y * m.y, s.x * m.y - s.y * m.x) / det / slope;
  vec2 here = ((vec2(at) + 0.5) * u_pixel - u_middle) / u_focal;
  float level = 1.0 + (sums.z - dot(g * slope, sums.xy)) / n;
  return -normalize(g.x * u_right + g.y * u_above + (level - dot(g, here)) * u_ahead);
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  uvec2 told = texelFetch(u_met, at, 0).rg;
  o_color = vec4(0.0);
  if (told.x == 0u) return;
  vec3 p = u_eye + uintBitsToFloat(told.x) * u_voxel * rayOf(gl_FragCoord.xy * u_pixel);
  vec3 color = decoded(vec3(told.y & 255u, told.y >> 8 & 255u, told.y >> 16 & 255u) / 255.0);
  if (u_overlay == 1) color = vec3(0.55);
  if (u_overlay == 2) color = decoded(u_tints[min(told.y >> 24 & 31u, 5u)]);
  bool dark = told.y >> 31 != 0u && u_ambient < 1.0;
  o_color = vec4(encoded(dark ? color * u_ambient : lit(color, normalAt(at, told), p)), 1.0);
}`;

/** What is there already of the fine picture, and the rough one elsewhere, with their depth. */
export const SHOWING = `
precision highp usampler2D;
uniform usampler2D u_fine;
uniform usampler2D u_rough;
uniform sampler2D u_fineLight;
uniform sampler2D u_roughLight;
uniform float u_rows;      // of the fine picture that are there
uniform float u_roughness; // pixels along one of the rough picture
uniform float u_voxel;
uniform vec2 u_depths;     // of a projection: m[10], m[14]
out vec4 o_color;
void main() {
  bool fine = gl_FragCoord.y < u_rows;
  ivec2 at = ivec2(gl_FragCoord.xy / (fine ? 1.0 : u_roughness));
  uint told = fine ? texelFetch(u_fine, at, 0).r : texelFetch(u_rough, at, 0).r;
  if (told == 0u) discard;
  o_color = vec4((fine ? texelFetch(u_fineLight, at, 0) : texelFetch(u_roughLight, at, 0)).rgb, 1.0);
  float depth = uintBitsToFloat(told) * u_voxel;
  gl_FragDepth = 0.5 + 0.5 * (u_depths.y - u_depths.x * depth) / depth;
}`;
