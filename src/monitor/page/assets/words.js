// Texts for units, numbers, times and states.

export const AXES = [
  { name: "tx", value: "tx_m", sd: "sd_tx_m" },
  { name: "ty", value: "ty_m", sd: "sd_ty_m" },
  { name: "tz", value: "tz_m", sd: "sd_tz_m" },
  { name: "roll", value: "roll_rad", sd: "sd_roll_rad" },
  { name: "pitch", value: "pitch_rad", sd: "sd_pitch_rad" },
  { name: "yaw", value: "yaw_rad", sd: "sd_yaw_rad" },
];

const UNITS = {
  um: [{ name: "µm", scale: 1e6, digits: 3 }, { name: "µrad", scale: 1e6, digits: 2 }],
  mm: [{ name: "mm", scale: 1e3, digits: 6 }, { name: "mrad", scale: 1e3, digits: 5 }],
  deg: [{ name: "mm", scale: 1e3, digits: 6 }, { name: "°", scale: 180 / Math.PI, digits: 6 }],
};

let chosen = "um";

export function chooseUnits(name) {
  chosen = name in UNITS ? name : "um";
}

/** The unit of axis 0 to 5: the first three are lengths. */
export const unit = (axis) => UNITS[chosen][axis < 3 ? 0 : 1];

/** A number with its digits; a dash for an unknown value. */
export function fixed(x, digits) {
  if (x === null || x === undefined || !Number.isFinite(x)) return "–";
  return x.toFixed(digits).replace(/^-(?=0\.?0*$)/, "").replace("-", "−");
}

/** Metres or radians in the unit of this axis. */
export const inUnit = (x, axis) => fixed(x === null || x === undefined ? x : x * unit(axis).scale, unit(axis).digits);

/** Micrometres, independent of the chosen units: used for offsets of the beam. */
export const um = (metres, digits = 2) => (metres === null || metres === undefined ? "–" : `${fixed(metres * 1e6, digits)} µm`);

export const count = (n) => String(n).replace(/\B(?=(\d{3})+(?!\d))/g, "\u202f");

/** Time of day, UTC; with the date if it differs from that of `now_ms`. */
export function time(ms, now_ms = ms) {
  const text = new Date(ms).toISOString();
  const day = text.slice(0, 10) === new Date(now_ms).toISOString().slice(0, 10) ? "" : `${text.slice(0, 10)} `;
  return `${day}${text.slice(11, 19)} UTC`;
}

export function duration(ms) {
  const s = Math.max(0, ms / 1000);
  if (s < 1) return `${(s * 1000).toFixed(0)} ms`;
  if (s < 10) return `${s.toFixed(1)} s`;
  if (s < 120) return `${s.toFixed(0)} s`;
  if (s < 7200) return `${(s / 60).toFixed(0)} min`;
  return `${(s / 3600).toFixed(1)} h`;
}

/** Each grade has a shape and a word besides its colour. */
export const SHAPES = { good: "●", limited: "▲", bad: "■", note: "◆", none: "○" };

/** The grades in words. */
export const GRADES = { good: "good", limited: "limited", bad: "bad", note: "replay", none: "no connection" };

export const LOCK_GRADES = {
  locked: "good", acquiring: "limited", searching: "limited", held: "limited",
  off: "note", manual: "note", railed: "bad", lost: "bad",
};

/** Grade and text of a status bit: "Fatal: too little light on PSD A." has the grade bad and the text after the colon. */
export function meaning(bit) {
  const [, grade, text] = /^(?:(Fatal|Warning): )?(.*?)\.?$/.exec(bit.meaning) ?? [null, null, bit.meaning];
  const lower = /^[A-Z][a-z]/.test(text) ? text[0].toLowerCase() + text.slice(1) : text;
  return { grade: { Fatal: "bad", Warning: "limited" }[grade] ?? "note", text: lower };
}

export function node(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** Writes only changed texts, because an unchanged page needs no layout. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Names and values as rows of a description list. */
export function facts(list, rows) {
  while (list.children.length > rows.length) list.lastChild.remove();
  rows.forEach(([name, value, title], i) => {
    if (!list.children[i]) list.append(node("div", {}, node("dt"), node("dd")));
    const [dt, dd] = list.children[i].children;
    say(dt, name);
    say(dd, value);
    if (title && dt.title !== title) dt.title = title;
  });
}
