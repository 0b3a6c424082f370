// Oriented discs: a fragment is met where the ray through it meets the plane of the disc.

import { LOOK_GLSL } from "../shading.js";

/** Of one disc: a point, or a square. */
export const VERTEX = `
layout(location = 0) in vec3 a_place;
layout(location = 1) in vec2 a_fold;
layout(location = 2) in vec3 a_color;
uniform vec3 u_lower;      // of the node, from the eye
uniform vec3 u_size;
uniform vec3 u_low;        // of the box that is drawn, from the eye
uniform vec3 u_high;
uniform float u_steps;     // of a folded normal
uniform float u_radius;
uniform vec3 u_right;
uniform vec3 u_above;
uniform vec3 u_ahead;
uniform vec2 u_pixels;     // width and height of the picture
uniform float u_focal;
uniform bool u_square;
flat out vec3 v_center;
flat out vec3 v_normal;
flat out vec3 v_color;
${LOOK_GLSL}
void main() {
  v_center = u_lower + a_place * u_size;
  v_color = decoded(a_color);
  vec2 fold = a_fold / u_steps;
  float up = 1.0 - abs(fold.x) - abs(fold.y);
  vec2 sides = vec2(fold.x >= 0.0 ? 1.0 : -1.0, fold.y >= 0.0 ? 1.0 : -1.0);
  v_normal = normalize(vec3(up < 0.0 ? (1.0 - abs(fold.yx)) * sides : fold, up));
  vec3 seen = vec3(dot(v_center, u_right), dot(v_center, u_above), dot(v_center, u_ahead));
  bool outside = any(lessThan(v_center, u_low)) || any(greaterThan(v_center, u_high));
  float gap = seen.z - u_radius;
  if (outside || seen.z <= 0.0) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    gl_PointSize = 1.0;
    return;
  }
  // The square that the cube around a ball shows in, about its middle.
  float spread = 1.0 + max(abs(seen.x), abs(seen.y)) / seen.z;
  float reach = gap > 0.0 ? u_focal * u_radius * spread / gap : 2.0 * max(u_pixels.x, u_pixels.y);
  vec2 middle = u_focal * seen.xy / seen.z;
  gl_PointSize = 2.0 * reach + 1.0;
  if (u_square) middle += (vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0) * (reach + 0.5);
  gl_Position = vec4(2.0 * middle / u_pixels, 0.0, 1.0);
}`;

/** What a pixel shows of a disc: alone, as depth, or as a share of a mixture. */
export const FRAGMENT = `
flat in vec3 v_center;
flat in vec3 v_normal;
flat in vec3 v_color;
uniform vec3 u_right;
uniform vec3 u_above;
uniform vec3 u_ahead;
uniform vec2 u_pixels;
uniform vec2 u_planes;     // nearest and farthest depth
uniform float u_focal;
uniform float u_radius;
uniform bool u_plain;
uniform bool u_mixed;
uniform sampler2D u_front; // depths of what is nearest, where discs are mixed
out vec4 o_color;
${LOOK_GLSL}
void main() {
  vec2 across = (gl_FragCoord.xy - 0.5 * u_pixels) / u_focal;
  vec3 ray = u_ahead + across.x * u_right + across.y * u_above;
  float slope = dot(ray, v_normal);
  float depth = dot(v_center, v_normal) / slope;
  vec3 aside = depth * ray - v_center;
  if (!(depth > u_planes.x) || dot(aside, aside) > u_radius * u_radius) discard;
  vec3 place = u_eye + depth * ray;
  if (cut(place)) discard;
  float range = u_planes.y - u_planes.x;
  gl_FragDepth = u_planes.y / range * (1.0 - u_planes.x / depth);
  vec3 albedo = u_plain ? vec3(0.55) : v_color;
  vec3 light = lit(albedo, slope > 0.0 ? -v_normal : v_normal, place);
  if (!u_mixed) {
    o_color = vec4(encoded(light), 1.0);
    return;
  }
  float front = texelFetch(u_front, ivec2(gl_FragCoord.xy), 0).r;
  front = u_planes.x / (1.0 - front * range / u_planes.y);
  if (depth > front + 2.0 * u_radius) discard;
  // A rim that is all a pixel has still tells its colour.
  float weight = max(1.0 - dot(aside, aside) / (u_radius * u_radius), 1e-3);
  o_color = vec4(light * weight, weight);
}`;
