// Where rays end, pixel by pixel: roughly at once, then finely strip by strip while the camera rests.

const [FEWEST_MS, MOST_MS] = [30, 90];
const ROUGHEST = 8;
const BYTES_PER_PIXEL = 8 + 4;
/** Pixels around one that its normal is taken from, on every side. */
const REACH = 12;

/** Two pictures of what rays met and of its light, and how far the fine one is. */
export class TracedScreen {
  /**
   * trace(pixel) draws a ray for every pixel of what is drawn to, `pixel` being its side;
   * shade(pixel, met) their light from the texture of what they met.
   */
  constructor(gl, counts, { trace, shade }) {
    Object.assign(this, { gl, counts, trace, shade });
    const picture = () => ({
      met: gl.createTexture(), light: gl.createTexture(),
      tracing: gl.createFramebuffer(), shading: gl.createFramebuffer(),
      width: 0, height: 0,
    });
    this.pictures = [picture(), picture()];
    [this.fine, this.rough] = this.pictures;
    this.traced = 0;
    this.key = "";
    this.rows = 0;
    this.strip = 16;
    this.roughness = 4;
    this.running = null;
    this.bytes = 0;
  }

  /** Whether more is to come. */
  get pending() {
    return this.running !== null || this.rows < this.fine.height;
  }

  /** Trace what a frame allows of a view that the key tells. */
  update(key, width, height) {
    const { gl } = this;
    this.#answer();
    if (key === this.key && this.running) return;
    const before = gl.getParameter(gl.DRAW_FRAMEBUFFER_BINDING);
    gl.disable(gl.DEPTH_TEST);
    if (key !== this.key) {
      // The camera is faster than the card.
      if (this.running?.kind === "rough") this.#roughen();
      this.key = key;
      this.rows = this.traced = 0;
      this.#shape(this.fine, width, height);
      this.#takeRough(width, height);
    } else if (this.rows < height) this.#takeStrip(height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, before);
    gl.viewport(0, 0, width, height);
    gl.enable(gl.DEPTH_TEST);
  }

  #takeRough(width, height) {
    const { rough, roughness } = this;
    this.#shape(rough, Math.ceil(width / roughness), Math.ceil(height / roughness));
    this.shownRoughness = roughness;
    this.#draw(rough, rough.tracing, 0, rough.height, () => this.trace(roughness));
    this.#draw(rough, rough.shading, 0, rough.height, () => this.shade(roughness, rough.met));
    this.#begin("rough", 0);
  }

  /** Normals need what is around a pixel: light follows some rows after. */
  #takeStrip(height) {
    const { fine } = this;
    const to = Math.min(this.traced + this.strip, height);
    const lit = to === height ? height : Math.max(this.rows, to - REACH);
    this.#draw(fine, fine.tracing, this.traced, to, () => this.trace(1));
    this.#draw(fine, fine.shading, this.rows, lit, () => this.shade(1, fine.met));
    this.traced = to;
    this.#begin("strip", lit);
  }

  #draw(picture, target, from, to, draw) {
    const { gl } = this;
    if (to <= from) return;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(0, 0, picture.width, picture.height);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, from, picture.width, to - from);
    draw();
    gl.disable(gl.SCISSOR_TEST);
  }

  #begin(kind, rows) {
    const { gl } = this;
    if (this.running) gl.deleteSync(this.running.fence);
    this.running = { kind, rows, fence: gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0), since: performance.now(), key: this.key };
    gl.flush();
  }

  /** Learn from how long the last part took. */
  #answer() {
    const { gl, running } = this;
    if (!running || gl.clientWaitSync(running.fence, 0, 0) === gl.TIMEOUT_EXPIRED) return;
    gl.deleteSync(running.fence);
    this.running = null;
    const took = performance.now() - running.since;
    if (running.kind === "strip") {
      if (running.key === this.key) this.rows = running.rows;
      if (took < FEWEST_MS) this.strip *= 2;
      else if (took > MOST_MS) this.strip = Math.max(8, this.strip >> 1);
    } else if (took < FEWEST_MS) this.roughness = Math.max(1, this.roughness / 2);
    else if (took > MOST_MS) this.#roughen();
  }

  #roughen() {
    this.roughness = Math.min(ROUGHEST, this.roughness * 2);
  }

  #shape(picture, width, height) {
    if (picture.width === width && picture.height === height) return;
    const { gl } = this;
    Object.assign(picture, { width, height });
    gl.activeTexture(gl.TEXTURE0);
    for (const [texture, target, internal, format, type] of [
      [picture.met, picture.tracing, gl.RG32UI, gl.RG_INTEGER, gl.UNSIGNED_INT],
      [picture.light, picture.shading, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE],
    ]) {
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, format, type, null);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      gl.bindFramebuffer(gl.FRAMEBUFFER, target);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    }
    gl.bindTexture(gl.TEXTURE_2D, null);
    const bytes = this.pictures.reduce((sum, one) => sum + one.width * one.height * BYTES_PER_PIXEL, 0);
    this.counts.bytes += bytes - this.bytes;
    this.bytes = bytes;
  }

  dispose() {
    const { gl } = this;
    if (this.running) gl.deleteSync(this.running.fence);
    for (const { met, light, tracing, shading } of this.pictures) {
      [met, light].forEach((texture) => gl.deleteTexture(texture));
      [tracing, shading].forEach((target) => gl.deleteFramebuffer(target));
    }
    this.counts.bytes -= this.bytes;
  }
}
