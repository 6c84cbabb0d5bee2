// What can be taken away: a picture, a film, or a link with the settings, which never has the key.

function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

/** Draws what is seen, field above traces, and a line that says what it is. */
function compose(canvas, parts, title, ground, ink) {
  const width = Math.max(...parts.map((part) => part.width)) & ~1, head = Math.round(width / 34);
  const height = (parts.reduce((sum, part) => sum + part.height, head + 8) + 1) & ~1;
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const context = canvas.getContext("2d");
  context.fillStyle = ground;
  context.fillRect(0, 0, width, height);
  context.fillStyle = ink;
  context.font = `${Math.round(head * 0.6)}px system-ui, sans-serif`;
  context.fillText(title, 8, head * 0.72);
  let y = head;
  for (const part of parts) { context.drawImage(part, 0, y); y += part.height + 8; }
}

export class Share {
  #parts; #title; #colours; #film = null; #canvas = document.createElement("canvas");

  /** parts: canvases. title, colours: functions that return the line above them, and [ground, ink]. */
  constructor(parts, title, colours) { this.#parts = parts; this.#title = title; this.#colours = colours; }

  #compose(canvas) { compose(canvas, this.#parts, this.#title(), ...this.#colours()); }

  picture(name) {
    const canvas = document.createElement("canvas");
    this.#compose(canvas);
    canvas.toBlob((blob) => save(blob, `${name}.png`));
  }

  get filming() { return this.#film !== null; }

  /** Begins a film, or ends it and saves it; returns whether it goes on, and null where the browser makes none. */
  film(name) {
    if (this.#film) { this.#film.stop(); this.#film = null; return false; }
    if (!window.MediaRecorder || !this.#canvas.captureStream) return null;
    const kind = ["video/webm;codecs=vp9", "video/webm", "video/mp4"].find((one) => MediaRecorder.isTypeSupported(one));
    if (!kind) return null;
    this.#compose(this.#canvas);
    const film = new MediaRecorder(this.#canvas.captureStream(30), { mimeType: kind, videoBitsPerSecond: 6e6 }), pieces = [];
    film.ondataavailable = ({ data }) => pieces.push(data);
    film.onstop = () => save(new Blob(pieces, { type: kind }), `${name}.${kind.includes("mp4") ? "mp4" : "webm"}`);
    film.start(1000);
    this.#film = film;
    return true;
  }

  /** Takes a frame into the film, if there is one. */
  drawn() { if (this.#film) this.#compose(this.#canvas); }
}

const KNOWN = ["case", "re", "by", "field", "speed", "both", "sensors"];

/** Returns the address of this page with settings. */
export function link(settings) {
  const kept = new URLSearchParams(Object.entries(settings).filter(([name]) => KNOWN.includes(name)));
  return `${location.origin}${location.pathname}#${kept}`;
}

/** Returns the key and the settings that the address has, and takes the key out of it. */
export function linked() {
  const said = new URLSearchParams(location.hash.slice(1)), key = said.get("key");
  const settings = Object.fromEntries([...said].filter(([name]) => KNOWN.includes(name)));
  if (key !== null) history.replaceState(null, "", location.pathname + location.search);
  return { key, settings };
}
