// Strip charts and spectra. Only visible charts are drawn, and drawing takes a limited part of the time.

import { css, plot, through } from "./plot.js";
import { AXES, duration, fixed, node, say, time, unit } from "./words.js";

const LINES = [["--line-1", "solid"], ["--line-2", "dash"], ["--line-3", "dot"]];
/** A spectrum is old if it has no new data for its window and this time. */
const OLD_MS = 2500;
/** A step back by more fine intervals is a restart of a replay; a smaller one is a repetition of known intervals. */
const BACK = 50;
/** Shortest time axis. */
const LEAST_MS = 5000;
/** Allowed steps between the times at the axis, milliseconds. */
const STEPS_MS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200].map((s) => s * 1000);

/** Charts that are drawn if they have new data, are visible, and their drawing interval has elapsed. */
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

  /** Limits drawing to a fifth of the time. */
  tick(period_ms) {
    const start = performance.now();
    if (!this.dirty || document.hidden || start < this.next_ms) return;
    this.dirty = false;
    for (const element of this.visible) this.draw(element);
    const took = performance.now() - start;
    this.next_ms = start + Math.max(period_ms, 5 * took);
  }
}

/** The six axes over time. Holds about one interval per pixel for every time span. */
export class Strips extends Charts {
  constructor(parent) {
    super();
    this.bins = [];
    this.marks = [];
    this.elements = AXES.map((axis, i) => this.add(parent.appendChild(node("div", { class: "chart", "data-axis": i }))));
  }

  /** Takes the history from the daemon. */
  past({ width_ms, through, bins }, span_s) {
    Object.assign(this, { width_ms, through, bins, span_ms: span_s * 1000, dirty: true });
  }

  /** Adds fine intervals to those of the chart; skips intervals that the history already contains. */
  add_news(news, fine_ms, now_ms) {
    if (!this.width_ms) return;
    const factor = this.width_ms / fine_ms;
    for (const [fine, ...row] of news) {
      if (fine <= this.through) {
        if (this.through - fine < BACK) continue;
        this.bins = []; // a replay has restarted: the drawn intervals are in its future
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

  /** Takes the events after which poses have another meaning. */
  mark(events) {
    this.marks = events;
    this.dirty = true;
  }

  /** Mean and range of an axis over the time span of the chart, from the last mark on. */
  statistics(axis) {
    const at = 2 + 3 * axis;
    let [n, sum, min, max] = [0, 0, Infinity, -Infinity];
    const from = (this.marks.at(-1)?.time_ms ?? -Infinity) / this.width_ms;
    for (const bin of this.bins) {
      if (bin[0] < from) continue; // begins before the mark
      n += bin[1];
      sum += bin[1] * bin[at + 2];
      min = Math.min(min, bin[at]);
      max = Math.max(max, bin[at + 1]);
    }
    return n > 0 ? { mean: sum / n, range: max - min } : { mean: null, range: null };
  }

  /** There is a gap between intervals with a larger distance than this. */
  get gap_ms() {
    return Math.max(this.width_ms, 1.5 * (this.period_ms ?? 0));
  }

  /** Time, and smallest, largest and mean of each interval; null where poses are missing. */
  lines(axis) {
    const { scale } = unit(axis);
    const at = 2 + 3 * axis;
    const lines = [[], [], [], []];
    const put = (...row) => row.forEach((value, i) => lines[i].push(value));
    let before = null;
    for (const bin of this.bins) {
      const middle = (bin[0] + 0.5) * this.width_ms;
      if (before !== null && (bin[0] - before) * this.width_ms > this.gap_ms) put(middle - this.width_ms, null, null, null);
      put(middle, ...bin.slice(at, at + 3).map((value) => value * scale));
      before = bin[0];
    }
    if (before === null) put(this.now_ms, null, null, null); // the axes need a time
    return lines;
  }

  draw(element) {
    if (this.now_ms === undefined) return;
    const axis = Number(element.dataset.axis);
    const data = this.lines(axis);
    element.chart ??= this.begin(element, axis, data);
    say(element.querySelector(".title"), `${AXES[axis].name}, ${unit(axis).name}`);
    say(element.querySelector(".empty"), this.bins.length > 0 ? "" : "no poses");
    element.chart.batch(() => element.chart.setData(data));
  }

  /** Lines at the marks. */
  under(u) {
    const { ctx, bbox } = u;
    ctx.save();
    ctx.strokeStyle = css("--event");
    ctx.lineWidth = uPlot.pxRatio;
    for (const { time_ms } of this.marks) {
      if (time_ms < this.from_ms || time_ms > this.now_ms) continue;
      const x = Math.round(u.valToPos(time_ms, "x", true));
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
    }
    ctx.restore();
  }

  /** Start of the time axis: that of the span, or of the data if they are shorter. */
  get from_ms() {
    const start = this.now_ms - this.span_ms;
    const first = this.bins[0]?.[0] * this.width_ms;
    return first > start ? Math.min(first, this.now_ms - LEAST_MS) : start;
  }

  begin(element, axis, data) {
    const clock = (ms) => new Date(ms).toISOString().slice(11, this.span_ms > 600e3 ? 16 : 19);
    return plot(element, {
      data,
      series: [
        { color: "--raw", width: 1, path: through(2), name: "smallest" },
        { part: true, name: "largest" },
        { color: "--mean", width: 1.5, name: "mean" },
      ],
      x: {
        range: () => [this.from_ms, this.now_ms], steps: STEPS_MS, values: (u, splits) => splits.map(clock),
        tell: (ms) => time(ms), reach: () => Math.max(this.gap_ms, this.span_ms / 200), // no readout in a gap
      },
      y: { tell: (value) => `${fixed(value, unit(axis).digits)} ${unit(axis).name}` },
      under: (u) => this.under(u),
    });
  }
}

/** Merges `[poses, min, max, mean, ...]` into an interval. */
function merge(bin, row) {
  const n = bin[1] + row[0];
  for (let i = 2; i < bin.length; i += 3) {
    bin[i] = Math.min(bin[i], row[i - 1]);
    bin[i + 1] = Math.max(bin[i + 1], row[i]);
    bin[i + 2] += ((row[i + 1] - bin[i + 2]) * row[0]) / n;
  }
  bin[1] = n;
}

/** Amplitude spectral densities of translations and rotations, nm/√Hz and nrad/√Hz. */
export class Spectra extends Charts {
  constructor(parent, words) {
    super();
    Object.assign(this, { parent, words });
    parent.hidden = true; // no empty space without a spectrum
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
    say(this.words, old ? `Old, from ${time(until_ms, now_ms)}: no ${of} of poses without a gap since then.` : what);
    if (old && this.spectrum) return;
    Object.assign(this, { spectrum, dirty: true });
  }

  draw(element) {
    if (!this.spectrum) return;
    const first = Number(element.dataset.axis);
    const { hz, asd } = this.spectrum;
    const data = [hz, ...asd.slice(first, first + 3).map((line) => line.map((x) => (x > 0 ? x * 1e9 : null)))];
    element.chart ??= this.begin(element, first, data);
    element.chart.batch(() => element.chart.setData(data));
  }

  begin(element, first, data) {
    const name = first === 0 ? "nm/√Hz" : "nrad/√Hz";
    return plot(element, {
      data, legend: true, title: first === 0 ? `translations, ${name}` : `rotations, ${name}`,
      series: LINES.map(([color, dash], i) => ({ color, dash, name: AXES[first + i].name })),
      x: { log: true, label: "Hz", range: (u, low, high) => [low, high], tell: (f) => `${f.toPrecision(4)} Hz` },
      y: { log: true, tell: (value) => `${value.toPrecision(4)} ${name}` },
    });
  }
}
