// What a page is shown, live: frames and notes from the server's socket, and messages to it.

const HEADER = 20, MAGIC = 0x656b6177; // "wake", the lowest byte first
const REASONS = {
  4401: "This page has no key of the server that runs now. Open the address that manywake play printed.",
  4429: "As many pages look as may. Close one of them; this one tries again.",
  4408: "This page sent too much at once. It tries again.",
  1011: "The flow's thread has ended. The terminal says why.",
};

/** Lets functions be called by what happened: on(kind, call), tell(kind, what). */
export class Source {
  calls = {};
  on(kind, call) { (this.calls[kind] ??= []).push(call); }
  tell(kind, what) { for (const call of this.calls[kind] ?? []) call(what); }
}

/** Returns what a frame holds: its number, that of its layout, the field, numbers, and a Uint8Array for each lane. */
export function decode(buffer) {
  const view = new DataView(buffer);
  if (view.getUint32(0, true) !== MAGIC) throw new Error("not a frame");
  const [layout, width, height, count] = [8, 12, 14, 16].map((at) => view.getUint16(at, true));
  const numbers = new Float32Array(buffer.slice(HEADER, HEADER + 4 * count));
  const lanes = [], first = HEADER + 4 * count, size = width * height;
  for (let k = 0; k < view.getUint8(11); k++) lanes.push(new Uint8Array(buffer, first + k * size, size));
  return { number: view.getUint32(4, true), layout, field: view.getUint8(10), width, height, numbers, lanes };
}

export class Live extends Source {
  #key; #socket = null; #wait = 500; #timer = 0;

  constructor(key) { super(); this.#key = key; }

  start() {
    clearTimeout(this.#timer);
    const socket = new WebSocket(`ws://${location.host}/live?key=${encodeURIComponent(this.#key)}`);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    socket.onopen = () => { this.#wait = 500; this.tell("link", { there: true }); };
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") {
        const said = JSON.parse(data);
        this.tell(said.type, said);
      } else this.tell("frame", decode(data));
    };
    socket.onclose = ({ code }) => {
      const again = code !== 4401;
      this.tell("link", { there: false, again, reason: REASONS[code] ?? "The server is gone. This page looks for it." });
      if (again) this.#timer = setTimeout(() => this.start(), this.#wait);
      this.#wait = Math.min(2 * this.#wait, 4000);
    };
  }

  send(type, what = {}) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify({ type, ...what }));
  }

  /** Says that a frame was drawn, so that the next may come. */
  drawn(frame) { this.send("seen", { frame: frame.number }); }
}
