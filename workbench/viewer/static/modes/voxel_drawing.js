// How parts of a cut are drawn, in colour or as the numbers of their nodes.

import { VertexArray } from "../gpu.js";
import { windowOf } from "./screen_window.js";

/** Faces that are drawn in one call, of four corners each. */
const BATCH = 1 << 14;
const CORNERS = Uint16Array.from({ length: 6 * BATCH }, (_, k) => 4 * Math.floor(k / 6) + [0, 1, 2, 2, 1, 3][k % 6]);
/** Surfaces reach so many voxels beyond their chunk: what just grazes another has no voxel there. */
const MARGIN = 1;

/** Draws what a store holds of a file; origin is taken off coordinates. */
export class VoxelDrawing {
  constructor({ gl, counts, origin }, file, store) {
    Object.assign(this, { gl, origin, file, store });
    this.faces = new VertexArray(gl, counts).indices(CORNERS);
  }

  get bytes() {
    return this.faces.bytes;
  }

  /**
   * Draw parts with the programs of their kinds. pass has the view, the clip matrix, the section,
   * the pixels of what is drawn to, and what to set for all parts of a kind and for each part;
   * counted is called with how many faces and triangles each part has.
   */
  draw(programs, shown, pass, counted = () => {}) {
    const { gl } = this;
    const inside = this.#seenInside(pass);
    for (const kind of ["surface", "voxels"]) {
      const parts = shown.filter((part) => part.kind === kind);
      if (!parts.length) continue;
      const { program, uniforms } = programs[kind];
      gl.useProgram(program);
      gl.uniformMatrix4fv(uniforms.u_clip, false, pass.clip);
      pass.prepare(uniforms);
      if (kind === "voxels") this.#prepareFaces(uniforms, pass);
      for (const part of parts) {
        gl.uniform3fv(uniforms.u_corner, this.#local(part.node.corner));
        pass.each(uniforms, part);
        counted(kind === "voxels" ? this.#drawFaces(uniforms, part, pass, inside) : this.#drawSurface(uniforms, part, pass));
      }
    }
  }

  #local(corner) {
    return corner.map((value, k) => value - this.origin[k]);
  }

  #prepareFaces(uniforms, { view }) {
    const { gl, file } = this;
    gl.uniform3fv(uniforms.u_from, view.eye);
    gl.uniform1i(uniforms.u_half, file.chunkLevel - 1);
    gl.uniform1i(uniforms.u_colored ?? null, file.colored ? 1 : 0);
    gl.uniform1i(uniforms.u_records, 0);
    this.faces.bind();
  }

  /** Faces that can look to the eye; from inside walls, too, those opposite them. */
  #drawFaces(uniforms, { node, octants }, { view }, inside) {
    const { gl, store, origin } = this;
    const { texture, starts } = store.get(node, "voxels");
    gl.uniform1f(uniforms.u_voxel, node.voxel);
    gl.uniform1ui(uniforms.u_octants, octants);
    texture.bind(0);
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

  /** Triangles as far as they lie in the chunk: large ones reach through many. */
  #drawSurface(uniforms, { node }, { clip, width, height }) {
    const { gl, file, store } = this;
    const low = this.#local(node.corner).map((value) => value - MARGIN * node.voxel);
    const high = low.map((value) => value + (2 ** file.chunkLevel + 2 * MARGIN) * node.voxel);
    gl.uniform3fv(uniforms.u_low, low);
    gl.uniform3fv(uniforms.u_high, high);
    const { array, count } = store.get(node, "surface");
    array.bind();
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(...windowOf(clip, low, high, width, height));
    gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
    gl.disable(gl.SCISSOR_TEST);
    return count / 3;
  }

  /** Whether inner sides of walls can be seen: through a section, or from among the walls. */
  #seenInside({ view, section }) {
    const { lower, upper } = this.file.nodes[0];
    const eye = view.eye.map((value, k) => value + this.origin[k]);
    return section.slice(0, 3).some(Boolean) || eye.every((value, k) => value > lower[k] && value < upper[k]);
  }

  dispose() {
    this.faces.dispose();
  }
}
