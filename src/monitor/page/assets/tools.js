// What a person does with the data shown: freeze them, save them, show them on a wall.

import { AXES, node, time } from "./words.js";

/** The intervals of the charts as CSV, in SI units. An interval without a pose is omitted. */
export function csv({ bins, width_ms, from_ms }, { session, config }) {
  const names = AXES.flatMap(({ value }) => ["min", "max", "mean"].map((what) => `${value}_${what}`));
  const head = [`# trifacet, session ${hex(session)}, configuration ${hex(config)}; intervals of ${width_ms} ms`, ["time_utc", "poses", ...names].join(",")];
  const rows = bins
    .filter(([k]) => (k + 1) * width_ms > from_ms)
    .map(([k, ...row]) => [new Date(k * width_ms).toISOString(), ...row].join(","));
  return [...head, ...rows, ""].join("\n");
}

export const hex = (n) => n.toString(16).padStart(8, "0");

/** All charts in one picture, two in a row, with their titles and the time. */
export function picture(elements, now_ms) {
  const charts = elements.filter(({ chart }) => chart);
  const [wide, high] = [Math.max(...charts.map(({ chart }) => chart.ctx.canvas.width)), Math.max(...charts.map(({ chart }) => chart.ctx.canvas.height))];
  const [line, rows] = [24 * devicePixelRatio, Math.ceil(charts.length / 2)];
  const canvas = node("canvas", { width: 2 * wide, height: rows * (high + line) + line });
  const style = getComputedStyle(document.body);
  const context = canvas.getContext("2d");
  context.fillStyle = style.backgroundColor;
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.fillStyle = style.color;
  context.font = `${13 * devicePixelRatio}px ${style.fontFamily}`;
  charts.forEach(({ chart, firstChild }, i) => {
    const [x, y] = [(i % 2) * wide, Math.floor(i / 2) * (high + line)];
    context.fillText(firstChild.textContent, x + line / 2, y + 0.7 * line);
    context.drawImage(chart.ctx.canvas, x, y + line);
  });
  context.fillText(`trifacet, ${new Date(now_ms).toISOString().slice(0, 10)} ${time(now_ms)}`, line / 2, canvas.height - 0.3 * line);
  return canvas;
}

/** Offers data to the person as a file. */
export function save(blob, name) {
  const link = node("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10e3);
}

/** The time in a file name: 20260102T030405Z. */
export const stamp = (ms) => `${new Date(ms).toISOString().slice(0, 19).replace(/[-:]/g, "")}Z`;
