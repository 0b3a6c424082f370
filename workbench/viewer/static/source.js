// Files on a web server, read piece by piece; whole where the server knows no ranges.

const TRIES = 3;
const FIRST_WAIT_MS = 250;
const AT_ONCE = 6;

/** What could not be read, in words for people. */
export class SourceError extends Error {
  constructor(message, { missing = false } = {}) {
    super(message);
    this.name = "SourceError";
    this.missing = missing;
  }
}

/** Requests of one page: how many at once, what they brought, who hears of it. */
export class Network {
  constructor({ timeoutMs = 20000, tell = () => {} } = {}) {
    this.timeoutMs = timeoutMs;
    this.tell = tell;
    this.bytes = 0;
    this.requests = 0;
    this.failures = 0;
    this.running = 0;
    this.waiting = [];
  }

  get idle() {
    return this.running === 0 && this.waiting.length === 0;
  }

  async #turn() {
    if (this.running >= AT_ONCE) await new Promise((resolve) => this.waiting.push(resolve));
    this.running += 1;
  }

  #done() {
    this.running -= 1;
    this.waiting.shift()?.();
    this.tell();
  }

  /** A response with its body, tried again where the line or the server stumbles. */
  async get(url, headers = {}, { signal } = {}) {
    await this.#turn();
    try {
      for (let attempt = 1; ; attempt++) {
        try {
          return await this.#once(url, headers, signal);
        } catch (error) {
          if (signal?.aborted || error.final || attempt === TRIES) throw error;
          await new Promise((resolve) => setTimeout(resolve, FIRST_WAIT_MS * 2 ** (attempt - 1)));
        }
      }
    } catch (error) {
      this.failures += 1;
      throw error;
    } finally {
      this.#done();
    }
  }

  async #once(url, headers, signal) {
    const name = decodeURIComponent(new URL(url, document.baseURI).pathname.split("/").pop());
    const limit = new AbortController();
    const stop = () => limit.abort();
    const clock = setTimeout(stop, this.timeoutMs);
    signal?.addEventListener("abort", stop);
    try {
      this.requests += 1;
      const response = await fetch(url, { headers, signal: limit.signal });
      if (response.status === 404 || response.status === 410) {
        throw Object.assign(new SourceError(`${name} is not on the server`, { missing: true }), { final: true });
      }
      if (!response.ok) {
        const error = new SourceError(`The server answered ${response.status} for ${name}`);
        throw Object.assign(error, { final: response.status < 500 });
      }
      const body = await response.arrayBuffer();
      this.bytes += body.byteLength;
      return { status: response.status, headers: response.headers, body, name };
    } catch (error) {
      if (error instanceof SourceError) throw error;
      const slow = limit.signal.aborted && !signal?.aborted;
      throw new SourceError(
        slow ? `The server took longer than ${Math.round(this.timeoutMs / 1000)} s for ${name}` : `${name} could not be read: ${error.message}`,
      );
    } finally {
      clearTimeout(clock);
      signal?.removeEventListener("abort", stop);
    }
  }

  async json(url) {
    const { body, name } = await this.get(url);
    try {
      return JSON.parse(new TextDecoder().decode(body));
    } catch {
      throw new SourceError(`${name} is damaged: it is no JSON`);
    }
  }
}

/** One file. */
export class Source {
  constructor(network, url) {
    this.network = network;
    this.url = url;
    this.whole = null;
    this.first = null;
  }

  /** Bytes of a part; a server that sends the whole file instead is asked once only. */
  async range(offset, bytes, options = {}) {
    if (this.whole) return this.#cut(await this.whole, offset, bytes);
    if (!bytes) return new ArrayBuffer(0);
    // Until an answer tells whether the server knows ranges, any other could bring the whole file, too.
    if (this.first) await this.first.catch(() => {});
    if (this.whole) return this.#cut(await this.whole, offset, bytes);
    const asked = { Range: `bytes=${offset}-${offset + bytes - 1}` };
    const coming = this.network.get(this.url, asked, options);
    this.first ??= coming;
    const answer = await coming;
    if (answer.status !== 206) {
      this.whole = Promise.resolve(answer.body);
      return this.#cut(answer.body, offset, bytes);
    }
    if (answer.body.byteLength !== bytes) this.#short(offset, bytes, answer.body.byteLength);
    return answer.body;
  }

  /** The whole file. */
  async all(options = {}) {
    this.whole ??= this.network.get(this.url, {}, options).then((answer) => answer.body);
    try {
      return await this.whole;
    } catch (error) {
      this.whole = null;
      throw error;
    }
  }

  #cut(body, offset, bytes) {
    if (offset + bytes > body.byteLength) this.#short(offset, bytes, body.byteLength - offset);
    return body.slice(offset, offset + bytes);
  }

  #short(offset, bytes, found) {
    const name = this.url.split("/").pop();
    throw new SourceError(
      `${name} is shorter than it says: ${Math.max(found, 0)} of ${bytes} bytes are there from ${offset} on. Publish it again.`,
    );
  }
}
