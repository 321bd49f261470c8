// Strip charts and spectra. Only what can be seen is drawn, and never so often that the page has no time
// for anything else.

import { plot, through } from "./plot.js";
import { AXES, duration, fixed, node, say, time, unit } from "./words.js";

const LINES = [["--line-1", "solid"], ["--line-2", "dash"], ["--line-3", "dot"]];
/** A spectrum that has got nothing new for longer than a window and this is old. */
const OLD_MS = 2500;
/** Time that goes back by more fine stretches is set back; less is told twice. */
const BACK = 50;
/** Between the times at the axis, seconds. */
const STEPS_MS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200].map((s) => s * 1000);

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
    if (!this.dirty || document.hidden || start < this.next_ms) return;
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

  /** Stretches that are farther apart have a hole between them. */
  get hole_ms() {
    return Math.max(this.width_ms, 1.5 * (this.period_ms ?? 0));
  }

  /** Time, and smallest, largest and mean of each stretch; nothing where poses are missing. */
  lines(axis) {
    const { scale } = unit(axis);
    const at = 2 + 3 * axis;
    const lines = [[], [], [], []];
    const put = (...row) => row.forEach((value, i) => lines[i].push(value));
    let before = null;
    for (const bin of this.bins) {
      const middle = (bin[0] + 0.5) * this.width_ms;
      if (before !== null && (bin[0] - before) * this.width_ms > this.hole_ms) put(middle - this.width_ms, null, null, null);
      put(middle, ...bin.slice(at, at + 3).map((value) => value * scale));
      before = bin[0];
    }
    if (before === null) put(this.now_ms, null, null, null); // the axes need a place
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
        range: () => [this.now_ms - this.span_ms, this.now_ms], steps: STEPS_MS, values: (u, splits) => splits.map(clock),
        tell: (ms) => time(ms), reach: () => Math.max(this.hole_ms, this.span_ms / 200), // in a hole nothing is read out
      },
      y: { tell: (value) => `${fixed(value, unit(axis).digits)} ${unit(axis).name}` },
    });
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
