// Curves of forces, grips, joints and the timing of the servo over the whole run. Each point has the
// largest value since the one before, so that no peak is lost.

import { keep, kept } from "./settings.js";

/** Number of points from which on two neighbours of the older half become one. */
const MOST = 8000;
/** Names of the colours of the curves, one for each arm. */
const HUES = ["one", "two", "three", "four"];
/** Time between two drawings (ms). */
const DRAWN = 250;

/** Merges two points into one with the larger value of each peak, and the last of all others. */
function merged(a, b) {
  const most = (k, j) => Math.max(a.arms[k].peak[j], b.arms[k].peak[j]);
  const arms = b.arms.map((arm, k) => (a.arms[k]
    ? { ...arm, peak: [most(k, 0), most(k, 1)], following: Math.max(a.arms[k].following, arm.following) } : arm));
  const servo = a.servo && b.servo
    ? { ...b.servo, late: Math.max(a.servo.late, b.servo.late), work: Math.max(a.servo.work, b.servo.work) }
    : a.servo ?? b.servo;
  return { time: b.time, arms, servo };
}

/** Returns fewer points with the same peaks: each two neighbours of the older half become one. */
export function thinned(points) {
  const half = 2 * Math.floor(points.length / 4);
  const kept = [];
  for (let i = 0; i < half; i += 2) kept.push(merged(points[i], points[i + 1]));
  return kept.concat(points.slice(half));
}

const deg = (rad) => (rad * 180) / Math.PI;
const axes = ["x", "y", "z"];
/**
 * Charts in groups: the value of an arm, the limits that are drawn, and the least top of the scale.
 * Those with `on` are shown until the person chooses others.
 */
const CHARTS = [
  { group: "Forces", name: "Force", unit: "N", of: (arm) => arm.peak[0], limit: (l) => l.force, least: 5, on: true },
  ...axes.map((axis, i) => ({ group: "Forces", name: `Force ${axis}`, unit: "N", of: (arm) => arm.wrench?.[i], least: 5 })),
  { group: "Torques", name: "Torque", unit: "Nm", of: (arm) => arm.peak[1], limit: (l) => l.torque, least: 1, on: true },
  ...axes.map((axis, i) => ({ group: "Torques", name: `Torque ${axis}`, unit: "Nm", of: (arm) => arm.wrench?.[3 + i], least: 1 })),
  { group: "Grip", name: "Grip", unit: "N", of: (arm) => arm.grip, least: 5 },
  { group: "Grip", name: "Jaw opening", unit: "mm", of: (arm) => arm.opening * 1e3, least: 90 },
  { group: "Motion", name: "Following error", unit: "mm", of: (arm) => arm.following * 1e3, least: 1, on: true },
  { group: "Joints", name: "Track", unit: "m", of: (arm) => arm.joints?.[0], least: 0.1 },
  ...[1, 2, 3, 4, 5, 6].map((i) => ({ group: "Joints", name: `Joint ${i}`, unit: "°", of: (arm) => deg(arm.joints?.[i]), least: 10 })),
  { group: "Servo", name: "Servo: late and work", unit: "µs", servo: true, limit: (l) => l.period * 1e6, least: 100, on: true },
];
/** Key under which the browser keeps the chosen charts. */
const CHOSEN = "curves";

const el = (tag, props = {}, ...children) => {
  const it = Object.assign(document.createElement(tag), props);
  it.append(...children);
  return it;
};

/** Returns a round step for a scale of this height, with at most three steps. */
function roundStep(height) {
  const power = 10 ** Math.floor(Math.log10(Math.max(height, 1e-9) / 3.2));
  return [1, 2, 2.5, 5, 10].map((s) => s * power).find((s) => height / s <= 3.2) ?? height / 2;
}

/** The charts and their points. */
export class Curves {
  /** `place` gets the charts, `tree` the choice of signals. */
  constructor(place, tree) {
    this.place = place;
    this.tree = tree;
    this.points = [];
    this.window = 60;
    /** Range of time that the person has chosen as [from, to]; null to follow the run. */
    this.range = null;
    /** Time at the pointer, drawn in all charts; null without a pointer. */
    this.cursor = null;
    /** Spans of phases and steps, drawn behind the curves. */
    this.bands = [];
    this.charts = [];
    this.names = kept(CHOSEN, CHARTS.filter((chart) => chart.on).map((chart) => chart.name));
  }

  /** Makes the charts for the arms of a new run, without points. */
  set(stage) {
    this.stage = stage;
    this.points = [];
    this.whole = false;
    this.now = 0;
    this.range = null;
    this.choose();
    this.build();
  }

  /** Takes the points of the run until now, or of a whole recording. */
  history({ points, whole }) {
    this.points = points;
    this.whole = whole;
    this.redraw();
  }

  /** Returns the charts that this run can have. */
  possible() {
    return CHARTS.filter((chart) => (!chart.servo || this.stage.pace === "real-time")
      && (chart.name !== "Track" || this.stage.arms.some((arm) => arm.has_track)));
  }

  /** Makes the choice of signals: a list of boxes for each group. */
  choose() {
    if (!this.tree) return;
    const groups = Map.groupBy?.(this.possible(), (chart) => chart.group) ?? new Map([["Signals", this.possible()]]);
    this.tree.replaceChildren(...[...groups].map(([group, charts]) => el("fieldset", {}, el("legend", { textContent: group }),
      ...charts.map(({ name }) => {
        const box = el("input", { type: "checkbox", checked: this.names.includes(name) });
        box.onchange = () => {
          this.names = box.checked ? [...this.names, name] : this.names.filter((other) => other !== name);
          keep(CHOSEN, this.names);
          this.build();
          this.redraw();
        };
        return el("label", {}, box, ` ${name}`);
      }))));
  }

  /** Makes the charts that are chosen. */
  build() {
    this.place.replaceChildren();
    this.charts = this.possible().filter((chart) => this.names.includes(chart.name)).map((chart) => {
      const names = chart.servo ? ["late", "work"] : this.stage.arms.map((arm) => arm.name);
      const key = el("span", {}, ...names.map((name, i) => el("span", { className: `key ${HUES[i] ?? ""}`, textContent: name })));
      const title = el("span");
      const canvas = el("canvas");
      canvas.setAttribute("role", "img");
      this.steer(canvas);
      this.place.append(el("figure", {}, el("figcaption", {}, title, key), canvas));
      return { ...chart, canvas, title };
    });
  }

  /** Lets pointer and wheel move a cursor, the range and its length. */
  steer(canvas) {
    let held = null;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held = { x: event.clientX, range: this.shown() };
    });
    canvas.addEventListener("pointermove", (event) => {
      const { left, width } = this.box(canvas);
      const [from, to] = this.shown();
      if (held && Math.abs(event.clientX - held.x) > 3) {
        const by = ((held.x - event.clientX) / width) * (held.range[1] - held.range[0]);
        this.zoom([held.range[0] + by, held.range[1] + by]);
      }
      this.cursor = from + ((event.clientX - left) / width) * (to - from);
      this.redraw();
    });
    const end = () => { held = null; };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => {
      this.cursor = null;
      this.redraw();
    });
    canvas.addEventListener("dblclick", () => this.zoom(null));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const { left, width } = this.box(canvas);
      const [from, to] = this.shown();
      const share = Math.min(1, Math.max(0, (event.clientX - left) / width));
      const at = from + share * (to - from);
      const length = Math.max(0.5, (to - from) * Math.exp(event.deltaY * 0.0015));
      this.zoom([at - share * length, at + (1 - share) * length]);
    }, { passive: false });
  }

  /** Returns the left edge and the width of the drawn area of a canvas, in the window (px). */
  box(canvas) {
    const { left, width } = canvas.getBoundingClientRect();
    return { left: left + LEFT, width: width - LEFT - 4 };
  }

  /** Shows this range of time, or follows the run again. */
  zoom(range) {
    this.range = range && [Math.max(-1, range[0]), range[1]];
    this.onrange?.(this.range);
    this.redraw();
  }

  /** Returns the range of time that is shown. */
  shown() {
    if (this.range) return this.range;
    const end = this.whole ? this.now : this.points.at(-1)?.time ?? 0;
    const from = Math.max(0, end - this.window);
    return [from, Math.max(end, from + Math.min(this.window, 10))];
  }

  /** Adds the point of a snapshot. Starts again if time has gone back. */
  show(snapshot) {
    this.now = snapshot.time;
    if (!this.whole) this.add(snapshot);
    this.due();
  }

  /** Adds the point of a snapshot of a live run. */
  add(snapshot) {
    const last = this.points.at(-1);
    // The history rounds its times.
    if (last && snapshot.time < last.time - 1e-3) this.points = [];
    if (last && snapshot.time <= last.time) return;
    const arms = snapshot.arms.map(({ peak, following, wrench, grip, opening, joints }) => ({ peak, following, wrench, grip, opening, joints }));
    this.points.push({ time: snapshot.time, arms, servo: snapshot.servo });
    if (this.points.length > MOST) this.points = thinned(this.points);
  }

  /** Draws the curves if 250 ms have passed since the last drawing, which is smooth enough. */
  due() {
    const now = performance.now();
    if (now - (this.drawn ?? 0) < DRAWN) return;
    this.draw();
  }

  /** Draws the curves with the next frame. */
  redraw() {
    this.waits ??= requestAnimationFrame(() => this.draw());
  }

  /** Draws all charts. */
  draw() {
    cancelAnimationFrame(this.waits);
    this.waits = null;
    this.drawn = performance.now();
    const [from, to] = this.shown();
    // One point more on each side, so that the lines reach the edges.
    const first = Math.max(0, this.points.findIndex((p) => p.time >= from) - 1);
    const after = this.points.findIndex((p) => p.time > to);
    const points = from > (this.points.at(-1)?.time ?? 0) ? [] : this.points.slice(first, after < 0 ? undefined : after + 1);
    const at = this.cursor === null ? null : nearest(points, this.cursor);
    for (const chart of this.charts) draw(chart, { points, from, to, at, stage: this.stage, bands: this.bands, now: this.whole ? this.now : null });
  }

  /** Returns the points that are shown as lines of comma-separated values. */
  table() {
    const [from, to] = this.shown();
    const columns = this.charts.filter((chart) => !chart.servo).flatMap((chart) => this.stage.arms.map((arm, i) => [`${arm.name} ${chart.name} (${chart.unit})`, (p) => chart.of(p.arms[i])]));
    const rows = this.points.filter((p) => p.time >= from && p.time <= to).map((p) => [p.time, ...columns.map(([, of]) => of(p))]);
    return [["time (s)", ...columns.map(([name]) => name)], ...rows].map((row) => row.join(",")).join("\n");
  }
}

/** Width of the numbers left of a chart, and height of those under it (px). */
const LEFT = 40;
const FOOT = 14;

/** Returns the point that is nearest to a time. */
function nearest(points, time) {
  return points.reduce((best, p) => (!best || Math.abs(p.time - time) < Math.abs(best.time - time) ? p : best), null);
}

/** Draws one chart: bands, scale, limit, a curve for each arm, the cursor, and the values as title. */
function draw(chart, { points, from, to, at: marked, stage, bands, now }) {
  const { canvas } = chart;
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const [w, h] = [canvas.clientWidth, canvas.clientHeight];
  if (!w || !h) return;
  const [wide, tall] = [Math.round(w * ratio), Math.round(h * ratio)];
  if (canvas.width !== wide || canvas.height !== tall) [canvas.width, canvas.height] = [wide, tall];
  const at = canvas.getContext("2d");
  at.setTransform(ratio, 0, 0, ratio, 0, 0);
  at.clearRect(0, 0, w, h);
  const style = getComputedStyle(canvas);
  const colour = (name) => style.getPropertyValue(name).trim();
  const values = (p) => chart.servo ? [p.servo?.late * 1e6, p.servo?.work * 1e6] : p.arms.map((arm) => chart.of(arm));
  const all = points.flatMap(values).filter(Number.isFinite);
  const most = all.reduce((m, v) => Math.max(m, v), chart.least);
  const least = all.reduce((m, v) => Math.min(m, v), 0);
  const limit = chart.limit?.(stage.limits);
  const high = limit && limit < most * 4 ? Math.max(limit * 1.08, most * 1.1) : most * 1.15;
  const low = least < 0 ? least * 1.15 : 0;
  const x = (t) => LEFT + ((t - from) / Math.max(1e-9, to - from)) * (w - LEFT - 4);
  const y = (v) => 4 + (1 - (v - low) / (high - low)) * (h - FOOT - 6);
  const vertical = (t) => {
    at.beginPath();
    at.moveTo(x(t), 4);
    at.lineTo(x(t), h - FOOT);
    at.stroke();
  };
  at.fillStyle = colour("--band");
  for (const [begin, end] of bands) {
    if (end > from && begin < to) at.fillRect(Math.max(LEFT, x(begin)), 4, Math.min(w - 4, x(end)) - Math.max(LEFT, x(begin)), h - FOOT - 4);
  }
  at.font = "10.5px system-ui, sans-serif";
  at.fillStyle = colour("--quiet");
  at.strokeStyle = colour("--line");
  at.lineWidth = 1;
  const step = roundStep(high - low);
  at.textAlign = "right";
  for (let v = Math.ceil(low / step) * step; v <= high; v += step) {
    at.beginPath();
    at.moveTo(LEFT, y(v));
    at.lineTo(w, y(v));
    at.stroke();
    at.fillText(String(Number(v.toPrecision(6))), LEFT - 4, y(v) + 3.5);
  }
  const digits = to - from < 20 ? 1 : 0;
  at.textAlign = "left";
  at.fillText(`${from.toFixed(digits)} s`, LEFT, h - 3);
  at.textAlign = "right";
  at.fillText(`${to.toFixed(digits)} s`, w - 3, h - 3);
  if (limit && limit <= high) {
    at.strokeStyle = colour("--bad");
    at.setLineDash([5, 4]);
    at.beginPath();
    at.moveTo(LEFT, y(limit));
    at.lineTo(w, y(limit));
    at.stroke();
    at.setLineDash([]);
  }
  at.save();
  at.beginPath();
  at.rect(LEFT, 0, w - LEFT, h - FOOT + 2);
  at.clip();
  const count = points.length ? values(points[0]).length : 0;
  for (let i = 0; i < count; i++) {
    at.strokeStyle = colour(`--${HUES[i] ?? HUES[0]}`);
    at.lineWidth = 1.4;
    at.beginPath();
    let begun = false;
    for (const p of points) {
      const v = values(p)[i];
      if (!Number.isFinite(v)) continue;
      if (begun) at.lineTo(x(p.time), y(v));
      else at.moveTo(x(p.time), y(v));
      begun = true;
    }
    at.stroke();
  }
  at.restore();
  at.lineWidth = 1;
  at.strokeStyle = colour("--ink");
  if (now !== null && now >= from && now <= to) vertical(now);
  at.strokeStyle = colour("--quiet");
  if (marked) vertical(marked.time);
  const told = marked ?? (now !== null ? nearest(points, now) : points.at(-1));
  const words = told ? values(told).map((v) => (Number.isFinite(v) ? v.toFixed(Math.abs(v) < 10 ? 1 : 0) : "–")).join(" / ") : "–";
  chart.title.textContent = `${chart.name} [${chart.unit}]: ${words}${marked ? ` at ${marked.time.toFixed(1)} s` : ""}`;
  canvas.setAttribute("aria-label", `${chart.name}: ${words} ${chart.unit}`);
}
