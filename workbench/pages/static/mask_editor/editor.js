// One picture with its mask: opened, changed, undone, saved, and decided on where two differ.

import * as api from "./api.js";
import { packed, same, unpacked } from "./codec.js";
import { History } from "./history.js";
import { Mask } from "./mask.js";
import { say, sayError, unsay } from "./notices.js";
import { keyOf } from "./saver.js";

// Packing takes a moment, so that the strokes of a large mask are gathered a little.
const KEEP_AFTER_MS = 300;
const PIXELS_PER_MS = 80_000;

// Event "told": something of what is shown about the subject has changed.
export class Editor extends EventTarget {
  constructor(view, tools, saver, orphans) {
    super();
    Object.assign(this, { view, tools, saver, orphans });
    this.subject = null;
    this.pasts = new Map();
    // Quarter turns in which pictures are looked at, by kind.
    this.turns = { scan: 0, photo: 0 };
    this.choice = null;
    this.working = null;
    this.ended = false;
    this.keeping = Promise.resolve();
    this.packing = 0;
    tools.addEventListener("changed", () => view.redrawMask());
    tools.addEventListener("drawn", () => this.#changed());
    tools.addEventListener("rectangle", (event) => this.#find(event.detail));
    saver.addEventListener("saved", (event) => this.#saved(event.detail));
    saver.addEventListener("status", (event) => this.#status(event.detail));
  }

  // Whether it was opened, and not another meanwhile.
  async open(subject) {
    const opening = (this.opening = {});
    this.tools.rest();
    await this.keepNow();
    if (this.opening !== opening) return false;
    this.#work("Opening …");
    unsay("damaged");
    try {
      const [bitmap, found] = await Promise.all([api.picture(subject), this.#load(subject)]);
      if (this.opening !== opening) return false;
      this.#remember();
      await this.#show(subject, bitmap, found);
      await this.#decide();
      return true;
    } catch (error) {
      if (this.opening === opening) sayError("open", error);
      return false;
    } finally {
      if (this.opening === opening) this.#work(null);
    }
  }

  turn() {
    if (!this.mask) return;
    const { kind } = this.subject;
    this.turns[kind] = (this.turns[kind] + 1) % 4;
    this.view.turn(this.turns[kind]);
  }

  get training() {
    return this.role === "training";
  }

  get drawable() {
    return Boolean(this.mask) && !this.choice && !this.working && !this.ended;
  }

  // Nothing more is drawn here; resolves when the browser keeps what was.
  async end() {
    this.tools.setLocked(true);
    this.ended = true;
    this.#tell();
    await this.keepNow();
    await this.saver.end();
  }

  get removable() {
    const own = ["training", "corrected"].includes(this.state?.standing);
    return own && this.drawable && !this.pending && !this.saver.status(this.subject);
  }

  undo() {
    if (this.drawable && !this.tools.busy && this.history.undo(this.mask)) this.#keepSoon();
  }

  redo() {
    if (this.drawable && !this.tools.busy && this.history.redo(this.mask)) this.#keepSoon();
  }

  // What Mask.fill, Mask.invert and their like do, as one change.
  change(what) {
    if (!this.drawable) return;
    this.tools.rest();
    what(this.mask);
    this.#changed();
  }

  setTraining(wanted) {
    if (!this.drawable || this.state.both) return;
    this.role = wanted ? "training" : "corrected";
    if (this.state.standing !== "none" || this.history.done.length) this.#keepSoon();
    this.#tell();
  }

  // Back to the automatic mask, or to none.
  async removeOwn() {
    if (!this.removable) return;
    const { subject, mask } = this;
    this.#work("Removing …");
    try {
      await api.removeMask(subject, this.state.version);
      const { data, state } = await this.#load(subject);
      mask.replace(data);
      const change = mask.settle();
      if (change) this.history.push(change);
      this.#take(state);
      say("removed", { text: "Your mask was removed.", detail: "Undo brings it back.", passing: true });
    } catch (error) {
      sayError("removed", error);
    } finally {
      this.#work(null);
      this.view.redrawMask();
    }
  }

  // Whether something is drawn that not even the browser keeps yet.
  get unkept() {
    return Boolean(this.pending) || this.packing > 0;
  }

  // Hands what is drawn to the saver; resolves when the browser keeps it.
  keepNow() {
    if (this.pending) {
      clearTimeout(this.pending);
      this.pending = null;
      this.packing++;
      this.keeping = this.keeping.then(() => this.#keep()).finally(() => this.packing--);
    }
    return this.keeping;
  }

  async #keep() {
    const { subject, role } = this;
    const bytes = await packed(this.mask.settled);
    // Only now: an earlier drawing may have arrived while this one was packed.
    await this.saver.put(subject, bytes, role, this.state.version);
  }

  // Shows one of the two masks that are to be chosen from.
  look(at) {
    this.choice.shown = at;
    this.mask.replace(this.choice[at]);
    this.view.redrawMask();
    this.#ask();
  }

  // Both stay in the history: the other one is an undo away.
  async keepShown() {
    const { choice, mask } = this;
    const other = choice.shown === "mine" ? "theirs" : "mine";
    this.choice = null;
    unsay("choice");
    mask.replace(choice[other]);
    mask.settle();
    mask.replace(choice[choice.shown]);
    const change = mask.settle();
    if (change) this.history.push(change);
    await this.saver.drop(this.subject);
    this.#take(choice.state);
    this.role = choice.role ?? this.role;
    if (choice.shown === "mine") {
      this.#keepSoon();
      await this.keepNow();
    }
    if (choice.orphan) await this.orphans.remove(choice.orphan);
    this.tools.setLocked(false);
    this.view.redrawMask();
    this.#tell();
  }

  async #load(subject) {
    try {
      return await api.mask(subject);
    } catch (error) {
      if (!(error instanceof api.Refused) || !error.state) throw error;
      // The file on disk is no mask; the user may draw another over it.
      sayError("damaged", error);
      return { state: error.state, data: new Uint8Array(subject.size[0] * subject.size[1]) };
    }
  }

  async #show(subject, bitmap, { state, data }) {
    for (const id of ["open", "removed", "rectangle"]) unsay(id);
    const key = keyOf(subject);
    const unsaved = this.saver.entries.get(key);
    const own = unsaved ? await unpacked(unsaved.bytes) : data;
    const past = this.pasts.get(key);
    const goesOn = past && same(past.bytes, await packed(own));
    this.subject = subject;
    this.mask = new Mask(...subject.size, own);
    this.disk = data;
    this.history = goesOn ? past.history : new History();
    this.choice = null;
    unsay("choice");
    this.tools.setLocked(false);
    this.view.show(bitmap, this.mask, this.turns[subject.kind]);
    // What is drawn on stays a drawing over the version it began with.
    this.#take(unsaved ? { ...state, version: unsaved.version } : state);
    this.found = state;
    if (unsaved) this.role = unsaved.role;
  }

  // Whether there are two masks to choose from.
  async #decide() {
    if (this.saver.status(this.subject) === "changed") {
      this.#differ({ mine: this.mask.data.slice(), theirs: this.disk, state: this.found });
      return;
    }
    for (const orphan of this.orphans.of(this.subject)) {
      const mine = await unpacked(orphan.bytes);
      if (mine.length !== this.mask.data.length) continue;
      if (same(mine, this.mask.data)) {
        await this.orphans.remove(orphan);
        continue;
      }
      const theirs = this.mask.data.slice();
      this.#differ({ mine, theirs, state: this.state, role: orphan.role, orphan });
      return;
    }
  }

  // Another mask is on disk by now than the one that was drawn over.
  async #changedElsewhere() {
    const { subject } = this;
    const found = await this.#load(subject).catch(() => null);
    if (!found || this.subject !== subject || this.choice) return;
    this.tools.rest();
    clearTimeout(this.pending);
    this.pending = null;
    if (same(found.data, this.mask.data)) {
      await this.saver.drop(subject);
      this.#take(found.state);
      return;
    }
    this.#differ({ mine: this.mask.data.slice(), theirs: found.data, state: found.state, role: this.role });
  }

  #differ(choice) {
    this.choice = choice;
    this.tools.setLocked(true);
    this.look("mine");
    this.#tell();
  }

  #ask() {
    const { shown, orphan } = this.choice;
    const mine = shown === "mine";
    const time = orphan && new Date(orphan.time).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
    say("choice", {
      tone: "attention",
      text: orphan
        ? `A drawing of ${time} was not saved; this browser kept it.`
        : "This mask was changed elsewhere while you drew.",
      detail: `Both are kept. You are looking at ${mine ? "your drawing" : "the mask on disk"}.`,
      actions: [
        [mine ? "Keep my drawing" : "Keep the mask on disk", () => this.keepShown()],
        [mine ? "Look at the mask on disk" : "Look at my drawing", () => this.look(mine ? "theirs" : "mine")],
      ],
    });
  }

  async #find(rectangle) {
    if (!this.drawable) return;
    const { subject, mask } = this;
    unsay("rectangle");
    this.#work("Finding the object …");
    try {
      const rows = await api.objectIn(subject, rectangle);
      if (this.mask !== mask) return;
      mask.paste(rectangle, rows);
      this.#changed();
    } catch (error) {
      if (this.mask !== mask) return;
      if (error instanceof api.Unreachable) {
        say("rectangle", {
          text: `${error.message}, so it cannot look for the object.`,
          detail: "Brush, eraser and lasso work all the same.",
          tone: "attention",
        });
      } else sayError("rectangle", error);
    } finally {
      if (this.mask === mask) this.#work(null);
    }
  }

  #changed() {
    const change = this.mask.settle();
    if (!change) return;
    this.history.push(change);
    this.#keepSoon();
  }

  #keepSoon() {
    clearTimeout(this.pending);
    const wait = Math.min(KEEP_AFTER_MS, this.mask.data.length / PIXELS_PER_MS);
    this.pending = setTimeout(() => this.keepNow(), wait);
    this.view.redrawMask();
    this.#tell();
  }

  #saved({ subject, state }) {
    subject.standing = state.standing;
    if (subject === this.subject) {
      const { role } = this;
      this.#take(state);
      // What was chosen since is on its way.
      if (this.pending || this.saver.status(subject) === "waiting") this.role = role;
      unsay("damaged");
    }
    this.#tell(subject);
  }

  #status(subject) {
    if (subject === this.subject) {
      const status = this.saver.status(subject);
      if (status === "changed") this.#changedElsewhere();
      if (status === "refused") {
        sayError("refused", this.saver.error(subject), [["Try again", () => this.#keepSoon()]]);
      } else unsay("refused");
    }
    this.#tell(subject);
  }

  #take(state) {
    this.state = state;
    this.subject.standing = state.standing;
    const own = ["training", "corrected"].includes(state.standing);
    this.role = own ? state.standing : state.automatic ? "corrected" : "training";
    this.#tell();
  }

  // The history of a mask is good for as long as the mask is what it left.
  #remember() {
    if (!this.subject) return;
    const { history, subject, mask } = this;
    packed(mask.settled).then((bytes) => this.pasts.set(keyOf(subject), { history, bytes }));
  }

  #work(words) {
    this.working = words;
    if (!this.choice && !this.ended) this.tools.setLocked(Boolean(words));
    this.#tell();
  }

  #tell(subject = this.subject) {
    this.dispatchEvent(new CustomEvent("told", { detail: subject }));
  }
}
