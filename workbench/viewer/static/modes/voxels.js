// The surface as voxels, of every part as fine ones as the picture needs and shows.

import { program } from "../gpu.js";
import { setLook } from "../shading.js";
import { dot, sub } from "../vectors.js";
import { readIndex } from "./vlod.js";
import { VoxelCut } from "./voxel_cut.js";
import { VoxelDrawing } from "./voxel_drawing.js";
import {
  SURFACE_FRAGMENT, SURFACE_ID_FRAGMENT, SURFACE_ID_VERTEX, SURFACE_VERTEX,
  VOXEL_FRAGMENT, VOXEL_ID_FRAGMENT, VOXEL_ID_VERTEX, VOXEL_VERTEX,
} from "./voxel_faces.js";
import { Sight } from "./voxel_sight.js";
import { VoxelStore } from "./voxel_store.js";

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
  const drawing = new VoxelDrawing(context, file, store);
  let [eyeBefore, refinement] = [null, "gradual"];

  /** Whole nodes are refined while one comes nearer, child by child while one moves to the side. */
  function chooseRefinement(view) {
    const step = eyeBefore ? sub(view.eye, eyeBefore) : [0, 0, 0];
    const ahead = dot(step, view.forward);
    if (dot(step, step) > 0) refinement = ahead > 0.7 * Math.sqrt(dot(step, step)) ? "whole" : "gradual";
    eyeBefore = view.eye;
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
      mode.shown = cut.of(file.nodes[0], look.pixelError, 0.9 * (look.budgetBytes - sight.bytes - drawing.bytes)).shown;
      gl.disable(gl.CULL_FACE);
      gl.vertexAttrib3f(2, ...STONE);
      const tinted = look.overlay === "level" || look.overlay === "shape";
      const { width, height } = view;
      const { section } = look;
      const inColor = {
        view, section, width, height,
        clip: new Float32Array(view.clip),
        prepare(uniforms) {
          setLook(gl, uniforms, view, look);
          gl.uniform1i(uniforms.u_tinted, tinted ? 1 : 0);
        },
        each: (uniforms, part) => gl.uniform3fv(uniforms.u_tint, look.overlay === "level" ? tintOf(part) : STONE),
      };
      drawing.draw(programs.color, mode.shown, inColor, (count) => counts.drew(count));
      sight.look(view, section, mode.shown, (target) => drawing.draw(programs.number, mode.shown, {
        view, section, ...target,
        prepare: (uniforms) => gl.uniform4fv(uniforms.u_section, section),
        each: (uniforms, { node }) => gl.uniform1i(uniforms.u_number, node.row + 1),
      }));
      gl.bindVertexArray(null);
      const lacking = store.want(cut.wanted);
      store.evict(look.budgetBytes);
      mode.pending = lacking || store.busy || sight.waiting;
    },
    dispose() {
      store.dispose();
      sight.dispose();
      drawing.dispose();
      for (const pair of Object.values(programs)) for (const { program: one } of Object.values(pair)) gl.deleteProgram(one);
    },
  };
  return mode;
}
