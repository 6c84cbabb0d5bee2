// Curves: what is read against time, and a training's learning curve.

import { sharp, style } from "./wake.js";

const SPAN = 40, FONT = "12px system-ui, sans-serif";
const NAMES = { c_d: "drag C_D", c_l: "lift C_L", power: "power C_P" };

export function named(name) { return NAMES[name] ?? name; }

function ticks(low, high, most) {
  const raw = (high - low) / most, ten = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * ten).find((k) => k >= raw);
  const found = [];
  for (let at = Math.ceil(low / step - 1e-9) * step; at <= high + 1e-9 * step; at += step) found.push(at);
  return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

function curve(context, points, x, y, colour, width, dash = []) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.lineJoin = "round";
  context.setLineDash(dash);
  context.beginPath();
  points.forEach(([a, b], k) => (k ? context.lineTo(x(a), y(b)) : context.moveTo(x(a), y(b))));
  context.stroke();
  context.setLineDash([]);
}

/** Draws axes in a box; returns what maps numbers to places. */
function axes(context, box, [x0, x1], [y0, y1]) {
  const x = (v) => box.x + ((v - x0) / (x1 - x0)) * box.w, y = (v) => box.y + box.h - ((v - y0) / (y1 - y0)) * box.h;
  context.font = FONT;
  context.fillStyle = style("soft");
  context.strokeStyle = style("line");
  context.lineWidth = 1;
  const rows = ticks(y0, y1, box.h > 90 ? 4 : 3);
  context.textAlign = "right";
  for (const at of rows.found) {
    context.beginPath();
    context.moveTo(box.x, y(at));
    context.lineTo(box.x + box.w, y(at));
    context.stroke();
    context.fillText(at.toFixed(rows.digits), box.x - 6, y(at) + 4);
  }
  context.textAlign = "center";
  for (const at of ticks(x0, x1, 4).found) context.fillText(String(Math.round(at)), x(at), box.y + box.h + 15);
  context.textAlign = "left";
  return { x, y };
}

export class Traces {
  #canvas; #shown = []; #rows = []; #ranges = [];

  constructor(canvas) { this.#canvas = canvas; }

  set shown(shown) { this.#shown = shown; this.#rows = []; this.#ranges = []; }

  set rows(rows) { this.#rows = rows; this.#ranges = []; }

  /** Takes a reading: its time, what was read with control, and without. */
  add(time, values) {
    const last = this.#rows.at(-1);
    if (!Number.isFinite(values[0]) || (last && time <= last[0])) return;
    this.#rows.push([time, ...values]);
    if (this.#rows.length > 2000) this.#rows.splice(0, 500);
  }

  get newest() { return this.#rows.at(-1); }

  draw(now = this.newest?.[0] ?? 0) {
    const width = this.#canvas.clientWidth, count = this.#shown.length;
    if (!count || !width) return;
    const wide = width >= 560, one = wide ? Math.max(150, Math.min(240, 0.25 * window.innerHeight)) : 138;
    const height = wide ? one : one * count, context = sharp(this.#canvas, width, height);
    context.clearRect(0, 0, width, height);
    const from = Math.max(now - SPAN, 0), rows = this.#rows.filter(([time]) => time >= from - 1);
    this.#shown.forEach((shown, k) => {
      const part = wide ? width / count : width;
      const box = { x: (wide ? k * part : 0) + 46, y: (wide ? 0 : one * k) + 24, w: part - 56, h: one - 44 };
      const with_ = rows.map((row) => [row[0], row[1 + k]]), without = rows.map((row) => [row[0], row[1 + count + k]]);
      const all = [shown.free, ...(shown.steady === null ? [] : [shown.steady])];
      for (const [, v] of with_) all.push(v);
      for (const [, v] of without) all.push(v);
      const range = this.#range(k, Math.min(...all), Math.max(...all), Math.abs(shown.free));
      const { x, y } = axes(context, box, [from, from + SPAN], range);
      context.save();
      context.beginPath();
      context.rect(box.x, box.y - 4, box.w, box.h + 8);
      context.clip();
      const across = (value) => [[from, value], [from + SPAN, value]];
      if (shown.steady !== null) curve(context, across(shown.steady), x, y, style("steady"), 2, [2, 4]);
      curve(context, across(shown.free), x, y, style("beside"), 1.5, [7, 5]);
      curve(context, without, x, y, style("beside"), 1.2);
      curve(context, with_, x, y, style("now"), 2.5);
      context.restore();
      context.fillStyle = style("ink");
      context.font = `600 ${FONT}`;
      const newest = with_.at(-1)?.[1];
      context.fillText(`${named(shown.name)}  ${newest === undefined ? "" : newest.toFixed(3)}`, box.x, box.y - 9);
      if (k === count - 1) {
        context.font = FONT;
        context.textAlign = "right";
        context.fillStyle = style("soft");
        context.fillText("time, L/U", box.x + box.w, box.y - 9);
        context.textAlign = "left";
      }
    });
  }

  /** Returns what an axis shows: it grows at once, and shrinks slowly. */
  #range(k, low, high, size) {
    const margin = 0.08 * Math.max(high - low, 0.02 * Math.max(size, 1)), wanted = [low - margin, high + margin];
    const kept = (this.#ranges[k] ??= wanted);
    return (this.#ranges[k] = [
      wanted[0] < kept[0] ? wanted[0] : kept[0] + 0.05 * (wanted[0] - kept[0]),
      wanted[1] > kept[1] ? wanted[1] : kept[1] + 0.05 * (wanted[1] - kept[1]),
    ]);
  }
}

/** Draws a learning curve: {name, points, total}. */
export function learning(canvas, { name, points, total }) {
  const width = canvas.clientWidth, height = 150;
  if (!width || !points.length) return;
  const context = sharp(canvas, width, height), box = { x: 40, y: 24, w: width - 52, h: height - 44 };
  context.clearRect(0, 0, width, height);
  const values = points.map(([, v]) => v), low = Math.min(0, ...values), high = Math.max(...values, low + 0.1);
  const margin = 0.08 * (high - low), { x, y } = axes(context, box, [0, Math.max(total, 1)], [low - margin, high + margin]);
  curve(context, points, x, y, style("now"), 2);
  context.fillStyle = style("ink");
  context.font = `600 ${FONT}`;
  context.fillText(name, box.x, box.y - 9);
}
