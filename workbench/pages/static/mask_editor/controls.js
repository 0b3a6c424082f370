// Buttons, sliders and keys, and what they show.

import { STANDINGS } from "./list.js";
import { Shortcuts } from "./shortcuts.js";

const TOOLS = {
  brush: "Paint the object; the right button erases.",
  eraser: "Paint what is not the object.",
  lasso: "Drag around an area, or click its corners and press Enter.",
  rectangle: "Drag a rectangle around the object; the workbench finds it by its colours.",
  hand: "Drag the picture; the wheel zooms.",
};
const MODES = ["veil", "tint", "outline"];
const KINDS = { scan: "scan", photo: "photograph" };
const SMALLEST_RADIUS = 0.5;
const RADIUS_RANGE = 1024;
const PAN_PX = 60;

const at = (selector) => document.querySelector(selector);
const all = (selector) => [...document.querySelectorAll(selector)];

export class Controls {
  constructor({ view, tools, editor, list, saver }) {
    Object.assign(this, { view, tools, editor, list, saver });
    this.#listen();
    this.shortcuts = new Shortcuts(this.#keys());
    this.shortcuts.explain(at("#keys"));
    editor.addEventListener("told", () => this.#showSubject());
    editor.addEventListener("told", () => this.#countKept());
    tools.addEventListener("tool", () => this.#showTool());
    view.addEventListener("moved", () => this.#showZoom());
    saver.addEventListener("reach", () => this.#showSubject());
    this.#showTool();
    this.#showView();
    this.#showSubject();
  }

  #listen() {
    const { view, tools, editor } = this;
    const clicks = {
      "#undo": () => editor.undo(),
      "#redo": () => editor.redo(),
      "#invert": () => editor.change((mask) => mask.invert()),
      "#keep-all": () => editor.change((mask) => mask.fill(255)),
      "#keep-none": () => editor.change((mask) => mask.fill(0)),
      "#lasso-keeps": () => tools.setLassoKeeps(true),
      "#lasso-removes": () => tools.setLassoKeeps(false),
      "#training": () => editor.setTraining(!editor.training),
      "#remove": () => editor.removeOwn(),
      "#zoom-in": () => view.zoom(1.25),
      "#zoom-out": () => view.zoom(0.8),
      "#fit": () => view.fit(),
      "#turn": () => editor.turn(),
      "#previous": () => this.#step(-1),
      "#next": () => this.#step(1),
      "#help": () => at("#help-panel").showModal(),
      "#help-close": () => at("#help-panel").close(),
    };
    for (const [selector, run] of Object.entries(clicks)) at(selector).addEventListener("click", run);
    for (const button of all("[data-tool]")) {
      button.addEventListener("click", () => tools.choose(button.dataset.tool));
    }
    for (const button of all("[data-mode]")) {
      button.addEventListener("click", () => this.#setMode(button.dataset.mode));
    }
    at("#size").addEventListener("input", (event) =>
      tools.resize(SMALLEST_RADIUS * RADIUS_RANGE ** (event.target.value / 100)),
    );
    at("#opacity").addEventListener("input", (event) => this.#setOpacity(event.target.value / 100));
    document.addEventListener("keyup", (event) => event.key === " " && tools.setSpaceHeld(false));
    addEventListener("blur", () => tools.setSpaceHeld(false));
  }

  #keys() {
    const { view, tools, editor } = this;
    const tool = (name) => () => tools.choose(name);
    return [
      {
        title: "Draw",
        rows: [
          { keys: ["b"], label: "Brush", run: tool("brush") },
          { keys: ["e"], label: "Eraser", run: tool("eraser") },
          { keys: ["l"], label: "Lasso: drag, or click corners", run: tool("lasso") },
          { keys: ["r"], label: "Find the object in a rectangle", run: tool("rectangle") },
          { keys: ["h"], label: "Move the picture", run: tool("hand") },
          { keys: [" "], label: "Move the picture while held", run: () => tools.setSpaceHeld(true) },
          { keys: ["x"], label: "Brush ⇄ eraser; the lasso keeps ⇄ removes", run: () => tools.swap() },
          { keys: ["[", ","], label: "Smaller brush; also Shift and wheel", run: () => tools.resize(tools.radius / 1.2) },
          { keys: ["]", "."], label: "Larger brush", run: () => tools.resize(tools.radius * 1.2) },
          { keys: ["Enter"], label: "Close the polygon; also a double click", run: () => tools.finish() },
          { keys: ["Backspace"], label: "Take back its last corner", run: () => tools.takeBackCorner() },
          { keys: ["Escape"], label: "Give up what is half drawn", run: () => tools.cancel() },
        ],
      },
      {
        title: "Mask",
        rows: [
          { keys: ["Mod+z"], label: "Undo", run: () => editor.undo() },
          { keys: ["Mod+Shift+z", "Mod+y"], label: "Redo", run: () => editor.redo() },
          { keys: ["Mod+s"], label: "Save now; it saves by itself too", run: () => editor.keepNow() },
          { keys: ["i"], label: "Invert", run: () => editor.change((mask) => mask.invert()) },
          { keys: ["t"], label: "Use for training, or not", run: () => editor.setTraining(!editor.training) },
          { keys: ["Delete"], label: "Remove your own mask", run: () => editor.removeOwn() },
        ],
      },
      {
        title: "Look",
        rows: [
          { keys: ["+", "="], label: "Zoom in; also the wheel", run: () => view.zoom(1.25) },
          { keys: ["-"], label: "Zoom out", run: () => view.zoom(0.8) },
          { keys: ["0"], label: "The whole picture", run: () => view.fit() },
          { keys: ["q"], label: "Quarter turn, for scanners that lay on their side", run: () => editor.turn() },
          { keys: ["1"], label: "One pixel as one pixel", run: () => view.zoom(1 / (view.scale * devicePixelRatio)) },
          { keys: ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"], label: "Move about", run: (event) => this.#pan(event.key) },
          { keys: ["v"], label: "Veil, tint, outline", run: () => this.#setMode(MODES[(MODES.indexOf(view.mode) + 1) % 3]) },
          { keys: ["o", "Shift+o"], label: "Less opaque, more opaque", run: (event) => this.#setOpacity(view.opacity + (event.shiftKey ? 0.1 : -0.1)) },
          { keys: ["m"], label: "Hide the mask, or show it", run: () => this.#hideMask() },
        ],
      },
      {
        title: "Pictures",
        rows: [
          { keys: ["PageDown", "n"], label: "Next picture", run: () => this.#step(1) },
          { keys: ["PageUp", "p"], label: "Previous picture", run: () => this.#step(-1) },
          { keys: ["g"], label: "Go to the list; then arrows", run: () => this.list.focus() },
          { keys: ["?"], label: "This panel", run: () => at("#help-panel").showModal() },
        ],
      },
    ];
  }

  #pan(key) {
    const [dx, dy] = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[key];
    if (this.editor.mask) this.view.move(dx * PAN_PX, dy * PAN_PX);
  }

  #step(by) {
    const { shown } = this.list;
    const here = shown.indexOf(this.list.selected);
    const to = shown[here < 0 ? 0 : here + by];
    if (to) this.list.dispatchEvent(new CustomEvent("chosen", { detail: to }));
  }

  #setMode(mode) {
    this.view.mode = mode;
    this.view.hidden = false;
    this.#showView();
  }

  #setOpacity(opacity) {
    this.view.opacity = Math.min(1, Math.max(0, opacity));
    this.view.hidden = false;
    this.#showView();
  }

  #hideMask() {
    this.view.hidden = !this.view.hidden;
    this.#showView();
  }

  #showView() {
    const { view } = this;
    at("#opacity").value = Math.round(100 * view.opacity);
    for (const button of all("[data-mode]")) {
      button.setAttribute("aria-checked", String(button.dataset.mode === view.mode && !view.hidden));
    }
    view.redrawMask();
  }

  #showZoom() {
    at("#zoom").textContent = `${Math.round(100 * this.view.scale * devicePixelRatio)} %`;
  }

  #showTool() {
    const { name, radius, lassoKeeps } = this.tools;
    for (const button of all("[data-tool]")) {
      button.setAttribute("aria-checked", String(button.dataset.tool === name));
    }
    at("#size-option").hidden = name !== "brush" && name !== "eraser";
    at("#lasso-option").hidden = name !== "lasso";
    at("#lasso-keeps").setAttribute("aria-checked", String(lassoKeeps));
    at("#lasso-removes").setAttribute("aria-checked", String(!lassoKeeps));
    at("#size").value = Math.round((100 * Math.log(radius / SMALLEST_RADIUS)) / Math.log(RADIUS_RANGE));
    at("#size-value").textContent = `${Math.max(1, Math.round(2 * radius))} px`;
    at("#hint").textContent = TOOLS[name];
  }

  #showSubject() {
    const { editor, list } = this;
    const { subject, state, history } = editor;
    at("#working").hidden = !editor.working;
    at("#working").textContent = editor.working ?? "";
    const { shown } = list;
    const here = shown.indexOf(list.selected);
    at("#previous").disabled = here <= 0;
    at("#next").disabled = here < 0 || here >= shown.length - 1;
    for (const id of ["#invert", "#keep-all", "#keep-none"]) at(id).disabled = !editor.drawable;
    at("#undo").disabled = !editor.drawable || !history.done.length;
    at("#redo").disabled = !editor.drawable || !history.undone.length;
    at("#training").disabled = !editor.drawable || state.both;
    at("#remove").disabled = !editor.removable;
    if (!subject) return;
    at("#name").textContent = subject.name;
    at("#facts").textContent = `${KINDS[subject.kind]} · ${subject.size.join(" × ")} pixels · ${here + 1} of ${shown.length}`;
    at("#standing").hidden = false;
    at("#standing").textContent = STANDINGS[state.standing];
    at("#standing").dataset.standing = state.standing;
    at("#training").setAttribute("aria-checked", String(editor.training));
    at("#training").title = state.both
      ? "There is a training mask beside this correction; it stays as it is"
      : "Learn clutter from this mask (T)";
    at("#remove").textContent = state.automatic ? "Back to automatic" : "Remove this mask";
    const [tone, words] = this.#saved();
    at("#saved").textContent = words;
    at("#saved").dataset.tone = tone;
  }

  #saved() {
    const { editor, saver } = this;
    if (editor.choice) return ["attention", "Waiting for your choice"];
    const status = saver.status(editor.subject);
    if (saver.holdsUnkept() && !saver.reachable) return ["attention", "Not saved"];
    if (status === "kept" || (status && !saver.reachable)) return ["attention", "Not saved – kept in this browser"];
    if (status === "refused") return ["attention", "Could not be saved"];
    if (status || editor.pending) return ["busy", "Saving …"];
    if (["training", "corrected"].includes(editor.state.standing)) return ["calm", "Saved"];
    return ["quiet", "Nothing drawn yet"];
  }

  // Counting a large mask takes a moment, so it is done once the hand rests.
  #countKept() {
    clearTimeout(this.counting);
    this.counting = setTimeout(() => {
      const share = this.editor.mask?.keptShare();
      at("#kept").textContent = share === undefined ? "" : `${(100 * share).toFixed(1)} % kept`;
    }, 150);
  }
}
