// The points of a cloud, round, as large as the gaps between them.

import { program } from "../gpu.js";
import { LOOK_GLSL, setLook } from "../shading.js";
import { boxInPlanes, frustumPlanes } from "../vectors.js";
import { CloudStore } from "./cloud_store.js";
import { POINT_BYTES, readPotree } from "./potree_file.js";

/** Points are that many spacings wide: the nearest on a surface may be a cell's diagonal away. */
const WIDTH = 1.7;
const NARROWEST = 1.5;

const VERTEX = `
layout(location = 0) in vec3 a_place;
layout(location = 1) in vec3 a_color;
layout(location = 2) in vec3 a_normal;
uniform mat4 u_clip;
uniform vec3 u_lower;
uniform float u_side;
uniform float u_widths[8]; // pixels at depth 1, of each octant
out vec3 v_point;
out vec3 v_normal;
out vec3 v_color;
void main() {
  v_point = u_lower + a_place * u_side;
  v_color = a_color;
  v_normal = a_normal;
  gl_Position = u_clip * vec4(v_point, 1.0);
  ivec3 side = ivec3(greaterThanEqual(a_place, vec3(0.5)));
  float width = u_widths[4 * side.x + 2 * side.y + side.z];
  gl_PointSize = max(width / max(gl_Position.w, 1e-6), ${NARROWEST.toFixed(1)});
}`;

const FRAGMENT = `
in vec3 v_point;
in vec3 v_normal;
in vec3 v_color;
uniform bool u_plain;
out vec4 o_color;
${LOOK_GLSL}
void main() {
  vec2 aside = 2.0 * gl_PointCoord - 1.0;
  if (dot(aside, aside) > 1.0 || cut(v_point)) discard;
  vec3 n = dot(v_normal, u_eye - v_point) < 0.0 ? -v_normal : v_normal;
  o_color = vec4(encoded(lit(u_plain ? vec3(0.55) : decoded(v_color), n, v_point)), 1.0);
}`;

/** Open the cloud of an entry of the scene. */
export async function open(context, entry) {
  const { gl, counts, origin } = context;
  const beside = (name) => context.source(entry.file.replace(/[^/]*$/, name));
  const file = await readPotree(context.source(entry.file), beside("hierarchy.bin"));
  const colored = file.places.rgb !== undefined;
  const store = new CloudStore(context, file, beside("octree.bin"));
  const drawing = program(gl, VERTEX, FRAGMENT);

  const local = (node) => node.lower.map((value, k) => value - origin[k]);

  /** Side of a pixel at the place of a node's cube that is nearest to the camera. */
  function pixelAt(view, node) {
    const low = local(node);
    const away = view.eye.map((value, k) => Math.max(low[k] - value, 0, value - low[k] - node.side));
    return Math.hypot(...away) / view.pixelsPerUnit;
  }

  /** Nodes that a view needs, the widest gaps first, as many as the card holds. */
  function chosen(view, look) {
    const planes = frustumPlanes(view.clip);
    const found = [];
    let bytes = 0;
    const waiting = [{ node: file.nodes[0], gap: Infinity }];
    while (waiting.length) {
      const { node, gap } = waiting.reduce((a, b) => (b.gap > a.gap ? b : a));
      waiting.splice(waiting.findIndex((one) => one.node === node), 1);
      const low = local(node);
      if (gap <= look.pixelError || boxInPlanes(planes, low, low.map((value) => value + node.side)) < 0) continue;
      bytes += node.points * POINT_BYTES;
      if (found.length && bytes > 0.9 * look.budgetBytes) break;
      found.push(node);
      // Children close the gaps that are left between the points of this node.
      const left = node.spacing / Math.max(pixelAt(view, node), 1e-30);
      for (const child of node.children) waiting.push({ node: child, gap: Math.min(left, gap) });
    }
    return found;
  }

  /** Gaps between points in each octant of each node: as the finest children there close them. */
  function gapsOf(nodes) {
    const wanted = new Set(nodes);
    const gaps = new Map();
    for (const node of [...nodes].sort((a, b) => b.level - a.level)) {
      const own = new Float32Array(8).fill(store.held.get(node)?.gap ?? node.spacing);
      for (const child of node.children) {
        if (wanted.has(child) && store.held.has(child)) own[child.octant] = Math.max(...gaps.get(child));
      }
      gaps.set(node, own);
    }
    return gaps;
  }

  const mode = {
    pending: true,
    items: entry.items,
    pixelError: 1,
    overlays: [...(colored ? [{ key: "color", label: "Colour" }] : []), { key: "shape", label: "Shape alone" }],
    draw(view, look) {
      const { uniforms } = drawing;
      store.upload();
      const nodes = chosen(view, look);
      const gaps = gapsOf(nodes);
      gl.useProgram(drawing.program);
      setLook(gl, uniforms, view, look);
      gl.uniformMatrix4fv(uniforms.u_clip, false, new Float32Array(view.clip));
      gl.uniform1i(uniforms.u_plain, look.overlay === "shape" || !colored ? 1 : 0);
      for (const node of nodes) {
        const array = store.held.get(node)?.array;
        if (!array) continue;
        gl.uniform3fv(uniforms.u_lower, local(node));
        gl.uniform1f(uniforms.u_side, node.side);
        gl.uniform1fv(uniforms.u_widths, gaps.get(node).map((gap) => WIDTH * gap * view.pixelsPerUnit));
        array.bind();
        gl.drawArrays(gl.POINTS, 0, node.points);
        counts.drew(node.points);
      }
      gl.bindVertexArray(null);
      const lacking = store.want(nodes);
      store.evict(look.budgetBytes);
      mode.pending = lacking || store.busy;
    },
    dispose() {
      store.dispose();
      gl.deleteProgram(drawing.program);
    },
  };
  return mode;
}
