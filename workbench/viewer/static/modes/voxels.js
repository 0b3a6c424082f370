// The surface as voxels, of every part as fine ones as the picture needs and shows.

import { VertexArray, program } from "../gpu.js";
import { setLook } from "../shading.js";
import { dot, sub } from "../vectors.js";
import { readIndex } from "./vlod.js";
import { VoxelCut } from "./voxel_cut.js";
import {
  SURFACE_FRAGMENT, SURFACE_ID_FRAGMENT, SURFACE_ID_VERTEX, SURFACE_VERTEX,
  VOXEL_FRAGMENT, VOXEL_ID_FRAGMENT, VOXEL_ID_VERTEX, VOXEL_VERTEX,
} from "./voxel_faces.js";
import { Sight } from "./voxel_sight.js";
import { VoxelStore } from "./voxel_store.js";

/** Faces that are drawn in one call, of four corners each. */
const BATCH = 1 << 14;
const CORNERS = Uint16Array.from({ length: 6 * BATCH }, (_, k) => 4 * Math.floor(k / 6) + [0, 1, 2, 2, 1, 3][k % 6]);

const STONE = [0.77, 0.77, 0.77];
/** From fine to coarse; the surface itself first. */
const TINTS = ["#4f7a4d", "#5a8f8a", "#8fb7c4", "#d9c46a", "#c8791a", "#8c2d04"];
const OVERLAYS = [
  { key: "color", label: "Colour" },
  { key: "shape", label: "Shape alone" },
  {
    key: "level", label: "Level of detail",
    legend: [[TINTS[0], "the surface itself"], [TINTS[1], "finest voxels"], [TINTS[2], "twice as large"], [TINTS[5], "much larger"]],
  },
];
const bytes = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);

/** Open the voxels of an entry of the scene. */
export async function open(context, entry) {
  const { gl, counts, origin } = context;
  const source = context.source(entry.file);
  const file = await readIndex(source);
  const store = new VoxelStore(context, file, source);
  const sight = new Sight(gl, counts);
  const programs = {
    color: { voxels: program(gl, VOXEL_VERTEX, VOXEL_FRAGMENT), surface: program(gl, SURFACE_VERTEX, SURFACE_FRAGMENT) },
    number: { voxels: program(gl, VOXEL_ID_VERTEX, VOXEL_ID_FRAGMENT), surface: program(gl, SURFACE_ID_VERTEX, SURFACE_ID_FRAGMENT) },
  };
  const faces = new VertexArray(gl, counts).indices(CORNERS);
  let [eyeBefore, refinement] = [null, "gradual"];

  /** Whole nodes are refined while one comes nearer, child by child while one moves to the side. */
  function chooseRefinement(view) {
    const step = eyeBefore ? sub(view.eye, eyeBefore) : [0, 0, 0];
    const ahead = dot(step, view.forward);
    if (dot(step, step) > 0) refinement = ahead > 0.7 * Math.sqrt(dot(step, step)) ? "whole" : "gradual";
    eyeBefore = view.eye;
  }

  /** Draw parts of a cut with a pair of programs; prepare sets what one of them needs for all. */
  function drawParts(pair, shown, view, clip, section, prepare, each, drawn = () => {}) {
    const inside = seenInside(view, section);
    for (const kind of ["surface", "voxels"]) {
      const parts = shown.filter((part) => part.kind === kind);
      if (!parts.length) continue;
      const { uniforms } = pair[kind];
      gl.useProgram(pair[kind].program);
      gl.uniformMatrix4fv(uniforms.u_clip, false, clip);
      if (kind === "voxels") {
        gl.uniform3fv(uniforms.u_from, view.eye);
        gl.uniform1i(uniforms.u_half, file.chunkLevel - 1);
        gl.uniform1i(uniforms.u_colored, file.colored ? 1 : 0);
        gl.uniform1i(uniforms.u_records, 0);
        faces.bind();
      }
      prepare(uniforms);
      for (const part of parts) {
        each(uniforms, part);
        drawn(drawPart(uniforms, part, view, inside));
      }
    }
  }

  function drawPart(uniforms, { node, kind, octants }, view, inside) {
    const corner = node.corner.map((value, k) => value - origin[k]);
    const held = store.get(node, kind);
    gl.uniform3fv(uniforms.u_corner, corner);
    if (kind === "voxels") {
      gl.uniform1f(uniforms.u_voxel, node.voxel);
      gl.uniform1ui(uniforms.u_octants, octants);
      held.texture.bind(0);
      return drawFaces(uniforms, node, held.starts, view, inside);
    } else {
      const side = node.voxel * 2 ** file.chunkLevel;
      gl.uniform3fv(uniforms.u_low, corner.map((value) => value - 1e-3 * node.voxel));
      gl.uniform3fv(uniforms.u_high, corner.map((value) => value + side + 1e-3 * node.voxel));
      held.array.bind();
      gl.drawElements(gl.TRIANGLES, held.count, gl.UNSIGNED_INT, 0);
    }
    return held.count / 3;
  }

  /** Faces that can look to the eye; from inside walls, too, those opposite them. How many. */
  function drawFaces(uniforms, node, starts, view, inside) {
    let drawn = 0;
    for (let list = 0; list < (inside ? 12 : 6); list++) {
      const [axis, side] = [(list % 6) >> 1, list & 1];
      const eye = view.eye[axis] + origin[axis];
      if (side ? eye <= node.lower[axis] : eye >= node.upper[axis]) continue;
      gl.uniform1i(uniforms.u_axis, axis);
      gl.uniform1i(uniforms.u_side, side);
      gl.uniform1i(uniforms.u_turned ?? null, list < 6 ? 0 : 1);
      for (let first = starts[list]; first < starts[list + 1]; first += BATCH) {
        const count = Math.min(BATCH, starts[list + 1] - first);
        gl.uniform1i(uniforms.u_first, first);
        gl.drawElements(gl.TRIANGLES, 6 * count, gl.UNSIGNED_SHORT, 0);
        drawn += count;
      }
    }
    return drawn;
  }

  /** Whether inner sides of walls can be seen: through a section, or from among the walls. */
  function seenInside(view, section) {
    const eye = view.eye.map((value, k) => value + origin[k]);
    const { lower, upper } = file.nodes[0];
    return section.slice(0, 3).some(Boolean) || eye.every((value, k) => value > lower[k] && value < upper[k]);
  }

  const tintOf = ({ node, kind }) => {
    const above = kind === "surface" ? 0 : 1 + file.level - node.level;
    return bytes(TINTS[Math.min(above, TINTS.length - 1)]);
  };

  const mode = {
    pending: true,
    items: entry.items,
    pixelError: 1,
    overlays: OVERLAYS,
    sight,
    store,
    shown: [],
    draw(view, look) {
      store.upload();
      chooseRefinement(view);
      const cut = new VoxelCut(store, sight, view, origin, refinement);
      mode.shown = cut.of(file.nodes[0], look.pixelError, 0.9 * (look.budgetBytes - sight.bytes - faces.bytes)).shown;
      gl.disable(gl.CULL_FACE);
      gl.vertexAttrib3f(2, ...STONE);
      const tinted = look.overlay === "level" || look.overlay === "shape";
      drawParts(
        programs.color, mode.shown, view, new Float32Array(view.clip), look.section,
        (uniforms) => {
          setLook(gl, uniforms, view, look);
          gl.uniform1i(uniforms.u_tinted, tinted ? 1 : 0);
        },
        (uniforms, part) => gl.uniform3fv(uniforms.u_tint, look.overlay === "level" ? tintOf(part) : STONE),
        (count) => counts.drew(count),
      );
      sight.look(view, look.section, mode.shown, (clip) => drawParts(
        programs.number, mode.shown, view, clip, look.section,
        (uniforms) => gl.uniform4fv(uniforms.u_section, look.section),
        (uniforms, { node }) => gl.uniform1i(uniforms.u_number, node.row + 1),
      ));
      gl.bindVertexArray(null);
      const lacking = store.want(cut.wanted);
      store.evict(look.budgetBytes);
      mode.pending = lacking || store.busy || sight.waiting;
    },
    dispose() {
      store.dispose();
      sight.dispose();
      faces.dispose();
      for (const pair of Object.values(programs)) for (const { program: one } of Object.values(pair)) gl.deleteProgram(one);
    },
  };
  return mode;
}
