// Panel for moving an arm by hand, as on a pendant: synchronise; move by joint, along the axes of
// world, base or tool, or by motor; jaws; named poses. It is shown only while the task is idle.

import { keep, kept } from "./settings.js";
import { $, el } from "./panels.js";

const deg = (rad) => (rad * 180) / Math.PI;
const rad = (degrees) => (degrees * Math.PI) / 180;

/**
 * Coordinates in which an arm is moved, with three sizes of steps: [length, angle]. Lengths are in
 * cm for joints and in mm for axes of a frame; angles are in degrees, for motors in rad.
 */
const STRAIGHT = [[0.5, 0.2], [2, 1], [10, 5]];
const MODES = {
  joint: { label: "Joints", steps: [[0.2, 1], [1, 5], [5, 20]] },
  world: { label: "World", steps: STRAIGHT, note: "Tool point and rotation in the world." },
  base: { label: "Base", steps: STRAIGHT, note: "Tool point and rotation in the base of this arm." },
  tool: { label: "Tool axes", steps: STRAIGHT, note: "Displacement in the tool's axes since this view was opened." },
  motor: { label: "Motors", steps: [[0.5, 0.5], [2, 2], [20, 20]] },
};
const FRAME = ["x", "y", "z", "about x", "about y", "about z"];
/** Time for which a button is held before it repeats, and between two looks for a repetition (ms). */
const HELD = 500;
const AGAIN = 100;
/** Time after an order to a target until a snapshot shows that the arm moves (ms). */
const AIMED = 600;
/** Share of a joint's range at its ends that is marked. */
const EDGE = 0.05;

/** Formats a number, without the sign of a negative zero. */
const fixed = (value, digits) => value.toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1");

/** Returns the vector `v` turned by the unit quaternion [x, y, z, w]. */
function turned([x, y, z, w], v) {
  const t = [y * v[2] - z * v[1], z * v[0] - x * v[2], x * v[1] - y * v[0]].map((c) => 2 * c);
  return [v[0] + w * t[0] + y * t[2] - z * t[1], v[1] + w * t[1] + z * t[0] - x * t[2], v[2] + w * t[2] + x * t[1] - y * t[0]];
}

/** Returns the product of two unit quaternions. */
function product([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz];
}

const inverse = ([x, y, z, w]) => [-x, -y, -z, w];

/** Returns `to` as seen from `from`, both poses in the world. */
function relative(from, to) {
  const back = inverse(from.rotation);
  return { translation: turned(back, to.translation.map((v, i) => v - from.translation[i])), rotation: product(back, to.rotation) };
}

/** Returns the rotation vector of a unit quaternion (rad): its axis times its angle. */
function rotationVector(q) {
  const [x, y, z, w] = q[3] < 0 ? q.map((c) => -c) : q;
  const s = Math.hypot(x, y, z);
  const angle = 2 * Math.atan2(s, w);
  return [x, y, z].map((c) => (s > 1e-9 ? (c / s) * angle : 2 * c));
}

/** The panel, with the chosen arm, mode and size of step. */
export class Manual {
  constructor(send) {
    this.send = send;
    this.arm = 0;
    this.mode = kept("mode", "joint");
    this.step = 1;
    /** Page's time of the last order to a target (ms). */
    this.aimed = -AIMED;
  }

  /** Makes the buttons for the arms of a new run. */
  set(stage) {
    this.stage = stage;
    this.arm = 0;
    this.from = null;
    $("manual-arms").replaceChildren(...stage.arms.map((arm, i) => el("button", {
      textContent: arm.name, onclick: () => { [this.arm, this.from] = [i, null]; this.build(); },
    })));
    this.build();
  }

  /** Sends an order to the chosen arm. */
  order(order) {
    this.send({ command: "manual", effector: this.arm, order });
  }

  /** Returns whether the mode moves the tool along the axes of a frame. */
  straight() {
    return ["world", "base", "tool"].includes(this.mode);
  }

  /** Returns the step of an axis of the chosen mode, in SI units and as text. */
  size(axis) {
    const [length, angle] = MODES[this.mode].steps[this.step];
    if (this.mode === "motor") return [angle, `${angle} rad`];
    const straight = this.straight() ? axis < 3 : axis === 0;
    return straight ? [length * (this.straight() ? 1e-3 : 1e-2), `${length} ${this.straight() ? "mm" : "cm"}`] : [rad(angle), `${angle}°`];
  }

  /**
   * Makes a button that gives `order` once when it is pressed, and again and again while it is held:
   * each time after the arm has carried out the last one.
   */
  jog(text, label, order) {
    const button = el("button", { textContent: text });
    button.setAttribute("aria-label", label);
    let timer = 0;
    const release = () => clearInterval(timer);
    button.addEventListener("pointerdown", (event) => {
      if (button.disabled || event.button) return;
      release();
      const since = performance.now();
      let last = since;
      this.order(order);
      timer = setInterval(() => {
        const now = performance.now();
        if (button.disabled) release();
        if (now - since < HELD || now - last < AGAIN || !this.rests()) return;
        last = now;
        this.order(order);
      }, AGAIN);
    });
    for (const name of ["pointerup", "pointercancel", "pointerleave", "blur"]) button.addEventListener(name, release);
    // A press of a key is a click without a pointer.
    button.addEventListener("click", (event) => { if (event.detail === 0) this.order(order); });
    return button;
  }

  /** Returns whether the chosen arm waits for an order. */
  rests() {
    const name = `ecp ${this.stage.arms[this.arm].name}`;
    const actor = this.last?.[0].actors.find((actor) => actor.name === name);
    return !actor || actor.state === "idle";
  }

  /** Builds the buttons for the chosen arm and mode. */
  build() {
    const arm = this.stage.arms[this.arm];
    [...$("manual-arms").children].forEach((b, i) => b.setAttribute("aria-pressed", String(i === this.arm)));
    const pick = (name, entries, current, set) => el("div", { className: "buttons small", role: "group", ariaLabel: name },
      ...entries.map(([value, label]) => {
        const button = el("button", { textContent: label, onclick: () => { set(value); this.build(); } });
        button.setAttribute("aria-pressed", String(value === current));
        button.dataset.pick = `${name} ${value}`;
        return button;
      }));
    const axes = [];
    const count = this.straight() ? 6 : 7;
    for (let axis = 0; axis < count; axis++) if (this.straight() || axis > 0 || arm.has_track) axes.push(axis);
    this.values = [];
    const rows = axes.map((axis) => {
      const name = this.name(axis);
      const value = el("output");
      const [by, words] = this.size(axis);
      const jog = (sign) => this.jog(sign < 0 ? "−" : "+", `${name} ${sign < 0 ? "minus" : "plus"} ${words}`, { order: this.mode, axis, by: sign * by });
      const middle = el("div", { className: "value" }, value);
      this.values.push([axis, value, this.range(arm, axis, name, middle)]);
      return el("div", { className: "row" }, el("span", { textContent: name }), jog(-1), middle, jog(1));
    });
    const [low, high] = arm.opening;
    const jaw = (label, opening) => el("button", { textContent: label, onclick: () => this.order({ order: "jaw", opening }) });
    this.jaws = el("output");
    const width = el("input", { type: "number", min: (low * 1e3).toFixed(0), max: (high * 1e3).toFixed(0), step: 1, value: (high * 1e3 - 3).toFixed(0) });
    width.setAttribute("aria-label", "width between the jaws in mm");
    const steps = MODES[this.mode].steps.map(([length, angle], k) => {
      const small = this.straight() ? "mm" : "cm";
      return [k, this.mode === "motor" ? `${angle} rad` : `${length} ${small} / ${angle}°`];
    });
    const mode = Object.entries(MODES).map(([key, { label }]) => [key, label]);
    const poses = arm.poses.map((name) => el("button", { textContent: name, onclick: () => this.order({ order: "pose", name }) }));
    this.sync = el("button", { id: "synchronise", textContent: "Synchronise", onclick: () => this.order({ order: "synchronise" }) });
    $("manual-body").replaceChildren(
      el("div", { className: "line" }, this.sync, el("button", { textContent: "Zero force sensor", onclick: () => this.order({ order: "bias" }) })),
      pick("move by", mode, this.mode, (value) => { [this.mode, this.from] = [value, null]; keep("mode", value); }),
      pick("step", steps, this.step, (value) => { this.step = value; }),
      el("p", { className: "quiet", textContent: `${MODES[this.mode].note ?? ""} A button that is held repeats its step.`.trim() }),
      el("div", { className: "axes" }, ...rows),
      ...this.target(axes),
      el("div", { className: "line" }, el("span", { textContent: "Jaws" }), this.jaws,
        jaw("Open", high - 0.003), jaw("Close", low + 0.001), width,
        el("button", { textContent: "Set width", onclick: () => this.order({ order: "jaw", opening: Number(width.value) * 1e-3 }) })),
      el("div", { className: "line" }, el("span", { textContent: "Go to" }), ...poses),
    );
    if (this.last) this.show(...this.last);
  }

  /** Returns the name of an axis of the chosen mode. */
  name(axis) {
    return this.straight() ? FRAME[axis] : axis === 0 ? "track" : `${this.mode} ${axis}`;
  }

  /** Returns the unit in which people read an axis of the chosen mode, and its size in SI units. */
  unit(axis) {
    if (this.mode === "motor") return ["rad", 1];
    if (this.straight()) return axis < 3 ? ["mm", 1e-3] : ["°", rad(1)];
    return axis ? ["°", rad(1)] : ["cm", 1e-2];
  }

  /**
   * Returns the line that moves one of `axes` to a number; an empty list where no number is a place:
   * a rotation about one axis changes the other two numbers, and the tool's own axes move with it.
   */
  target(axes) {
    const places = axes.filter((axis) => !this.straight() || (axis < 3 && this.mode !== "tool"));
    if (!places.length) return [];
    const choice = el("select", {}, ...places.map((axis) => el("option", { value: String(axis), textContent: this.name(axis) })));
    choice.setAttribute("aria-label", "axis that moves to the number");
    const number = el("input", { type: "number", step: "any" });
    const label = () => {
      const [unit] = this.unit(Number(choice.value));
      unitLabel.textContent = unit;
      number.setAttribute("aria-label", `target of ${this.name(Number(choice.value))} in ${unit === "°" ? "deg" : unit}`);
    };
    const unitLabel = el("span");
    const go = el("button", { textContent: "Move there", onclick: () => {
      const axis = Number(choice.value);
      // The order is the way from here, so a second one before the arm rests would go beyond.
      if (!this.rests() || performance.now() - this.aimed < AIMED) return;
      const by = number.valueAsNumber * this.unit(axis)[1] - this.position(axis);
      // An empty field is no number, and an arm that is not synchronised has no position.
      if (!Number.isFinite(by)) return;
      this.aimed = performance.now();
      this.order({ order: this.mode, axis, by });
    } });
    go.title = "at most 200 mm, 34° or 60 rad of a motor at once";
    number.onkeydown = (event) => { if (event.key === "Enter") go.click(); };
    choice.onchange = label;
    label();
    return [el("div", { className: "line target" }, el("span", { textContent: "Target" }), choice, number, unitLabel, go)];
  }

  /** Returns the position of an axis of the chosen mode in SI units; NaN if it is unknown. */
  position(axis) {
    const arm = this.last?.[0].arms[this.arm];
    if (!arm) return NaN;
    if (this.mode === "motor") return arm.motors[axis];
    if (!arm.synchronised) return NaN;
    return this.mode === "joint" ? arm.joints[axis] : this.numbers(arm)[axis];
  }

  /** Adds a meter for the range of a joint or motor; returns it, or null for an axis of a frame. */
  range(arm, axis, name, place) {
    if (this.straight()) return null;
    const [low, high] = (this.mode === "motor" ? arm.motor_limits : arm.joint_limits)[axis];
    const edge = EDGE * (high - low);
    const meter = el("meter", { min: low, max: high, low: low + edge, high: high - edge, optimum: (low + high) / 2 });
    const text = (v) => (this.mode === "motor" ? `${v.toFixed(0)} rad` : axis ? `${deg(v).toFixed(0)}°` : `${(v * 100).toFixed(0)} cm`);
    meter.title = `from ${text(low)} to ${text(high)}`;
    meter.setAttribute("aria-label", `range of ${name}, ${meter.title}`);
    place.append(meter);
    return meter;
  }

  /** Returns the six numbers of the tool in the chosen frame: lengths (m) and a rotation vector. */
  numbers(arm) {
    const tool = arm.frames[6];
    if (this.mode === "tool") this.from ??= tool;
    const from = { world: { translation: [0, 0, 0], rotation: [0, 0, 0, 1] }, base: arm.frames[0], tool: this.from }[this.mode];
    const { translation, rotation } = relative(from, tool);
    return [...translation, ...rotationVector(rotation)];
  }

  /** Returns the pose in the world whose axes the chosen mode moves along; null without axes. */
  axes() {
    const arm = this.last?.[0].arms[this.arm];
    if (!arm?.synchronised || !this.straight()) return null;
    const { translation, rotation } = arm.frames[6];
    return { translation, rotation: { world: [0, 0, 0, 1], base: arm.frames[0].rotation, tool: rotation }[this.mode] };
  }

  /** Shows the positions of the chosen arm. `moves` says whether the robot accepts motions now. */
  show(snapshot, moves) {
    this.last = [snapshot, moves];
    const arm = snapshot.arms[this.arm];
    if (!arm || !this.values) return;
    for (const [axis, output, meter] of this.values) {
      const [unit, size] = this.unit(axis);
      const position = this.position(axis);
      // Lengths along the axes of a frame are in mm, all other numbers have larger units.
      const digits = unit === "mm" ? 1 : 2;
      const text = Number.isNaN(position) ? "unknown" : `${fixed(position / size, digits)}${unit === "°" ? "" : " "}${unit}`;
      if (output.textContent !== text) output.textContent = text;
      if (meter) meter.value = (this.mode === "motor" ? arm.motors : arm.joints)[axis];
    }
    this.jaws.textContent = `${(arm.opening * 1e3).toFixed(1)} mm`;
    this.sync.disabled = arm.synchronised || !moves;
    this.sync.textContent = arm.synchronised ? "Synchronised" : "Synchronise";
  }
}
