// What a page is shown where no server runs: recorded episodes, one for each of who drives.

import { Source } from "./source.js";

const AGAIN = 2000; // milliseconds at the end, before it begins anew

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Returns a recording: its layout, and of each driver numbers and fields. Rows are kept as changes from the left. */
async function recording(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  const buffer = await answer.arrayBuffer(), length = new DataView(buffer).getUint32(0, true);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const fields = await inflated(new Uint8Array(buffer, 4 + length));
  const size = about.width * about.height, one = size * about.frames;
  about.fields = {};
  about.drivers.forEach((name, k) => {
    const mine = fields.subarray(k * one, (k + 1) * one);
    for (let at = 0; at < one; at++) if (at % about.width) mine[at] += mine[at - 1];
    for (let at = 0; at < one; at++) mine[at] = (mine[at] << 1) | (mine[at] >> 6);
    about.fields[name] = Array.from({ length: about.frames }, (_, t) => mine.subarray(t * size, (t + 1) * size));
  });
  return about;
}

export class Demo extends Source {
  #kept = {}; #shown = null; #t = 0; #timer = 0; #layout = 0;
  #state = { by: "none", hand: [], paused: false, speed: 5, reached: null, field: "vorticity", busy: null, notice: null, score: null };

  async start() {
    try {
      this.cases = await (await fetch("cases.json")).json();
      await this.#open(this.cases[0].name);
      this.tell("link", { there: true });
    } catch (error) {
      this.tell("link", { there: false, again: false, reason: `The recordings cannot be read (${error.message}).` });
    }
  }

  async #open(name) {
    clearTimeout(this.#timer);
    this.tell("state", { ...this.#state, busy: { what: `loading ${name}`, share: 0.5 } });
    this.#shown = this.#kept[name] ??= await recording(`${name}.wake`);
    this.#layout += 1;
    this.#t = 0;
    if (!this.#shown.drivers.includes(this.#state.by)) this.#state.by = "none";
    this.tell("layout", { ...this.#shown.layout, id: this.#layout, cases: this.cases });
    this.#begin();
  }

  #begin() {
    this.#t = 0;
    this.tell("traces", { id: this.#layout, rows: [] });
    this.tell("state", this.#state);
    this.#next();
  }

  #next() {
    clearTimeout(this.#timer);
    const shown = this.#shown, t = this.#t, by = this.#state.by;
    this.tell("frame", {
      number: t, layout: this.#layout, field: 0, width: shown.width, height: shown.height,
      numbers: Float32Array.from(shown.numbers[by][t], (x) => x ?? NaN),
      lanes: [shown.fields.none[t], shown.fields[by][t]],
    });
    if (this.#state.paused) return;
    const last = t + 1 >= shown.frames, wait = last ? AGAIN : (1000 * shown.interval) / this.#state.speed;
    this.#timer = setTimeout(() => { if (last) this.#begin(); else { this.#t += 1; this.#next(); } }, wait);
  }

  send(type, what = {}) {
    if (type === "open") { this.#open(what.case); return; }
    if (type === "reset") { this.#begin(); return; }
    if (type === "drive" && this.#shown?.drivers.includes(what.by)) {
      this.#state.by = what.by;
      // what was shown so far is told anew, as it was under the other
      const rows = this.#shown.numbers[what.by].slice(0, this.#t + 1).map((n) => [n[1], ...n.slice(5, 5 + 2 * this.#shown.layout.shown.length)]);
      this.tell("traces", { id: this.#layout, rows: rows.filter((row) => !row.includes(null)) });
    } else if (type === "pause") this.#state.paused = what.on;
    else if (type === "speed") this.#state.speed = what.value;
    this.tell("state", this.#state);
    if (this.#shown) this.#next();
  }

  drawn() {}
}
