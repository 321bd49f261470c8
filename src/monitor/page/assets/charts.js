// Strip charts and spectra. Only what can be seen is drawn, and never so often that the page has no time
// for anything else.

import { AXES, duration, node, say, time, unit } from "./words.js";

const LINES = [["--line-1", "solid"], ["--line-2", "dash"], ["--line-3", "dot"]];
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
/** A spectrum that has got nothing new for longer than a window and this is old. */
const OLD_MS = 2500;
/** Time that goes back by more fine stretches is set back; less is told twice. */
const BACK = 50;
const OPTIONS = { displayModeBar: false, responsive: true, scrollZoom: false };

function look(more) {
  // Labels at the edges have room: to hide them, every label would be measured, and remembered, for each drawing.
  const axis = { ticklabeloverflow: "allow", gridcolor: css("--grid"), linecolor: css("--grid"), zerolinecolor: css("--grid"), automargin: false };
  return {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false, dragmode: false,
    font: { family: getComputedStyle(document.body).fontFamily, size: 11, color: css("--quiet") },
    ...more, xaxis: { ...axis, ...more.xaxis }, yaxis: { ...axis, ...more.yaxis },
  };
}

/** Charts that are drawn when they have something new, can be seen, and it is their turn. */
class Charts {
  constructor() {
    this.visible = new Set();
    this.dirty = false;
    this.next_ms = 0;
    this.seen = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) this.visible[isIntersecting ? "add" : "delete"](target);
      this.dirty = true;
    });
  }

  add(element) {
    this.seen.observe(element);
    return element;
  }

  /** Drawing takes a fifth of the time at most. */
  tick(period_ms) {
    const start = performance.now();
    if (!this.dirty || !window.Plotly || document.hidden || start < this.next_ms) return;
    this.dirty = false;
    for (const element of this.visible) this.draw(element);
    const took = performance.now() - start;
    this.next_ms = start + Math.max(period_ms, 5 * took);
  }
}

/** The six axes over time. Holds one stretch per pixel or so, whatever the time shown. */
export class Strips extends Charts {
  constructor(parent) {
    super();
    this.bins = [];
    this.elements = AXES.map((axis, i) => this.add(parent.appendChild(node("div", { class: "chart", "data-axis": i }))));
  }

  /** What the daemon kept. */
  past({ width_ms, through, bins }, span_s) {
    Object.assign(this, { width_ms, through, bins, span_ms: span_s * 1000, dirty: true });
  }

  /** Fine stretches go into those of the chart; what the past had already is left out. */
  add_news(news, fine_ms, now_ms) {
    if (!this.width_ms) return;
    const factor = this.width_ms / fine_ms;
    for (const [fine, ...row] of news) {
      if (fine <= this.through) {
        if (this.through - fine < BACK) continue;
        this.bins = []; // a replay began again: what was drawn lies in its future
      }
      this.through = fine;
      const k = Math.floor(fine / factor);
      const last = this.bins.at(-1);
      if (last?.[0] === k) merge(last, row);
      else this.bins.push([k, ...row]);
    }
    const oldest = (now_ms - this.span_ms) / this.width_ms - 1;
    let drop = 0;
    while (drop < this.bins.length && this.bins[drop][0] < oldest) drop++;
    this.bins.splice(0, drop);
    this.now_ms = now_ms;
    this.dirty = true;
  }

  /** Mean and range of an axis over all that is shown. */
  statistics(axis) {
    const at = 2 + 3 * axis;
    let [n, sum, min, max] = [0, 0, Infinity, -Infinity];
    for (const bin of this.bins) {
      n += bin[1];
      sum += bin[1] * bin[at + 2];
      min = Math.min(min, bin[at]);
      max = Math.max(max, bin[at + 1]);
    }
    return n > 0 ? { mean: sum / n, range: max - min } : { mean: null, range: null };
  }

  draw(element) {
    const axis = Number(element.dataset.axis);
    const { scale, name } = unit(axis);
    const at = 2 + 3 * axis;
    const [x, raw, xm, mean] = [[], [], [], []];
    const hole = Math.max(1, (1.5 * (this.period_ms ?? 0)) / this.width_ms);
    let before = null;
    for (const bin of this.bins) {
      // Not a whole number: the library takes one of four digits for a year, and the twin's time begins in 1970.
      const t = (bin[0] + 0.5) * this.width_ms + 1e-3;
      if (before !== null && bin[0] - before > hole) {
        for (const list of [raw, mean]) list.push(null);
        for (const list of [x, xm]) list.push(t);
      }
      x.push(t, t);
      raw.push(bin[at] * scale, bin[at + 1] * scale);
      xm.push(t);
      mean.push(bin[at + 2] * scale);
      before = bin[0];
    }
    const line = { type: "scatter", mode: "lines", connectgaps: false };
    const data = [
      { ...line, x, y: raw, hoverinfo: "skip", line: { color: css("--raw"), width: 1, simplify: false } },
      { ...line, x: xm, y: mean, name: "mean", hovertemplate: `%{y:.4~f} ${name}<extra></extra>`, line: { color: css("--mean"), width: 1.5 } },
    ];
    const layout = look({
      height: 176, margin: { l: 56, r: 26, t: 22, b: 22 }, hovermode: "x",
      title: { text: `${AXES[axis].name}, ${name}`, x: 0, xref: "paper", xanchor: "left", y: 0.97, font: { size: 12, color: css("--text") } },
      xaxis: { type: "date", range: [this.now_ms - this.span_ms, this.now_ms], nticks: 6, fixedrange: true, tickformat: this.span_ms > 600e3 ? "%H:%M" : "%H:%M:%S" },
      yaxis: { fixedrange: true, nticks: 5, tickformat: "~g", hoverformat: ".4f", separatethousands: true, showticklabels: xm.length > 0 },
      annotations: xm.length > 0 ? [] : [{ text: "no poses", xref: "paper", yref: "paper", x: 0.5, y: 0.5, showarrow: false }],
    });
    window.Plotly.react(element, data, layout, OPTIONS);
  }
}

/** `[poses, min, max, mean, ...]` into a stretch. */
function merge(bin, row) {
  const n = bin[1] + row[0];
  for (let i = 2; i < bin.length; i += 3) {
    bin[i] = Math.min(bin[i], row[i - 1]);
    bin[i + 1] = Math.max(bin[i + 1], row[i]);
    bin[i + 2] += ((row[i + 1] - bin[i + 2]) * row[0]) / n;
  }
  bin[1] = n;
}

/** Amplitude densities: translations and rotations, nanometres and nanoradians per root hertz. */
export class Spectra extends Charts {
  constructor(parent, words) {
    super();
    Object.assign(this, { parent, words });
    parent.hidden = true; // no empty space where there is no spectrum
    this.elements = [0, 3].map((first) => this.add(parent.appendChild(node("div", { class: "chart", "data-axis": first }))));
  }

  update(spectrum, rate_hz, now_ms) {
    const { segments, resolution_hz, until_ms } = spectrum;
    const window_ms = 1000 / resolution_hz;
    const of = duration(window_ms);
    const old = now_ms - until_ms > window_ms + OLD_MS;
    this.parent.hidden = false;
    this.parent.classList.toggle("old", old);
    const what = `Welch, Hann windows of ${of} overlapping by half, ${Math.min(segments, 16)} of 16 averaged, lines ${resolution_hz.toPrecision(3)} Hz apart, from all ${rate_hz} poses a second.`;
    say(this.words, old ? `Old, of ${time(until_ms, now_ms)}: since then no ${of} of poses without a gap.` : what);
    if (old && this.spectrum) return;
    Object.assign(this, { spectrum, dirty: true });
  }

  draw(element) {
    if (!this.spectrum) return;
    const first = Number(element.dataset.axis);
    const name = first === 0 ? "nm/√Hz" : "nrad/√Hz";
    const data = LINES.map(([color, dash], i) => ({
      type: "scatter", mode: "lines", name: AXES[first + i].name, x: this.spectrum.hz,
      y: this.spectrum.asd[first + i].map((x) => x * 1e9),
      hovertemplate: `%{x:.4~g} Hz: %{y:.4~g} ${name}`, line: { color: css(color), dash, width: 1.4 },
    }));
    const layout = look({
      height: 240, margin: { l: 56, r: 20, t: 26, b: 36 }, hovermode: "closest", showlegend: true,
      legend: { orientation: "h", x: 1, xanchor: "right", y: 1.15, bgcolor: "rgba(0,0,0,0)" },
      title: { text: first === 0 ? `translations, ${name}` : `rotations, ${name}`, x: 0, xref: "paper", xanchor: "left", y: 0.97, font: { size: 12, color: css("--text") } },
      xaxis: { type: "log", title: { text: "Hz", standoff: 4 }, fixedrange: true, dtick: 1, exponentformat: "none", minor: { dtick: "D1" } },
      yaxis: { type: "log", fixedrange: true, dtick: 1, exponentformat: "power" },
    });
    window.Plotly.react(element, data, layout, OPTIONS);
  }
}
