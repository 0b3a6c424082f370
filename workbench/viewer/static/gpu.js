// WebGL2: programs that say what is wrong with them, buffers and textures whose bytes are counted.

/** Bytes that are on the GPU now, and all that ever came; drawing calls and items of a frame. */
export class Counts {
  #bytes = 0;

  constructor() {
    this.uploaded = 0;
    this.calls = 0;
    this.items = 0;
  }

  get bytes() {
    return this.#bytes;
  }

  set bytes(bytes) {
    this.uploaded += Math.max(0, bytes - this.#bytes);
    this.#bytes = bytes;
  }

  startFrame() {
    this.calls = 0;
    this.items = 0;
  }

  drew(items) {
    this.calls += 1;
    this.items += items;
  }
}

/** A context, or null where the browser has none. */
export function contextOf(canvas) {
  return canvas.getContext("webgl2", {
    antialias: true,
    alpha: false,
    depth: true,
    powerPreference: "high-performance",
    preserveDrawingBuffer: false,
  });
}

/** A linked program with the places of its uniforms; throws with the compiler's own words. */
export function program(gl, vertexText, fragmentText) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertexText], [gl.FRAGMENT_SHADER, fragmentText]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, `#version 300 es\nprecision highp float;\nprecision highp int;\n${text}`);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) {
      throw new Error(`The graphics driver refused a shader: ${gl.getShaderInfoLog(shader)}`);
    }
    gl.attachShader(made, shader);
    gl.deleteShader(shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) {
    throw new Error(`The graphics driver refused a program: ${gl.getProgramInfoLog(made)}`);
  }
  const uniforms = {};
  for (let k = 0; k < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); k++) {
    const name = gl.getActiveUniform(made, k).name;
    uniforms[name.replace(/\[0\]$/, "")] = gl.getUniformLocation(made, name);
  }
  return { program: made, uniforms };
}

/** Buffers of one vertex array, and how to give them back. */
export class VertexArray {
  constructor(gl, counts) {
    this.gl = gl;
    this.counts = counts;
    this.array = gl.createVertexArray();
    this.buffers = [];
    this.bytes = 0;
  }

  #buffer(target, data) {
    const { gl } = this;
    const buffer = gl.createBuffer();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(target, buffer);
    gl.bufferData(target, data, gl.STATIC_DRAW);
    this.buffers.push(buffer);
    this.bytes += data.byteLength;
    this.counts.bytes += data.byteLength;
  }

  /** Interleaved data; fields of [place, size, type, normalised, offset, whole numbers]. */
  vertices(data, stride, fields, divisor = 0) {
    const { gl } = this;
    this.#buffer(gl.ARRAY_BUFFER, data);
    for (const [place, size, type, normalised, offset, whole] of fields) {
      gl.enableVertexAttribArray(place);
      if (whole) gl.vertexAttribIPointer(place, size, type, stride, offset);
      else gl.vertexAttribPointer(place, size, type, normalised, stride, offset);
      gl.vertexAttribDivisor(place, divisor);
    }
    return this;
  }

  indices(data) {
    this.#buffer(this.gl.ELEMENT_ARRAY_BUFFER, data);
    return this;
  }

  bind() {
    this.gl.bindVertexArray(this.array);
  }

  dispose() {
    this.buffers.forEach((buffer) => this.gl.deleteBuffer(buffer));
    this.gl.deleteVertexArray(this.array);
    this.counts.bytes -= this.bytes;
    this.buffers = [];
    this.bytes = 0;
  }
}

/** A texture of a picture or of typed data, counted. */
export class Texture {
  constructor(gl, counts) {
    this.gl = gl;
    this.counts = counts;
    this.texture = gl.createTexture();
    this.bytes = 0;
  }

  #counted(bytes) {
    this.counts.bytes += bytes - this.bytes;
    this.bytes = bytes;
  }

  /** An image bitmap with mipmaps, sRGB-decoded by the GPU unless told otherwise. */
  picture(bitmap, { srgb = true, mipmaps = true } = {}) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
    gl.texImage2D(gl.TEXTURE_2D, 0, srgb ? gl.SRGB8_ALPHA8 : gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, mipmaps ? gl.LINEAR_MIPMAP_LINEAR : gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    if (mipmaps) gl.generateMipmap(gl.TEXTURE_2D);
    this.#counted(bitmap.width * bitmap.height * (mipmaps ? 16 / 3 : 4));
    return this;
  }

  /** Typed data, read by texelFetch. */
  data(width, height, internal, format, type, values) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, format, type, values);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    this.#counted(values ? values.byteLength : width * height * 4);
    return this;
  }

  bind(slot) {
    this.gl.activeTexture(this.gl.TEXTURE0 + slot);
    this.gl.bindTexture(this.gl.TEXTURE_2D, this.texture);
  }

  dispose() {
    this.gl.deleteTexture(this.texture);
    this.#counted(0);
  }
}
