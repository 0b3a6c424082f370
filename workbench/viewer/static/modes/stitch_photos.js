// Image management: which photographs the picture needs, and which of them are on the card.

import { crc32 } from "../crc32.js";
import { Texture } from "../gpu.js";
import { SourceError } from "../source.js";
import { Pass, Target } from "./stitch_screen.js";

const STEP = 4;
const AT_ONCE = 3;

// One pixel of each square of so many, another one in each: stripes of labels are not missed.
const SAMPLED = `
uniform usampler2D u_shown;
out vec4 o_label;
void main() {
  ivec2 cell = ivec2(gl_FragCoord.xy);
  ivec2 within = ivec2(cell.x + 2 * cell.y, 3 * cell.x + cell.y) & ${STEP - 1};
  ivec2 at = min(${STEP} * cell + within, textureSize(u_shown, 0) - 1);
  uint what = texelFetch(u_shown, at, 0).g;
  o_label = vec4(what & 255u, (what >> 8) & 127u, 0u, 255u) / 255.0;
}`;

const USABLE = `
uniform sampler2D u_mask;
out vec4 o_color;
void main() { o_color = vec4(texelFetch(u_mask, ivec2(gl_FragCoord.xy), 0).r); }`;

/** How many pixels show each photograph, told a little later: nobody waits for the card. */
export class Histogram {
  constructor(gl, counts) {
    Object.assign(this, { gl, counts, pass: new Pass(gl, SAMPLED), fence: null, buffer: null, asked: 0, tookMs: 0 });
  }

  resize(width, height) {
    const { gl, counts } = this;
    this.#forget();
    this.target?.dispose();
    this.target = new Target(gl, counts, ["RGBA8"], Math.ceil(width / STEP), Math.ceil(height / STEP));
  }

  get pending() {
    return this.fence !== null;
  }

  /** Count the fragments of a picture. */
  ask(shown) {
    const { gl, target } = this;
    this.pass.run(target, { u_shown: shown.texture });
    this.buffer = gl.createBuffer();
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.buffer);
    gl.bufferData(gl.PIXEL_PACK_BUFFER, 4 * target.width * target.height, gl.STREAM_READ);
    gl.readPixels(0, 0, target.width, target.height, gl.RGBA, gl.UNSIGNED_BYTE, 0);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    this.asked = performance.now();
  }

  /** Photograph → pixels, null while it is not known yet. */
  answer() {
    const { gl, target } = this;
    if (!this.fence || gl.clientWaitSync(this.fence, 0, 0) === gl.TIMEOUT_EXPIRED) return null;
    this.tookMs = performance.now() - this.asked;
    const bytes = new Uint8Array(4 * target.width * target.height);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.buffer);
    gl.getBufferSubData(gl.PIXEL_PACK_BUFFER, 0, bytes);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    this.#forget();
    const pixels = new Map();
    for (let k = 0; k < bytes.length; k += 4) {
      const label = bytes[k] + 256 * bytes[k + 1] - 1;
      if (label >= 0) pixels.set(label, (pixels.get(label) ?? 0) + STEP * STEP);
    }
    return pixels;
  }

  #forget() {
    if (!this.fence) return;
    this.gl.deleteSync(this.fence);
    this.gl.deleteBuffer(this.buffer);
    this.fence = null;
  }

  dispose() {
    this.#forget();
    this.target?.dispose();
    this.pass.dispose();
  }
}

/** Photographs on the card; the least recently needed give way. */
export class Photos {
  /** told of stitched.json; file is the place of that file, beside which photographs lie. */
  constructor(context, told, file) {
    Object.assign(this, { context, told });
    this.folder = file.slice(0, file.lastIndexOf("/") + 1);
    this.loaded = new Map();
    this.running = new Set();
    this.ready = [];
    this.failed = new Set();
    this.wanted = [];
    this.bytes = 0;
    this.pixels = new Map();
    this.roomBytes = 0;
    this.closed = false;
    this.usable = new Pass(context.gl, USABLE);
  }

  #size(number) {
    const [width, height] = this.told[number].size;
    return 4 * width * height;
  }

  get pending() {
    return this.running.size > 0 || this.ready.length > 0 || this.#missing().length > 0;
  }

  #missing() {
    const coming = new Set([...this.running, ...this.failed, ...this.ready.map(([k]) => k)]);
    return this.wanted.filter((k) => !this.loaded.has(k) && !coming.has(k));
  }

  /** Want the most relevant photographs for which there is room. */
  want(pixels, roomBytes) {
    Object.assign(this, { pixels, roomBytes });
    let free = roomBytes;
    const order = [...pixels.keys()].filter((k) => this.told[k]?.picture).sort((a, b) => pixels.get(b) - pixels.get(a) || a - b);
    this.wanted = order.filter((k) => {
      const fits = this.#size(k) <= free;
      if (fits) free -= this.#size(k);
      return fits;
    });
    // Those needed last are at the end of the map.
    for (const k of [...this.wanted].reverse()) {
      const one = this.loaded.get(k);
      if (one) {
        this.loaded.delete(k);
        this.loaded.set(k, one);
      }
    }
    this.#ask();
  }

  #ask() {
    for (const k of this.#missing()) {
      if (this.running.size + this.ready.length >= AT_ONCE) return;
      this.#load(k);
    }
  }

  async #load(number) {
    this.running.add(number);
    const told = this.told[number];
    try {
      const largest = this.context.gl.getParameter(this.context.gl.MAX_TEXTURE_SIZE);
      if (Math.max(...told.size) > largest) throw new SourceError(`${told.picture} is larger than this graphics card takes`);
      const names = ["picture", "mask"].filter((kind) => told[kind]);
      const bitmaps = await Promise.all(names.map((kind) => this.#bitmap(told, kind)));
      if (bitmaps.some(({ width, height }) => width !== told.size[0] || height !== told.size[1])) {
        throw new SourceError(`${told.picture} is damaged: it has another size`);
      }
      this.ready.push([number, bitmaps]);
    } catch (error) {
      this.failed.add(number);
      this.context.tell(`A photograph is missing, colours of the meshes stand in for it: ${error.message}`);
    } finally {
      this.running.delete(number);
      if (!this.closed) this.context.redraw();
    }
  }

  async #bitmap(told, kind) {
    const content = await this.context.source(this.folder + told[kind]).all();
    if (crc32(new Uint8Array(content)) !== told[`${kind}_crc`]) throw new SourceError(`${told[kind]} is damaged`);
    try {
      return await createImageBitmap(new Blob([content]), { colorSpaceConversion: "none", premultiplyAlpha: "none" });
    } catch {
      throw new SourceError(`${told[kind]} is no picture this browser knows`);
    }
  }

  /** Bring at most one photograph to the card and hold the bytes below; whether any came or went. */
  step(roomBytes) {
    let changed = false;
    if (roomBytes !== this.roomBytes) this.want(this.pixels, roomBytes);
    const next = this.ready.shift();
    const needed = new Set(this.wanted);
    const goes = (bytes) => {
      for (const k of [...this.loaded.keys()].filter((one) => !needed.has(one)).concat([...this.wanted].reverse())) {
        if (this.bytes <= bytes) return;
        changed = this.#drop(k) || changed;
      }
    };
    const bytes = next && this.#size(next[0]);
    if (next && (needed.has(next[0]) ? bytes : this.bytes + bytes) <= roomBytes) {
      goes(roomBytes - bytes);
      this.#upload(...next);
      changed = true;
    }
    if (this.bytes > roomBytes) goes(0.95 * roomBytes);
    this.#ask();
    return changed;
  }

  #drop(number) {
    const one = this.loaded.get(number);
    if (!one) return false;
    one.dispose();
    this.bytes -= this.#size(number);
    return this.loaded.delete(number);
  }

  #upload(number, [picture, mask]) {
    const { gl, counts } = this.context;
    const texture = new Texture(gl, counts).picture(picture, { srgb: false, mipmaps: false });
    if (mask) {
      const told = new Texture(gl, counts).picture(mask, { srgb: false, mipmaps: false });
      const framebuffer = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture.texture, 0);
      gl.colorMask(false, false, false, true);
      const target = { bind: () => gl.viewport(0, 0, picture.width, picture.height) };
      this.usable.run(target, { u_mask: told.texture });
      gl.colorMask(true, true, true, true);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
      gl.deleteFramebuffer(framebuffer);
      told.dispose();
    }
    [picture, mask].forEach((bitmap) => bitmap?.close());
    this.loaded.set(number, texture);
    this.bytes += this.#size(number);
  }

  dispose() {
    this.closed = true;
    this.wanted = [];
    [...this.loaded.keys()].forEach((k) => this.#drop(k));
    this.usable.dispose();
  }
}
