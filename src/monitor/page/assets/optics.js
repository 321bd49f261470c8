// The three detectors and the balance, as pictures.

import { fixed, node, say } from "./words.js";

const SVG = "http://www.w3.org/2000/svg";
const TRAIL = 50; // five seconds
const PSDS = ["a", "b", "c"];

function draw(parent, tag, attributes = {}) {
  const element = document.createElementNS(SVG, tag);
  set(element, attributes);
  parent.append(element);
  return element;
}

function set(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
}

const close = (points) => points.map((p) => p.map((x) => x.toFixed(4)).join(",")).join(" ");

/** A square per detector: the area, the margin, the spot and its trail. Millimetres, v upwards. */
export class Detectors {
  constructor(parent) {
    this.magnified = false;
    this.views = PSDS.map((name) => {
      const svg = document.createElementNS(SVG, "svg");
      set(svg, { class: "psd", role: "img", "aria-label": `Spot on PSD ${name.toUpperCase()}` });
      const parts = {
        area: draw(svg, "rect", { class: "area" }),
        margin: draw(svg, "rect", { class: "margin" }),
        cross: draw(svg, "path", { class: "cross" }),
        beam: draw(svg, "circle", { class: "light" }),
        trail: draw(svg, "polyline", { class: "trail" }),
        spot: draw(svg, "circle", { class: "spot" }),
        none: draw(svg, "text", { class: "none", "text-anchor": "middle" }),
      };
      const title = node("figcaption", { class: "number" });
      parent.append(node("figure", {}, svg, title));
      return { name, svg, parts, title, past: [] };
    });
  }

  configure(config) {
    this.size = config.head.psd_size_mm;
    this.margin = config.estimation.edge_margin_mm;
    this.diameter = config.head.beam_diameter_mm;
    for (const { parts } of this.views) {
      const [half, inner] = [this.size / 2, this.size / 2 - this.margin];
      set(parts.area, { x: -half, y: -half, width: this.size, height: this.size });
      set(parts.margin, { x: -inner, y: -inner, width: 2 * inner, height: 2 * inner });
      set(parts.cross, { d: `M${-half} 0H${half}M0 ${-half}V${half}` });
    }
  }

  update(frame) {
    if (!this.size) return;
    const total = PSDS.reduce((sum, name) => sum + (frame[`power_${name}_w`] ?? 0), 0);
    for (const view of this.views) {
      const [u, v] = [frame[`u_${view.name}_m`], frame[`v_${view.name}_m`]];
      const lit = u !== null && v !== null;
      if (lit) view.past.push([u * 1e3, -v * 1e3]);
      while (view.past.length > TRAIL || (!lit && view.past.length > 0)) view.past.shift();
      const power = frame[`power_${view.name}_w`];
      this.place(view, lit ? view.past.at(-1) : null, power === null ? "no samples" : "no light");
      const share = power !== null && total > 0 ? `${fixed((100 * power) / total, 2)} %` : "–";
      const watts = power === null ? "–" : `${fixed(power * 1e3, 4)} mW`;
      const at = lit ? `u ${fixed(u * 1e3, 4)} mm\nv ${fixed(v * 1e3, 4)} mm` : "u –\nv –";
      say(view.title, `PSD ${view.name.toUpperCase()}\n${at}\n${watts}\n${share}`);
    }
  }

  place({ svg, parts, past }, spot, none) {
    const span = this.size * (this.magnified ? 0.1 : 1.06);
    const [x, y] = this.magnified && spot ? mean(past) : [0, 0];
    set(svg, { viewBox: `${x - span / 2} ${y - span / 2} ${span} ${span}` });
    parts.trail.setAttribute("points", close(past));
    const at = { cx: spot?.[0] ?? 0, cy: spot?.[1] ?? 0, visibility: spot ? "visible" : "hidden" };
    set(parts.beam, { ...at, r: this.diameter / 2 });
    set(parts.spot, { ...at, r: span / 40 });
    set(parts.none, { x, y: y - span * 0.08, "font-size": span / 11 });
    say(parts.none, spot ? "" : none);
  }
}

const mean = (points) => [0, 1].map((i) => points.reduce((sum, p) => sum + p[i], 0) / points.length);

/** Corners of the triangle: A at the right as in the head, B and C behind. */
const CORNERS = PSDS.map((_, i) => [Math.cos((i * 2 * Math.PI) / 3), -Math.sin((i * 2 * Math.PI) / 3)]);

/** The point in the triangle for three shares with the sum 1. */
const place = (shares) => [0, 1].map((i) => shares.reduce((sum, share, k) => sum + share * CORNERS[k][i], 0));

/** The shares of the three powers: equal shares are in the middle. */
export class Balance {
  constructor(svg) {
    this.svg = svg;
    this.magnified = false;
    this.past = [];
    draw(svg, "polygon", { class: "area", points: close(CORNERS) });
    this.limit = draw(svg, "polygon", { class: "margin" });
    draw(svg, "path", { class: "cross", d: CORNERS.map(([x, y]) => `M0 0L${x} ${y}M0 0L${-x / 2} ${-y / 2}`).join("") });
    this.trail = draw(svg, "polyline", { class: "trail" });
    this.spot = draw(svg, "circle", { class: "spot" });
    this.names = PSDS.map((name) => Object.assign(draw(svg, "text", { class: "corner", "text-anchor": "middle", "dominant-baseline": "central" }), { textContent: name.toUpperCase() }));
    this.none = draw(svg, "text", { class: "none", "text-anchor": "middle" });
  }

  /** The limit on the distance of each share from a third, drawn as a hexagon. */
  configure(config) {
    const b = Math.min(config.estimation.balance_limit, 1 / 3);
    const around = [[b, 0, -b], [0, b, -b], [-b, b, 0], [-b, 0, b], [0, -b, b], [b, -b, 0]];
    this.limit.setAttribute("points", close(around.map((d) => place(d.map((x) => x + 1 / 3)))));
  }

  update(frame) {
    const powers = PSDS.map((name) => frame[`power_${name}_w`]);
    const total = powers.reduce((sum, power) => sum + (power ?? 0), 0);
    const lit = powers.every((power) => power !== null) && total > 0;
    if (lit) this.past.push(place(powers.map((power) => power / total)));
    while (this.past.length > TRAIL || (!lit && this.past.length > 0)) this.past.shift();
    const zoom = this.magnified ? 0.1 : 1;
    set(this.svg, { viewBox: [-0.85, -1.15, 2.1, 2.3].map((x) => x * zoom).join(" ") });
    this.trail.setAttribute("points", close(this.past));
    const [cx, cy] = this.past.at(-1) ?? [0, 0];
    set(this.spot, { cx, cy, r: 0.035 * zoom, visibility: lit ? "visible" : "hidden" });
    this.names.forEach((text, i) => {
      const [x, y] = CORNERS[i].map((c) => c * zoom * (this.magnified ? 0.9 : 1.12));
      set(text, { x, y, "font-size": 0.17 * zoom });
    });
    say(this.none, powers.includes(null) ? "no samples" : "no light");
    set(this.none, { x: 0, y: -0.14 * zoom, "font-size": 0.19 * zoom, visibility: lit ? "hidden" : "visible" });
  }
}
