// The picture with the mask over it, zoomed and moved.
//
// The mask is drawn per pixel of the screen, so that it is sharp at every zoom and costs the
// same for every size of picture.

const LARGEST_ZOOM = 32;
const MARGIN_PX = 24;

// What the eye is shown, as [red, green, blue]: clutter behind a veil, the object tinted, or
// the outline alone.
const VEIL = [26, 28, 30];
const TINT = [0, 150, 136];
const OUTLINE = [255, 214, 64];

export class View extends EventTarget {
  constructor(stage) {
    super();
    this.stage = stage;
    [this.pictureCanvas, this.maskCanvas, this.toolCanvas] = stage.querySelectorAll("canvas");
    this.scale = 1;
    this.left = 0;
    this.top = 0;
    this.turns = 0;
    this.mode = "veil";
    this.opacity = 0.5;
    this.hidden = false;
    this.drawTool = null;
    this.fitted = true;
    new ResizeObserver(() => this.#resize()).observe(stage);
    this.#resize();
  }

  show(bitmap, mask, turns) {
    this.bitmap?.close();
    this.bitmap = bitmap;
    this.mask = mask;
    this.turn(turns);
  }

  // Quarter turns clockwise; scanners do not always stand upright.
  turn(turns) {
    this.turns = turns % 4;
    this.fit();
  }

  // Screen to picture, in pixels of the mask.
  toPicture(x, y) {
    const { width, height } = this.mask;
    const [u, v] = [(x - this.left) / this.scale, (y - this.top) / this.scale];
    return [[u, v], [v, height - u], [width - u, height - v], [width - v, u]][this.turns];
  }

  toScreen(x, y) {
    const { width, height } = this.mask;
    const turned = [[x, y], [height - y, x], [width - x, height - y], [y, width - x]];
    const [u, v] = turned[this.turns];
    return [u * this.scale + this.left, v * this.scale + this.top];
  }

  // Width and height as they are seen.
  get #seen() {
    const { width, height } = this.mask;
    return this.turns % 2 ? [height, width] : [width, height];
  }

  fit() {
    this.fitted = true;
    if (this.mask) {
      const { clientWidth: width, clientHeight: height } = this.stage;
      const [across, down] = this.#seen;
      this.scale = Math.min(
        Math.max(1, width - 2 * MARGIN_PX) / across,
        Math.max(1, height - 2 * MARGIN_PX) / down,
      );
      this.left = (width - across * this.scale) / 2;
      this.top = (height - down * this.scale) / 2;
    }
    this.redraw();
  }

  // Zooms about a point of the screen, its middle if none is told.
  zoom(factor, x = this.stage.clientWidth / 2, y = this.stage.clientHeight / 2) {
    if (!this.mask) return;
    const smallest = Math.min(1, 64 / Math.max(this.mask.width, this.mask.height));
    const scale = Math.min(LARGEST_ZOOM, Math.max(smallest, this.scale * factor));
    this.left = x - ((x - this.left) * scale) / this.scale;
    this.top = y - ((y - this.top) * scale) / this.scale;
    this.scale = scale;
    this.fitted = false;
    this.#hold();
  }

  move(dx, dy) {
    this.left += dx;
    this.top += dy;
    this.fitted = false;
    this.#hold();
  }

  redraw() {
    if (this.frame) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = null;
      this.#drawPicture();
      this.redrawMask();
      this.redrawTool();
      this.dispatchEvent(new Event("moved"));
    });
  }

  redrawMask() {
    this.maskFrame ??= requestAnimationFrame(() => {
      this.maskFrame = null;
      this.#drawMask();
    });
  }

  redrawTool() {
    const context = this.toolCanvas.getContext("2d");
    const ratio = devicePixelRatio;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.stage.clientWidth, this.stage.clientHeight);
    this.drawTool?.(context);
  }

  // Some of the picture stays on the screen.
  #hold() {
    const { clientWidth: width, clientHeight: height } = this.stage;
    const stays = 2 * MARGIN_PX;
    const [across, down] = this.#seen;
    this.left = Math.min(width - stays, Math.max(stays - across * this.scale, this.left));
    this.top = Math.min(height - stays, Math.max(stays - down * this.scale, this.top));
    this.redraw();
  }

  #resize() {
    const ratio = devicePixelRatio;
    for (const canvas of [this.pictureCanvas, this.maskCanvas, this.toolCanvas]) {
      canvas.width = Math.max(1, Math.round(this.stage.clientWidth * ratio));
      canvas.height = Math.max(1, Math.round(this.stage.clientHeight * ratio));
    }
    if (this.fitted) this.fit();
    else this.redraw();
  }

  #drawPicture() {
    const context = this.pictureCanvas.getContext("2d");
    const ratio = devicePixelRatio;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.pictureCanvas.width, this.pictureCanvas.height);
    if (!this.bitmap || !this.mask) return;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.imageSmoothingEnabled = this.scale < 3;
    context.imageSmoothingQuality = "high";
    const { width, height } = this.mask;
    const scale = ratio * this.scale;
    const [cos, sin] = [[1, 0], [0, 1], [-1, 0], [0, -1]][this.turns];
    const [left, top] = this.toScreen(0, 0);
    context.setTransform(cos * scale, sin * scale, -sin * scale, cos * scale, left * ratio, top * ratio);
    context.drawImage(this.bitmap, 0, 0, width, height);
  }

  #drawMask() {
    const context = this.maskCanvas.getContext("2d");
    const { width, height } = this.maskCanvas;
    context.clearRect(0, 0, width, height);
    if (!this.mask || this.hidden) return;
    const [across, down] = this.#seen;
    const columns = screenToMask(width, this.left, this.scale, across);
    const rows = screenToMask(height, this.top, this.scale, down);
    this.#turnOffsets(columns.at, rows.at);
    if (columns.from >= columns.to || rows.from >= rows.to) return;
    const image = new ImageData(columns.to - columns.from, rows.to - rows.from);
    paint(new Uint32Array(image.data.buffer), this.mask.data, columns.at, rows.at, this.#colors());
    context.putImageData(image, columns.from, rows.from);
  }

  // From the column and the row that is seen to what each adds to the place in the mask.
  #turnOffsets(columns, rows) {
    const { width, height } = this.mask;
    const last = width * height - width;
    const [across, along] = [
      [(x) => x, (y) => y * width],
      [(x) => last - x * width, (y) => y],
      [(x) => width - 1 - x, (y) => last - y * width],
      [(x) => x * width, (y) => width - 1 - y],
    ][this.turns];
    for (let k = 0; k < columns.length; k++) columns[k] = across(columns[k]);
    for (let k = 0; k < rows.length; k++) rows[k] = along(rows[k]);
  }

  #colors() {
    const alpha = Math.round(255 * this.opacity);
    return {
      keep: this.mode === "tint" ? rgba(TINT, alpha) : 0,
      clutter: this.mode === "veil" ? rgba(VEIL, alpha) : 0,
      outline: rgba(OUTLINE, this.mode === "outline" ? Math.max(alpha, 128) : 255),
    };
  }
}

// Which row or column of the turned mask lies under each pixel of the screen in from … to.
function screenToMask(length, start, scale, size) {
  const ratio = devicePixelRatio;
  const from = Math.max(0, Math.ceil(start * ratio - 0.5));
  const to = Math.min(length, Math.ceil((start + size * scale) * ratio - 0.5));
  const at = new Int32Array(Math.max(0, to - from));
  for (let k = 0; k < at.length; k++) {
    const position = Math.floor(((k + from + 0.5) / ratio - start) / scale);
    at[k] = Math.min(size - 1, Math.max(0, position));
  }
  return { from, to, at };
}

// Outlines are where the next pixel of the screen, to the right or below, is of the other kind.
function paint(pixels, data, columns, rows, { keep, clutter, outline }) {
  let k = 0;
  for (let y = 0; y < rows.length; y++) {
    const row = rows[y];
    const below = rows[Math.min(y + 1, rows.length - 1)];
    let here = data[row + columns[0]];
    for (let x = 0; x < columns.length; x++) {
      const next = data[row + columns[Math.min(x + 1, columns.length - 1)]];
      const edge = here !== next || here !== data[below + columns[x]];
      pixels[k++] = edge ? outline : here ? keep : clutter;
      here = next;
    }
  }
}

// As it lies in memory on the little-endian machines there are.
function rgba([red, green, blue], alpha) {
  return ((alpha << 24) | (blue << 16) | (green << 8) | red) >>> 0;
}
