// Depth meshes and photographs, stitched in the picture (Arikan et al. 2014, section 6): visibility,
// image management, stitching, texturing and levelling.

import { LOOK_GLSL, setLook } from "../shading.js";
import { SourceError } from "../source.js";
import { Choice } from "./stitch_choice.js";
import { COLOR_GLSL, Levelling } from "./stitch_levelling.js";
import { Meshes } from "./stitch_meshes.js";
import { Histogram, Photos } from "./stitch_photos.js";
import { FRAGMENT_GLSL, PLACE_GLSL, Pass, Target, setPlace } from "./stitch_screen.js";
import { Texturing } from "./stitch_texturing.js";

// What all pictures of a screen take for each of its pixels, and how much of the budget they may.
const BYTES_OF_PIXEL = 193;
const SCREEN_SHARE = 0.6;
// A camera that rests lets the levelling settle for so many pictures, of so many cycles.
const SETTLING = 6;
const CYCLES = 2;
// While meshes and photographs come, pictures are made anew when there are so many times as many.
const MORE = 2;
const SLOW_MS = 80;

const OVERLAYS = [
  { key: "color", label: "Photographs", number: 0 },
  { key: "unlevelled", label: "Without levelling", number: 1 },
  { key: "label", label: "Which photograph", number: 2 },
];

const FINISHED = (levelled) => `
uniform usampler2D u_shown;
uniform sampler2D u_own;
${levelled ? "uniform sampler2D u_change;" : ""}
uniform vec2 u_scale;      // of the picture to what is drawn to
uniform int u_overlay;
uniform vec2 u_projection; // of depth
out vec4 o_color;
${FRAGMENT_GLSL}
${COLOR_GLSL}
${PLACE_GLSL}
${LOOK_GLSL}
// How the surface goes on from a pixel to that side where it is nearer by depth.
vec3 along(ivec2 at, ivec2 way, vec3 place, float deep) {
  vec3 best = vec3(0.0);
  float least = 3e38;
  for (int side = -1; side < 2; side += 2) {
    ivec2 one = at + side * way;
    if (min(one.x, one.y) < 0 || any(greaterThanEqual(one, textureSize(u_shown, 0)))) continue;
    uvec4 f = texelFetch(u_shown, one, 0);
    float away = abs(uintBitsToFloat(f.x) - deep);
    if (!isThere(f) || away >= least) continue;
    least = away;
    best = float(side) * (placeOf(one, uintBitsToFloat(f.x)) - place);
  }
  return best;
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy * u_scale);
  uvec4 f = texelFetch(u_shown, at, 0);
  if (!isThere(f)) discard;
  float deep = uintBitsToFloat(f.x);
  vec4 bare = bareColor(u_own, f, at);
  vec3 c = bare.rgb;
  ${levelled ? "if (u_overlay == 0) c += texelFetch(u_change, at, 0).rgb;" : ""}
  if (u_overlay == 2) {
    float turn = bare.a > 0.5 ? 2.39996 * float(labelOf(f.y)) : 0.0;
    c = bare.a > 0.5 ? 0.6 + 0.35 * cos(turn + vec3(0.0, 2.0944, 4.1888)) : vec3(0.6);
  }
  if (u_ambient < 1.0) {
    vec3 place = placeOf(at, deep);
    vec3 n = cross(along(at, ivec2(1, 0), place, deep), along(at, ivec2(0, 1), place, deep));
    if (dot(n, u_eye - place) < 0.0) n = -n;
    c = encoded(lit(decoded(clamp(c, 0.0, 1.0)), n, place));
  }
  o_color = vec4(clamp(c, 0.0, 1.0), 1.0);
  gl_FragDepth = 0.5 * (u_projection.y / deep - u_projection.x) + 0.5;
}`;

/** Open the stitched patches of an entry of the scene. */
export async function open(context, entry) {
  const { network } = context;
  const told = await network.json(entry.file);
  if (told.version !== 2) throw new SourceError("The page and its data are of different versions. Publish it again.");
  return new Stitched(context, entry, told);
}

class Stitched {
  constructor(context, entry, told) {
    Object.assign(this, { context, told, overlays: OVERLAYS });
    const { gl, counts } = context;
    const shift = told.from_positions.map((value, k) => value - context.origin[k]);
    this.levelled = Boolean(gl.getExtension("EXT_color_buffer_float") ?? gl.getExtension("EXT_color_buffer_half_float"));
    if (!this.levelled) {
      context.tell("This graphics card draws no pictures of floating-point numbers: borders between photographs are not levelled.");
    }
    const bulk = entry.file.replace(/[^/]*$/, told.file);
    this.meshes = new Meshes(context, context.source(bulk), told.meshes, shift);
    this.photos = new Photos(context, told.photos, entry.file);
    this.histogram = new Histogram(gl, counts);
    this.choice = new Choice(gl, counts, told, shift);
    this.texturing = new Texturing(gl, told, shift, this.levelled);
    this.levelling = this.levelled ? new Levelling(gl, counts, told) : null;
    this.finished = new Pass(gl, FINISHED(this.levelled));
    this.items = this.meshes.triangles;
    this.place = "";
    this.seen = "";
    this.quick = false;
    this.triangles = 0;
    this.drawn = 0;
    this.textured = 0;
    this.came = false;
    this.counted = true;
    this.rest = 0;
    this.size = "";
    this.meshes.load();
  }

  get #coming() {
    return this.quick || this.came || this.meshes.pending || this.photos.pending || this.histogram.pending || !this.counted;
  }

  get pending() {
    return this.#coming || (this.levelled && this.rest < SETTLING);
  }

  draw(view, look) {
    const { gl, counts } = this.context;
    const out = gl.getParameter(gl.DRAW_FRAMEBUFFER_BINDING);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    this.#fit(view, look);
    this.meshes.upload(look.budgetBytes - counts.bytes);
    this.meshes.load();
    const place = JSON.stringify([[...view.clip], look.section, this.size]);
    // A slow card shows the best of each pixel alone while the camera moves.
    const quick = this.place !== "" && place !== this.place && this.histogram.tookMs > SLOW_MS;
    this.place = place;
    const seen = `${place} ${quick}`;
    const moved = seen !== this.seen || this.#grown();
    if (moved) {
      Object.assign(this, { seen, quick });
      this.drawn = this.meshes.there;
      // The picture before is still needed to smooth over time.
      this.shown = [this.shown[1], this.shown[0]];
      this.triangles = this.choice.draw(this.meshes, view, look, this.shown[0], quick);
      this.counted = false;
    }
    if (!this.counted && !this.histogram.pending) {
      this.histogram.ask(this.shown[0]);
      this.counted = true;
    }
    const room = look.budgetBytes - (counts.bytes - this.photos.bytes);
    const pixels = this.histogram.answer();
    if (pixels) this.photos.want(pixels, room);
    this.came = this.photos.step(room) || this.came;
    const { loaded, pending } = this.photos;
    if (moved || (this.came && (!pending || loaded.size >= MORE * this.textured || loaded.size < this.textured))) {
      this.came = false;
      this.textured = loaded.size;
      this.texturing.draw(this.shown[0], view, this.photos.loaded, this.colors);
      this.levelling?.begin(this.shown[0], this.colors, view);
      this.rest = 0;
    }
    // What is still to change is not settled.
    if (this.levelling && this.rest < (this.#coming ? 1 : SETTLING)) {
      this.rest += 1;
      this.levelling.solve(this.shown[0], view, CYCLES, this.rest === SETTLING);
    }
    this.#finish(out, view, look);
    counts.items += this.triangles;
  }

  /** Whether so many meshes came that a new picture pays, or the last. */
  #grown() {
    const { there, pending } = this.meshes;
    return there > this.drawn && (!pending || there >= MORE * this.drawn);
  }

  /** Pictures of the screen's size, or smaller where they would take too much of the budget. */
  #fit(view, look) {
    const most = (SCREEN_SHARE * look.budgetBytes) / BYTES_OF_PIXEL;
    const scale = Math.min(1, Math.sqrt(most / (view.width * view.height)));
    const [width, height] = [view.width, view.height].map((side) => Math.max(1, Math.floor(scale * side)));
    const size = `${width} ${height}`;
    if (size === this.size) return;
    this.size = size;
    this.#free();
    const { gl, counts } = this.context;
    const made = (formats) => new Target(gl, counts, formats, width, height);
    this.shown = [made(["RGBA32UI"]), made(["RGBA32UI"])];
    this.colors = made(this.levelled ? ["RGBA16F", "RGBA16F"] : ["RGBA8"]);
    this.choice.resize(width, height);
    this.histogram.resize(width, height);
    this.levelling?.resize(width, height);
    this.rest = 0;
  }

  #finish(framebuffer, view, look) {
    const { gl } = this.context;
    const [shown, size] = [this.shown[0], { width: view.width, height: view.height }];
    const target = {
      bind: () => {
        gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
        gl.viewport(0, 0, size.width, size.height);
      },
    };
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    const uniforms = this.finished.begin(target, {
      u_shown: shown.texture, u_own: this.colors.texture, ...(this.levelled && { u_change: this.levelling.change.texture }),
    });
    setLook(gl, uniforms, view, look);
    setPlace(gl, uniforms, view, shown);
    gl.uniform2f(uniforms.u_scale, shown.width / size.width, shown.height / size.height);
    gl.uniform1i(uniforms.u_overlay, (OVERLAYS.find(({ key }) => key === look.overlay) ?? OVERLAYS[0]).number);
    gl.uniform2f(uniforms.u_projection, view.projection[10], view.projection[14]);
    this.finished.end();
  }

  #free() {
    if (!this.shown) return;
    [...this.shown, this.colors].forEach((target) => target.dispose());
    this.shown = null;
  }

  dispose() {
    this.#free();
    [this.meshes, this.photos, this.histogram, this.choice, this.texturing, this.levelling, this.finished].forEach((part) => part?.dispose());
  }
}
