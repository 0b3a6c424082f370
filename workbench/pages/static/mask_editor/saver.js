// Brings drawings to the workbench; until it confirms one, the browser keeps it.

import { Unreachable, saveMask } from "./api.js";

const RETRY_MS = 1000;

export const keyOf = (subject) => `${subject.kind}/${subject.name}`;

// Status of a subject: "waiting", "saving", "kept" (the workbench does not answer), "unkept"
// (nor does the browser keep it), "changed" (another mask is on disk by now), "refused".
// Events: "status" (detail: subject), "saved" (detail: {subject, state}), "reach".
export class Saver extends EventTarget {
  constructor(drafts) {
    super();
    this.drafts = drafts;
    this.entries = new Map();
    this.reachable = true;
    this.moved = false;
    this.ended = false;
    this.running = false;
  }

  status(subject) {
    return this.entries.get(keyOf(subject))?.status ?? null;
  }

  error(subject) {
    return this.entries.get(keyOf(subject))?.error ?? null;
  }

  holdsUnkept() {
    return [...this.entries.values()].some((entry) => entry.unkept);
  }

  // A drawing over the mask of `version`; drawings of one subject follow each other.
  async put(subject, bytes, role, version) {
    const key = keyOf(subject);
    const before = this.entries.get(key);
    const entry = { subject, bytes, role, version, status: "waiting", unkept: false };
    // A drawing on its way changes the version; it is told when it has arrived.
    if (before?.status === "saving") before.next = entry;
    this.entries.set(key, entry);
    this.#tell(entry, this.reachable ? "waiting" : "kept");
    await this.#keep(entry);
    this.run();
  }

  // Forgets what was not saved of a subject.
  async drop(subject) {
    this.entries.delete(keyOf(subject));
    // A draft that stays behind is found to be what is on disk, and goes then.
    await this.drafts?.remove(subject).catch(() => {});
    this.dispatchEvent(new CustomEvent("status", { detail: subject }));
  }

  // Nothing more is sent: another page goes on. Resolves when the browser keeps everything.
  async end() {
    this.ended = true;
    await Promise.all([...this.entries.values()].map((entry) => entry.kept));
  }

  async run() {
    if (this.running) return;
    this.running = true;
    let entry;
    while (!this.ended && (entry = this.#next())) await this.#send(entry);
    this.running = false;
  }

  #next() {
    return [...this.entries.values()].find((entry) => ["waiting", "kept"].includes(entry.status));
  }

  async #send(entry) {
    this.#tell(entry, "saving");
    try {
      const state = await saveMask(entry.subject, entry.bytes, entry.role, entry.version);
      this.#reach(true);
      await this.#arrived(entry, state);
    } catch (error) {
      if (error instanceof Unreachable) {
        this.#reach(false, error.moved);
        this.#tell(entry, "kept");
        await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
      } else {
        this.#reach(true);
        entry.error = error;
        this.#tell(entry, error.status === 412 ? "changed" : "refused");
      }
    }
  }

  async #arrived(entry, state) {
    const { subject, next } = entry;
    this.dispatchEvent(new CustomEvent("saved", { detail: { subject, state } }));
    if (next && this.entries.get(keyOf(subject)) === next) {
      next.version = state.version;
      await this.#keep(next);
    } else if (this.entries.get(keyOf(subject)) === entry) {
      await this.drop(subject);
    }
  }

  #keep(entry) {
    entry.kept = this.drafts
      ? this.drafts.put(entry.subject, entry.bytes, entry.role, entry.version).then(
          () => (entry.unkept = false),
          () => (entry.unkept = true),
        )
      : Promise.resolve((entry.unkept = true));
    return entry.kept;
  }

  #reach(reachable, moved = false) {
    if (reachable === this.reachable && moved === this.moved) return;
    Object.assign(this, { reachable, moved });
    if (!reachable) navigator.storage?.persist?.();
    this.dispatchEvent(new Event("reach"));
  }

  #tell(entry, status) {
    entry.status = status;
    if (this.entries.get(keyOf(entry.subject)) === entry) {
      this.dispatchEvent(new CustomEvent("status", { detail: entry.subject }));
    }
  }
}
