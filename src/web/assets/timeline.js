// Timeline of the run: phases, steps of the plan, who holds the cube, pauses, questions and events,
// with the steps that are still planned.

/** Rows with their names, and the lanes of the program that they show. */
const ROWS = [
  ["phase", ["phase"]], ["step", ["step"]], ["cube", ["holder"]], ["operator", ["pause", "question"]], ["events", ["message"]],
];
/** Width of the names, height of a row and of the axis under them (px). */
const LEFT = 64;
const HIGH = 19;
const FOOT = 15;
/** Time between two drawings (ms). */
const DRAWN = 250;
/** Bounds of the ratio of taken to planned time, with which the time that is left is told. */
const RATIO = [0.5, 3];

/** Returns a time in words for people: seconds, from two minutes on also minutes. */
export function inWords(seconds) {
  const s = Math.max(0, Math.round(seconds));
  return s < 120 ? `${s} s` : `${Math.floor(s / 60)} min ${s % 60} s`;
}

/** Returns the words of a span in a few letters: the turn of a step, the holder of the cube. */
function short({ lane, words }) {
  if (lane === "holder") return words.replace("held by ", "");
  const turn = lane === "step" && words.match(/ turns (\S+)/);
  const take = lane === "step" && words.match(/ takes (\S+)/);
  return turn ? turn[1] : take ? "grip" : words;
}

/** The strip under the header. */
export class Timeline {
  /** `canvas` shows the spans, `words` what is at the pointer; `choose` gets a time that was clicked. */
  constructor(canvas, words, choose) {
    this.canvas = canvas;
    this.words = words;
    this.choose = choose;
    this.clear();
    canvas.addEventListener("pointermove", (event) => this.point(this.place(event)));
    canvas.addEventListener("pointerleave", () => this.point(null));
    canvas.addEventListener("click", (event) => {
      const { time, row } = this.place(event);
      this.choose(time, this.at(time, row));
    });
    canvas.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: -0.01, ArrowRight: 0.01, PageUp: -0.1, PageDown: 0.1 }[event.key];
      if (by) this.point({ time: Math.min(this.end(), Math.max(0, (this.pointer?.time ?? this.now) + by * this.end())), row: 1 });
      else if (event.key === "Enter" && this.pointer) this.choose(this.pointer.time, this.at(this.pointer.time, 1));
      else return;
      event.preventDefault();
    });
  }

  /** Forgets everything of the last run. */
  clear() {
    this.spans = [];
    this.plan = [];
    this.step = null;
    this.now = 0;
    this.whole = 0;
    this.over = false;
    this.pointer = null;
  }

  /** Takes the changed spans as [index, span]. */
  take(changed) {
    for (const [index, span] of changed) this.spans[index] = span;
    this.draw();
  }

  /** Takes the steps of a new plan. */
  plans(lines) {
    this.plan = lines;
  }

  /** Takes time, step and state of a snapshot. */
  show(snapshot) {
    this.now = snapshot.time;
    this.step = snapshot.step;
    this.over = snapshot.control === "ended";
    this.whole = (snapshot.services.seek_ms ?? 0) / 1000;
    if (performance.now() - (this.drawn ?? 0) >= DRAWN) this.draw();
  }

  /** Returns the spans of phases as [from, to], every second one, for the background of curves. */
  bands() {
    return this.spans.filter((span) => span?.lane === "phase").filter((_, i) => i % 2).map((span) => [span.from, span.to ?? Infinity]);
  }

  /** Returns how much longer the steps of the plan took than they were planned. */
  ratio() {
    const steps = this.spans.filter((span) => span?.lane === "step" && span.to !== null).slice(-12);
    let [took, planned] = [0, 0];
    for (const span of steps) {
      const line = this.plan.find((line) => line.what === span.words);
      if (line) [took, planned] = [took + span.to - span.from, planned + line.seconds];
    }
    return planned ? Math.min(RATIO[1], Math.max(RATIO[0], took / planned)) : 1;
  }

  /** Returns the steps after the present one with the times at which they are expected. */
  ahead() {
    if (this.over || this.whole || this.step === null || !this.plan.length) return [];
    const ratio = this.ratio();
    const begun = this.spans.findLast((span) => span?.lane === "step" && span.to === null)?.from ?? this.now;
    let at = Math.max(this.now, begun + (this.plan[this.step]?.seconds ?? 0) * ratio);
    return this.plan.slice(this.step + 1).map((line) => {
      const from = at;
      at += line.seconds * ratio;
      return { lane: "step", from, to: at, words: line.what };
    });
  }

  /** Returns the time that the plan still takes (s), or null if nothing is planned. */
  left() {
    const ahead = this.ahead();
    if (this.over || this.whole || this.step === null || !this.plan.length) return null;
    const begun = this.spans.findLast((span) => span?.lane === "step" && span.to === null)?.from ?? this.now;
    const own = begun + (this.plan[this.step]?.seconds ?? 0) * this.ratio();
    return Math.max(0, (ahead.at(-1)?.to ?? own) - this.now);
  }

  /** Returns the last time of the axis. */
  end() {
    return Math.max(1, this.now, this.whole, this.ahead().at(-1)?.to ?? 0);
  }

  /** Returns time and row at the pointer. */
  place(event) {
    const { left, top, width } = this.canvas.getBoundingClientRect();
    const share = Math.min(1, Math.max(0, (event.clientX - left - LEFT) / (width - LEFT - 4)));
    return { time: share * this.end(), row: Math.floor((event.clientY - top) / HIGH) };
  }

  /** Returns the span of a row at a time, for events the nearest one. */
  at(time, row) {
    const lanes = ROWS[row]?.[1] ?? [];
    const own = [...this.spans, ...this.ahead()].filter((span) => lanes.includes(span?.lane));
    if (lanes[0] !== "message") return own.findLast((span) => span.from <= time && time <= (span.to ?? this.now));
    const near = this.end() / 100;
    return own.filter((span) => Math.abs(span.from - time) < near).sort((a, b) => Math.abs(a.from - time) - Math.abs(b.from - time))[0];
  }

  /** Tells what is at the pointer. */
  point(pointer) {
    this.pointer = pointer;
    const span = pointer && this.at(pointer.time, pointer.row);
    const last = span?.to ?? this.now;
    const length = span && last > span.from ? `, for ${(last - span.from).toFixed(1)} s` : "";
    this.words.textContent = !pointer ? "" : span ? `${span.from.toFixed(1)} s${length}: ${span.words}` : `${pointer.time.toFixed(1)} s`;
    this.draw();
  }

  /** Draws all rows. */
  draw() {
    this.drawn = performance.now();
    const { canvas } = this;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [w, h] = [canvas.clientWidth, ROWS.length * HIGH + FOOT];
    if (!w) return;
    if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) [canvas.width, canvas.height] = [Math.round(w * ratio), Math.round(h * ratio)];
    const at = canvas.getContext("2d");
    at.setTransform(ratio, 0, 0, ratio, 0, 0);
    at.clearRect(0, 0, w, h);
    const style = getComputedStyle(canvas);
    const colour = (name) => style.getPropertyValue(name).trim();
    const end = this.end();
    const x = (t) => LEFT + (t / end) * (w - LEFT - 4);
    at.font = "11px system-ui, sans-serif";
    at.textBaseline = "middle";
    const fills = { phase: "--main-soft", step: "--main-soft", holder: "--good-soft", pause: "--warn-soft", question: "--warn-soft" };
    const box = (span, top, planned) => {
      const [from, to] = [x(span.from), x(span.to ?? this.now)];
      const wide = Math.max(1, to - from - 1);
      const text = short(span);
      at.fillStyle = at.strokeStyle = colour(planned ? "--line" : fills[span.lane]);
      if (planned) at.strokeRect(from + 0.5, top + 2.5, wide, HIGH - 5);
      else at.fillRect(from, top + 2, wide, HIGH - 4);
      // A change of grips is paler than a turn.
      if (!planned && text === "grip") {
        at.fillStyle = colour("--field");
        at.fillRect(from + 1, top + 3, wide - 2, HIGH - 6);
      }
      if (wide < 6 + 5.5 * Math.min(text.length, 4)) return;
      at.save();
      at.beginPath();
      at.rect(from, top, wide - 2, HIGH);
      at.clip();
      at.fillStyle = colour(planned ? "--quiet" : "--ink");
      at.fillText(text, from + 3, top + HIGH / 2 + 0.5);
      at.restore();
    };
    ROWS.forEach(([name, lanes], row) => {
      const top = row * HIGH;
      at.fillStyle = colour("--quiet");
      at.textAlign = "left";
      at.fillText(name, 2, top + HIGH / 2 + 0.5);
      at.strokeStyle = colour("--line");
      at.beginPath();
      at.moveTo(LEFT, top + HIGH - 0.5);
      at.lineTo(w - 4, top + HIGH - 0.5);
      at.stroke();
      for (const span of this.spans) {
        if (!lanes.includes(span?.lane)) continue;
        if (span.lane !== "message") {
          box(span, top, false);
          continue;
        }
        at.fillStyle = colour({ info: "--quiet", warning: "--warn" }[span.class] ?? "--bad");
        at.beginPath();
        at.arc(x(span.from), top + HIGH / 2, 3.5, 0, 7);
        at.fill();
      }
    });
    for (const span of this.ahead()) box(span, HIGH, true);
    const bottom = ROWS.length * HIGH;
    at.fillStyle = colour("--quiet");
    at.fillText("0 s", LEFT, bottom + FOOT / 2 + 1);
    at.textAlign = "right";
    at.fillText(`${end.toFixed(0)} s`, w - 4, bottom + FOOT / 2 + 1);
    const line = (time, name) => {
      at.strokeStyle = colour(name);
      at.beginPath();
      at.moveTo(x(time), 0);
      at.lineTo(x(time), bottom);
      at.stroke();
    };
    if (this.pointer) line(this.pointer.time, "--quiet");
    if (!this.over || this.whole) line(this.now, "--ink");
    const open = this.spans.filter((span) => span && span.to === null).map((span) => span.words);
    canvas.setAttribute("aria-label", `Timeline of ${end.toFixed(0)} s; now ${open.join(", ") || "over"}. Arrow keys move along it.`);
  }
}
