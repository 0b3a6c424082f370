// Visibility and stitching: of the meshes that show the surface in a pixel, the one that is to.
//
// Meshes compete where they lie within ε of the front-most. A card has no lists for a pixel: they
// are drawn once for the front, then once for each of the best few, every time without the meshes
// that a pixel has already. Depth of these passes is not how far a fragment is but how well its
// mesh suits: foreground before background, then the lower cost. Neighbours then vote, as
// `workbench.render.stitch.stitching` has it, over the pixels alone.

import { program } from "../gpu.js";
import { LOOK_GLSL, setLook } from "../shading.js";
import { frustumPlanes } from "../vectors.js";
import { FRAGMENT_GLSL, PRECISE, Pass, Target, bindAll } from "./stitch_screen.js";

// Meshes that compete at a pixel, at most. Without a browser there are eight: one pixel in two
// hundred then shows another photograph.
const SLOTS = 3;

const VERTEX = `
layout(location = 0) in vec3 a_position;
layout(location = 1) in vec4 a_color;
layout(location = 2) in uvec2 a_told;
uniform mat4 u_clip;
uniform vec3 u_shift;
out vec3 v_point;
out vec4 v_color;
out float v_deep;
flat out uvec2 v_told;
flat out float v_reach;
invariant gl_Position;
void main() {
  v_point = a_position + u_shift;
  v_color = a_color;
  v_told = a_told;
  v_reach = a_color.a * 255.0 / 32.0;
  gl_Position = u_clip * vec4(v_point, 1.0);
  v_deep = gl_Position.w;
}`;

const FRONT = `
in vec3 v_point;
${LOOK_GLSL}
void main() { if (cut(v_point)) discard; }`;

const COMPETING = `
in vec3 v_point;
in vec4 v_color;
in float v_deep;
flat in uvec2 v_told;
flat in float v_reach;
uniform sampler2D u_front;
uniform usampler2D u_slot0, u_slot1;
uniform int u_before;      // slots filled already
uniform uint u_mesh;
uniform float u_epsilon;
uniform vec2 u_range;      // near and far
layout(location = 0) out uvec4 o_fragment;
${LOOK_GLSL}
${FRAGMENT_GLSL}
void main() {
  if (cut(v_point)) discard;
  ivec2 at = ivec2(gl_FragCoord.xy);
  float stored = texelFetch(u_front, at, 0).r;
  float front = u_range.x * u_range.y / (u_range.y - stored * (u_range.y - u_range.x));
  if (v_deep > front + u_epsilon * v_reach) discard;
  bool mine = (v_told.x & 0x8000u) != 0u;
  if (u_before > 0) {
    uvec4 f = texelFetch(u_slot0, at, 0);
    if (inFront(f) != mine || meshOf(f.y) == u_mesh) discard;
  }
  if (u_before > 1) {
    uvec4 f = texelFetch(u_slot1, at, 0);
    if (!isThere(f) || meshOf(f.y) == u_mesh) discard;
  }
  uvec3 c = uvec3(v_color.rgb * 255.0 + 0.5);
  o_fragment = uvec4(
    floatBitsToUint(v_deep),
    THERE | (u_mesh << 15) | (v_told.x & 0x7fffu),
    v_told.y | (mine ? 0x10000u : 0u),
    c.r | (c.g << 8) | (c.b << 16)
  );
  gl_FragDepth = (float(v_told.y) + (mine ? 0.0 : 65536.0)) / 131072.0;
}`;

// Chosen is RG32UI: depth, and what it is with the slot in bits 28 and 29, contested in bit 30.
const SLOTS_GLSL = `
uniform usampler2D u_slot0, u_slot1, u_slot2;
uvec4 slot(int k, ivec2 at) {
  if (k == 0) return texelFetch(u_slot0, at, 0);
  if (k == 1) return texelFetch(u_slot1, at, 0);
  return texelFetch(u_slot2, at, 0);
}`;

const FIRST = `
${SLOTS_GLSL}
layout(location = 0) out uvec2 o_chosen;
${FRAGMENT_GLSL}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  uvec4 f = slot(0, at);
  o_chosen = isThere(f) ? uvec2(f.x, f.y | (isThere(slot(1, at)) ? 0x40000000u : 0u)) : uvec2(0u);
}`;

const VOTE = `
${SLOTS_GLSL}
uniform usampler2D u_chosen;
uniform bool u_settledAlone;   // pixels that nothing contests vote first
uniform int u_radius;
uniform float u_epsilon, u_step, u_labelWeight, u_meshWeight;
layout(location = 0) out uvec2 o_chosen;
${FRAGMENT_GLSL}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  o_chosen = texelFetch(u_chosen, at, 0).rg;
  if ((o_chosen.y & 0x40000000u) == 0u) return;
  int mine = int((o_chosen.y >> 28) & 3u);
  float deep = uintBitsToFloat(o_chosen.x);
  uvec4 own[${SLOTS}];
  vec2 same[${SLOTS}];
  int count = 0;
  for (int s = 0; s < ${SLOTS}; s++) {
    own[s] = slot(s, at);
    same[s] = vec2(0.0);
    if (isThere(own[s])) count = s + 1;
  }
  ivec2 last = textureSize(u_chosen, 0) - 1;
  ivec2 low = max(at - u_radius, ivec2(0)), high = min(at + u_radius, last);
  float neighbours = 0.0;
  for (int r = low.y; r <= high.y; r++) {
    for (int c = low.x; c <= high.x; c++) {
      int far = max(abs(r - at.y), abs(c - at.x));
      uvec2 other = texelFetch(u_chosen, ivec2(c, r), 0).rg;
      if (far == 0 || (other.y & THERE) == 0u) continue;
      if (u_settledAlone && (other.y & 0x40000000u) != 0u) continue;
      if (abs(uintBitsToFloat(other.x) - deep) > u_epsilon * float(far)) continue;
      neighbours += 1.0;
      for (int s = 0; s < ${SLOTS}; s++) {
        same[s] += vec2(labelOf(other.y) == labelOf(own[s].y), meshOf(other.y) == meshOf(own[s].y));
      }
    }
  }
  if (neighbours == 0.0) return;
  float best = 3e38;
  int winner = mine;
  for (int s = 0; s < ${SLOTS}; s++) {
    if (s >= count) break;
    vec2 against = 1.0 - same[s] / neighbours;
    float cost = u_step * costOf(own[s]) + u_labelWeight * against.x + u_meshWeight * against.y;
    if (cost < best || (cost == best && s == mine)) {
      best = cost;
      winner = s;
    }
  }
  uvec4 f = slot(winner, at);
  o_chosen = uvec2(f.x, f.y | 0x40000000u | (uint(winner) << 28));
}`;

const SHOWN = `
${SLOTS_GLSL}
uniform usampler2D u_chosen;
layout(location = 0) out uvec4 o_fragment;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  uint chosen = texelFetch(u_chosen, at, 0).g;
  o_fragment = chosen == 0u ? uvec4(0u) : slot(int((chosen >> 28) & 3u), at);
}`;

export class Choice {
  /** told as stitched.json has it; shift added to stored positions gives local coordinates. */
  constructor(gl, counts, told, shift) {
    Object.assign(this, { gl, counts, told, shift });
    this.front = program(gl, VERTEX, FRONT);
    this.competing = program(gl, VERTEX, PRECISE + COMPETING);
    this.passes = { first: new Pass(gl, FIRST), vote: new Pass(gl, VOTE), shown: new Pass(gl, SHOWN) };
  }

  /** What is drawn to, for pictures of so many pixels. */
  resize(width, height) {
    this.#free();
    const { gl, counts } = this;
    const made = (formats, depth) => new Target(gl, counts, formats, width, height, depth);
    const nearest = made(["DEPTH"]);
    const suited = made(["RGBA32UI", "DEPTH"]);
    const slots = [suited];
    while (slots.length < SLOTS) slots.push(made(["RGBA32UI"], suited));
    this.targets = { nearest, slots, chosen: [made(["RG32UI"]), made(["RG32UI"])] };
  }

  /**
   * Draw meshes as a view sees them and leave the chosen fragments in a target of RGBA32UI.
   *
   * quick leaves neighbours without a vote. How many triangles there were is returned.
   */
  draw(meshes, view, look, shown, quick) {
    const { gl, told, targets } = this;
    const planes = frustumPlanes(view.clip);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.depthMask(true);
    const start = (made, target) => {
      target.bind();
      gl.clear(gl.DEPTH_BUFFER_BIT);
      gl.useProgram(made.program);
      setLook(gl, made.uniforms, view, look);
      gl.uniformMatrix4fv(made.uniforms.u_clip, false, new Float32Array(view.clip));
      gl.uniform3fv(made.uniforms.u_shift, this.shift);
    };
    start(this.front, targets.nearest);
    const triangles = meshes.draw(planes, () => {});
    const used = quick ? targets.slots.slice(0, 1) : targets.slots;
    used.forEach((slot, k) => {
      const { uniforms } = this.competing;
      start(this.competing, slot);
      gl.clearBufferuiv(gl.COLOR, 0, [0, 0, 0, 0]);
      // What is drawn to must not be bound to be read, even unread.
      const before = (s) => (s < k ? targets.slots[s].texture : null);
      bindAll(gl, uniforms, { u_front: targets.nearest.texture, u_slot0: before(0), u_slot1: before(1) });
      gl.uniform1i(uniforms.u_before, k);
      gl.uniform1f(uniforms.u_epsilon, told.epsilon);
      gl.uniform2f(uniforms.u_range, view.near, view.far);
      meshes.draw(planes, (number) => gl.uniform1ui(uniforms.u_mesh, number));
    });
    gl.disable(gl.CULL_FACE);
    gl.disable(gl.DEPTH_TEST);
    const slots = Object.fromEntries(targets.slots.map((_, k) => [`u_slot${k}`, used[k]?.texture ?? null]));
    let [now, next] = targets.chosen;
    this.passes.first.run(now, slots);
    for (let round = 0; round < (quick ? 0 : told.vote.rounds); round++) {
      const uniforms = this.passes.vote.begin(next, { ...slots, u_chosen: now.texture });
      gl.uniform1i(uniforms.u_settledAlone, round === 0 ? 1 : 0);
      gl.uniform1i(uniforms.u_radius, told.vote.radius);
      gl.uniform1f(uniforms.u_epsilon, told.epsilon);
      gl.uniform1f(uniforms.u_step, told.cost_step);
      gl.uniform1f(uniforms.u_labelWeight, told.vote.label_weight);
      gl.uniform1f(uniforms.u_meshWeight, told.vote.mesh_weight);
      this.passes.vote.end();
      [now, next] = [next, now];
    }
    this.passes.shown.run(shown, { ...slots, u_chosen: now.texture });
    return triangles;
  }

  #free() {
    if (!this.targets) return;
    const { nearest, slots, chosen } = this.targets;
    [nearest, ...slots, ...chosen].forEach((target) => target.dispose());
    this.targets = null;
  }

  dispose() {
    this.#free();
    for (const { program: made } of [this.front, this.competing]) this.gl.deleteProgram(made);
    Object.values(this.passes).forEach((pass) => pass.dispose());
  }
}
