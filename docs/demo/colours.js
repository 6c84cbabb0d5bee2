// Colour maps as 256 colours. Blue and red depart from the middle, which is light or dark as the page is; both are told
// apart with every kind of colour blindness.

const MAPS = {
  light: ["053061", "2166ac", "4393c3", "92c5de", "d1e5f0", "f7f7f7", "fddbc7", "f4a582", "d6604d", "b2182b", "67001f"],
  dark: ["c3d9ff", "8fb8f2", "5b95d6", "2f6ea9", "1c4468", "151b22", "5a2420", "96392f", "cf5f4b", "f09a7d", "ffd9c4"],
  one: ["00224e", "123570", "3b496c", "575d6d", "707173", "8a8678", "a59c74", "c3b369", "e1cc55", "fee838"],
  amplitude: ["5e2d9b", "7b55b5", "9d85cc", "c3b4dd", "e6e0ee", "f5f5f5", "fbe3c0", "f6bf74", "e8952c", "c96f0a", "9a4c00"],
};

function parts(hex) { return [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16)); }

/** Returns the 256 colours of a map as [r, g, b]. */
export function colours(name) {
  const anchors = MAPS[name].map(parts), last = anchors.length - 1;
  return Array.from({ length: 256 }, (_, k) => {
    const at = (k / 255) * last, low = Math.min(Math.floor(at), last - 1), share = at - low;
    return anchors[low].map((c, i) => Math.round(c + share * (anchors[low + 1][i] - c)));
  });
}

/** Returns the same as numbers that a Uint32Array of pixels takes. */
export function table(name) {
  return Uint32Array.from(colours(name), ([r, g, b]) => (0xff000000 | (b << 16) | (g << 8) | r) >>> 0);
}

const amplitudes = colours("amplitude");

/** Returns the colour of an amplitude in units of its limit: purple where it sucks or turns clockwise, else orange. */
export function amplitude(share) {
  const k = Math.max(0, Math.min(255, Math.round(127.5 + share * 120)));
  return `rgb(${amplitudes[k].join(" ")})`;
}
