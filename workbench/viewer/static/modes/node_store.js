// What the stores of nodes have in common: parts of files asked for, uploaded a little each frame.

/** Parts of one file on their way to the GPU; a store keeps what is there and gives it up. */
export class NodeStore {
  /** At most `most` requests are under way, and about so many bytes are uploaded in a frame. */
  constructor({ gl, counts, redraw, tell }, file, source, { most, uploadBytes }) {
    Object.assign(this, { gl, counts, redraw, tell, file, source, most, uploadBytes });
    this.arrived = [];
    this.running = 0;
    this.stopping = new AbortController();
    this.frame = 0;
  }

  /** Bytes on their way, or still to be uploaded. */
  get busy() {
    return this.running > 0 || this.arrived.length > 0;
  }

  /** How many more requests may be made now. */
  get free() {
    return this.most - this.running;
  }

  /** Read something: what `read` gives waits for its upload, or `failed` hears why there is none. */
  async ask(read, failed) {
    const { signal } = this.stopping;
    this.running += 1;
    try {
      const found = await read(signal);
      if (!signal.aborted) this.arrived.push(found);
    } catch (error) {
      if (!signal.aborted) failed(error.message);
    } finally {
      this.running -= 1;
      if (!signal.aborted) this.redraw();
    }
  }

  /** Put what arrived on the GPU, not much at a time: `put` takes one and tells its bytes. */
  uploadArrived(put) {
    this.frame += 1;
    let bytes = 0;
    while (this.arrived.length && bytes < this.uploadBytes) bytes += put(this.arrived.shift());
  }

  /** Ask for nothing more. */
  stop() {
    this.stopping.abort();
  }
}
