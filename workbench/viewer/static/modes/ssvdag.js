// The surface as voxels in a graph of which mirrored parts are kept once, walked by the rays of pixels.

import { Texture, program } from "../gpu.js";
import { setLook } from "../shading.js";
import { readGraph } from "./graph_file.js";
import { TracedScreen } from "./graph_screen.js";
import { SHADING, SHOWING } from "./graph_shading.js";
import { FULL_SCREEN, ROW_BITS, traceFragment } from "./graph_trace.js";

const TINTS = ["#5a8f8a", "#8fb7c4", "#d9c46a", "#c8791a", "#a8501a", "#8c2d04"];
const OVERLAYS = [
  { key: "color", label: "Colour", number: 0 },
  { key: "shape", label: "Shape alone", number: 1 },
  {
    key: "level", label: "Level of detail", number: 2,
    legend: [[TINTS[0], "finest voxels"], [TINTS[1], "twice as large"], [TINTS[5], "much larger"]],
  },
];
const parts = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);

/** Values in rows of a texture, `wide` of them for each place. */
function arrayTexture(gl, counts, values, wide, internal, format, type) {
  const row = 1 << ROW_BITS;
  const height = Math.max(1, Math.ceil(values.length / wide / row));
  if (height > gl.getParameter(gl.MAX_TEXTURE_SIZE)) {
    throw new Error("The voxel graph is larger than this graphics card can hold. Publish it with a lower resolution.");
  }
  const padded = new values.constructor(height * row * wide);
  padded.set(values);
  return new Texture(gl, counts).data(row, height, internal, format, type, padded);
}

/** Open the graph of an entry of the scene. */
export async function open(context, entry) {
  const { gl, counts, origin } = context;
  const graph = readGraph(await context.source(entry.file).all());
  const voxel = graph.size / 2 ** graph.level;
  const from = graph.origin.map((value, k) => value - origin[k]);
  const arrays = {
    u_halves: arrayTexture(gl, counts, graph.halves, 1, gl.R16UI, gl.RED_INTEGER, gl.UNSIGNED_SHORT),
    u_bricks: arrayTexture(gl, counts, graph.bricks, 2, gl.RG32UI, gl.RG_INTEGER, gl.UNSIGNED_INT),
    u_below: arrayTexture(gl, counts, graph.below, 1, gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT),
    u_colors: arrayTexture(gl, counts, graph.colors ?? new Uint8Array(3), 3, gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE),
  };
  const tracing = program(gl, FULL_SCREEN, traceFragment(graph.level));
  const shading = program(gl, FULL_SCREEN, SHADING);
  const showing = program(gl, FULL_SCREEN, SHOWING);
  const empty = gl.createVertexArray();
  let [seen, wanted] = [null, null];
  const screen = new TracedScreen(gl, counts, { trace, shade });

  function setRays({ uniforms }, pixel) {
    const row = (k) => [seen.fromWorld[k], seen.fromWorld[4 + k], seen.fromWorld[8 + k]];
    gl.uniform3fv(uniforms.u_right, row(0));
    gl.uniform3fv(uniforms.u_above, row(1));
    gl.uniform3fv(uniforms.u_ahead, row(2).map((value) => -value));
    gl.uniform2f(uniforms.u_middle, seen.width / 2, seen.height / 2);
    gl.uniform1f(uniforms.u_focal, seen.pixelsPerUnit);
    gl.uniform1f(uniforms.u_pixel, pixel);
  }

  function trace(pixel) {
    const { uniforms } = tracing;
    gl.useProgram(tracing.program);
    setRays(tracing, pixel);
    Object.entries(arrays).forEach(([name, texture], slot) => {
      texture.bind(slot);
      gl.uniform1i(uniforms[name], slot);
    });
    const [a, b, c, d] = wanted.section;
    gl.uniform1i(uniforms.u_colored, graph.colors ? 1 : 0);
    gl.uniform1iv(uniforms.u_starts, graph.starts);
    gl.uniform1ui(uniforms.u_turn, graph.rootTurn);
    gl.uniform3fv(uniforms.u_origin, seen.eye.map((value, k) => (value - from[k]) / voxel));
    gl.uniform1f(uniforms.u_slope, Math.max(wanted.pixelError, pixel) / seen.pixelsPerUnit);
    gl.uniform4f(uniforms.u_section, a, b, c, (d + a * from[0] + b * from[1] + c * from[2]) / voxel);
    gl.uniform1i(uniforms.u_shadows, shadows() ? 1 : 0);
    gl.uniform3fv(uniforms.u_light, wanted.light);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  const shadows = () => wanted.lit && !wanted.headlight;

  function shade(pixel, met) {
    const { uniforms } = shading;
    gl.useProgram(shading.program);
    setLook(gl, uniforms, seen, wanted);
    setRays(shading, pixel);
    bind(0, met);
    gl.uniform1i(uniforms.u_met, 0);
    gl.uniform1f(uniforms.u_voxel, voxel);
    gl.uniform1i(uniforms.u_overlay, (OVERLAYS.find(({ key }) => key === wanted.overlay) ?? OVERLAYS[0]).number);
    gl.uniform3fv(uniforms.u_tints, TINTS.flatMap(parts));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    // What is drawn to must not be read from, too.
    bind(0, null);
  }

  function bind(slot, texture) {
    gl.activeTexture(gl.TEXTURE0 + slot);
    gl.bindTexture(gl.TEXTURE_2D, texture);
  }

  function showPicture() {
    const { uniforms } = showing;
    const { fine, rough } = screen;
    gl.useProgram(showing.program);
    const textures = { u_fine: fine.met, u_rough: rough.met, u_fineLight: fine.light, u_roughLight: rough.light };
    Object.entries(textures).forEach(([name, texture], slot) => {
      bind(slot, texture);
      gl.uniform1i(uniforms[name], slot);
    });
    gl.uniform1f(uniforms.u_rows, screen.rows);
    gl.uniform1f(uniforms.u_roughness, screen.shownRoughness);
    gl.uniform1f(uniforms.u_voxel, voxel);
    gl.uniform2f(uniforms.u_depths, seen.projection[10], seen.projection[14]);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    counts.drew(graph.voxels);
    [3, 2, 1, 0].forEach((slot) => bind(slot, null));
  }

  const mode = {
    pending: true,
    items: entry.items,
    pixelError: 1,
    overlays: OVERLAYS,
    screen,
    draw(view, look) {
      [seen, wanted] = [view, look];
      const { light, lit, headlight, overlay, section, pixelError } = look;
      const key = JSON.stringify([[...view.clip], view.width, view.height, light, lit, headlight, overlay, section, pixelError]);
      gl.bindVertexArray(empty);
      screen.update(key, view.width, view.height);
      showPicture();
      gl.bindVertexArray(null);
      mode.pending = screen.pending;
    },
    dispose() {
      screen.dispose();
      Object.values(arrays).forEach((texture) => texture.dispose());
      gl.deleteVertexArray(empty);
      [tracing, shading, showing].forEach((one) => gl.deleteProgram(one.program));
    },
  };
  return mode;
}
