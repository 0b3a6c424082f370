// The scans and photographs of the project, with where the mask of each comes from.

import { thumbnailUrl } from "./api.js";
import { keyOf } from "./saver.js";

export const STANDINGS = {
  training: "training",
  corrected: "corrected",
  automatic: "automatic",
  none: "no mask",
};
const GROUPS = { scan: "Scans", photo: "Photographs" };

// Event "chosen" (detail: the subject).
export class SubjectList extends EventTarget {
  constructor(element, filter, summary) {
    super();
    Object.assign(this, { element, filter, summary });
    this.subjects = [];
    this.rows = new Map();
    filter.addEventListener("change", () => this.#filtered());
    element.addEventListener("keydown", (event) => this.#key(event));
  }

  show(subjects) {
    this.subjects = subjects;
    this.rows.clear();
    this.element.replaceChildren();
    for (const [kind, title] of Object.entries(GROUPS)) {
      const members = subjects.filter((subject) => subject.kind === kind);
      if (members.length) this.element.append(this.#group(title, members));
    }
    this.#filtered();
  }

  // The subjects in their order, as far as the filter lets them through.
  get shown() {
    return this.subjects.filter((subject) => !this.rows.get(keyOf(subject)).hidden && subject.size);
  }

  select(subject) {
    this.selected = subject;
    for (const [key, row] of this.rows) {
      const chosen = key === keyOf(subject);
      row.setAttribute("aria-selected", String(chosen));
      row.tabIndex = chosen ? 0 : -1;
      if (chosen) row.scrollIntoView({ block: "nearest" });
    }
  }

  // Where the mask comes from, and whether something of it is not saved.
  update(subject, unsaved) {
    const row = this.rows.get(keyOf(subject));
    const [, badge] = row.querySelectorAll(".name, .badge");
    row.dataset.standing = subject.standing;
    row.classList.toggle("unsaved", unsaved);
    badge.textContent = unsaved
      ? "not saved"
      : subject.size
        ? STANDINGS[subject.standing]
        : "no grid, no mask";
    this.#count();
  }

  focus() {
    this.rows.get(keyOf(this.selected ?? this.subjects[0]))?.focus();
  }

  #group(title, members) {
    const group = document.createElement("div");
    group.setAttribute("role", "group");
    group.setAttribute("aria-label", title);
    const heading = document.createElement("h2");
    heading.textContent = title;
    const count = document.createElement("span");
    count.textContent = members.length;
    heading.append(count);
    group.append(heading, ...members.map((subject) => this.#row(subject)));
    return group;
  }

  #row(subject) {
    const row = document.createElement("div");
    row.className = "subject";
    row.setAttribute("role", "option");
    row.setAttribute("aria-selected", "false");
    row.tabIndex = -1;
    row.title = subject.file;
    const picture = document.createElement("img");
    picture.alt = "";
    if (subject.size) {
      picture.loading = "lazy";
      picture.src = thumbnailUrl(subject);
      row.addEventListener("click", () => this.#choose(subject));
    } else {
      row.setAttribute("aria-disabled", "true");
    }
    const [name, badge] = ["name", "badge"].map((className) => {
      const span = document.createElement("span");
      span.className = className;
      return span;
    });
    name.textContent = subject.name;
    row.append(picture, name, badge);
    this.rows.set(keyOf(subject), row);
    this.update(subject, false);
    return row;
  }

  #choose(subject) {
    this.dispatchEvent(new CustomEvent("chosen", { detail: subject }));
  }

  #key(event) {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!step && !["Home", "End", "Enter", " "].includes(event.key)) return;
    const { shown } = this;
    const at = shown.findIndex((subject) => this.rows.get(keyOf(subject)) === document.activeElement);
    const to = { Home: 0, End: shown.length - 1 }[event.key] ?? at + (step ?? 0);
    event.preventDefault();
    event.stopPropagation();
    if (!shown[to]) return;
    this.rows.get(keyOf(shown[to])).focus();
    this.#choose(shown[to]);
  }

  #filtered() {
    const wanted = this.filter.value;
    for (const subject of this.subjects) {
      this.rows.get(keyOf(subject)).hidden = wanted !== "all" && subject.standing !== wanted;
    }
    for (const group of this.element.children) {
      group.hidden = [...group.querySelectorAll(".subject")].every((row) => row.hidden);
    }
    this.#count();
  }

  #count() {
    const counts = Object.entries(STANDINGS)
      .map(([standing, label]) => [this.subjects.filter((s) => s.standing === standing).length, label])
      .filter(([count]) => count);
    this.summary.textContent = counts.map(([count, label]) => `${count}\u00a0${label.replace(" ", "\u00a0")}`).join(" · ");
  }
}
