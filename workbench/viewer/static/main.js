// The page: what can be chosen, what is told, and the link to what is shown.

import { Camera, Hands } from "./camera.js";
import { Measuring, lengthInWords } from "./measuring.js";
import { contextOf } from "./gpu.js";
import { Network } from "./source.js";
import { Stage } from "./stage.js";

const UPS = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
const $ = (id) => document.getElementById(id);
const short = new Intl.NumberFormat("en", { notation: "compact", maximumFractionDigits: 1 });

/** Bytes in words. */
function bytesInWords(bytes) {
  if (bytes < 1e6) return `${Math.max(1, Math.round(bytes / 1e3))} kB`;
  return bytes < 1e9 ? `${(bytes / 1e6).toFixed(1)} MB` : `${(bytes / 1e9).toFixed(2)} GB`;
}

/** Say what went wrong, once. */
function tell(message) {
  const there = [...$("notices").querySelectorAll("p")].some((p) => p.dataset.message === message);
  if (there) return;
  const notice = document.createElement("p");
  notice.dataset.message = message;
  notice.append(message);
  const close = document.createElement("button");
  close.type = "button";
  close.textContent = "Close";
  close.addEventListener("click", () => notice.remove());
  notice.append(close);
  $("notices").append(notice);
}

/** Buttons of which one is chosen, also by arrow keys. */
function radios(group, chosen) {
  const buttons = () => [...group.querySelectorAll('[role="radio"]')];
  const choose = (button) => {
    buttons().forEach((other) => {
      other.setAttribute("aria-checked", String(other === button));
      other.tabIndex = other === button ? 0 : -1;
    });
    chosen(button);
  };
  group.addEventListener("click", (event) => {
    const button = event.target.closest('[role="radio"]');
    if (button && !button.disabled) choose(button);
  });
  group.addEventListener("keydown", (event) => {
    const step = { ArrowDown: 1, ArrowRight: 1, ArrowUp: -1, ArrowLeft: -1 }[event.key];
    const open = buttons().filter((button) => !button.disabled);
    const at = open.indexOf(document.activeElement);
    if (!step || at < 0) return;
    event.preventDefault();
    const next = open[(at + step + open.length) % open.length];
    next.focus();
    choose(next);
  });
  return choose;
}

class Page {
  constructor(scene) {
    this.scene = scene;
    this.camera = new Camera(scene.bounds, UPS[scene.up], scene.home);
    this.network = new Network({ tell: () => this.stage?.redraw() });
    const canvas = $("picture");
    this.stage = new Stage(canvas, scene, this.camera, this.network, {
      tell,
      drawn: () => this.#drawn(),
    });
    this.measuring = new Measuring($("drawn"), scene.unit);
    this.hands = new Hands(canvas, this.camera, () => this.#moved(), (x, y) => this.#clicked(x, y));
    canvas.addEventListener("dblclick", (event) => this.#lookAt(event));
    this.#describe();
    this.#wire();
    addEventListener("hashchange", () => this.#follow());
    this.#follow();
  }

  #describe() {
    const { scene } = this;
    document.title = scene.name;
    $("name").textContent = scene.name;
    const size = scene.bounds[1].map((value, k) => lengthInWords(value - scene.bounds[0][k], scene.unit));
    $("facts").textContent = size.join(" × ");
    for (const entry of scene.modes) {
      const button = document.createElement("button");
      button.type = "button";
      button.role = "radio";
      button.dataset.mode = entry.mode;
      button.append(entry.label);
      const told = document.createElement("small");
      told.textContent = bytesInWords(entry.bytes);
      button.append(told);
      $("modes").append(button);
    }
    for (const { mode, label, reason } of scene.left_out ?? []) {
      const button = document.createElement("button");
      Object.assign(button, { type: "button", role: "radio", disabled: true, title: reason });
      button.dataset.mode = mode;
      button.append(label);
      const told = document.createElement("small");
      told.textContent = "not there";
      button.append(told);
      $("modes").append(button);
    }
  }

  #wire() {
    const { stage, camera } = this;
    this.chooseMode = radios($("modes"), (button) => this.#show(button.dataset.mode));
    this.chooseOverlay = radios($("overlays"), (button) => this.#overlay(button.dataset.key));
    this.chooseLight = radios($("lights"), (button) => this.#light(button.dataset.light));
    this.chooseSection = radios($("sections"), (button) => this.#section(button.dataset.axis));
    for (const id of ["light-azimuth", "light-elevation"]) $(id).addEventListener("input", () => this.#lamp());
    $("section-place").addEventListener("input", () => this.#cut());
    $("section-flip").addEventListener("click", () => {
      this.flipped = !this.flipped;
      this.#cut();
    });
    $("detail").addEventListener("input", () => this.#detail());
    $("foveated").addEventListener("change", () => {
      this.stage.look.foveated = $("foveated").checked;
      this.stage.redraw();
    });
    $("home").addEventListener("click", () => {
      camera.reset();
      this.#moved();
    });
    const toggles = { walk: () => this.#walk(), measure: () => this.#measure(!this.measuring.active), shot: () => this.#shot(), link: () => this.#copy(), help: () => $("help-panel").showModal() };
    for (const [id, doing] of Object.entries(toggles)) $(id).addEventListener("click", doing);
    addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("input")) return;
      const doing = { m: toggles.measure, p: toggles.shot, l: toggles.link, i: toggles.walk, "?": toggles.help }[event.key];
      if (doing) doing();
      else if (event.key === "Escape" && this.measuring.active) this.#measure(false);
    });
    this.chooseSection($("sections").querySelector('[data-axis=""]'));
    this.chooseLight($("lights").querySelector(`[data-light="${this.scene.light ?? "camera"}"]`));
    $("detail").value = "30";
    this.#detail();
    stage.redraw();
  }

  async #show(mode) {
    const entry = this.scene.modes.find((one) => one.mode === mode);
    if (!entry || this.shown === mode) return;
    this.shown = mode;
    $("loading").textContent = `Loading ${entry.label.toLowerCase()} …`;
    await this.stage.show(entry);
    if (this.shown !== mode) return;
    $("loading").textContent = "";
    $("mode-facts").textContent = entry.told ?? "";
    $("detail-section").hidden = this.stage.mode?.pixelError === undefined;
    $("foveated-label").hidden = this.stage.mode?.foveated === undefined;
    this.#overlays();
    this.#remember();
  }

  #overlays() {
    const found = this.stage.mode?.overlays ?? [];
    $("overlay-section").hidden = found.length < 2;
    $("overlays").replaceChildren(
      ...found.map(({ key, label }) => {
        const button = document.createElement("button");
        Object.assign(button, { type: "button", role: "radio" });
        button.dataset.key = key;
        button.append(label);
        return button;
      }),
    );
    const wanted = found.some(({ key }) => key === this.stage.look.overlay) ? this.stage.look.overlay : "color";
    const button = $("overlays").querySelector(`[data-key="${wanted}"]`);
    if (button) this.chooseOverlay(button);
    else this.stage.look.overlay = "color";
  }

  #overlay(key) {
    this.stage.look.overlay = key;
    const told = this.stage.mode?.overlays?.find((one) => one.key === key);
    $("legend").replaceChildren(
      ...(told?.legend ?? []).map(([color, label]) => {
        const row = document.createElement("li");
        const patch = document.createElement("span");
        patch.style.background = color;
        row.append(patch, label);
        return row;
      }),
    );
    this.stage.redraw();
    this.#remember();
  }

  #light(kind) {
    Object.assign(this.stage.look, { lit: kind !== "none", headlight: kind === "camera" });
    $("lamp").hidden = kind !== "fixed";
    this.light = kind;
    this.#lamp();
    this.#remember();
  }

  #lamp() {
    const around = (Number($("light-azimuth").value) * Math.PI) / 180;
    const height = (Number($("light-elevation").value) * Math.PI) / 180;
    const flat = Math.cos(height);
    const across = [flat * Math.cos(around), flat * Math.sin(around)];
    const up = Math.sin(height);
    this.stage.look.light = { x: [up, ...across], y: [across[1], up, across[0]], z: [...across, up] }[this.scene.up];
    this.stage.redraw();
  }

  #section(axis) {
    this.axis = axis;
    $("cut").hidden = axis === "";
    this.#cut();
  }

  #cut() {
    const plane = [0, 0, 0, 1];
    if (this.axis) {
      const k = Number(this.axis);
      const [low, high] = [this.scene.bounds[0][k], this.scene.bounds[1][k]];
      const place = low + (Number($("section-place").value) / 1000) * (high - low);
      const side = this.flipped ? -1 : 1;
      plane[k] = -side;
      plane[3] = side * place;
    }
    this.stage.look.section = plane;
    this.stage.redraw();
  }

  #detail() {
    const error = 0.5 * 2 ** (Number($("detail").value) / 20);
    this.stage.look.pixelError = error;
    $("detail-value").textContent = `${error.toFixed(1)} px`;
    this.stage.redraw();
  }

  #walk() {
    this.camera.walking = !this.camera.walking;
    $("walk").setAttribute("aria-checked", String(this.camera.walking));
    $("picture").focus();
  }

  #measure(active) {
    this.measuring.active = active;
    if (!active) this.measuring.clear();
    $("measure").setAttribute("aria-checked", String(active));
    document.body.classList.toggle("measuring", active);
    $("said").textContent = active ? "Click two places of the model." : "";
    this.stage.redraw();
  }

  #clicked(x, y) {
    if (!this.measuring.active) return;
    const place = this.stage.placeAt(x, y);
    if (!place) {
      $("said").textContent = "There is nothing of the model at this place.";
      return;
    }
    const distance = this.measuring.add(place);
    $("said").textContent = distance === null ? "Click the second place." : `Distance ${lengthInWords(distance, this.scene.unit)}`;
    this.stage.redraw();
  }

  #lookAt(event) {
    if (this.measuring.active) return;
    const box = $("picture").getBoundingClientRect();
    const place = this.stage.placeAt(event.clientX - box.left, event.clientY - box.top);
    if (!place) return;
    this.camera.lookAt(place);
    this.#moved();
  }

  #shot() {
    this.stage.frame();
    $("picture").toBlob((blob) => {
      const anchor = document.createElement("a");
      anchor.href = URL.createObjectURL(blob);
      anchor.download = `${this.scene.name}.png`;
      anchor.click();
      setTimeout(() => URL.revokeObjectURL(anchor.href), 1000);
    });
  }

  async #copy() {
    this.#write();
    try {
      await navigator.clipboard.writeText(location.href);
      $("said").textContent = "The link to this view is copied.";
    } catch {
      $("said").textContent = "The address of this page now links to this view.";
    }
  }

  #moved() {
    this.stage.redraw();
    this.#remember();
  }

  /** The address follows, but not at every step: browsers count. */
  #remember() {
    clearTimeout(this.later);
    this.later = setTimeout(() => this.#write(), 400);
  }

  #write() {
    clearTimeout(this.later);
    const told = { mode: this.shown ?? "", ...this.camera.text(), color: this.stage.look.overlay, light: this.light };
    history.replaceState(null, "", `#${new URLSearchParams(told)}`);
  }

  #follow() {
    const told = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
    this.camera.read(told);
    if (told.color) this.stage.look.overlay = told.color;
    const light = $("lights").querySelector(`[data-light="${CSS.escape(told.light ?? "")}"]`);
    if (light) this.chooseLight(light);
    const open = [...$("modes").querySelectorAll("button:not(:disabled)")];
    const wanted = open.find((button) => button.dataset.mode === told.mode) ?? open[0];
    if (wanted) this.chooseMode(wanted);
    else tell("There is nothing to show: nothing was exported.");
    this.stage.redraw();
  }

  #drawn() {
    const { stage, network } = this;
    const canvas = $("picture");
    const view = this.camera.view(canvas.width, canvas.height);
    this.measuring.draw(view, canvas.clientWidth, canvas.clientHeight);
    const items = stage.counts.items;
    const rows = {
      Drawn: `${short.format(items)} ${stage.entry?.unit ?? "triangles"}`,
      Loaded: `${bytesInWords(network.bytes)}, ${network.requests} requests`,
      "On the card": bytesInWords(stage.counts.bytes),
      Calls: String(stage.counts.calls),
      Picture: `${stage.clock.median.toFixed(1)} ms`,
    };
    $("statistics").replaceChildren(
      ...Object.entries(rows).flatMap(([name, value]) => {
        const [dt, dd] = [document.createElement("dt"), document.createElement("dd")];
        dt.textContent = name;
        dd.textContent = value;
        return [dt, dd];
      }),
    );
    if (stage.mode) $("loading").textContent = network.idle ? "" : `Loading, ${bytesInWords(network.bytes)} so far`;
  }
}

async function begin() {
  if (!contextOf(document.createElement("canvas"))) {
    tell("This browser shows no WebGL2, which the model needs. Use a current Firefox, Chrome, Edge or Safari, and allow hardware graphics in its settings.");
    return;
  }
  try {
    const scene = await new Network().json("scene.json");
    if (scene.version !== 1) throw new Error("The page and its data are of different versions. Publish it again.");
    window.page = new Page(scene);
  } catch (error) {
    tell(error.message);
  }
}

begin();
