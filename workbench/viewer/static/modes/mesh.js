// The surface as triangles: with its texture, its vertex colours, or where it comes from.

import { readGlb } from "../glb.js";
import { Texture, VertexArray, program } from "../gpu.js";
import { lengthInWords } from "../measuring.js";
import { LOOK_GLSL, setLook } from "../shading.js";

const PLACES = { POSITION: 0, NORMAL: 1, COLOR_0: 2, TEXCOORD_0: 3, _PROVENANCE: 4, _COLOR_PROVENANCE: 5, _DISTANCE_TO_SAMPLES_M: 6 };

const VERTEX = `
layout(location = 0) in vec3 a_position;
layout(location = 1) in vec3 a_normal;
layout(location = 2) in vec3 a_color;
layout(location = 3) in vec2 a_place;
layout(location = 4) in float a_provenance;
layout(location = 5) in float a_colorProvenance;
layout(location = 6) in float a_deviation;
uniform mat4 u_clip;
uniform vec3 u_from;
out vec3 v_point;
out vec3 v_normal;
out vec3 v_color;
out vec2 v_place;
out vec3 v_told;
void main() {
  v_point = a_position + u_from;
  v_normal = a_normal;
  v_color = a_color;
  v_place = a_place;
  v_told = vec3(a_provenance, a_colorProvenance, a_deviation);
  gl_Position = u_clip * vec4(v_point, 1.0);
}`;

const FRAGMENT = `
in vec3 v_point;
in vec3 v_normal;
in vec3 v_color;
in vec2 v_place;
in vec3 v_told;
uniform sampler2D u_picture;
uniform int u_overlay;       // 0 colour, 1 provenance, 2 colour's provenance, 3 distance, 4 none
uniform bool u_textured;
uniform float u_widest;      // distance shown in full, metres
uniform vec3 u_near;
uniform vec3 u_far;
uniform vec3 u_tints[3];
out vec4 o_color;
${LOOK_GLSL}
vec3 albedo() {
  if (u_overlay == 4) return vec3(0.55);
  if (u_overlay == 0) return u_textured ? texture(u_picture, v_place).rgb : v_color;
  if (u_overlay == 3) {
    if (v_told.z < 0.0) return u_tints[2];
    return mix(u_near, u_far, clamp(v_told.z / u_widest, 0.0, 1.0));
  }
  int kind = int((u_overlay == 1 ? v_told.x : v_told.y) + 0.5);
  return u_tints[min(kind, 2)];
}
void main() {
  if (cut(v_point)) discard;
  vec3 n = v_normal;
  if (!gl_FrontFacing) n = -n;
  o_color = vec4(encoded(lit(albedo(), n, v_point)), 1.0);
}`;

/** Which colours a mesh can have, and what they mean. Tints are linear. */
export const OVERLAYS = [
  { key: "color", label: "Colour", number: 0 },
  { key: "shape", label: "Shape alone", number: 4 },
  {
    key: "provenance", label: "Measured or filled in", number: 1, needs: "_PROVENANCE",
    legend: [["#5a8f8a", "measured"], ["#c8791a", "filled in"]],
  },
  {
    key: "color_provenance", label: "Photographed or inpainted", number: 2, needs: "_COLOR_PROVENANCE",
    legend: [["#5a8f8a", "photographed"], ["#c8791a", "inpainted"], ["#9a958b", "no colour"]],
  },
  { key: "distance", label: "Distance from the samples", number: 3, needs: "_DISTANCE_TO_SAMPLES_M" },
];

const [NEAR, FAR] = ["#dcdbd5", "#8c2d04"];
const linear = (hex) => [1, 3, 5].map((k) => {
  const c = parseInt(hex.slice(k, k + 2), 16) / 255;
  return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
});

/** The distance that nineteen of twenty measured corners are within, rounded up to 1, 2 or 5. */
function widestDistance(parts) {
  const found = [];
  for (const { attributes } of parts) {
    const told = attributes._DISTANCE_TO_SAMPLES_M;
    const kind = attributes._PROVENANCE;
    if (!told) continue;
    const values = new DataView(told.data.buffer, told.data.byteOffset);
    const step = Math.max(1, Math.floor(told.count / 20000));
    for (let k = 0; k < told.count; k += step) {
      const distance = values.getFloat32(k * told.stride, true);
      if (distance >= 0 && !kind?.data[k * kind.stride]) found.push(distance);
    }
  }
  if (!found.length) return 0.001;
  const most = found.sort((a, b) => a - b)[Math.floor(0.95 * (found.length - 1))] || 1e-9;
  const unit = 10 ** Math.floor(Math.log10(most));
  return unit * [1, 2, 5, 10].find((step) => step * unit >= most);
}

/** Open the mesh of an entry of the scene. */
export async function open(context, entry) {
  const { gl, counts, origin } = context;
  const buffer = await context.source(entry.file).all();
  const { fromPositions, parts } = readGlb(buffer, entry.file);
  const from = fromPositions.map((value, k) => value - origin[k]);
  const drawing = program(gl, VERTEX, FRAGMENT);
  const made = [];
  for (const part of parts) {
    const array = new VertexArray(gl, counts);
    for (const [name, { data, size, stride, type }] of Object.entries(part.attributes)) {
      if (name in PLACES) array.vertices(data, stride, [[PLACES[name], size, type, false, 0]]);
    }
    array.indices(part.indices.data);
    const texture = part.picture && new Texture(gl, counts).picture(
      await createImageBitmap(part.picture, { colorSpaceConversion: "none", premultiplyAlpha: "none" }),
    );
    made.push({ array, texture, count: part.indices.count, type: part.indices.type, names: Object.keys(part.attributes) });
  }
  const widest = widestDistance(parts);
  const overlays = OVERLAYS.map((one) => (one.key !== "distance" ? one : {
    ...one, legend: [[NEAR, "none"], [FAR, `${lengthInWords(widest, "m")} and more`]],
  }));
  const names = new Set(made.flatMap((part) => part.names));
  const triangles = made.reduce((sum, part) => sum + part.count / 3, 0);

  return {
    pending: false,
    items: triangles,
    overlays: overlays.filter(({ needs }) => !needs || names.has(needs)),
    draw(view, look) {
      const { uniforms } = drawing;
      gl.useProgram(drawing.program);
      gl.disable(gl.CULL_FACE);
      setLook(gl, uniforms, view, look);
      gl.uniformMatrix4fv(uniforms.u_clip, false, new Float32Array(view.clip));
      gl.uniform3fv(uniforms.u_from, from);
      const overlay = OVERLAYS.find(({ key }) => key === look.overlay) ?? OVERLAYS[0];
      gl.uniform1i(uniforms.u_overlay, overlay.number);
      gl.uniform3fv(uniforms.u_tints, ["#5a8f8a", "#c8791a", "#9a958b"].flatMap(linear));
      gl.uniform1f(uniforms.u_widest, widest);
      gl.uniform3fv(uniforms.u_near, linear(NEAR));
      gl.uniform3fv(uniforms.u_far, linear(FAR));
      gl.uniform1i(uniforms.u_picture, 0);
      for (const part of made) {
        gl.uniform1i(uniforms.u_textured, part.texture ? 1 : 0);
        part.texture?.bind(0);
        part.array.bind();
        if (!part.names.includes("COLOR_0")) gl.vertexAttrib3f(2, 0.55, 0.55, 0.55);
        gl.drawElements(gl.TRIANGLES, part.count, part.type, 0);
        counts.drew(part.count / 3);
      }
    },
    dispose() {
      made.forEach((part) => {
        part.array.dispose();
        part.texture?.dispose();
      });
      gl.deleteProgram(drawing.program);
    },
  };
}
