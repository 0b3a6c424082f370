// Levelling: steps of colour at the borders of labels are spread over the surface around.
//
// As `workbench.render.stitch.levelling` has it: border pixels get the mean of both sides, and
// spread how much the photographs differ in one place, averaged along the border; between, the
// change solves the Laplace equation. It is solved by V-cycles over sums of 2 × 2 pixels, with
// damped Jacobi steps, which shaders do for all pixels at once.

import { FRAGMENT_GLSL, PLACE_GLSL, Pass, Target, setPlace } from "./stitch_screen.js";

const [FREE, BORDER, STEP, EMPTY] = [0, 1, 2, 3];
// So much of a new picture's change is used while the camera moves (Arikan et al., table 3).
const NEW_SHARE = 0.4;

// Colour before levelling; a is 1 where it comes from a photograph.
export const COLOR_GLSL = `
vec4 bareColor(sampler2D own, uvec4 f, ivec2 at) {
  vec4 c = texelFetch(own, at, 0);
  return c.a > 0.5 ? vec4(c.rgb / c.a, 1.0) : vec4(colorOf(f), 0.0);
}`;

const GIVEN = `
uniform usampler2D u_shown;
uniform sampler2D u_own, u_others;
uniform float u_epsilon;
layout(location = 0) out vec4 o_given;   // change of a given pixel, and its kind
layout(location = 1) out vec4 o_seam;    // what a border is to spread, and 1 where that is known
${FRAGMENT_GLSL}
${COLOR_GLSL}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy), last = textureSize(u_shown, 0) - 1;
  uvec4 f = texelFetch(u_shown, at, 0);
  o_given = vec4(0.0, 0.0, 0.0, ${EMPTY}.0);
  o_seam = vec4(0.0);
  if (!isThere(f)) return;
  vec4 mine = bareColor(u_own, f, at);
  uint label = mine.a > 0.5 ? labelOf(f.y) : 0u;
  float deep = uintBitsToFloat(f.x);
  int kind = ${FREE};
  vec4 total = vec4(0.0);
  for (int side = 0; side < 4; side++) {
    ivec2 beside = at + (side < 2 ? ivec2(2 * side - 1, 0) : ivec2(0, 2 * side - 5));
    if (any(lessThan(beside, ivec2(0))) || any(greaterThan(beside, last))) continue;
    uvec4 g = texelFetch(u_shown, beside, 0);
    if (!isThere(g)) continue;
    vec4 other = bareColor(u_own, g, beside);
    uint theirs = other.a > 0.5 ? labelOf(g.y) : 0u;
    bool apart = abs(uintBitsToFloat(g.x) - deep) > u_epsilon;
    if (theirs == label && !apart) continue;
    if (theirs == 0u || apart) kind = ${STEP};
    else total += vec4(other.rgb - mine.rgb, 1.0);
  }
  if (total.a > 0.0) {
    kind = ${BORDER};
    o_given.rgb = total.rgb / (total.a + mine.a);
    vec4 others = texelFetch(u_others, at, 0);
    if (label == 0u) o_seam = vec4(o_given.rgb, 1.0);
    else if (others.a > 0.5) o_seam = vec4((others.rgb - others.a * mine.rgb) / (others.a + 1.0), 1.0);
  }
  o_given.a = float(kind);
}`;

// The change that the picture before had in a place; a is the share of its pixels that show it.
const BEFORE_GLSL = `
uniform usampler2D u_shownBefore;
uniform sampler2D u_changeBefore;
uniform mat4 u_before;            // clip of the picture before
uniform bool u_any;
vec4 changeBefore(vec3 place, float epsilon) {
  vec4 p = u_before * vec4(place, 1.0);
  if (!u_any || p.w <= 0.0) return vec4(0.0);
  ivec2 size = textureSize(u_shownBefore, 0);
  vec2 at = (0.5 * p.xy / p.w + 0.5) * vec2(size) - 0.5;
  if (any(lessThan(at, vec2(-1.0))) || any(greaterThan(at, vec2(size)))) return vec4(0.0);
  vec2 low = floor(at), share = at - low;
  vec4 sum = vec4(0.0);
  for (int corner = 0; corner < 4; corner++) {
    ivec2 far = ivec2(corner & 1, corner >> 1), one = ivec2(low) + far;
    if (any(lessThan(one, ivec2(0))) || any(greaterThanEqual(one, size))) continue;
    uvec4 f = texelFetch(u_shownBefore, one, 0);
    if (!isThere(f) || abs(uintBitsToFloat(f.x) - p.w) > epsilon) continue;
    vec2 w = mix(1.0 - share, share, vec2(far));
    sum += w.x * w.y * vec4(texelFetch(u_changeBefore, one, 0).rgb, 1.0);
  }
  return sum.a < 0.25 ? vec4(0.0) : vec4(sum.rgb / sum.a, sum.a);
}`;

const BEGIN = `
uniform usampler2D u_shown;
uniform sampler2D u_own, u_given, u_seam;
uniform float u_epsilon;
uniform int u_radius;
out vec4 o_x;
${FRAGMENT_GLSL}
${COLOR_GLSL}
${PLACE_GLSL}
${BEFORE_GLSL}
uint shownLabel(ivec2 at) {
  return texelFetch(u_own, at, 0).a > 0.5 ? labelOf(texelFetch(u_shown, at, 0).g) : 0u;
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy), last = textureSize(u_shown, 0) - 1;
  int kind = int(texelFetch(u_given, at, 0).a + 0.5);
  o_x = vec4(0.0, 0.0, 0.0, float(kind));
  if (kind == ${FREE}) {
    o_x.rgb = changeBefore(placeOf(at, uintBitsToFloat(texelFetch(u_shown, at, 0).r)), u_epsilon).rgb;
    return;
  }
  if (kind != ${BORDER}) return;
  uint label = shownLabel(at);
  ivec2 low = max(at - u_radius, ivec2(0)), high = min(at + u_radius, last);
  vec4 sum = vec4(0.0);
  for (int r = low.y; r <= high.y; r++) {
    for (int c = low.x; c <= high.x; c++) {
      ivec2 one = ivec2(c, r);
      vec4 seam = texelFetch(u_seam, one, 0);
      if (seam.a > 0.5 && shownLabel(one) == label) sum += seam;
    }
  }
  o_x.rgb = sum.rgb / max(sum.a, 1.0);
}`;

// A grid has links to the right and down, what holds a pixel beside its links, and their sum, 0
// where nothing is unknown.
const NEIGHBOURS_GLSL = `
const ivec2 SIDES[4] = ivec2[4](ivec2(1, 0), ivec2(-1, 0), ivec2(0, 1), ivec2(0, -1));
float link(sampler2D grid, vec4 own, ivec2 at, int side) {
  if (side == 0) return own.r;
  if (side == 2) return own.g;
  ivec2 one = at + SIDES[side];
  if (min(one.x, one.y) < 0) return 0.0;
  vec4 g = texelFetch(grid, one, 0);
  return side == 1 ? g.r : g.g;
}`;

// Islands without any given pixel are held to no change by a thread too thin to be seen elsewhere.
const FINEST = `
uniform sampler2D u_x;
out vec4 o_grid;
int kindOf(ivec2 at) {
  ivec2 last = textureSize(u_x, 0) - 1;
  if (any(lessThan(at, ivec2(0))) || any(greaterThan(at, last))) return ${EMPTY};
  return int(texelFetch(u_x, at, 0).a + 0.5);
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  o_grid = vec4(0.0);
  if (kindOf(at) != ${FREE}) return;
  int right = kindOf(at + ivec2(1, 0)), left = kindOf(at - ivec2(1, 0));
  int down = kindOf(at + ivec2(0, 1)), up = kindOf(at - ivec2(0, 1));
  o_grid.r = right == ${FREE} ? 1.0 : 0.0;
  o_grid.g = down == ${FREE} ? 1.0 : 0.0;
  float links = o_grid.r + o_grid.g + (left == ${FREE} ? 1.0 : 0.0) + (up == ${FREE} ? 1.0 : 0.0);
  for (int k = 0; k < 4; k++) {
    int kind = k == 0 ? right : k == 1 ? left : k == 2 ? down : up;
    if (kind == ${BORDER} || kind == ${STEP}) o_grid.b += 1.0;
  }
  o_grid.b += 1e-5;
  o_grid.a = links + o_grid.b;
}`;

const COARSER = `
uniform sampler2D u_grid;
out vec4 o_grid;
${NEIGHBOURS_GLSL}
vec4 fetched(ivec2 at) {
  return all(lessThan(at, textureSize(u_grid, 0))) && min(at.x, at.y) >= 0 ? texelFetch(u_grid, at, 0) : vec4(0.0);
}
void main() {
  ivec2 at = 2 * ivec2(gl_FragCoord.xy);
  vec4 a = fetched(at), b = fetched(at + ivec2(1, 0)), c = fetched(at + ivec2(0, 1)), d = fetched(at + ivec2(1, 1));
  // A correction that is constant over two pixels pays double for a slope: links count half.
  o_grid.r = 0.5 * (b.r + d.r);
  o_grid.g = 0.5 * (c.g + d.g);
  o_grid.b = a.b + b.b + c.b + d.b;
  float left = fetched(at + ivec2(-1, 0)).r + fetched(at + ivec2(-1, 1)).r;
  float up = fetched(at + ivec2(0, -1)).g + fetched(at + ivec2(1, -1)).g;
  o_grid.a = o_grid.r + o_grid.g + 0.5 * (left + up) + o_grid.b;
}`;

const RESIDUAL = `
uniform sampler2D u_x, u_grid;
out vec4 o_r;
${NEIGHBOURS_GLSL}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy), last = textureSize(u_x, 0) - 1;
  o_r = vec4(0.0);
  vec4 grid = texelFetch(u_grid, at, 0);
  if (grid.a <= 0.0) return;
  vec3 own = texelFetch(u_x, at, 0).rgb, missing = vec3(0.0);
  for (int side = 0; side < 4; side++) {
    ivec2 one = at + SIDES[side];
    if (any(lessThan(one, ivec2(0))) || any(greaterThan(one, last))) continue;
    vec4 x = texelFetch(u_x, one, 0);
    if (x.a < ${EMPTY}.0 - 0.5) missing += x.rgb - own;
  }
  o_r.rgb = missing - 1e-5 * own;
}`;

const DAMPING = "0.8";

const RESTRICT = `
uniform sampler2D u_r, u_grid;
out vec4 o_r;
${NEIGHBOURS_GLSL}
// The first step from no correction.
vec3 stepped(ivec2 at) {
  float diagonal = texelFetch(u_grid, at, 0).a;
  return diagonal > 0.0 ? ${DAMPING} * texelFetch(u_r, at, 0).rgb / diagonal : vec3(0.0);
}
void main() {
  ivec2 size = textureSize(u_r, 0);
  o_r = vec4(0.0);
  for (int k = 0; k < 4; k++) {
    ivec2 at = 2 * ivec2(gl_FragCoord.xy) + ivec2(k & 1, k >> 1);
    if (any(greaterThanEqual(at, size))) continue;
    vec4 grid = texelFetch(u_grid, at, 0);
    if (grid.a <= 0.0) continue;
    vec3 own = stepped(at);
    o_r.rgb += texelFetch(u_r, at, 0).rgb - grid.b * own;
    for (int side = 0; side < 4; side++) {
      float weight = link(u_grid, grid, at, side);
      if (weight > 0.0) o_r.rgb += weight * (stepped(at + SIDES[side]) - own);
    }
  }
}`;

const CORRECT = `
uniform sampler2D u_r, u_grid, u_coarser, u_x;
uniform bool u_coarsest, u_onto;   // u_onto: added to x
out vec4 o_e;
${NEIGHBOURS_GLSL}
vec3 corrected(ivec2 at) {
  float diagonal = texelFetch(u_grid, at, 0).a;
  if (diagonal <= 0.0) return vec3(0.0);
  vec3 e = ${DAMPING} * texelFetch(u_r, at, 0).rgb / diagonal;
  return u_coarsest ? e : e + texelFetch(u_coarser, at / 2, 0).rgb;
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  o_e = u_onto ? texelFetch(u_x, at, 0) : vec4(0.0);
  vec4 grid = texelFetch(u_grid, at, 0);
  if (grid.a <= 0.0) return;
  if (u_coarsest) {
    o_e.rgb += texelFetch(u_r, at, 0).rgb / grid.a;
    return;
  }
  vec3 own = corrected(at);
  vec3 missing = texelFetch(u_r, at, 0).rgb - grid.b * own;
  for (int side = 0; side < 4; side++) {
    float weight = link(u_grid, grid, at, side);
    if (weight > 0.0) missing += weight * (corrected(at + SIDES[side]) - own);
  }
  o_e.rgb += own + ${DAMPING} * missing / grid.a;
}`;

const CHANGE = `
uniform usampler2D u_shown;
uniform sampler2D u_x, u_given;
uniform float u_epsilon, u_share;
out vec4 o_change;
${FRAGMENT_GLSL}
${PLACE_GLSL}
${BEFORE_GLSL}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 given = texelFetch(u_given, at, 0);
  o_change = vec4(0.0);
  if (given.a > ${EMPTY}.0 - 0.5) return;
  vec3 change = given.a < 0.5 ? texelFetch(u_x, at, 0).rgb : given.rgb;
  vec4 old = changeBefore(placeOf(at, uintBitsToFloat(texelFetch(u_shown, at, 0).r)), u_epsilon);
  o_change = vec4(old.a > 0.0 ? mix(old.rgb, change, u_share) : change, 1.0);
}`;

export class Levelling {
  constructor(gl, counts, told) {
    Object.assign(this, { gl, counts, told });
    const texts = { given: GIVEN, begin: BEGIN, finest: FINEST, coarser: COARSER, residual: RESIDUAL, restrict: RESTRICT, correct: CORRECT, change: CHANGE };
    this.passes = Object.fromEntries(Object.entries(texts).map(([name, text]) => [name, new Pass(gl, text)]));
  }

  resize(width, height) {
    this.#free();
    const { gl, counts } = this;
    const made = (w, h, formats = ["RGBA16F"]) => new Target(gl, counts, formats, w, h);
    const levels = [];
    for (let [w, h] = [width, height]; ; [w, h] = [Math.ceil(w / 2), Math.ceil(h / 2)]) {
      levels.push({ grid: made(w, h), r: made(w, h), e: levels.length ? made(w, h) : null });
      if (w === 1 && h === 1) break;
    }
    this.targets = {
      levels,
      given: made(width, height, ["RGBA16F", "RGBA16F"]),
      x: [made(width, height), made(width, height)],
      changes: [made(width, height), made(width, height)],
    };
    this.before = null;
  }

  /** The change as it is applied, RGBA16F. */
  get change() {
    return this.targets.changes[0];
  }

  /** A new picture: fragments, own colours and neighbours' of `colors`, seen by a view. */
  begin(shown, colors, view) {
    const { gl, told, passes, targets } = this;
    const [own, others] = colors.sheets.map(({ texture }) => texture);
    let uniforms = passes.given.begin(targets.given, { u_shown: shown.texture, u_own: own, u_others: others });
    gl.uniform1f(uniforms.u_epsilon, told.epsilon);
    passes.given.end();
    const [given, seam] = targets.given.sheets.map(({ texture }) => texture);
    uniforms = passes.begin.begin(targets.x[0], {
      u_shown: shown.texture, u_own: own, u_given: given, u_seam: seam, ...this.#old(shown),
    });
    gl.uniform1f(uniforms.u_epsilon, told.epsilon);
    gl.uniform1i(uniforms.u_radius, told.seam_radius);
    this.#seen(uniforms, view, targets.x[0]);
    passes.begin.end();
    passes.finest.run(targets.levels[0].grid, { u_x: targets.x[0].texture });
    targets.levels.slice(1).forEach((level, k) => passes.coarser.run(level.grid, { u_grid: targets.levels[k].grid.texture }));
  }

  /** Improve the solution, and take it over: wholly, or smoothly from the picture before. */
  solve(shown, view, cycles, wholly) {
    for (let k = 0; k < cycles; k++) this.#cycle();
    const { gl, told, passes, targets } = this;
    const [now, next] = targets.changes;
    const uniforms = passes.change.begin(next, {
      u_shown: shown.texture, u_x: targets.x[0].texture, u_given: targets.given.texture, ...this.#old(shown),
    });
    gl.uniform1f(uniforms.u_epsilon, told.epsilon);
    gl.uniform1f(uniforms.u_share, wholly ? 1 : NEW_SHARE);
    this.#seen(uniforms, view, next);
    passes.change.end();
    targets.changes = [next, now];
    this.before = { shown, clip: new Float32Array(view.clip) };
  }

  #cycle() {
    const { passes, targets } = this;
    const { levels, x } = targets;
    passes.residual.run(levels[0].r, { u_x: x[0].texture, u_grid: levels[0].grid.texture });
    for (let k = 0; k + 1 < levels.length; k++) {
      passes.restrict.run(levels[k + 1].r, { u_r: levels[k].r.texture, u_grid: levels[k].grid.texture });
    }
    for (let k = levels.length - 1; k >= 0; k--) {
      const coarser = levels[k + 1]?.e ?? null;
      const uniforms = passes.correct.begin(k ? levels[k].e : x[1], {
        u_r: levels[k].r.texture, u_grid: levels[k].grid.texture, u_coarser: coarser?.texture ?? null, u_x: k ? null : x[0].texture,
      });
      this.gl.uniform1i(uniforms.u_coarsest, coarser ? 0 : 1);
      this.gl.uniform1i(uniforms.u_onto, k ? 0 : 1);
      passes.correct.end();
    }
    targets.x = [x[1], x[0]];
  }

  #old(shown) {
    return { u_shownBefore: (this.before?.shown ?? shown).texture, u_changeBefore: this.change.texture };
  }

  #seen(uniforms, view, size) {
    const { gl, before } = this;
    gl.uniform1i(uniforms.u_any, before ? 1 : 0);
    gl.uniformMatrix4fv(uniforms.u_before, false, before?.clip ?? new Float32Array(16));
    setPlace(gl, uniforms, view, size);
  }

  #free() {
    if (!this.targets) return;
    const { levels, given, x, changes } = this.targets;
    levels.forEach(({ grid, r, e }) => [grid, r, e].forEach((target) => target?.dispose()));
    [given, ...x, ...changes].forEach((target) => target.dispose());
    this.targets = null;
  }

  dispose() {
    this.#free();
    Object.values(this.passes).forEach((pass) => pass.dispose());
  }
}
