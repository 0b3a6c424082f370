// The surface as oriented discs, of every part as many as the picture needs.

import { program } from "../gpu.js";
import { setLook } from "../shading.js";
import { SurfelCut } from "./surfel_cut.js";
import { FRAGMENT, VERTEX } from "./surfel_discs.js";
import { readIndex } from "./surfel_file.js";
import { MixingScreen } from "./surfel_screen.js";
import { SizeControl } from "./surfel_size.js";
import { SurfelStore, bytesOf } from "./surfel_store.js";

/** Discs that are wider than that, in pixels, are drawn as squares: points have a largest size. */
const WIDEST_POINT = 48;

/** So many times as large are surfels, more, with every half of the picture's height from its middle. */
const FALLOFF = 3;

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
  const screen = MixingScreen.of(gl, counts);

  /** The cut of a view whose bytes fit on the card: larger surfels where they do not. */
  function cutOf(view, size, budget, falloff) {
    for (let coarser = size; ; coarser *= 1.25) {
      const cut = new SurfelCut(store, view, origin, coarser, falloff).of(file.nodes[0]);
      const bytes = cut.wanted.reduce((sum, { node, count }) => sum + bytesOf(file, node, count), 0);
      if (bytes <= 0.9 * (budget - (screen?.bytes ?? 0)) || coarser > 1000) return cut;
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
    store.held.get(node).bind(count, square);
    if (square) gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
    else gl.drawArrays(gl.POINTS, 0, count);
  }

  const mode = {
    pending: true,
    items: entry.items,
    pixelError: 1,
    foveated: false,
    overlays: OVERLAYS,
    draw(view, look) {
      const { uniforms } = drawing;
      store.upload();
      const size = control.sizeFor(view, look.pixelError);
      const cut = cutOf(view, size, look.budgetBytes, look.foveated ? FALLOFF : 0);
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
      const discs = (pass) => {
        gl.uniform1i(uniforms.u_mixed, pass === "mixed" ? 1 : 0);
        cut.shown.forEach((part) => drawPart(view, part));
      };
      gl.uniform1i(uniforms.u_front, 0);
      if (screen) screen.draw(view.width, view.height, discs);
      else discs("nearest");
      cut.shown.forEach(({ count }) => counts.drew(count));
      gl.bindVertexArray(null);
      const lacking = store.want(cut.wanted);
      store.evict(look.budgetBytes, cut.wanted);
      mode.pending = lacking || store.busy || control.waiting;
    },
    dispose() {
      store.dispose();
      screen?.dispose();
      gl.deleteProgram(drawing.program);
    },
  };
  return mode;
}

/** How far a box is from the origin. */
function nearest(low, high) {
  return Math.hypot(...low.map((value, k) => Math.max(value, 0, -high[k])));
}
