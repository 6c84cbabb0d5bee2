// The hand: a slider for each action, and two keys that drive it as long as they are held.

const UP = ["KeyQ", "KeyW", "KeyE", "KeyR", "KeyT", "KeyY"], DOWN = ["KeyA", "KeyS", "KeyD", "KeyF", "KeyG", "KeyH"];
const TOUCHED = 1500; // milliseconds in which the page knows better than the server what the hand does

export class Hands {
  #box; #act; #sliders = []; #values = []; #due = false; #touched = -Infinity; #held = new Set();

  /** act: called with all actions, at most once a frame. */
  constructor(box, act) { this.#box = box; this.#act = act; }

  set layout({ actions }) {
    this.#values = actions.map(() => 0);
    this.#box.replaceChildren(Object.assign(document.createElement("h2"), { textContent: "By hand" }));
    this.#sliders = actions.map((name, k) => {
      const label = document.createElement("label"), head = document.createElement("span"), says = document.createElement("output");
      label.className = "pull";
      const text = document.createElement("span"), keys = document.createElement("span");
      text.textContent = name;
      if (k < UP.length) {
        keys.append(...[DOWN[k], UP[k]].map((code) => Object.assign(document.createElement("kbd"), { textContent: code.slice(3) })));
      }
      head.append(text, keys, says);
      const slider = Object.assign(document.createElement("input"), { type: "range", min: -1, max: 1, step: 0.01, value: 0 });
      slider.setAttribute("aria-label", `${name}, in units of its limit`);
      slider.addEventListener("input", () => this.#set(k, Number(slider.value)));
      slider.addEventListener("dblclick", () => this.#set(k, 0));
      label.append(head, slider);
      this.#box.append(label);
      return { slider, says };
    });
    this.#show();
  }

  get values() { return [...this.#values]; }

  /** Takes what the server knows of the hand, unless it was just moved here. */
  set values(values) {
    if (performance.now() - this.#touched < TOUCHED || values.length !== this.#values.length) return;
    this.#values = [...values];
    this.#show();
  }

  #set(k, value) {
    this.#values[k] = value;
    this.#touched = performance.now();
    this.#show();
    if (this.#due) return;
    this.#due = true;
    requestAnimationFrame(() => { this.#due = false; this.#act(this.values); });
  }

  #show() {
    this.#sliders.forEach(({ slider, says }, k) => {
      slider.value = this.#values[k];
      says.textContent = `${this.#values[k] > 0 ? "+" : ""}${this.#values[k].toFixed(2)}`;
    });
  }

  /** Takes a key that goes down or up; returns whether it was one of the hand's. */
  key(event, down) {
    const k = [UP, DOWN].map((codes) => codes.indexOf(event.code)).find((at) => at >= 0 && at < this.#values.length);
    if (k === undefined) return false;
    if (event.repeat) return true;
    if (down) this.#held.add(event.code); else if (!this.#held.delete(event.code)) return false;
    this.#set(k, Number(this.#held.has(UP[k])) - Number(this.#held.has(DOWN[k])));
    return true;
  }

  /** Lets go of all keys, as when the page loses the focus. */
  release() {
    for (const code of this.#held) { this.#held.delete(code); this.#set(Math.max(UP.indexOf(code), DOWN.indexOf(code)), 0); }
  }
}
