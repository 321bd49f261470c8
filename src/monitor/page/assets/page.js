// The live page: shows the messages of the daemon in the elements of the page.

import { Spectra, Strips } from "./charts.js";
import { Link } from "./link.js";
import { Balance, Detectors } from "./optics.js";
import { AXES, LOCK_GRADES, SHAPES, chooseUnits, count, duration, facts, fixed, inUnit, meaning, node, say, time, um, unit } from "./words.js";

const SPANS = [[10, "10 s"], [60, "1 min"], [600, "10 min"], [3600, "1 h"], [21600, "6 h"]];
const FINE_MS = 20;
const RECENT_MS = 10 * 60e3;
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

function message({ hello: first, history, span_s: shown, update, missed }) {
  if (first) begin(first);
  if (history) strips.past(history, shown);
  if (missed) console.info(`this page missed ${missed} updates`);
  if (update && hello) show(update);
}

function begin(first) {
  hello = first;
  const { descriptor, config } = hello;
  detectors.configure(config);
  balance.configure(config);
  strips.period_ms = 1000 / descriptor.rate_hz;
  const source = config.acquisition.source === "twin" ? twin(config.twin) :
    config.acquisition.source === "replay" ? `recording ${config.replay.file}` : `board at ${config.acquisition.serial.port}`;
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
const hex = (n) => n.toString(16).padStart(8, "0");

function show(update) {
  const { frame } = update;
  const now_ms = frame ? frame.time_ns / 1e6 : Date.now();
  document.body.classList.toggle("stale", frame === null || update.dead?.silent === true);
  headline(update, now_ms);
  faults(update, now_ms);
  if (frame === null) return;
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

/** The headline: the most important state in one sentence. */
function headline({ frame, ready, dead }, now_ms) {
  const wrong = ready.checks.filter((check) => !check.ok);
  if (!dead && frame && hello.descriptor.replay) return grade("note", replayed(frame, hello.descriptor.replay, wrong));
  if (dead) {
    const at = dead.since_ns === null ? "" : ` since ${time(dead.since_ns / 1e6, now_ms)}`;
    return grade("bad", `${dead.silent ? "No poses" : still(frame)}: ${dead.why}${at}`);
  }
  if (wrong.length === 0) return grade("good", "Pose valid, beam locked");
  const [{ name, since, reason }] = wrong;
  const from = since ? ` since ${time(Date.parse(since), now_ms)}` : "";
  if (name === "lock") {
    const { mode } = hello.config.centering;
    const loop = mode === "shadow" ? " (loop in shadow mode)" : "";
    return grade("warn", `Pose valid, beam not locked: ${reason}${loop}${from}`);
  }
  const unusable = ["time", "consistency", "calibration"].includes(name);
  const fault = unusable ? "Pose not usable" : "No valid pose";
  grade("bad", `${fault}: ${reasons(reason)}${from}`);
}

/** The headline of a replay, which must not look like live data. */
function replayed({ status, lock }, { file, recorded, repeat }, wrong) {
  const what = `Replay of ${file}, recorded ${recorded.slice(0, 10)} ${time(Date.parse(recorded))}`;
  if (status.includes("SOURCE_DOWN")) {
    const over = !repeat && counters?.replay_ends > 0;
    return `${what}: ${over ? "ended" : "no samples at this position"}`;
  }
  const dark = wrong.find((check) => check.name === "optics");
  return `${what}: ${dark ? `no valid pose: ${reasons(dark.reason)}` : still({ status, lock }).toLowerCase()}`;
}

/** Pose and lock state of the frames while a task is stalled. */
function still({ status, lock }) {
  const pose = status.includes("POSE_VALID") ? "Pose valid" : "No valid pose";
  return `${pose}, beam ${lock === "locked" ? "locked" : `not locked (${lock})`}`;
}

/** "PSD_A_LOW, PSD_B_LOW" in words; equal faults of several detectors in one phrase. A cause may follow: "SOURCE_DOWN: why". */
function reasons(reason) {
  const colon = reason.indexOf(": ");
  return colon < 0 ? bits(reason) : bits(reason.slice(0, colon)) + reason.slice(colon);
}

function bits(names) {
  const words = names.split(", ").map((name) => {
    const bit = hello.bits.find((bit) => bit.name === name);
    return bit ? meaning(bit).text : name;
  });
  const parts = words.map((text) => /^(.*) PSD ([ABC])(.*)$/.exec(text));
  if (words.length > 1 && parts.every((p) => p && p[1] === parts[0][1] && p[3] === parts[0][3])) {
    return `${parts[0][1]} PSD ${parts.map((p) => p[2]).join(", ")}${parts[0][3]}`;
  }
  return words.join("; ");
}

function grade(name, text) {
  const place = $("headline");
  if (place.dataset.grade !== name) place.dataset.grade = name;
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

/** Present faults, then recent ones. */
function faults({ history, dead, ready }, now_ms) {
  const explained = history.map((spell) => ({ ...spell, ...hello.bits[spell.bit], ...meaning(hello.bits[spell.bit]) }));
  const shown = explained.filter((spell) => !MARKS.includes(spell.name) && (spell.until_ms === null || now_ms - spell.until_ms < RECENT_MS));
  if (dead?.since_ns) shown.push({ bit: -1, name: dead.silent ? "no frames" : "stalled", grade: "bad", text: dead.why, since_ms: dead.since_ns / 1e6, until_ms: null, times: 1 });
  for (const { subject, since, text } of ready.doubts) {
    shown.push({ bit: -1, name: `doubt: ${subject}`, grade: "warn", text, since_ms: Date.parse(since), until_ms: null, times: 1 });
  }
  const rank = (spell) => (spell.until_ms === null ? 0 : 4) + ["bad", "warn", "note"].indexOf(spell.grade);
  shown.sort((a, b) => rank(a) - rank(b) || a.bit - b.bit);
  const list = $("faults").querySelector("ul");
  while (list.children.length > shown.length) list.lastChild.remove();
  shown.forEach((spell, i) => {
    if (!list.children[i]) list.append(node("li", {}, node("span", { class: "shape", "aria-hidden": "true" }), node("strong"), node("span", { class: "quiet number" })));
    const [shape, text, when] = list.children[i].children;
    const over = spell.until_ms !== null;
    list.children[i].dataset.grade = over ? "none" : spell.grade;
    say(shape, over ? SHAPES.none : SHAPES[spell.grade]);
    const kind = { bad: "Fault", warn: "Warning", note: "Note" }[spell.grade];
    say(text, `${kind}: ${spell.text}`);
    const times = spell.times > 1 ? `, ${count(spell.times)} times` : "";
    const span = over
      ? `ended: ${time(spell.since_ms, now_ms)} for ${duration(spell.until_ms - spell.since_ms)}`
      : `since ${time(spell.since_ms, now_ms)}`;
    say(when, `${spell.name}, ${span}${times}`);
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
