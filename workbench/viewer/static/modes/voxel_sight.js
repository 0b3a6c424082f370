// Which nodes are seen: their numbers are drawn into a small picture that comes back when it is ready.

const SHARE = 2;
/** Places within a pixel of the small picture; together they are the middles of all pixels. */
const SHIFTS = [[0.25, 0.25], [-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25]];
/** So long a node that was seen behind others is not tried coarse again. */
const MEMORY = 64;
const MOST_PASSES = 60;

/** The feedback of what was drawn. */
export class Sight {
  constructor(gl, counts) {
    this.gl = gl;
    this.counts = counts;
    this.target = gl.createFramebuffer();
    this.color = gl.createRenderbuffer();
    this.depth = gl.createRenderbuffer();
    this.reading = null;
    this.bytes = 0;
    this.size = [0, 0];
    this.enabled = true;
    this.notes = new Map();
    this.forget();
  }

  /** Begin anew. */
  forget() {
    this.pass = 0;
    this.told = 0;
    this.view = "";
    this.viewPass = 0;
    this.changedPass = 0;
    this.cut = "";
    this.notes.clear();
  }

  #note(node) {
    let note = this.notes.get(node);
    if (!note) this.notes.set(node, (note = { visited: -2, since: 0, seen: -Infinity, exposed: -Infinity }));
    return note;
  }

  /** A node takes part in the picture, itself or by its children. */
  visited(node) {
    const note = this.#note(node);
    if (note.visited < this.pass - 1) note.since = this.pass;
    note.visited = this.pass;
  }

  /** Whether it is known that nothing of a node is seen from here. */
  hidden(node) {
    if (!this.enabled) return false;
    const note = this.notes.get(node);
    if (!note || note.visited < this.pass - 1) return false;
    const exposed = note.exposed >= this.viewPass || this.told - note.exposed < MEMORY;
    const unseen = this.told - Math.max(note.seen, note.since) >= SHIFTS.length;
    return unseen && !exposed;
  }

  /** Whether something of a node was seen lately. */
  seen(node) {
    const note = this.notes.get(node);
    return !this.enabled || (note !== undefined && this.told - note.seen < SHIFTS.length);
  }

  /** Whether more pictures may change what is known of this view. */
  get waiting() {
    if (!this.enabled) return false;
    const settled = this.told - Math.max(this.changedPass, this.viewPass) > SHIFTS.length;
    return !settled && this.pass - this.viewPass < MOST_PASSES;
  }

  /** Draw the numbers of the nodes that are shown, unless an earlier picture is still to come. */
  look(view, section, shown, draw) {
    this.#answer();
    const key = [...view.clip, ...section].join();
    if (key !== this.view) [this.view, this.viewPass] = [key, this.pass];
    const cut = shown.map(({ node, kind, octants }) => `${node.row}${kind[0]}${octants}`).join();
    if (cut !== this.cut) [this.cut, this.changedPass] = [cut, this.pass];
    if (!this.enabled || this.reading || !this.waiting) return;
    const { gl } = this;
    const before = gl.getParameter(gl.DRAW_FRAMEBUFFER_BINDING);
    // The picture for measuring is drawn in between: it says nothing new.
    if (before) return;
    this.#resize(Math.ceil(view.width / SHARE), Math.ceil(view.height / SHARE));
    const [width, height] = this.size;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    draw({ clip: this.#shifted(view, SHIFTS[this.pass % SHIFTS.length]), width, height });
    // A buffer of its own: one that is used again makes browsers wait, or warn.
    const pixels = gl.createBuffer();
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, pixels);
    gl.bufferData(gl.PIXEL_PACK_BUFFER, width * height * 4, gl.STREAM_READ);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, 0);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, view.width, view.height);
    this.reading = { fence: gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0), pixels, bytes: width * height * 4, shown, number: this.pass };
    gl.flush();
    this.pass += 1;
  }

  /** The clip matrix moved by shares of a pixel of the small picture. */
  #shifted({ clip, width, height }, [x, y]) {
    const moved = Float32Array.from(clip);
    for (let column = 0; column < 4; column++) {
      moved[4 * column] += ((2 * SHARE * x) / width) * clip[4 * column + 3];
      moved[4 * column + 1] += ((2 * SHARE * y) / height) * clip[4 * column + 3];
    }
    return moved;
  }

  #answer() {
    const { gl, reading } = this;
    if (!reading) return;
    const state = gl.clientWaitSync(reading.fence, 0, 0);
    if (state === gl.TIMEOUT_EXPIRED) return;
    const bytes = new Uint8Array(reading.bytes);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, reading.pixels);
    gl.getBufferSubData(gl.PIXEL_PACK_BUFFER, 0, bytes);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    this.#end();
    const rows = new Set(new Uint32Array(bytes.buffer).map((word) => word & 0xffffff));
    this.told = reading.number + 1;
    for (const { node, coarse } of reading.shown) {
      if (!rows.has(node.row + 1)) continue;
      if (coarse) this.#note(node).exposed = reading.number;
      for (let one = node; one; one = one.parent) this.#note(one).seen = reading.number;
    }
  }

  #resize(width, height) {
    if (this.size[0] === width && this.size[1] === height) return;
    const { gl } = this;
    this.size = [width, height];
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    for (const [buffer, format, attachment] of [
      [this.color, gl.RGBA8, gl.COLOR_ATTACHMENT0],
      [this.depth, gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT],
    ]) {
      gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
      gl.renderbufferStorage(gl.RENDERBUFFER, format, width, height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, attachment, gl.RENDERBUFFER, buffer);
    }
    this.counts.bytes += width * height * 12 - this.bytes;
    this.bytes = width * height * 12;
  }

  #end() {
    if (!this.reading) return;
    this.gl.deleteSync(this.reading.fence);
    this.gl.deleteBuffer(this.reading.pixels);
    this.reading = null;
  }

  dispose() {
    const { gl } = this;
    this.#end();
    [this.color, this.depth].forEach((buffer) => gl.deleteRenderbuffer(buffer));
    gl.deleteFramebuffer(this.target);
    this.counts.bytes -= this.bytes;
  }
}
