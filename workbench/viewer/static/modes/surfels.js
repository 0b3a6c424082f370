// The surface as oriented discs, of every part as many as the picture needs.

import { program } from "../gpu.js";
import { LOOK_GLSL, setLook } from "../shading.js";
import { SurfelCut } from "./surfel_cut.js";
import { readIndex } from "./surfel_file.js";
import { SizeControl } from "./surfel_size.js";
import { SurfelStore, bytesOf } from "./surfel_store.js";

/** Discs that are wider than that, in pixels, are drawn as squares: points have a largest size. */
const WIDEST_POINT = 48;

const VERTEX = `
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

const FRAGMENT = `
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
  o_color = vec4(encoded(lit(albedo, slope > 0.0 ? -v_normal : v_normal, place)), 1.0);
}`;

const OVERLAYS = [
  { key: "color", label: "Colour" },
  { key: "shape", label: "Shape alone" },
];

/** Open the surfels of an entry of the scene. */
export async function open(context, entry) {
  const { gl, counts, origin } = context;
  const source = context.source(entry.file);
  const file = await readIndex(source);
  const store = new SurfelStore(context, file, source);
  const drawing = program(gl, VERTEX, FRAGMENT);
  const control = new SizeControl();

  /** The cut of a view whose bytes fit on the card: larger surfels where they do not. */
  function cutOf(view, size, budget) {
    for (let coarser = size; ; coarser *= 1.25) {
      const cut = new SurfelCut(store, view, origin, coarser).of(file.nodes[0]);
      const counted = new Map(cut.wanted.map(({ node, count }) => [node, count]));
      let bytes = 0;
      for (const [node, count] of counted) bytes += bytesOf(file, node, Math.max(count, store.loaded(node)));
      if (bytes <= 0.9 * budget || coarser > 1000) return cut;
    }
  }

  function drawPart(view, { node, count, radius, within }) {
    const { uniforms } = drawing;
    const local = (corner) => corner.map((value, k) => value - origin[k] - view.eye[k]);
    const box = within ?? node;
    // Rounding must not take away what lies on the border of the box.
    const margin = within ? 0 : node.radius + 1e-3 * radius;
    gl.uniform3fv(uniforms.u_lower, local(node.lower));
    gl.uniform3fv(uniforms.u_size, file.exact ? [1, 1, 1] : node.size);
    gl.uniform3fv(uniforms.u_low, local(box.lower).map((value) => value - margin));
    gl.uniform3fv(uniforms.u_high, local(box.upper).map((value) => value + margin));
    gl.uniform1f(uniforms.u_radius, radius);
    const near = Math.max(nearest(local(node.lower), local(node.upper)) - radius, 1e-9);
    const square = (2 * radius * view.pixelsPerUnit) / near > WIDEST_POINT;
    gl.uniform1i(uniforms.u_square, square ? 1 : 0);
    store.used(node).bind(count, square);
    if (square) gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
    else gl.drawArrays(gl.POINTS, 0, count);
    counts.drew(count);
  }

  const mode = {
    pending: true,
    items: entry.items,
    pixelError: 1,
    overlays: OVERLAYS,
    draw(view, look) {
      const { uniforms } = drawing;
      store.upload();
      const size = control.sizeFor(view, look.pixelError);
      const cut = cutOf(view, size, look.budgetBytes);
      gl.useProgram(drawing.program);
      setLook(gl, uniforms, view, look);
      const row = (k) => [view.fromWorld[k], view.fromWorld[4 + k], view.fromWorld[8 + k]];
      gl.uniform3fv(uniforms.u_right, row(0));
      gl.uniform3fv(uniforms.u_above, row(1));
      gl.uniform3fv(uniforms.u_ahead, row(2).map((value) => -value));
      gl.uniform2f(uniforms.u_pixels, view.width, view.height);
      gl.uniform2f(uniforms.u_planes, view.near, view.far);
      gl.uniform1f(uniforms.u_focal, view.pixelsPerUnit);
      gl.uniform1f(uniforms.u_steps, file.exact ? 32767 : 127);
      gl.uniform1i(uniforms.u_plain, look.overlay === "shape" ? 1 : 0);
      gl.vertexAttrib3f(2, 0.77, 0.77, 0.77);
      cut.shown.forEach((part) => drawPart(view, part));
      gl.bindVertexArray(null);
      const lacking = store.want(cut.wanted);
      store.evict(look.budgetBytes);
      mode.pending = lacking || store.busy || control.waiting;
    },
    dispose() {
      store.dispose();
      gl.deleteProgram(drawing.program);
    },
  };
  return mode;
}

/** How far a box is from the origin. */
function nearest(low, high) {
  return Math.hypot(...low.map((value, k) => Math.max(value, 0, -high[k])));
}
