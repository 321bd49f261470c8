// Charts on a canvas, drawn by uPlot: lines with gaps, marks, bars, and the values at the pointer. Shared
// by the
// live page and the report of the experiment.

/** The current value of a colour in the style sheet: a chart that is drawn again follows the theme. */
export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const DASHES = { solid: [], dash: [7, 4], dot: [2, 3] };
const SYMBOLS = { circle: "●", square: "■", diamond: "◆", open: "◇" };

function tag(name, className, ...children) {
  const element = document.createElement(name);
  element.className = className;
  element.append(...children);
  return element;
}

/** A line through the values of `count` series, one after the other at each place. A null ends the line; a single value is a dot. */
export const through = (count) => (u, si, from, to) => {
  const stroke = new Path2D();
  let open = false;
  for (let i = from; i <= to; i++) {
    const x = u.valToPos(u.data[0][i], "x", true);
    for (let k = si; k < si + count; k++) {
      const value = u.data[k][i];
      const known = value !== null && value !== undefined;
      const y = known ? u.valToPos(value, "y", true) : 0;
      if (known && !open) stroke.moveTo(x, y);
      if (known) stroke.lineTo(x, y);
      open = known;
    }
  }
  return { stroke };
};

/** Upright bars, from the values of the next series to those of the one after it. */
export function bars(u, si, from, to) {
  const stroke = new Path2D();
  const half = 3 * uPlot.pxRatio;
  for (let i = from; i <= to; i++) {
    if (u.data[si][i] === null) continue;
    const x = u.valToPos(u.data[0][i], "x", true);
    const [low, high] = [si + 1, si + 2].map((k) => u.valToPos(u.data[k][i], "y", true));
    for (const y of [low, high]) {
      stroke.moveTo(x - half, y);
      stroke.lineTo(x + half, y);
    }
    stroke.moveTo(x, low);
    stroke.lineTo(x, high);
  }
  return { stroke };
}

const outlines = {
  circle: (path, x, y, r) => path.arc(x, y, r, 0, 2 * Math.PI),
  square: (path, x, y, r) => path.rect(x - r, y - r, 2 * r, 2 * r),
  diamond: (path, x, y, r) => polygon(path, [[x, y - 1.3 * r], [x + 1.3 * r, y], [x, y + 1.3 * r], [x - 1.3 * r, y]]),
  tick: (path, x, y, r) => polygon(path, [[x - r, y], [x + r, y]]),
};
outlines.open = outlines.diamond;

function polygon(path, [first, ...rest]) {
  path.moveTo(...first);
  for (const point of rest) path.lineTo(...point);
  path.closePath();
}

/** A symbol at each value. */
const marks = (symbol, size) => (u, si, from, to) => {
  const path = new Path2D();
  for (let i = from; i <= to; i++) {
    if (u.data[si][i] === null) continue;
    const one = new Path2D();
    outlines[symbol](one, u.valToPos(u.data[0][i], "x", true), u.valToPos(u.data[si][i], "y", true), (size / 2) * uPlot.pxRatio);
    path.addPath(one);
  }
  return { stroke: path, fill: symbol === "open" || symbol === "tick" ? null : path };
};

/** The options of uPlot for a line. A line that is `part` of another is not drawn itself; a line without a name is not read out. */
function line({ name = "", color, dash = "solid", width = 1.4, path = through(1), symbol, size = 6, part = false, unlisted = false }) {
  if (part) return { name, class: "part", label: " ", paths: () => null, points: { show: false } };
  const sign = tag("span", `mark ${dash}`, SYMBOLS[symbol] ?? "");
  sign.style.color = `var(${color})`;
  return {
    name, width, class: unlisted ? "part" : undefined, label: tag("span", "", sign, name), dash: DASHES[dash].map((length) => length * uPlot.pxRatio),
    cap: dash === "solid" ? "round" : "butt", pxAlign: 0, stroke: () => css(color), paths: path ?? (() => null),
    points: symbol ? { show: true, size, width: 1.2, stroke: () => css(color), fill: () => css(color), paths: marks(symbol, size) } : { show: false, size: 6 },
  };
}

/** From the smallest to the largest value, with room; or from `range()`. */
function scale({ log = false, range, include = [] }) {
  const fit = (low, high) => {
    if (low === null) return [null, null]; // no values, no axis
    if (log) return [low / 1.2, high * 1.2];
    const [least, most] = [Math.min(low, ...include), Math.max(high, ...include)];
    const room = 0.06 * (most - least) || 1e-3 * Math.abs(most) || 1;
    return [least - room, most + room];
  };
  return { time: false, distr: log ? 3 : 1, range: range ?? ((u, low, high) => fit(low, high)) };
}

/** Ticks at 1 to 9 of every decade. */
function decades(u, i, min, max) {
  const splits = [];
  for (let power = Math.floor(Math.log10(min)); 10 ** power <= max; power++) {
    for (let m = 1; m < 10; m++) splits.push(Number(`${m}e${power}`));
  }
  return splits.filter((value) => value >= min && value <= max);
}

const starts = (value, digits) => digits.includes(value.toExponential()[0]);

/** Numbers at a logarithmic axis: 1 of every decade, with 2 and 5 if there is room; or of every few decades. */
function powers(u, splits, i) {
  const { scale: key } = u.axes[i];
  const decade_px = Math.abs(u.valToPos(10, key) - u.valToPos(1, key));
  const label_px = key === "x" ? 40 : 20;
  const every = Math.ceil(label_px / decade_px);
  return splits.map((value) => {
    if (!starts(value, decade_px > 3.5 * label_px ? "125" : "1") || Math.floor(Math.log10(value)) % every !== 0) return null;
    return value >= 1e-3 && value < 1e5 ? String(value) : value.toExponential(0).replace("-", "−").replace("+", "");
  });
}

/** Numbers with the digits that their distance needs: 0.25 has two. */
function numbers(u, splits, i, space, step) {
  let digits = 0;
  while (digits < 15 && Math.abs(Number(step.toFixed(digits)) - step) > 1e-6 * step) digits++;
  return splits.map((value) => value.toFixed(digits).replace("-", "−"));
}

function axis(key, { log = false, label, values, splits, steps }, font) {
  const family = getComputedStyle(document.body).fontFamily;
  const quiet = () => css("--quiet");
  const lines = { stroke: () => css("--grid"), width: 1 };
  const grid = { ...lines, filter: (u, places) => (log ? places.map((value) => (starts(value, "125") ? value : null)) : places) };
  const wide = (u, texts) => Math.max(46, 14 + 0.6 * font * Math.max(0, ...(texts ?? []).map((text) => text?.length ?? 0)));
  return {
    scale: key, side: key === "x" ? 2 : 3, stroke: quiet, font: `${font}px ${family}`, labelFont: `${font}px ${family}`, labelSize: font + 8,
    size: key === "x" ? font + 11 : wide, space: key === "x" ? 66 : 26, gap: 5, grid, ticks: { show: false }, border: { show: true, ...lines },
    label, values: values ?? (log ? powers : numbers), splits: splits ?? (log ? decades : undefined), filter: (u, places) => places, incrs: steps,
  };
}

/** Shows the values of the lines at the pointer. Lines without a value there are omitted. */
function readout(x, y) {
  let tip;
  const init = (u) => {
    tip = u.over.appendChild(tag("div", "tip"));
    tip.hidden = true;
  };
  const setCursor = (u) => {
    const { idx, idxs, left } = u.cursor;
    const shown = u.series.flatMap(({ show }, k) => (k > 0 && show && typeof idx === "number" && typeof idxs[k] === "number" ? [k] : []));
    tip.hidden = shown.length === 0;
    if (tip.hidden) return;
    tip.textContent = [x.tell(u.data[0][idx]), ...shown.map((k) => `${u.series[k].name} ${y.tell(u.data[k][idx])}`)].join("\n");
    const right = left > u.over.clientWidth / 2;
    tip.style.left = right ? "" : `${left + 10}px`;
    tip.style.right = right ? `${u.over.clientWidth - left + 10}px` : "";
  };
  return { hooks: { init, setCursor } };
}

/**
 * Draws into an element, follows its size, and returns the object of uPlot, which is also the property `chart` of the element.
 * `x` and `y` define for each direction: `log`, `label`, `range`, `tell` (a value in words), `values`, `splits` and `steps` at the axis,
 * and `reach`, the largest distance of a value from the pointer for the readout.
 */
export function plot(element, { series, x, y, data, under, title, legend = false, zoom = false, font = 11 }) {
  const head = tag("div", "head", tag("span", "title", title ?? ""));
  const empty = tag("div", "empty", "");
  const size = () => ({ width: element.clientWidth, height: Math.max(60, element.clientHeight - head.offsetHeight) });
  element.chart?.destroy(); // an earlier chart
  element.replaceChildren(head, empty);
  const near = (u, i, at) => Math.abs(u.data[0][i] - at) <= (x.reach?.() ?? Infinity);
  const known = (u, si, i, at) => (si === 0 || (u.series[si].name && u.data[si][i] !== null && near(u, i, at)) ? i : null);
  const options = {
    width: 0, height: 0, ms: 1, padding: [8, 14, 0, 0], series: [{}, ...series.map(line)], scales: { x: scale(x), y: scale(y) },
    axes: [axis("x", x, font), axis("y", y, font)], plugins: [readout(x, y)], hooks: { drawAxes: under ? [under] : [] },
    cursor: { y: false, drag: { x: zoom, y: false, setScale: zoom }, dataIdx: known },
    legend: { show: legend, live: false, mount: (u, table) => head.append(table), markers: { show: false, stroke: () => "inherit" } },
  };
  const chart = new uPlot(options, data, (u, init) => {
    element.append(u.root);
    init();
    u.setSize(size());
  });
  const resized = new ResizeObserver(() => chart.setSize(size()));
  resized.observe(element);
  chart.hooks.destroy = [() => resized.disconnect()];
  return (element.chart = chart);
}
