// Draws the figures of the report. All numbers are in the data element.

const data = JSON.parse(document.getElementById("data").textContent);
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const MARKS = [["--line-1", "circle"], ["--line-2", "square"], ["--line-3", "diamond"]];
const PAPER_PX = [325, 235]; // size of a printed chart: two side by side on A4

function look(more) {
  const axis = { gridcolor: css("--grid"), linecolor: css("--edge"), zerolinecolor: css("--edge"), automargin: true, fixedrange: false };
  const title = (a) => (a?.title ? { title: { text: a.title, standoff: 6 } } : {});
  return {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false, hovermode: "closest",
    margin: { l: 60, r: 14, t: 10, b: 44 }, autosize: true,
    font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: css("--quiet") },
    ...more, xaxis: { ...axis, ...more.xaxis, ...title(more.xaxis) }, yaxis: { ...axis, ...more.yaxis, ...title(more.yaxis) },
  };
}

const lines = (x, y, name, line) => ({ type: "scatter", mode: "lines", x, y, name, line, hovertemplate: `%{x:.4~g}: %{y:.4~g}<extra>${name}</extra>` });

/** (a): measured against reference. */
function displacement(a) {
  const ends = [Math.min(...a.reference), Math.max(...a.reference)];
  return [[
    lines(ends, ends, "reference", { color: css("--quiet"), width: 1, dash: "dot" }),
    { ...lines(a.reference, a.measured, "mean", { color: css("--mean"), width: 1.5 }), mode: "lines+markers", marker: { size: 6 } },
  ], look({ xaxis: { title: `reference, ${a.unit}` }, yaxis: { title: `measured, ${a.unit}` } })];
}

/** (b): errors with their scatter. */
function errors(a) {
  const sum = (x, y, sign) => x.map((value, i) => value + sign * y[i]);
  const sigma = { color: css("--sigma"), width: 1.2, dash: "dash" };
  const range = { color: css("--range"), width: 1, dash: "dot" };
  const mark = { mode: "lines+markers", marker: { size: 4, symbol: "line-ew-open" } };
  const shapes = [{ type: "rect", xref: "paper", x0: 0, x1: 1, y0: -a.paper_std, y1: a.paper_std, fillcolor: css("--band"), layer: "below", line: { color: css("--paper"), width: 1 } }];
  return [[
    { ...lines(a.reference, a.high, "largest", range), ...mark },
    { ...lines(a.reference, a.low, "smallest", range), ...mark },
    lines(a.reference, sum(a.error, a.std, 1), "+σ", sigma),
    lines(a.reference, sum(a.error, a.std, -1), "-σ", sigma),
    { ...lines(a.reference, a.error, "mean", { color: css("--mean"), width: 2 }), mode: "lines+markers", marker: { size: 6 } },
  ], look({ shapes, xaxis: { title: `reference, ${a.unit}` }, yaxis: { title: `error, ${a.unit}` } })];
}

function bound({ names, ratio, half, paper }) {
  const dots = (y, name, colour, symbol, more) => ({
    type: "scatter", mode: "markers", x: names, y, name, marker: { color: css(colour), symbol, size: 10 },
    hovertemplate: `%{x}: %{y:.3f}<extra>${name}</extra>`, ...more,
  });
  return [[
    dots(ratio, "measured", "--mean", "circle", { error_y: { type: "data", array: half, color: css("--mean"), thickness: 1.5, width: 5 } }),
    dots(paper, "paper", "--paper", "diamond-open"),
  ], look({
    showlegend: true, legend: { orientation: "h", x: 1, xanchor: "right", y: 1.02, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" }, margin: { l: 60, r: 14, t: 34, b: 30 },
    shapes: [{ type: "line", xref: "paper", x0: 0, x1: 1, y0: 1, y1: 1, line: { color: css("--quiet"), width: 1, dash: "dot" } }],
    xaxis: { type: "category" }, yaxis: { title: "measured / predicted" },
  })];
}

const three = (first) => data.rest.axes.slice(first, first + 3);
const legend = { showlegend: true, legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" }, margin: { l: 60, r: 14, t: 34, b: 44 } };

function allan(first) {
  const theory = (axis) => data.rest.tau.map((tau) => axis.stated / Math.sqrt(tau / data.rest.tau[0]));
  const own = three(first).flatMap((axis, i) => [
    { ...lines(data.rest.tau, theory(axis), `${axis.name}, white noise`, { color: css(MARKS[i][0]), width: 1, dash: "dot" }), showlegend: false },
    {
      ...lines(data.rest.tau, axis.allan, axis.name, { color: css(MARKS[i][0]), width: 1.5 }), mode: "markers", marker: { color: css(MARKS[i][0]), symbol: MARKS[i][1], size: 8 },
      error_y: { type: "data", array: axis.allan.map((a, k) => a * axis.part[k]), color: css(MARKS[i][0]), thickness: 1.2, width: 3 },
    },
  ]);
  const log = { type: "log", dtick: 1, exponentformat: "none", minor: { dtick: "D1" } };
  return [own, look({ ...legend, xaxis: { ...log, title: "averaging time, s" }, yaxis: { ...log, title: `Allan deviation, ${data.rest.axes[first].unit}` } })];
}

function course(first) {
  const own = three(first).map((axis, i) => ({
    ...lines(data.rest.times, axis.course, axis.name, { color: css(MARKS[i][0]), width: 1.3 }), mode: "lines+markers", marker: { symbol: MARKS[i][1], size: 5 },
  }));
  return [own, look({ ...legend, xaxis: { title: "time, s" }, yaxis: { title: `relative to the mean, ${data.rest.axes[first].unit}` } })];
}

function figure(element) {
  const [kind, which] = [element.dataset.kind ?? element.id, Number(element.dataset.axis)];
  if (kind === "bound") return bound(data.bound);
  if (kind === "allan") return allan(which);
  if (kind === "course") return course(which);
  return kind === "errors" ? errors(data.axes[which]) : displacement(data.axes[which]);
}

function draw(size) {
  for (const element of document.querySelectorAll(".chart")) {
    const [traces, layout] = figure(element);
    const fixed = size ? { autosize: false, width: element.id === "bound" ? 2 * size[0] : size[0], height: size[1], font: { ...layout.font, size: 10 } } : {};
    element.style.height = size ? `${size[1]}px` : "";
    Plotly.react(element, traces, { ...layout, ...fixed }, { displayModeBar: false, responsive: true });
  }
}

draw();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw());
addEventListener("beforeprint", () => { document.documentElement.dataset.theme = "light"; draw(PAPER_PX); });
addEventListener("afterprint", () => { delete document.documentElement.dataset.theme; draw(); });
document.body.dataset.drawn = "yes";
