// Draws the figures of the report from the numbers in the data element. Is appended to plot.js in one module.

const data = JSON.parse(document.getElementById("data").textContent);
const MARKS = [["--line-1", "circle"], ["--line-2", "square"], ["--line-3", "diamond"]];
const PAPER_PX = [325, 235]; // size of a printed chart: two side by side on A4

const figures = (value) => Number(value.toPrecision(4)).toString().replace("-", "−");
const said = (unit) => (value) => `${figures(value)} ${unit}`;

/** A line across the whole chart, or an area between two. */
function across(u, low, high, { stroke, fill, dash = [] }) {
  const { ctx, bbox } = u;
  const [top, bottom] = [high, low].map((y) => u.valToPos(y, "y", true));
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.lineWidth = uPlot.pxRatio;
  ctx.setLineDash(dash.map((length) => length * uPlot.pxRatio));
  Object.assign(ctx, { strokeStyle: css(stroke), fillStyle: fill ? css(fill) : "transparent" });
  ctx.fillRect(bbox.left, top, bbox.width, bottom - top);
  for (const y of high === low ? [low] : [low, high]) {
    ctx.beginPath();
    ctx.moveTo(bbox.left, y === high ? top : bottom);
    ctx.lineTo(bbox.left + bbox.width, y === high ? top : bottom);
    ctx.stroke();
  }
  ctx.restore();
}

/** The points in the order of their references. */
function sorted(a) {
  const order = a.reference.map((_, i) => i).sort((i, k) => a.reference[i] - a.reference[k]);
  return (key) => order.map((i) => a[key][i]);
}

/** (a): measured against reference. */
function displacement(a) {
  const of = sorted(a);
  return {
    data: [of("reference"), of("reference"), of("measured")],
    series: [{ name: "reference", color: "--quiet", width: 1, dash: "dot" }, { name: "mean", color: "--mean", width: 1.5, symbol: "circle" }],
    x: { label: `reference, ${a.unit}`, tell: said(a.unit) }, y: { label: `measured, ${a.unit}`, tell: said(a.unit) },
  };
}

/** (b): errors with their scatter. */
function errors(a) {
  const of = sorted(a);
  const [error, std] = [of("error"), of("std")];
  const range = { color: "--range", width: 1, dash: "dot", symbol: "tick" };
  const sigma = { color: "--sigma", width: 1.2, dash: "dash" };
  return {
    data: [of("reference"), of("high"), of("low"), error.map((e, i) => e + std[i]), error.map((e, i) => e - std[i]), error],
    series: [{ ...range, name: "largest" }, { ...range, name: "smallest" }, { ...sigma, name: "+σ" }, { ...sigma, name: "−σ" }, { name: "mean", color: "--mean", width: 2, symbol: "circle" }],
    under: (u) => across(u, -a.paper_std, a.paper_std, { stroke: "--paper", fill: "--band" }),
    x: { label: `reference, ${a.unit}`, tell: said(a.unit) }, y: { label: `error, ${a.unit}`, tell: said(a.unit), include: [-a.paper_std, a.paper_std] },
  };
}

function bound({ names, ratio, half, paper }) {
  const places = names.map((_, i) => i);
  return {
    legend: true, data: [places, ratio, ratio.map((r, i) => r - half[i]), ratio.map((r, i) => r + half[i]), paper],
    series: [{ name: "measured", color: "--mean", path: bars, symbol: "circle", size: 9 }, { part: true }, { part: true }, { name: "paper", color: "--paper", path: null, symbol: "open", size: 9 }],
    under: (u) => across(u, 1, 1, { stroke: "--quiet", dash: [2, 3] }),
    x: { range: () => [-0.5, names.length - 0.5], splits: () => places, values: () => names, tell: (i) => names[i] },
    y: { label: "measured / predicted", tell: (value) => value.toFixed(3), include: [1] },
  };
}

const three = (first) => data.rest.axes.slice(first, first + 3);

/** The measured values with error bars, and white noise of the reported standard uncertainty. */
function allan(first) {
  const { tau } = data.rest;
  const { unit } = data.rest.axes[first];
  const part = { part: true };
  return {
    legend: true,
    data: [tau, ...three(first).flatMap(({ allan: a, part: p, stated }) => [
      a, a.map((value, k) => value * (1 - p[k])), a.map((value, k) => value * (1 + p[k])), tau.map((t) => stated / Math.sqrt(t / tau[0])),
    ])],
    series: three(first).flatMap(({ name }, i) => [
      { name, color: MARKS[i][0], path: bars, symbol: MARKS[i][1], size: 7 }, part, part, { name: `${name}, white noise`, color: MARKS[i][0], width: 1, dash: "dot", unlisted: true },
    ]),
    x: { log: true, label: "time of a mean, s", tell: said("s") }, y: { log: true, label: `Allan deviation, ${unit}`, tell: said(unit) },
  };
}

function course(first) {
  const { unit } = data.rest.axes[first];
  return {
    legend: true, data: [data.rest.times, ...three(first).map((axis) => axis.course)],
    series: three(first).map(({ name }, i) => ({ name, color: MARKS[i][0], width: 1.3, symbol: MARKS[i][1], size: 5 })),
    x: { label: "time, s", tell: said("s") }, y: { label: `less the mean, ${unit}`, tell: said(unit) },
  };
}

function figure(element) {
  const [kind, which] = [element.dataset.kind ?? element.id, Number(element.dataset.axis)];
  if (kind === "bound") return bound(data.bound);
  if (kind === "allan") return allan(which);
  if (kind === "course") return course(which);
  return kind === "errors" ? errors(data.axes[which]) : displacement(data.axes[which]);
}

/** Draws synchronously, because the browser prints when this returns. */
function draw(paper) {
  for (const element of document.querySelectorAll(".chart")) {
    element.style.width = paper ? `${element.id === "bound" ? 2 * paper[0] : paper[0]}px` : "";
    element.style.height = paper ? `${paper[1]}px` : "";
    plot(element, { ...figure(element), zoom: true, font: paper ? 10 : 12 }).batch(() => {});
  }
}

draw();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw());
addEventListener("beforeprint", () => { document.documentElement.dataset.theme = "light"; draw(PAPER_PX); });
addEventListener("afterprint", () => { delete document.documentElement.dataset.theme; draw(); });
document.body.dataset.drawn = "yes";
