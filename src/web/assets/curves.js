// Live curves of forces, following errors and the timing of the servo. Each point is the largest
// value since the last snapshot, so that no peak is lost.

/**
 * Number of the newest points that are all kept. Older points are merged into one per SPAN (s), and
 * are dropped after LONGEST (s), the longest time that is shown.
 */
const NEW = 2400;
const SPAN = 0.25;
const LONGEST = 600;

/** Merges two points into one with the larger value of each quantity. */
function merged(a, b) {
  const most = (k, j) => Math.max(a.arms[k].peak[j], b.arms[k].peak[j]);
  const arms = b.arms.map((arm, k) => ({ peak: [most(k, 0), most(k, 1)], following: Math.max(a.arms[k].following, arm.following) }));
  const servo = a.servo && b.servo
    ? { ...b.servo, late: Math.max(a.servo.late, b.servo.late), work: Math.max(a.servo.work, b.servo.work) }
    : a.servo ?? b.servo;
  return { time: b.time, arms, servo };
}

/** Returns fewer points with the same peaks. */
export function thinned(points) {
  const fine = points.length - NEW;
  const from = points.at(-1).time - LONGEST;
  const span = (p) => Math.floor(p.time / SPAN);
  const kept = [];
  points.forEach((point, i) => {
    if (point.time < from) return;
    const last = kept.at(-1);
    if (last && i < fine && span(last) === span(point)) kept[kept.length - 1] = merged(last, point);
    else kept.push(point);
  });
  return kept;
}

/** Charts: the value of an arm, the limit that is drawn, and the least top of the scale. */
const CHARTS = [
  { name: "Force", unit: "N", of: (arm) => arm.peak[0], limit: (l) => l.force, least: 5 },
  { name: "Torque", unit: "Nm", of: (arm) => arm.peak[1], limit: (l) => l.torque, least: 1 },
  { name: "Following error", unit: "mm", of: (arm) => arm.following * 1e3, least: 1 },
  { name: "Servo: late and work", unit: "µs", servo: true, limit: (l) => l.period * 1e6, least: 100 },
];

/** The charts and their points. */
export class Curves {
  constructor(place) {
    this.place = place;
    this.points = [];
    this.room = 2 * NEW;
    this.window = 60;
    this.charts = [];
  }

  /** Makes the charts for the arms of a new run, without points. */
  set(stage) {
    this.stage = stage;
    this.points = [];
    this.place.replaceChildren();
    const charts = CHARTS.filter((chart) => !chart.servo || stage.pace === "real-time");
    this.charts = charts.map((chart) => {
      const figure = document.createElement("figure");
      const caption = document.createElement("figcaption");
      const title = document.createElement("span");
      const names = chart.servo ? ["late", "work"] : stage.arms.map((arm) => arm.name);
      const key = document.createElement("span");
      names.forEach((name, i) => key.append(Object.assign(document.createElement("span"), { className: `key ${i ? "two" : ""}`, textContent: name })));
      caption.append(title, key);
      const canvas = document.createElement("canvas");
      canvas.setAttribute("role", "img");
      figure.append(caption, canvas);
      this.place.append(figure);
      return { ...chart, canvas, title };
    });
  }

  /** Adds the point of a snapshot. Starts again if time has gone back, as in a replay. */
  show(snapshot) {
    const last = this.points.at(-1);
    if (last && snapshot.time < last.time) this.points = [];
    if (last && snapshot.time === last.time) return this.due();
    this.points.push({ time: snapshot.time, arms: snapshot.arms.map((a) => ({ peak: a.peak, following: a.following })), servo: snapshot.servo });
    if (this.points.length > this.room) {
      this.points = thinned(this.points);
      this.room = this.points.length + NEW;
    }
    this.due();
  }

  /** Draws the curves if 250 ms have passed since the last drawing, which is smooth enough. */
  due() {
    const now = performance.now();
    if (now - (this.drawn ?? 0) < 250) return;
    this.drawn = now;
    this.charts.forEach((chart) => this.draw(chart));
  }

  /** Draws one chart: scale, limit, a curve for each arm, and the latest values as its title. */
  draw(chart) {
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
    const end = this.points.at(-1)?.time ?? 0;
    const from = Math.max(0, end - this.window);
    const shown = this.points.filter((p) => p.time >= from);
    const values = (p) => chart.servo ? [p.servo?.late * 1e6, p.servo?.work * 1e6] : p.arms.map((arm) => chart.of(arm));
    const top = shown.reduce((m, p) => Math.max(m, ...values(p).filter(Number.isFinite)), chart.least);
    const limit = chart.limit?.(this.stage.limits);
    const high = limit && limit < top * 4 ? Math.max(limit * 1.08, top * 1.1) : top * 1.15;
    const [left, foot] = [34, 14];
    const x = (t) => left + ((t - from) / Math.max(1e-9, Math.max(end - from, Math.min(this.window, 10)))) * (w - left - 4);
    const y = (v) => 4 + (1 - v / high) * (h - foot - 6);
    at.font = "10.5px system-ui, sans-serif";
    at.fillStyle = colour("--quiet");
    at.strokeStyle = colour("--line");
    at.lineWidth = 1;
    const step = [0.5, 1, 2, 5, 10, 20, 25, 50, 100, 200, 500, 1000, 2000, 5000].find((s) => high / s <= 3.2) ?? high / 2;
    at.textAlign = "right";
    for (let v = 0; v <= high; v += step) {
      at.beginPath();
      at.moveTo(left, y(v));
      at.lineTo(w, y(v));
      at.stroke();
      at.fillText(String(v), left - 4, y(v) + 3.5);
    }
    at.textAlign = "left";
    at.fillText(`${from.toFixed(0)} s`, left, h - 3);
    at.textAlign = "right";
    at.fillText(`${end.toFixed(0)} s`, w - 3, h - 3);
    if (limit && limit <= high) {
      at.strokeStyle = colour("--bad");
      at.setLineDash([5, 4]);
      at.beginPath();
      at.moveTo(left, y(limit));
      at.lineTo(w, y(limit));
      at.stroke();
      at.setLineDash([]);
    }
    const count = shown.length ? values(shown[0]).length : 0;
    for (let i = 0; i < count; i++) {
      at.strokeStyle = colour(i ? "--two" : "--one");
      at.lineWidth = 1.4;
      at.beginPath();
      shown.forEach((p, k) => {
        const v = values(p)[i];
        if (!Number.isFinite(v)) return;
        k ? at.lineTo(x(p.time), y(v)) : at.moveTo(x(p.time), y(v));
      });
      at.stroke();
    }
    const last = shown.length ? values(shown.at(-1)).map((v) => (Number.isFinite(v) ? v.toFixed(v < 10 ? 1 : 0) : "–")).join(" / ") : "–";
    chart.title.textContent = `${chart.name} [${chart.unit}]: ${last}`;
    canvas.setAttribute("aria-label", `${chart.name}: ${last} ${chart.unit}`);
  }
}
