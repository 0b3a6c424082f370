// Pictures that discs are mixed in: where several lie on one surface, all of them count.

import { program } from "../gpu.js";

const BYTES_PER_PIXEL = 8 + 4;

const VERTEX = `
void main() { gl_Position = vec4(vec2(gl_VertexID % 2, gl_VertexID / 2) * 4.0 - 1.0, 0.0, 1.0); }`;

const FRAGMENT = `
uniform sampler2D u_sums;   // linear colour times weight, weight
uniform sampler2D u_front;
out vec4 o_color;
vec3 encoded(vec3 linear) {
  vec3 c = clamp(linear, 0.0, 1.0);
  return mix(1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, 12.92 * c, lessThanEqual(c, vec3(0.0031308)));
}
void main() {
  vec4 sums = texelFetch(u_sums, ivec2(gl_FragCoord.xy), 0);
  if (sums.a <= 0.0) discard;
  gl_FragDepth = texelFetch(u_front, ivec2(gl_FragCoord.xy), 0).r;
  o_color = vec4(encoded(sums.rgb / sums.a), 1.0);
}`;

/** A picture of depths and one of sums, as large as what is drawn to; null where the card has none. */
export class MixingScreen {
  static of(gl, counts) {
    return gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float")
      ? new MixingScreen(gl, counts)
      : null;
  }

  constructor(gl, counts) {
    this.gl = gl;
    this.counts = counts;
    this.finish = program(gl, VERTEX, FRAGMENT);
    this.empty = gl.createVertexArray();
    [this.front, this.sums] = [gl.createTexture(), gl.createTexture()];
    [this.near, this.mixed] = [gl.createFramebuffer(), gl.createFramebuffer()];
    [this.width, this.height] = [0, 0];
  }

  get bytes() {
    return this.width * this.height * BYTES_PER_PIXEL;
  }

  /** Draw the nearest discs, then mix all that lie with them, then bring the mixture where it goes. */
  draw(width, height, discs) {
    const { gl } = this;
    const target = gl.getParameter(gl.DRAW_FRAMEBUFFER_BINDING);
    if (width !== this.width || height !== this.height) this.#resize(width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.near);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    discs("nearest");
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.mixed);
    gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    this.#bind(0, this.front);
    discs("mixed");
    gl.disable(gl.BLEND);
    gl.enable(gl.DEPTH_TEST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.useProgram(this.finish.program);
    this.#bind(1, this.sums);
    gl.uniform1i(this.finish.uniforms.u_front, 0);
    gl.uniform1i(this.finish.uniforms.u_sums, 1);
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    // Neither may be bound when it is drawn to again.
    this.#bind(1, null);
    this.#bind(0, null);
  }

  #bind(slot, texture) {
    this.gl.activeTexture(this.gl.TEXTURE0 + slot);
    this.gl.bindTexture(this.gl.TEXTURE_2D, texture);
  }

  #resize(width, height) {
    const { gl } = this;
    this.counts.bytes += width * height * BYTES_PER_PIXEL - this.bytes;
    [this.width, this.height] = [width, height];
    const shaped = (texture, internal, format, type) => {
      this.#bind(0, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, format, type, null);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    };
    shaped(this.front, gl.DEPTH_COMPONENT24, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT);
    shaped(this.sums, gl.RGBA16F, gl.RGBA, gl.HALF_FLOAT);
    this.#bind(0, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.near);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.front, 0);
    gl.drawBuffers([gl.NONE]);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.mixed);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.sums, 0);
  }

  dispose() {
    const { gl } = this;
    [this.front, this.sums].forEach((texture) => gl.deleteTexture(texture));
    [this.near, this.mixed].forEach((target) => gl.deleteFramebuffer(target));
    gl.deleteVertexArray(this.empty);
    gl.deleteProgram(this.finish.program);
    this.counts.bytes -= this.bytes;
  }
}
