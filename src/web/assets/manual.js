// Panel for moving an arm by hand: synchronise, jog by motor, joint or tool axis, jaws, named poses.
// It is shown only while the task is idle.

const $ = (id) => document.getElementById(id);
const el = (tag, props = {}, ...children) => {
  const it = Object.assign(document.createElement(tag), props);
  it.append(...children);
  return it;
};
const deg = (rad) => (rad * 180) / Math.PI;
const rad = (degrees) => (degrees * Math.PI) / 180;

/**
 * Coordinates in which an arm is moved, with three sizes of steps: [length, angle]. Lengths are in
 * cm for joints and in mm for tool axes; angles are in degrees, for motors in rad.
 */
const MODES = {
  joint: { label: "Joints", steps: [[0.2, 1], [1, 5], [5, 20]] },
  tool: { label: "Tool axes", steps: [[0.5, 0.2], [2, 1], [10, 5]] },
  motor: { label: "Motors", steps: [[0.5, 0.5], [2, 2], [20, 20]] },
};
const TOOL = ["x", "y", "z", "about x", "about y", "about z"];

/** Formats a number, without the sign of a negative zero. */
const fixed = (value, digits) => value.toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1");

/** The panel, with the chosen arm, mode and size of step. */
export class Manual {
  constructor(send) {
    this.send = send;
    this.arm = 0;
    this.mode = "joint";
    this.step = 1;
  }

  /** Makes the buttons for the arms of a new run. */
  set(stage) {
    this.stage = stage;
    this.arm = 0;
    $("manual-arms").replaceChildren(...stage.arms.map((arm, i) => el("button", {
      textContent: arm.name, onclick: () => { this.arm = i; this.build(); },
    })));
    this.build();
  }

  /** Sends an order to the chosen arm. */
  order(order) {
    this.send({ command: "manual", effector: this.arm, order });
  }

  /** Returns the step of an axis of the chosen mode, in SI units and as text. */
  size(axis) {
    const [length, angle] = MODES[this.mode].steps[this.step];
    if (this.mode === "motor") return [angle, `${angle} rad`];
    const straight = this.mode === "tool" ? axis < 3 : axis === 0;
    return straight ? [length * (this.mode === "tool" ? 1e-3 : 1e-2), `${length} ${this.mode === "tool" ? "mm" : "cm"}`] : [rad(angle), `${angle}°`];
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
    const count = this.mode === "tool" ? 6 : 7;
    for (let axis = 0; axis < count; axis++) if (this.mode === "tool" || axis > 0 || arm.has_track) axes.push(axis);
    this.values = [];
    const rows = axes.map((axis) => {
      const name = this.mode === "tool" ? TOOL[axis] : axis === 0 ? "track" : this.mode === "motor" ? `motor ${axis}` : `joint ${axis}`;
      const value = el("output");
      this.values.push([axis, value]);
      const [by, words] = this.size(axis);
      const jog = (sign) => {
        const button = el("button", { textContent: sign < 0 ? "−" : "+", onclick: () => this.order({ order: this.mode, axis, by: sign * by }) });
        button.setAttribute("aria-label", `${name} ${sign < 0 ? "minus" : "plus"} ${words}`);
        return button;
      };
      return el("div", { className: "row" }, el("span", { textContent: name }), jog(-1), value, jog(1));
    });
    const [low, high] = arm.opening;
    const jaw = (label, opening) => el("button", { textContent: label, onclick: () => this.order({ order: "jaw", opening }) });
    this.jaws = el("output");
    const steps = MODES[this.mode].steps.map(([length, angle], k) => {
      const small = this.mode === "tool" ? "mm" : "cm";
      return [k, this.mode === "motor" ? `${angle} rad` : `${length} ${small} / ${angle}°`];
    });
    const mode = Object.entries(MODES).map(([key, { label }]) => [key, label]);
    const poses = arm.poses.map((name) => el("button", { textContent: name, onclick: () => this.order({ order: "pose", name }) }));
    this.sync = el("button", { id: "synchronise", textContent: "Synchronise", onclick: () => this.order({ order: "synchronise" }) });
    $("manual-body").replaceChildren(
      el("div", { className: "line" }, this.sync, el("button", { textContent: "Zero force sensor", onclick: () => this.order({ order: "bias" }) })),
      pick("move by", mode, this.mode, (value) => { this.mode = value; }),
      pick("step", steps, this.step, (value) => { this.step = value; }),
      el("div", { className: "axes" }, ...rows),
      el("div", { className: "line" }, el("span", { textContent: "Jaws" }), this.jaws,
        jaw("Open", high - 0.003), jaw("Close", low + 0.001)),
      el("div", { className: "line" }, el("span", { textContent: "Go to" }), ...poses),
    );
    if (this.last) this.show(...this.last);
  }

  /** Shows the positions of the chosen arm. `moves` says whether the robot accepts motions now. */
  show(snapshot, moves) {
    this.last = [snapshot, moves];
    const arm = snapshot.arms[this.arm];
    if (!arm || !this.values) return;
    for (const [axis, output] of this.values) {
      let text = "";
      if (this.mode === "motor") text = `${fixed(arm.motors[axis], 2)} rad`;
      else if (!arm.synchronised) text = "unknown";
      else if (this.mode === "joint") text = axis ? `${fixed(deg(arm.joints[axis]), 2)}°` : `${fixed(arm.joints[0] * 100, 2)} cm`;
      else if (axis < 3) text = `${fixed(arm.frames[6].translation[axis] * 1e3, 1)} mm`;
      if (output.textContent !== text) output.textContent = text;
    }
    this.jaws.textContent = `${(arm.opening * 1e3).toFixed(1)} mm`;
    this.sync.disabled = arm.synchronised || !moves;
    this.sync.textContent = arm.synchronised ? "Synchronised" : "Synchronise";
  }
}
