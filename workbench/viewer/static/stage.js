// The picture: one representation at a time, drawn when something changed or is still to come.

import { Counts, contextOf, program } from "./gpu.js";
import { BACKGROUND } from "./shading.js";
import { Source } from "./source.js";
import { inverse, projected } from "./vectors.js";

const QUAD = `
void main() { gl_Position = vec4(vec2(gl_VertexID % 2, gl_VertexID / 2) * 4.0 - 1.0, 0.0, 1.0); }`;
const DEPTH_BYTES = `
uniform sampler2D u_depth;
uniform ivec2 u_pixel;
out vec4 o_bytes;
void main() {
  uint d = uint(texelFetch(u_depth, u_pixel, 0).r * 16777215.0 + 0.5);
  o_bytes = vec4(d & 255u, (d >> 8) & 255u, (d >> 16) & 255u, 255u) / 255.0;
}`;
const MODES = {
  mesh: () => import("./modes/mesh.js"),
  voxels: () => import("./modes/voxels.js"),
  ssvdag: () => import("./modes/ssvdag.js"),
  surfels: () => import("./modes/surfels.js"),
  stitched: () => import("./modes/stitched.js"),
  cloud: () => import("./modes/cloud.js"),
};

/** Frame times in milliseconds of the last pictures. */
class Clock {
  constructor() {
    this.times = [];
  }

  took(ms) {
    this.times.push(ms);
    if (this.times.length > 120) this.times.shift();
  }

  get median() {
    const sorted = [...this.times].sort((a, b) => a - b);
    return sorted.length ? sorted[sorted.length >> 1] : 0;
  }
}

export class Stage {
  /** scene as read from scene.json; tell(message) shows a failure; drawn() is called after frames. */
  constructor(canvas, scene, camera, network, { tell, drawn }) {
    this.canvas = canvas;
    this.gl = contextOf(canvas);
    this.scene = scene;
    this.camera = camera;
    this.network = network;
    this.tell = tell;
    this.drawn = drawn;
    this.counts = new Counts();
    this.clock = new Clock();
    this.mode = null;
    this.entry = null;
    this.opening = 0;
    this.look = {
      light: [0, 0, 1], lit: true, headlight: true, overlay: "color",
      section: [0, 0, 0, 1], pixelError: 1, foveated: false, budgetBytes: 512 << 20,
    };
    this.asked = false;
    this.started = performance.now();
    this.firstPicture = null;
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.mode = null;
      tell("The graphics card gave up the picture. Reload the page.");
    });
    new ResizeObserver(() => this.redraw()).observe(canvas);
  }

  /** Show an entry of the scene; what is shown stays until the other can be drawn. */
  async show(entry) {
    const number = ++this.opening;
    const context = {
      gl: this.gl,
      counts: this.counts,
      network: this.network,
      origin: this.scene.origin,
      source: (file) => new Source(this.network, file),
      redraw: () => this.redraw(),
      tell: this.tell,
    };
    try {
      const { open } = await MODES[entry.kind]();
      const mode = await open(context, entry);
      if (number !== this.opening) {
        mode.dispose();
        return;
      }
      this.mode?.dispose();
      this.mode = mode;
      this.entry = entry;
      this.clock.times = [];
    } catch (error) {
      if (number === this.opening) this.tell(error.message);
    }
    this.redraw();
  }

  /** Draw soon. */
  redraw() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.frame();
    });
  }

  get pending() {
    return Boolean(this.mode?.pending) || !this.network.idle;
  }

  /** Draw now. */
  frame() {
    const { gl, canvas } = this;
    const start = performance.now();
    const share = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(canvas.clientWidth * share));
    const height = Math.max(1, Math.round(canvas.clientHeight * share));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    this.counts.startFrame();
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    this.#draw(this.camera.view(width, height));
    if (this.mode) {
      this.firstPicture ??= performance.now() - this.started;
      this.clock.took(performance.now() - start);
      if (this.mode.pending) this.redraw();
    }
    this.drawn();
  }

  #draw(view) {
    const { gl } = this;
    gl.viewport(0, 0, view.width, view.height);
    gl.clearColor(...BACKGROUND, 1);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    try {
      this.mode?.draw(view, this.look);
    } catch (error) {
      this.mode = null;
      this.tell(error.message);
    }
  }

  /** The place [x, y, z] shown at a pixel of the page, null where nothing is. */
  placeAt(x, y) {
    const { gl, canvas } = this;
    if (!this.mode) return null;
    const [width, height] = [canvas.width, canvas.height];
    const pixel = [Math.floor((x / canvas.clientWidth) * width), height - 1 - Math.floor((y / canvas.clientHeight) * height)];
    const [color, depth] = [gl.createTexture(), gl.createTexture()];
    const target = gl.createFramebuffer();
    const texture = (name, internal, format, type, attachment) => {
      gl.bindTexture(gl.TEXTURE_2D, name);
      gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, format, type, null);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, attachment, gl.TEXTURE_2D, name, 0);
    };
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    texture(color, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, gl.COLOR_ATTACHMENT0);
    texture(depth, gl.DEPTH_COMPONENT24, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT, gl.DEPTH_ATTACHMENT);
    // What is drawn to must not be read from, too.
    gl.bindTexture(gl.TEXTURE_2D, null);
    const view = this.camera.view(width, height);
    this.#draw(view);
    this.pickProgram ??= program(gl, QUAD, DEPTH_BYTES);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, null, 0);
    gl.disable(gl.DEPTH_TEST);
    gl.viewport(0, 0, 1, 1);
    gl.useProgram(this.pickProgram.program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, depth);
    gl.uniform1i(this.pickProgram.uniforms.u_depth, 0);
    gl.uniform2i(this.pickProgram.uniforms.u_pixel, ...pixel);
    gl.bindVertexArray(null);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    const bytes = new Uint8Array(4);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(target);
    gl.deleteTexture(color);
    gl.deleteTexture(depth);
    this.redraw();
    const stored = (bytes[0] + 256 * bytes[1] + 65536 * bytes[2]) / 16777215;
    if (stored >= 1) return null;
    const at = [(2 * (pixel[0] + 0.5)) / width - 1, (2 * (pixel[1] + 0.5)) / height - 1, 2 * stored - 1];
    return projected(inverse(view.clip), at).slice(0, 3);
  }
}
