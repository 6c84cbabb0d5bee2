// Draws one or two lanes of a flow: the field, bodies, actuators by their amplitude, sensors; the view can be moved.

import { amplitude, table } from "./colours.js";

const GAP = 8, MOST = 8;

/** Returns what of the style sheet is drawn with. */
export function style(name) { return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim(); }

/** Makes a canvas as sharp as the screen; returns its context, in CSS pixels. */
export function sharp(canvas, width, height) {
  const scale = Math.min(window.devicePixelRatio || 1, 2);
  const [w, h] = [Math.round(width * scale), Math.round(height * scale)];
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; canvas.style.height = `${height}px`; }
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  return context;
}

export class Wake {
  both = true; sensors = false; names = ["without control", "with control"];
  #canvas; #layout = null; #frame = null; #lanes = []; #zoom = 1; #centre = [0.5, 0.5]; #tables = {}; #pixels = []; #shape = 0;
  changed = () => {};

  constructor(canvas) {
    this.#canvas = canvas;
    this.#moving();
  }

  set layout(layout) {
    this.#layout = layout;
    this.#frame = null;
    this.whole();
  }

  recolour() {
    const dark = document.documentElement.dataset.theme === "dark";
    this.#tables = { two: table(dark ? "dark" : "light"), one: table("one") };
  }

  colours(field) { return this.#layout.fields[field].diverging ? this.#tables.two : this.#tables.one; }

  draw(frame = this.#frame) {
    if (!this.#layout || !frame) return;
    this.#frame = frame;
    const width = this.#canvas.clientWidth, ratio = frame.height / frame.width;
    const which = this.both ? [0, 1] : [1], beside = this.both && ratio > 0.36 && width >= 640;
    const rows = beside ? 1 : which.length, most = Math.max(260, 0.58 * window.innerHeight);
    let laneWidth = beside ? (width - GAP) / 2 : width;
    const height = Math.min(laneWidth * ratio, (most - (rows - 1) * GAP) / rows);
    laneWidth = Math.min(laneWidth, height / ratio);
    const used = beside ? 2 * laneWidth + GAP : laneWidth, left = (width - used) / 2;
    this.#lanes = which.map((lane, k) => ({
      lane, x: left + (beside ? k * (laneWidth + GAP) : 0), y: beside ? 0 : k * (height + GAP), w: laneWidth, h: height,
    }));
    const context = sharp(this.#canvas, width, Math.round(rows * height + (rows - 1) * GAP));
    context.clearRect(0, 0, width, rows * height + GAP);
    for (const place of this.#lanes) this.#lane(context, place, frame);
  }

  #lane(context, place, frame) {
    const { lane, x, y, w, h } = place, z = this.#zoom, [cx, cy] = this.#centre;
    context.save();
    context.beginPath();
    context.roundRect(x, y, w, h, 6);
    context.clip();
    const image = this.#image(lane, frame);
    context.imageSmoothingEnabled = true;
    context.imageSmoothingQuality = "high";
    const { width: W, height: H } = frame;
    context.drawImage(image, (cx - 0.5 / z) * W, (cy - 0.5 / z) * H, W / z, H / z, x, y, w, h);
    const [x0, x1] = this.#layout.view.x, [y0, y1] = this.#layout.view.y;
    const at = ([px, py]) => [
      x + (((px - x0) / (x1 - x0) - cx) * z + 0.5) * w, y + (((y1 - py) / (y1 - y0) - cy) * z + 0.5) * h,
    ];
    const path = (points, closed) => {
      points.forEach((point, k) => (k ? context.lineTo(...at(point)) : context.moveTo(...at(point))));
      if (closed) context.closePath();
    };
    context.fillStyle = style("wall");
    context.beginPath();
    context.rect(x - 1, y - 1, w + 2, h + 2);
    path(this.#layout.domain, true);
    context.fill("evenodd");
    context.fillStyle = style("body");
    for (const body of this.#layout.bodies) { context.beginPath(); path(body, true); context.fill(); }
    const amplitudes = lane === 1 ? frame.numbers.slice(5 + 2 * this.#layout.shown.length) : [];
    this.#layout.actuators.forEach(({ lines }, k) => {
      const a = amplitudes[k] || 0;
      context.lineCap = "round";
      const thick = (w / 190) * Math.sqrt(z) + 1;
      const stroke = (colour, width) => {
        context.strokeStyle = colour;
        context.lineWidth = width;
        for (const line of lines) { context.beginPath(); path(line, false); context.stroke(); }
      };
      stroke("#14181d", thick + 2.5);
      context.shadowColor = amplitude(Math.sign(a));
      context.shadowBlur = 45 * Math.min(Math.abs(a), 1);
      stroke(amplitude(a), thick);
      if (Math.abs(a) > 0.25) stroke(amplitude(a), thick);
      context.shadowBlur = 0;
    });
    if (this.sensors) {
      context.fillStyle = style("ink");
      context.globalAlpha = 0.6;
      for (const { points } of this.#layout.sensors) {
        for (const point of points) { const [px, py] = at(point); context.fillRect(px - 1.5, py - 1.5, 3, 3); }
      }
      context.globalAlpha = 1;
    }
    context.font = "600 13px system-ui, sans-serif";
    const name = this.names[lane], size = context.measureText(name).width;
    context.fillStyle = style("ground");
    context.globalAlpha = 0.82;
    context.beginPath();
    context.roundRect(x + 8, y + 8, size + 16, 22, 5);
    context.fill();
    context.globalAlpha = 1;
    context.fillStyle = lane ? style("now") : style("beside");
    context.fillText(name, x + 16, y + 23);
    context.restore();
  }

  #image(lane, frame) {
    const size = frame.width * 65536 + frame.height;
    if (this.#shape !== size) { this.#pixels = []; this.#shape = size; }
    const kept = (this.#pixels[lane] ??= (() => {
      const canvas = document.createElement("canvas");
      [canvas.width, canvas.height] = [frame.width, frame.height];
      const context = canvas.getContext("2d"), data = context.createImageData(frame.width, frame.height);
      return { canvas, context, data, pixels: new Uint32Array(data.data.buffer) };
    })());
    const colour = this.colours(frame.field), levels = frame.lanes[lane];
    for (let k = 0; k < levels.length; k++) kept.pixels[k] = colour[levels[k]];
    kept.context.putImageData(kept.data, 0, 0);
    return kept.canvas;
  }

  whole() { this.#zoom = 1; this.#centre = [0.5, 0.5]; this.#bound(); }

  zoom(factor, at = [0.5, 0.5]) {
    const before = this.#zoom, now = Math.max(1, Math.min(MOST, before * factor));
    this.#centre = this.#centre.map((c, k) => c + (at[k] - 0.5) * (1 / before - 1 / now));
    this.#zoom = now;
    this.#bound();
  }

  move(dx, dy) {
    this.#centre = [this.#centre[0] - dx / this.#zoom, this.#centre[1] - dy / this.#zoom];
    this.#bound();
  }

  #bound() {
    const half = 0.5 / this.#zoom;
    this.#centre = this.#centre.map((c) => Math.max(half, Math.min(1 - half, c)));
    this.changed();
  }

  #moving() {
    const canvas = this.#canvas, held = new Map();
    const place = (event) => {
      const box = canvas.getBoundingClientRect(), [px, py] = [event.clientX - box.left, event.clientY - box.top];
      const lane = this.#lanes.find(({ x, y, w, h }) => px >= x && px <= x + w && py >= y && py <= y + h) ?? this.#lanes[0];
      return lane ? [(px - lane.x) / lane.w, (py - lane.y) / lane.h] : [0.5, 0.5];
    };
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 400), place(event));
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); held.set(event.pointerId, event); });
    canvas.addEventListener("pointermove", (event) => {
      const before = held.get(event.pointerId);
      if (!before || !this.#lanes.length) return;
      held.set(event.pointerId, event);
      if (held.size === 1) {
        const { w, h } = this.#lanes[0];
        this.move((event.clientX - before.clientX) / w, (event.clientY - before.clientY) / h);
      } else if (held.size === 2) {
        const [other] = [...held.values()].filter((one) => one.pointerId !== event.pointerId);
        const apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
        this.zoom(apart(event) / Math.max(apart(before), 1), place(event));
      }
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => held.delete(event.pointerId));
    canvas.addEventListener("dblclick", () => this.whole());
    canvas.addEventListener("keydown", (event) => {
      const step = 0.12, moves = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
      if (moves[event.key]) { this.move(...moves[event.key]); event.preventDefault(); }
      if (event.key === "+" || event.key === "=") this.zoom(1.25);
      if (event.key === "-") this.zoom(0.8);
    });
  }
}
