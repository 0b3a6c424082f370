// The keys of the page: one table for what they do and for the panel that explains them.

// Keys as in KeyboardEvent.key, letters small; "Mod" is Ctrl, or ⌘ on a Mac.
export class Shortcuts {
  constructor(groups) {
    this.groups = groups;
    this.actions = new Map();
    for (const { rows } of groups) {
      for (const { keys, run } of rows) for (const key of keys) this.actions.set(key, run);
    }
    document.addEventListener("keydown", (event) => this.#pressed(event));
  }

  explain(place) {
    place.replaceChildren(
      ...this.groups.map(({ title, rows }) => {
        const section = document.createElement("section");
        const heading = document.createElement("h3");
        heading.textContent = title;
        const list = document.createElement("dl");
        for (const { keys, label } of rows) {
          const term = document.createElement("dt");
          term.append(...keys.flatMap((key, k) => [k ? " " : "", keyCap(key)]));
          const words = document.createElement("dd");
          words.textContent = label;
          list.append(term, words);
        }
        section.append(heading, list);
        return section;
      }),
    );
  }

  #pressed(event) {
    if (document.querySelector("dialog[open]")) return;
    const key = named(event);
    const run = this.actions.get(key);
    if (!run || belongsTo(event.target, event.key)) return;
    if (run(event) !== false) event.preventDefault();
  }
}

function named(event) {
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const letter = key.length > 1 || /\p{Letter}/u.test(key);
  const shift = event.shiftKey && letter ? "Shift+" : "";
  return `${event.ctrlKey || event.metaKey ? "Mod+" : ""}${shift}${key}`;
}

// Keys that a control under the focus needs itself.
function belongsTo(target, key) {
  if (target.closest("select, textarea")) return true;
  if (target.closest("input[type=range], [role=listbox]")) {
    return /^(Arrow|Page|Home|End|Enter| )/.test(key);
  }
  return Boolean(target.closest("button, input, [role=switch]")) && /^(Enter| )$/.test(key);
}

const CAPS = {
  ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓", PageUp: "Page ↑", PageDown: "Page ↓",
  Escape: "Esc", Mod: /Mac/.test(navigator.platform) ? "⌘" : "Ctrl", " ": "Space",
};

function keyCap(key) {
  const cap = document.createElement("kbd");
  cap.textContent = key
    .split(/(?<=.)\+/)
    .map((part) => CAPS[part] ?? (part.length === 1 ? part.toUpperCase() : part))
    .join(" ");
  return cap;
}
