// The live page: shows the messages of the daemon in the elements of the page.

import { Spectra, Strips } from "./charts.js";
import { Link } from "./link.js";
import { Balance, Detectors } from "./optics.js";
import { csv, hex, picture, save, stamp } from "./tools.js";
import { AXES, GRADES, LOCK_GRADES, SHAPES, chooseUnits, count, duration, facts, fixed, inUnit, meaning, node, say, time, um, unit } from "./words.js";

const SPANS = [[10, "10 s"], [60, "1 min"], [600, "10 min"], [3600, "1 h"], [21600, "6 h"]];
const FINE_MS = 20;
const RECENT_MS = 10 * 60e3;
/** Most events in the list. */
const EVENTS = 50;
/** Bits that describe the kind of a frame and are not faults. */
const MARKS = ["POSE_VALID", "STEERING_MEASURED"];

/** Text for values of the loop in a replay. */
const NO_LOOP = "none: a replay";

const $ = (id) => document.getElementById(id);
const stored = (key, value) => {
  try {
    if (value !== undefined) localStorage.setItem(key, value);
    return localStorage.getItem(key);
  } catch {
    return null; // private windows
  }
};

const rows = AXES.map((axis) => {
  const cells = ["now", "sd", "mean", "range", "unit"].map((name) => node("td", { class: name }));
  $("pose").querySelector("tbody").append(node("tr", { "data-axis": axis.name }, node("th", { scope: "row" }, axis.name), ...cells));
  return cells;
});

const detectors = new Detectors(document.querySelector(".psds"));
const balance = new Balance($("balance"));
const strips = new Strips(document.querySelector(".strips"));
const spectra = new Spectra(document.querySelector(".spectra"), $("spectrum-facts"));
let hello = null;
let newest = null;
let counters = null;
/** State of the recorder. */
let recording = null;

// Settings of the user.

function theme(name) {
  if (name === "auto") document.documentElement.removeAttribute("data-theme");
  else document.documentElement.dataset.theme = name;
  strips.dirty = spectra.dirty = true;
}
function bind(id, key, fallback, act) {
  const select = $(id);
  select.value = stored(key) ?? fallback;
  if (!select.value) select.value = fallback;
  act(select.value);
  select.addEventListener("change", () => act(stored(key, select.value) ?? select.value));
}
bind("theme", "trifacet.theme", "auto", theme);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => theme($("theme").value));
bind("units", "trifacet.units", "um", (name) => {
  chooseUnits(name);
  strips.dirty = true;
  if (newest) pose(newest);
});
$("magnify").addEventListener("change", (event) => {
  detectors.magnified = balance.magnified = event.target.checked;
});
let span_s = SPANS.map(([s]) => s).find((s) => s === Number(stored("trifacet.span"))) ?? 60;
for (const [seconds, name] of SPANS) {
  const radio = node("input", { type: "radio", name: "span", value: seconds });
  radio.checked = seconds === span_s;
  radio.addEventListener("change", () => {
    span_s = seconds;
    stored("trifacet.span", seconds);
    link.look(seconds);
  });
  $("span").append(node("label", {}, radio, node("span", {}, name)));
}

// Messages of the daemon.

const link = new Link({ message, broken });
link.look(span_s);

/** Update at which the person has frozen the page; `null` while it follows the daemon. */
let frozen = null;

$("freeze").addEventListener("click", () => {
  frozen = frozen === null && newest ? newest.time_ns / 1e6 : null;
  $("freeze").setAttribute("aria-pressed", frozen !== null);
  document.body.classList.toggle("frozen", frozen !== null);
  if (frozen === null) link.look(); // the charts need what they have missed
});
$("csv").addEventListener("click", () => {
  if (strips.now_ms === undefined) return;
  save(new Blob([csv(strips, hello.descriptor)], { type: "text/csv" }), `trifacet-${stamp(strips.now_ms)}.csv`);
});
$("png").addEventListener("click", () => {
  if (strips.now_ms === undefined) return;
  picture(strips.elements, strips.now_ms).toBlob((blob) => save(blob, `trifacet-${stamp(strips.now_ms)}.png`));
});
function wall(on) {
  document.body.classList.toggle("wall", on);
  $("wall").setAttribute("aria-pressed", on);
}
wall(stored("trifacet.wall") === "true");
$("wall").addEventListener("click", () => wall(stored("trifacet.wall", !document.body.classList.contains("wall")) === "true"));

function message({ hello: first, history, span_s: shown, events: past, update, missed }) {
  if (first) begin(first);
  if (history && frozen === null) strips.past(history, shown);
  if (past) events(past);
  if (missed) console.info(`this page missed ${missed} updates`);
  if (update && hello) show(update);
}

function begin(first) {
  hello = first;
  const { descriptor, config } = hello;
  detectors.configure(config);
  balance.configure(config);
  strips.period_ms = 1000 / descriptor.rate_hz;
  const source = sourceOf(config);
  say($("device"), `${source}, ${descriptor.rate_hz} poses/s`);
  say($("config"), JSON.stringify(config, null, 2));
  facts($("facts"), [
    ["version", descriptor.daemon_version],
    ["source", source],
    ["samples", `${config.acquisition.rate_hz} Hz, ${descriptor.average} averaged`],
    ["model", descriptor.model],
    ["calibration", calibration(descriptor)],
    ["loop", descriptor.replay ? NO_LOOP : `${config.centering.mode}, to the ${config.centering.target}`],
    ["steering", descriptor.replay ? NO_LOOP : `${config.steering.kind}, ±${config.steering.limit_um} µm`],
    ["session", hex(descriptor.session)],
    ["configuration", hex(descriptor.config)],
    ["TCP", config.publishing.tcp ?? "off"],
    ["stream", descriptor.stream_version],
  ]);
  $("control").hidden = !hello.control;
  const idle = descriptor.replay !== undefined;
  for (const button of document.querySelectorAll("#control :is(button, input)")) button.disabled = idle;
  if (idle) say($("answer"), "◆ A recording is replayed: commands are not available");
}
/** Where the samples come from. */
function sourceOf({ acquisition, replay, twin: own }) {
  const { source, serial, labjack, port, address, socket } = acquisition;
  switch (source) {
    case "twin": return twin(own);
    case "replay": return `recording ${replay.file}`;
    case "labjack": return `LabJack T7 at ${labjack.address}`;
    case "serial": return `board at ${serial.port}`;
    default: return `board at ${port ?? address ?? socket}`;
  }
}

/** The calibration in words: whether it is valid, its date and age, its method, range and uncertainty, and its end. */
function calibration({ calibration: record, uncalibrated }) {
  if (!record) return uncalibrated ?? "calibrated";
  const days = Math.floor((Date.now() - Date.parse(record.date)) / 86_400_000);
  const [m, rad] = record.range;
  const largest = (from, to) => (Math.max(...record.uncertainty.slice(from, to)) * 1e6).toPrecision(2);
  const end = record.expires ? `, until ${record.expires.slice(0, 10)}` : "";
  const about = `${record.date.slice(0, 10)} (${days} d), ${record.method}, ±${m * 1e3} mm ±${rad * 1e3} mrad: ` +
    `${largest(0, 3)} µm, ${largest(3, 6)} µrad${end}`;
  return uncalibrated ? `${uncalibrated} (${about})` : about;
}

// The twin: its head is that of the estimator, unless one of these sections gives it another one.
const OWN_HEAD = ["head", "psd", "beam", "stage", "tolerances"];
const twin = (config) =>
  OWN_HEAD.some((section) => config[section] !== null) ? "digital twin with a head of its own" : "digital twin";

function show(update) {
  const { frame } = update;
  const now_ms = frame ? frame.time_ns / 1e6 : Date.now();
  document.body.classList.toggle("stale", frame === null || update.dead?.silent === true);
  if (update.recording) recording = update.recording;
  if (update.events) events(update.events);
  headline(update, now_ms);
  badges(update);
  faults(update, now_ms);
  if (frame === null || frozen !== null) return;
  newest = frame;
  strips.add_news(update.bins, FINE_MS, now_ms);
  pose(frame);
  detectors.update(frame);
  balance.update(frame);
  beam(frame, update, now_ms);
  const day = hello.descriptor.replay ? `${new Date(now_ms).toISOString().slice(0, 10)} ` : "";
  say($("clock"), `${day}${time(now_ms)}${frame.status.includes("CLOCK_UNSYNCED") ? ", not synchronised" : ""}`);
  losses(update);
  if (update.spectrum) spectra.update(update.spectrum, hello.descriptor.rate_hz, now_ms);
}

function pose(frame) {
  AXES.forEach((axis, i) => {
    const { mean, range } = strips.statistics(i);
    const { scale, digits, name } = unit(i);
    const sd = frame[axis.sd] === null ? null : frame[axis.sd] * scale;
    const texts = [inUnit(frame[axis.value], i), fixed(sd, digits), inUnit(mean, i), inUnit(range, i), name];
    rows[i].forEach((cell, k) => say(cell, texts[k]));
  });
  $("pose").dataset.sample = frame.sample_index;
  $("pose").dataset.time = frame.time_ns / 1e6;
}

/** The headline: the most important state in one sentence, with the grade that the daemon gives. */
function headline({ frame, ready }, now_ms) {
  const since = ready.since ? `, since ${time(Date.parse(ready.since), now_ms)}` : "";
  const { replay } = hello.descriptor;
  if (frame && replay) return grade("note", replayed(frame, replay, ready));
  grade(ready.grade, `${ready.headline}${ready.grade === "good" ? "" : since}`);
}

/** Conditions that hold until somebody ends them, beside the name. */
function badges({ frame }) {
  const { descriptor, config } = hello;
  const tare = Object.values(config.frames.tare).flat();
  const file = recording?.recording ? recording.file?.split("/").at(-1) : null;
  const free = recording?.free_bytes ? `, ${fixed(recording.free_bytes / 1e9, 1)} GB are free` : "";
  const all = [
    [frozen !== null, `FROZEN at ${time(frozen ?? 0)}`, "pose, detectors and charts are those of this time; the first line is current"],
    [frame?.status.includes("SIMULATED"), "SIMULATED", "the light is simulated, not measured"],
    [descriptor.replay !== undefined, "REPLAY", "the samples come from a recording"],
    [descriptor.uncalibrated, "UNCALIBRATED", descriptor.uncalibrated],
    [config.centering.mode === "shadow", "SHADOW", "the loop computes commands, but does not steer"],
    [tare.some((x) => x !== 0), "TARED", "poses are relative to the tare pose", "note"],
    [file, `RECORDING ${file}`, `${recording?.file}${free}`, "note"],
  ].filter(([on]) => on);
  const list = $("badges");
  while (list.children.length > all.length) list.lastChild.remove();
  all.forEach(([, text, title, kind], i) => {
    if (!list.children[i]) list.append(node("li"));
    const badge = list.children[i];
    say(badge, text);
    if (badge.title !== title) badge.title = title;
    badge.classList.toggle("note", kind === "note");
  });
}

/** The headline of a replay, which must not look like live data. */
function replayed({ status }, { file, recorded, repeat }, { headline: now }) {
  const what = `Replay of ${file}, recorded ${recorded.slice(0, 10)} ${time(Date.parse(recorded))}`;
  if (status.includes("SOURCE_DOWN")) {
    const over = !repeat && counters?.replay_ends > 0;
    return `${what}: ${over ? "ended" : "no samples at this position"}`;
  }
  return now.replace("Replay:", `${what}:`);
}

/** Grade and text of the headline; the grade also on the tab. */
function grade(name, text) {
  const place = $("headline");
  if (place.dataset.grade !== name) {
    place.dataset.grade = name;
    document.title = `${SHAPES[name]} ${GRADES[name]} – trifacet`;
    $("icon").href = `/icon-${name}.svg`;
  }
  say(place.querySelector(".shape"), SHAPES[name]);
  say(place.querySelector(".text"), text);
}

function broken(why, since_ms) {
  document.body.classList.add("stale");
  grade("none", `${why} since ${time(since_ms)}: the data shown are old`);
}

function beam(frame, update, now_ms) {
  const { beam_dx_m: dx, beam_dy_m: dy } = frame;
  const away = dx === null ? null : Math.hypot(dx, dy);
  const since = `since ${time(update.lock_since_ms, now_ms)}`;
  const measured = frame.status.includes("STEERING_MEASURED") ? "read back" : "as commanded";
  const steering = frame.steering_x_m === null ? "unknown" : measured;
  facts($("beam-facts"), [
    ["loop", hello.descriptor.replay ? NO_LOOP : hello.config.centering.mode],
    ["lock", `${SHAPES[LOCK_GRADES[frame.lock]]} ${frame.lock}`],
    ["", since],
    ["cause", update.lock?.text ?? "–"],
    ["offset x", um(dx, 3)],
    ["offset y", um(dy, 3)],
    ["distance", um(away, 3)],
    ["steering x", um(frame.steering_x_m)],
    ["steering y", um(frame.steering_y_m)],
    ["", steering],
  ]);
}

/** Present limitations, causes before their consequences, then recent states that have ended. */
function faults({ history, ready }, now_ms) {
  const present = ready.limitations.map(({ grade, name, text, remedy, since, consequence }) => ({
    grade: consequence ? "none" : grade,
    kind: consequence ? "Consequence" : { bad: "Fault", limited: "Limitation" }[grade],
    text,
    when: since ? `${name}, since ${time(Date.parse(since), now_ms)}` : name,
    remedy: consequence ? "" : remedy,
    consequence,
  }));
  const named = new Set(ready.limitations.flatMap(({ name }) => name.split(", ")));
  const over = history.filter(({ bit, until_ms }) => until_ms !== null && now_ms - until_ms < RECENT_MS && !named.has(hello.bits[bit].name));
  const ended = over.filter(({ bit }) => !MARKS.includes(hello.bits[bit].name)).map(({ bit, since_ms, until_ms, times }) => ({
    grade: "none",
    kind: { bad: "Fault", limited: "Limitation", note: "Note" }[meaning(hello.bits[bit]).grade],
    text: meaning(hello.bits[bit]).text,
    when: `${hello.bits[bit].name}, ended: ${time(since_ms, now_ms)} for ${duration(until_ms - since_ms)}${times > 1 ? `, ${count(times)} times` : ""}`,
    remedy: "",
    consequence: false,
  }));
  const shown = [...present, ...ended];
  const list = $("faults").querySelector("ul");
  while (list.children.length > shown.length) list.lastChild.remove();
  shown.forEach(({ grade, kind, text, when, remedy, consequence }, i) => {
    if (!list.children[i]) {
      list.append(node("li", {}, node("span", { class: "shape", "aria-hidden": "true" }), node("strong"),
        node("span", { class: "quiet number" }), node("span", { class: "quiet remedy" })));
    }
    const row = list.children[i];
    row.dataset.grade = grade;
    row.classList.toggle("consequence", consequence);
    const texts = [consequence ? "↳" : SHAPES[grade], `${kind}: ${text}`, when, remedy && `→ ${remedy}`];
    texts.forEach((text, k) => say(row.children[k], text));
  });
}

/** After these events, poses have another meaning: statistics begin anew, and the charts have a mark. */
const MARKED = ["start", "tare", "configuration"];

/** The list of events, newest first. */
function events(all) {
  strips.mark(all.filter(({ kind }) => MARKED.includes(kind)));
  const shown = all.slice(-EVENTS).reverse();
  const list = $("events").querySelector("ol");
  while (list.children.length > shown.length) list.lastChild.remove();
  shown.forEach(({ time_ms, kind, text, times }, i) => {
    if (!list.children[i]) list.append(node("li", {}, node("span", { class: "quiet number" }), node("strong"), node("span")));
    const texts = [time(time_ms, Date.now()), kind, times > 1 ? `${text} (${count(times)} times)` : text];
    texts.forEach((text, k) => say(list.children[i].children[k], text));
  });
}

/** Rates over the last second, from ten updates. */
const lately = [];
function losses(update) {
  lately.push(update);
  if (update.counters) counters = update.counters;
  if (!update.counters && lately.length < 10) return;
  const sum = (name) => lately.reduce((total, u) => total + u[name], 0);
  const delays = lately.map((u) => u.delay_us).filter(Boolean);
  const worst = delays.length > 0 ? Math.max(...delays.map((d) => d[2])) : null;
  const [median, high] = [0, 1].map((i) => (delays.length > 0 ? delays.reduce((s, d) => s + d[i], 0) / delays.length : null));
  const us = (x) => (x === null ? "–" : `${fixed(x, 0)} µs`);
  const share = sum("frames") > 0 ? `${fixed((100 * sum("invalid")) / sum("frames"), 1)} %` : "–";
  const lost = Object.entries(counters ?? {}).filter(([name, n]) => n > 0 && hello.losses.includes(name));
  facts($("latency"), [
    ["sample to datagram, median", us(median)],
    ["99th percentile", us(high)],
    ["maximum", us(worst)],
    ["frames without a pose", share],
    ["samples lost, last second", delays.length > 0 ? count(sum("lost")) : "–"],
    ...lost.map(([name, n]) => [name.replaceAll("_", " "), count(n), hello.counters[name]]),
  ]);
  facts($("counters"), Object.entries(counters ?? {}).map(([name, n]) => [name.replaceAll("_", " "), count(n), hello.counters[name]]));
  lately.length = 0;
}

// Commands of the user.

for (const button of document.querySelectorAll("#control button")) {
  button.addEventListener("click", () => order(button.dataset.command));
}
async function order(command) {
  say($("answer"), `${command} ...`);
  try {
    const answer = await fetch("/control", {
      method: "POST",
      headers: { "Content-Type": "application/json", Authorization: `Bearer ${$("token").value}` },
      body: JSON.stringify({ command }),
    });
    const { error } = await answer.json();
    say($("answer"), error ? `■ ${command}: ${error}` : `● ${command}: done`);
  } catch (e) {
    say($("answer"), `■ ${command}: no answer (${e.message})`);
  }
}

// No drawing while the page is hidden.
let turning;
function turn() {
  clearInterval(turning);
  if (document.hidden) return;
  turning = setInterval(() => {
    strips.tick(span_s <= 60 ? 250 : 1000);
    spectra.tick(1000);
  }, 50);
}
document.addEventListener("visibilitychange", turn);
turn();
