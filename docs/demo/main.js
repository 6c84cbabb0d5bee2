// The page: what comes from the source is drawn, what is pressed goes to it.

import { colours } from "./colours.js";
import { Demo } from "./demo.js";
import { Hands } from "./hands.js";
import { Share, link, linked } from "./share.js";
import { Live } from "./source.js";
import { Traces, learning, named } from "./strip.js";
import { Wake, style } from "./wake.js";

const $ = (id) => document.getElementById(id);
const demo = document.documentElement.dataset.source === "demo";
const CALM = window.matchMedia("(prefers-reduced-motion: reduce)"), CALM_WAIT = 500;
const DRIVERS = {
  hand: ["Hand", "The sliders or the keys drive."],
  none: ["None", "Nothing acts: both flows are the same."],
  constant: ["Constant", "The constant action with the best reward that a search found."],
  harmonic: ["Harmonic", "The sine with the best reward that a search found."],
  feedback: ["Feedback", "The answer to the lift with the best reward that a search found."],
  policy: ["Policy", "A network that learnt by reinforcement, without noise."],
};

// ---- what is kept in the browser

function kept(name, value) {
  try {
    if (value === undefined) return localStorage.getItem(`manywake-${name}`);
    localStorage.setItem(`manywake-${name}`, value);
  } catch { /* a browser that keeps nothing */ }
  return null;
}

const given = linked();
if (given.key) kept("key", given.key);
const source = demo ? new Demo() : new Live(given.key ?? kept("key") ?? "");
let wanted = given.settings, layout = null, state = {}, frame = null, due = false, game = null, newest = null, curve = null;
let told = 0, refused = 0, times = [];

const wake = new Wake($("field")), traces = new Traces($("traces"));
const hands = new Hands($("hand"), (actions) => {
  if (state.by !== "hand") source.send("drive", { by: "hand" });
  source.send("hand", { actions });
});
const share = new Share([$("field"), $("traces")], title, () => [style("ground"), style("ink")]);

// ---- dark and light

const night = window.matchMedia("(prefers-color-scheme: dark)");
function theme(name = kept("theme") ?? (night.matches ? "dark" : "light")) {
  document.documentElement.dataset.theme = name;
  wake.recolour();
  if (layout && newest) { legend(); redraw(); }
}
$("theme").onclick = () => {
  const name = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  kept("theme", name);
  theme(name);
};
night.addEventListener("change", () => theme());
theme();

// ---- what comes

function banner(text) { $("banner").hidden = !text; $("banner").textContent = text ?? ""; }

source.on("link", ({ there, reason }) => {
  banner(there ? null : reason);
  document.body.dataset.link = there ? "there" : "gone";
  if (!there) $("status").textContent = "";
});

source.on("layout", (said) => {
  layout = said;
  wake.layout = hands.layout = said;
  traces.shown = said.shown;
  newest = null;
  $("title-case").textContent = `${demo ? "recorded" : "play"} · ${said.name}, Re ${round(said.reynolds)}`;
  choice($("fields"), said.fields.map(({ name }) => [name, name]), (name) => source.send("field", { name }));
  choice($("drive"), said.drivers.map((name) => [name, DRIVERS[name]?.[0] ?? name]), drive);
  $("case").replaceChildren(...said.cases.map(({ name }) => new Option(name, name, false, name === said.case)));
  $("reynolds").value = round(said.reynolds);
  [$("reynolds").min, $("reynolds").max] = said.reynolds_range.map(round);
  $("saved-name").textContent = said.shown[0].name === "c_d" ? "Drag saved" : `Less ${named(said.shown[0].name)}`;
  $("game").hidden = said.scored === null;
  $("best").textContent = best() === null ? "" : `best ${best().toFixed(1)} %`;
  $("trace-key").querySelector(".steady").hidden = said.shown.every(({ steady }) => steady === null);
  $("sensors").disabled = !said.sensors.length;
  game = null;
  settle();
});

source.on("state", (said) => {
  state = said;
  $("making").hidden = !said.busy;
  if (said.busy) { $("making-what").textContent = said.busy.what; $("making-share").value = said.busy.share; }
  $("cancel").hidden = demo;
  checked($("drive"), said.by);
  checked($("fields"), said.field);
  $("drive-says").textContent = DRIVERS[said.by]?.[1] ?? "";
  wake.names[1] = said.by === "none" ? "not driven either" : `driven: ${(DRIVERS[said.by]?.[0] ?? said.by ?? "").toLowerCase()}`;
  $("pause").textContent = said.paused ? "Go on" : "Pause";
  if (document.activeElement !== $("speed")) $("speed").value = Math.log2(said.speed);
  $("speed-says").textContent = `${said.speed.toFixed(said.speed < 2 ? 2 : 1)} L/U a s`;
  hands.values = said.hand;
  if (said.notice && said.notice.id !== refused) { refused = said.notice.id; banner(said.notice.text); }
  else if (!said.notice && document.body.dataset.link === "there") banner(null);
  scored(said.score);
});

source.on("error", ({ message }) => banner(message));
source.on("traces", ({ id, rows }) => { if (id === layout?.id) traces.rows = rows; });
source.on("training", ({ problem, curve: found, version, run }) => {
  $("training").hidden = false;
  if (problem) { $("training-says").textContent = problem; return; }
  curve = found ?? curve;
  const done = curve ? `${curve.done} of ${curve.total} episodes${curve.minutes === null ? "" : ` in ${curve.minutes} min`}` : "no episode yet";
  $("training-says").textContent = `${run}: ${done}. The policy is that after ${version} updates.`;
  if (curve) learning($("curve"), curve);
});

source.on("frame", (said) => {
  if (said.layout !== layout?.id) { source.drawn(said); return; }
  frame = said;
  const n = layout.shown.length, numbers = said.numbers;
  traces.add(numbers[1], [...numbers.slice(5, 5 + 2 * n)]);
  if (due) return;
  due = true;
  if (CALM.matches && !state.paused) setTimeout(() => requestAnimationFrame(paint), CALM_WAIT);
  else requestAnimationFrame(paint);
});

function paint() {
  due = false;
  if (!frame || frame.layout !== layout.id) return;
  const changed = newest?.field !== frame.field || newest === null;
  newest = frame;
  if (changed) legend();
  redraw();
  share.drawn();
  source.drawn(frame);
  const now = performance.now();
  times = times.filter((time) => now - time < 1000);
  times.push(now);
  if (now - told > 500) { told = now; status(); }
}

function redraw() {
  if (!newest) return;
  wake.draw(newest);
  traces.draw(newest.numbers[1]);
  const [, time, saved, spent, power] = newest.numbers;
  $("saved").textContent = Number.isFinite(saved) ? `${(100 * saved).toFixed(1).replace(/^-0\.0$/, "0.0")} %` : "–";
  $("spent").textContent = Number.isFinite(spent) ? `power spent ${(100 * spent).toFixed(1)} %` : "–";
  const of = layout.shown[0].name === "c_d" ? "the drag without control" : "its mean without control";
  $("over").textContent = `Means over the last ${Math.min(layout.window, time).toFixed(1)} L/U, in percent of ${of}.`;
}

wake.changed = () => { if (newest) wake.draw(newest); };
new ResizeObserver(() => { redraw(); if (curve) learning($("curve"), curve); }).observe($("wake"));

function status() {
  const read = layout.shown.map(({ name }, k) => `${named(name)} ${newest.numbers[5 + k].toFixed(3)}`);
  $("traces").setAttribute("aria-label", `Against time: ${read.join(", ")}`);
  const t = `t ${newest.numbers[0].toFixed(1)} L/U`;
  if (demo) { $("status").textContent = t; return; }
  const pace = state.paused ? "paused" : `${(state.reached ?? state.speed).toFixed(1)} L/U a second`;
  $("status").textContent = `${t} · ${pace} · ${state.paused ? 0 : times.length} frames a second`;
}

function legend() {
  const field = layout.fields[newest.field], context = $("scale").getContext("2d");
  const map = colours(field.diverging ? (document.documentElement.dataset.theme === "dark" ? "dark" : "light") : "one");
  map.forEach(([r, g, b], k) => { context.fillStyle = `rgb(${r} ${g} ${b})`; context.fillRect(k, 0, 1, 1); });
  [$("low").textContent, $("high").textContent] = [field.low, field.high].map((v) => v.toFixed(field.diverging && Math.abs(v) === 3 ? 0 : 2));
  $("shade").textContent = field.label;
}

// ---- what is pressed

function round(value) { return Number(value.toPrecision(6)); }

/** Fills a group of buttons of which one is chosen: arrows go from one to the next, as with all such groups. */
function choice(box, options, call) {
  box.replaceChildren(...options.map(([value, text]) => {
    const button = Object.assign(document.createElement("button"), { type: "button", textContent: text });
    button.dataset.value = value;
    button.setAttribute("role", "radio");
    button.onclick = () => call(value);
    return button;
  }));
  box.onkeydown = (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!step) return;
    const buttons = [...box.children], next = buttons[(buttons.indexOf(document.activeElement) + step + buttons.length) % buttons.length];
    next.focus();
    next.click();
    event.preventDefault();
  };
}

function checked(box, value) {
  for (const button of box.children) {
    const on = button.dataset.value === value;
    button.setAttribute("aria-checked", on);
    button.tabIndex = on ? 0 : -1;
  }
}

function drive(by) {
  if (by === "hand") source.send("hand", { actions: hands.values });
  source.send("drive", { by });
}

function pause() { source.send("pause", { on: !state.paused }); }

$("flow").onsubmit = (event) => { event.preventDefault(); open(); };
$("case").onchange = () => {
  const chosen = layout.cases.find(({ name }) => name === $("case").value);
  if (chosen.reynolds) $("reynolds").value = round(chosen.reynolds);
  if (demo) open(); else for (const end of ["min", "max"]) $("reynolds").removeAttribute(end); // they are of the flow before
};
function open() {
  const reynolds = Number($("reynolds").value);
  source.send("open", { case: $("case").value, ...(demo || !(reynolds > 0) ? {} : { reynolds }) });
}
$("cancel").onclick = () => source.send("cancel");
$("pause").onclick = pause;
$("step").onclick = () => source.send("step");
$("reset").onclick = () => source.send("reset");
$("score").onclick = () => source.send("score");
$("speed").oninput = () => source.send("speed", { value: Math.min(20, Math.max(0.25, 2 ** Number($("speed").value))) });
$("both").onchange = () => { wake.both = $("both").checked; redraw(); };
$("sensors").onchange = () => { wake.sensors = $("sensors").checked; redraw(); };
$("in").onclick = () => wake.zoom(1.4);
$("out").onclick = () => wake.zoom(1 / 1.4);
$("whole").onclick = () => wake.whole();
$("ask").onclick = () => $("help").showModal();
$("picture").onclick = () => share.picture(filename());
$("movie").onclick = () => {
  const on = share.film(filename());
  $("movie").setAttribute("aria-pressed", on === true);
  $("movie").textContent = on ? "End and save" : "Record";
  $("share-says").textContent = on === null ? "This browser makes no films." : on ? "Recording." : "";
};
$("link").onclick = async () => {
  const text = link({
    case: layout.case, re: round(layout.reynolds), by: state.by, field: state.field, speed: state.speed,
    both: Number(wake.both), sensors: Number(wake.sensors),
  });
  try { await navigator.clipboard.writeText(text); $("share-says").textContent = `Copied: ${text}`; } catch { $("share-says").textContent = text; }
};

function filename() { return `manywake-${layout.name}-${state.by}-${newest ? newest.numbers[0].toFixed(0) : 0}`; }

function title() {
  const saved = newest ? newest.numbers[2] : NaN, tail = Number.isFinite(saved) ? `, ${$("saved-name").textContent.toLowerCase()} ${(100 * saved).toFixed(1)} %` : "";
  return `manywake · ${layout.name}, Re ${round(layout.reynolds)} · ${wake.names[1]}${tail}`;
}

/** Does what a link asks for, once: first the flow, then the rest. */
function settle() {
  const { case: name, re, by, field, speed, both, sensors } = wanted;
  if (name && layout.cases.some((each) => each.name === name) && (name !== layout.case || (re && Number(re) !== round(layout.reynolds)))) {
    wanted = { ...wanted, case: undefined };
    source.send("open", { case: name, ...(Number(re) > 0 && !demo ? { reynolds: Number(re) } : {}) });
    return;
  }
  wanted = {};
  if (by && layout.drivers.includes(by)) drive(by);
  if (field) source.send("field", { name: field });
  if (Number(speed) > 0) source.send("speed", { value: Number(speed) });
  if (both !== undefined) wake.both = $("both").checked = both !== "0";
  if (sensors !== undefined) wake.sensors = $("sensors").checked = sensors === "1";
}

// ---- the game

function best() {
  const value = layout && kept(`best:${layout.name}:${round(layout.reynolds)}`);
  return value === null || value === "" || !Number.isFinite(Number(value)) ? null : Number(value);
}

function scored(score) {
  if (!score) { if (game === "on") $("game-says").textContent = "The game is over."; game = null; return; }
  if (score.value === null) {
    game = "on";
    $("game-says").textContent = `${score.left.toFixed(1)} L/U to go. Sliders or keys ${$("hand").querySelector("kbd") ? "A and Q" : ""}.`;
  } else if (game !== "done") {
    game = "done";
    const before = best(), record = before === null || score.value > before;
    if (record) kept(`best:${layout.name}:${round(layout.reynolds)}`, score.value);
    $("game-says").textContent = `${score.value.toFixed(1)} %${record ? ", your best so far" : ""}. Nothing gives about 0.`;
    $("best").textContent = `best ${best()?.toFixed(1) ?? score.value.toFixed(1)} %`;
  }
}

// ---- keys

window.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || !layout || $("help").open) return;
  const at = event.target;
  if (at instanceof HTMLInputElement && at.type === "number") return;
  if (!demo && hands.key(event, true)) { event.preventDefault(); return; }
  const button = at instanceof HTMLButtonElement || at instanceof HTMLSelectElement || (at instanceof HTMLInputElement && at.type === "checkbox");
  const fields = layout.fields.map(({ name }) => name);
  const call = {
    " ": button ? null : pause, ".": () => source.send("step"), 0: () => source.send("reset"),
    v: () => source.send("field", { name: fields[(fields.indexOf(state.field) + 1) % fields.length] }),
    b: () => $("both").click(), n: () => $("sensors").click(), "?": () => $("help").showModal(),
  }[event.key.toLowerCase()] ?? (layout.drivers[Number(event.key) - 1] && (() => drive(layout.drivers[Number(event.key) - 1])));
  if (call) { call(); event.preventDefault(); }
});
window.addEventListener("keyup", (event) => hands.key(event, false));
window.addEventListener("blur", () => hands.release());

/** Returns the frame that was drawn last; for whoever looks from the browser's console. */
globalThis.manywake = () => newest;

$("demo-says").hidden = !demo;
source.start();
