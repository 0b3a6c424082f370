// Pictures that passes draw to and read from, and passes over all of their pixels.

import { program } from "../gpu.js";

const ALL = `
void main() { gl_Position = vec4(vec2(gl_VertexID % 2, gl_VertexID / 2) * 4.0 - 1.0, 0.0, 1.0); }`;

/** Samplers of all that is drawn to are exact. */
export const PRECISE = `
precision highp sampler2D;
precision highp usampler2D;
`;

// Name → internal format, format, type and bytes of a pixel.
const FORMATS = {
  RG32UI: ["RG32UI", "RG_INTEGER", "UNSIGNED_INT", 8],
  RGBA32UI: ["RGBA32UI", "RGBA_INTEGER", "UNSIGNED_INT", 16],
  RGBA16F: ["RGBA16F", "RGBA", "HALF_FLOAT", 8],
  RGBA8: ["RGBA8", "RGBA", "UNSIGNED_BYTE", 4],
  DEPTH: ["DEPTH_COMPONENT24", "DEPTH_COMPONENT", "UNSIGNED_INT", 4],
};

/** A texture of a screen's size, counted. */
class Sheet {
  constructor(gl, counts, format, width, height) {
    const [internal, kind, type, bytes] = FORMATS[format];
    Object.assign(this, { gl, counts, format, width, height, bytes: bytes * width * height });
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl[internal], width, height, 0, gl[kind], gl[type], null);
    for (const name of ["TEXTURE_MIN_FILTER", "TEXTURE_MAG_FILTER"]) gl.texParameteri(gl.TEXTURE_2D, gl[name], gl.NEAREST);
    for (const name of ["TEXTURE_WRAP_S", "TEXTURE_WRAP_T"]) gl.texParameteri(gl.TEXTURE_2D, gl[name], gl.CLAMP_TO_EDGE);
    gl.bindTexture(gl.TEXTURE_2D, null);
    counts.bytes += this.bytes;
  }

  dispose() {
    this.gl.deleteTexture(this.texture);
    this.counts.bytes -= this.bytes;
  }
}

/** What a pass draws to: pictures of some formats, with a depth of its own or another's. */
export class Target {
  constructor(gl, counts, formats, width, height, depth = null) {
    Object.assign(this, { gl, width, height });
    this.framebuffer = gl.createFramebuffer();
    this.sheets = formats.map((format) => new Sheet(gl, counts, format, width, height));
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    const attach = (place, sheet) => gl.framebufferTexture2D(gl.FRAMEBUFFER, place, gl.TEXTURE_2D, sheet.texture, 0);
    const colors = this.sheets.filter(({ format }) => format !== "DEPTH");
    colors.forEach((sheet, k) => attach(gl.COLOR_ATTACHMENT0 + k, sheet));
    const own = this.sheets.find(({ format }) => format === "DEPTH") ?? depth?.sheets.find(({ format }) => format === "DEPTH");
    if (own) attach(gl.DEPTH_ATTACHMENT, own);
    gl.drawBuffers(colors.length ? colors.map((_, k) => gl.COLOR_ATTACHMENT0 + k) : [gl.NONE]);
  }

  get texture() {
    return this.sheets[0].texture;
  }

  bind() {
    this.gl.bindFramebuffer(this.gl.FRAMEBUFFER, this.framebuffer);
    this.gl.viewport(0, 0, this.width, this.height);
  }

  dispose() {
    this.gl.deleteFramebuffer(this.framebuffer);
    this.sheets.forEach((sheet) => sheet.dispose());
  }
}

/** Give textures by the names of their samplers to the program in use, from a unit on. */
export function bindAll(gl, uniforms, textures, first = 0) {
  Object.entries(textures).forEach(([name, texture], k) => {
    gl.activeTexture(gl.TEXTURE0 + first + k);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.uniform1i(uniforms[name], first + k);
  });
}

/** A program that computes every pixel of what is drawn to. */
export class Pass {
  constructor(gl, fragment) {
    this.gl = gl;
    Object.assign(this, program(gl, ALL, PRECISE + fragment));
  }

  /** Begin: the target, textures by sampler; uniforms are then set by the caller. */
  begin(target, textures) {
    const { gl } = this;
    target.bind();
    gl.useProgram(this.program);
    bindAll(gl, this.uniforms, textures);
    return this.uniforms;
  }

  end() {
    this.gl.bindVertexArray(null);
    this.gl.drawArrays(this.gl.TRIANGLES, 0, 3);
  }

  run(target, textures) {
    this.begin(target, textures);
    this.end();
  }

  dispose() {
    this.gl.deleteProgram(this.program);
  }
}

/** To be put before shaders that ask where the surface in a pixel is. */
export const PLACE_GLSL = `
uniform vec3 u_from;   // the eye
uniform mat3 u_axes;   // right and up for half the picture, and forward
uniform vec2 u_size;   // of the picture, pixels
vec3 placeOf(ivec2 at, float deep) {
  vec2 share = (2.0 * (vec2(at) + 0.5)) / u_size - 1.0;
  return u_from + deep * (u_axes * vec3(share, 1.0));
}`;

/** Set what PLACE_GLSL asks for, for a picture of a view of so many pixels. */
export function setPlace(gl, uniforms, view, { width, height }) {
  const m = view.fromWorld;
  const [across, along] = [1 / view.projection[0], 1 / view.projection[5]];
  gl.uniform3fv(uniforms.u_from, view.eye);
  gl.uniformMatrix3fv(uniforms.u_axes, false, [
    ...[m[0], m[4], m[8]].map((c) => c * across),
    ...[m[1], m[5], m[9]].map((c) => c * along),
    -m[2], -m[6], -m[10],
  ]);
  gl.uniform2f(uniforms.u_size, width, height);
}

/** Numbers of a fragment as passes hand it on; RGBA32UI: depth, what it is, what it costs, colour. */
export const FRAGMENT_GLSL = `
const uint THERE = 0x80000000u;
bool isThere(uvec4 f) { return (f.y & THERE) != 0u; }
uint labelOf(uint what) { return what & 0x7fffu; }            // number + 1; 0 for none
uint meshOf(uint what) { return (what >> 15) & 0x1fffu; }
bool inFront(uvec4 f) { return (f.z & 0x10000u) != 0u; }      // foreground
float costOf(uvec4 f) { return float(f.z & 0xffffu); }
vec3 colorOf(uvec4 f) { return vec3(f.w & 255u, (f.w >> 8) & 255u, (f.w >> 16) & 255u) / 255.0; }
`;
