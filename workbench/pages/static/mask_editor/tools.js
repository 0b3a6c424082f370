// Drawing with pointer and wheel: brush, eraser, lasso, rectangle, hand.

const CLICK_PX = 4;
const WHEEL_ZOOM = 0.0015;
const LARGEST_RADIUS = 512;

// Events: "changed" (the mask was), "drawn" (a change is complete), "rectangle" (detail: its
// four sides), "tool" (tool, size or sign changed).
export class Tools extends EventTarget {
  constructor(view) {
    super();
    this.view = view;
    this.name = "brush";
    this.radius = 16;
    this.lassoKeeps = true;
    this.locked = false;
    this.pointer = null;
    this.stroke = null;
    this.corners = [];
    view.drawTool = (context) => this.#draw(context);
    this.#listen(view.toolCanvas);
  }

  choose(name) {
    this.rest();
    this.name = name;
    this.#told();
  }

  resize(radius) {
    this.radius = Math.min(LARGEST_RADIUS, Math.max(0.5, radius));
    this.#told();
  }

  setLassoKeeps(keeps) {
    this.lassoKeeps = keeps;
    this.#told();
  }

  // The other of a pair: brush and eraser, a lasso that keeps and one that removes.
  swap() {
    if (this.name === "brush" || this.name === "eraser") {
      this.choose(this.name === "brush" ? "eraser" : "brush");
    } else if (this.name === "lasso") {
      this.setLassoKeeps(!this.lassoKeeps);
    }
  }

  get busy() {
    return this.stroke !== null || this.corners.length > 0;
  }

  // Ends a stroke where it is, and gives up what means nothing by half.
  rest() {
    if (this.stroke?.paints) this.#up();
    this.cancel();
  }

  // Gives up what is half drawn.
  cancel() {
    if (this.stroke?.paints) {
      this.view.mask.revert();
      this.dispatchEvent(new Event("changed"));
    }
    this.stroke = null;
    this.corners = [];
    this.#cursor();
    this.view.redrawTool();
  }

  // Closes a polygon.
  finish() {
    const { corners } = this;
    const value = this.polygonValue;
    this.corners = [];
    if (corners.length > 2) {
      this.view.mask.polygon(corners, value);
      this.dispatchEvent(new Event("drawn"));
    }
    this.view.redrawTool();
  }

  takeBackCorner() {
    this.corners.pop();
    this.view.redrawTool();
  }

  #listen(canvas) {
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", (event) => this.#up(event));
    canvas.addEventListener("pointercancel", () => this.rest());
    canvas.addEventListener("pointerleave", () => this.#place(null));
    canvas.addEventListener("dblclick", () => this.finish());
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
  }

  #down(event) {
    if (!this.view.mask || this.stroke) return;
    const { offsetX: x, offsetY: y, button } = event;
    event.target.setPointerCapture(event.pointerId);
    if (this.name === "hand" || button === 1 || this.view.spaceHeld) {
      this.stroke = { moves: true, x, y };
      this.#cursor();
      return;
    }
    if (this.locked || button === 1) return;
    // The other button, or Alt, does the opposite.
    const opposite = button === 2 || event.altKey;
    const start = this.view.toPicture(x, y);
    if (this.name === "brush" || this.name === "eraser") {
      this.stroke = { paints: true, value: (this.name === "brush") !== opposite ? 255 : 0, last: start };
      this.#paint(start);
    } else if (this.name === "lasso") {
      if (!this.corners.length) this.polygonValue = this.lassoKeeps !== opposite ? 255 : 0;
      this.stroke = { ropes: true, x, y, path: [start], dragged: false };
    } else {
      this.stroke = { spans: true, start, end: start };
    }
    this.view.redrawTool();
  }

  #move(event) {
    const { offsetX: x, offsetY: y } = event;
    const { stroke, view } = this;
    if (stroke?.moves) {
      view.move(x - stroke.x, y - stroke.y);
      Object.assign(stroke, { x, y });
    } else if (stroke) {
      // Between two frames the pointer passes several places.
      const passed = event.getCoalescedEvents?.() ?? [];
      for (const each of passed.length ? passed : [event]) {
        this.#follow(view.toPicture(each.offsetX, each.offsetY), each.offsetX, each.offsetY);
      }
    }
    this.#place([x, y]);
  }

  #follow(at, x, y) {
    const { stroke } = this;
    if (stroke.paints) this.#paint(at);
    else if (stroke.spans) stroke.end = at;
    else {
      stroke.dragged ||= Math.hypot(x - stroke.x, y - stroke.y) > CLICK_PX;
      if (stroke.dragged) stroke.path.push(at);
    }
  }

  #up() {
    const { stroke } = this;
    this.stroke = null;
    if (!stroke) return;
    if (stroke.paints) this.dispatchEvent(new Event("drawn"));
    else if (stroke.spans) this.#span(stroke);
    else if (stroke.ropes) {
      this.corners.push(...stroke.path);
      if (stroke.dragged) this.finish();
    }
    this.#cursor();
    this.view.redrawTool();
  }

  #paint(at) {
    const { stroke, view } = this;
    view.mask.stroke(...stroke.last, ...at, this.radius, stroke.value);
    stroke.last = at;
    this.dispatchEvent(new Event("changed"));
  }

  #span({ start, end }) {
    const { width, height } = this.view.mask;
    const clamped = (value, size) => Math.min(size, Math.max(0, Math.round(value)));
    const [left, right] = [start[0], end[0]].map((x) => clamped(x, width)).sort((a, b) => a - b);
    const [top, bottom] = [start[1], end[1]].map((y) => clamped(y, height)).sort((a, b) => a - b);
    if (right - left < 4 || bottom - top < 4) return;
    this.dispatchEvent(new CustomEvent("rectangle", { detail: [left, top, right, bottom] }));
  }

  #wheel(event) {
    event.preventDefault();
    if (event.shiftKey) {
      this.resize(this.radius * (event.deltaY + event.deltaX > 0 ? 1 / 1.12 : 1.12));
    } else {
      const pixels = event.deltaY * (event.deltaMode === 1 ? 20 : 1) * (event.ctrlKey ? 6 : 1);
      this.view.zoom(Math.exp(-WHEEL_ZOOM * pixels), event.offsetX, event.offsetY);
    }
    this.#place([event.offsetX, event.offsetY]);
  }

  #place(pointer) {
    this.pointer = pointer;
    this.view.redrawTool();
  }

  #told() {
    this.#cursor();
    this.dispatchEvent(new Event("tool"));
    this.view.redrawTool();
  }

  #cursor() {
    const moving = this.name === "hand" || this.view.spaceHeld;
    this.view.stage.dataset.cursor = this.stroke?.moves
      ? "grabbing"
      : moving
        ? "grab"
        : this.locked
          ? "locked"
          : this.name === "brush" || this.name === "eraser"
            ? "none"
            : "cross";
  }

  setLocked(locked) {
    if (locked) this.rest();
    this.locked = locked;
    this.#cursor();
  }

  setSpaceHeld(held) {
    this.view.spaceHeld = held;
    this.#cursor();
    this.view.redrawTool();
  }

  #draw(context) {
    const { view, stroke } = this;
    if (!view.mask) return;
    if (stroke?.spans) {
      const [x0, y0] = view.toScreen(...stroke.start);
      const [x1, y1] = view.toScreen(...stroke.end);
      twice(context, () => context.rect(Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0)));
    }
    const path = [...this.corners, ...(stroke?.ropes ? stroke.path : [])];
    if (path.length) this.#drawPath(context, path);
    const brushes = this.name === "brush" || this.name === "eraser";
    if (this.pointer && brushes && !view.spaceHeld && !this.locked) {
      const [x, y] = this.pointer;
      twice(context, () => context.arc(x, y, Math.max(1.5, this.radius * view.scale), 0, 2 * Math.PI), this.name === "eraser");
    }
  }

  #drawPath(context, path) {
    const { view, pointer, stroke } = this;
    twice(context, () => {
      path.forEach((corner, k) => {
        const [x, y] = view.toScreen(...corner);
        if (k) context.lineTo(x, y);
        else context.moveTo(x, y);
      });
      if (pointer && !stroke) context.lineTo(...pointer);
    });
    context.fillStyle = "#fff";
    context.strokeStyle = "#111";
    for (const corner of this.corners) {
      const [x, y] = view.toScreen(...corner);
      context.beginPath();
      context.arc(x, y, 3, 0, 2 * Math.PI);
      context.fill();
      context.stroke();
    }
  }
}

// Light on dark, to be seen on any picture.
function twice(context, trace, dashed = false) {
  for (const [style, width, dash] of [["rgb(0 0 0 / 0.75)", 3, []], ["#fff", 1.25, dashed ? [4, 3] : []]]) {
    context.beginPath();
    context.setLineDash(dash);
    context.strokeStyle = style;
    context.lineWidth = width;
    trace();
    context.stroke();
  }
  context.setLineDash([]);
}
