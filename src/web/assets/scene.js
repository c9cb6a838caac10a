// 3-D view of the cell as the controller believes it: arms, jaws, cube with its turned layer, hand;
// fixed objects as the scenario has them, loose ones as the simulated plant has them.
// Lengths are in m, angles in rad.

import { Renderer, matrix, multiply } from "./render.js";

export const COLOURS = ["#f4f4f0", "#c8202c", "#1f8a46", "#f2c318", "#ee7a1c", "#1f57b8"];
export const COLOUR_NAMES = ["white", "red", "green", "yellow", "orange", "blue"];
export const LETTERS = "URFDLB";

// Outward normals of the faces URFDLB in the frame of the cube.
const NORMALS = [[0, 0, 1], [1, 0, 0], [0, -1, 0], [0, 0, -1], [-1, 0, 0], [0, 1, 0]];
// Directions of the columns and rows of each face in reading order.
const COLUMNS = [[1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 0, 0], [0, -1, 0], [-1, 0, 0]];
const ROWS = [[0, -1, 0], [0, 0, -1], [0, 0, -1], [0, 1, 0], [0, 0, -1], [0, 0, -1]];

const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);
const STICKERS = COLOURS.map(rgb);
/** Colour of a sticker that was not read. */
const UNKNOWN = [0.42, 0.44, 0.47];

/** Views to choose from: direction and distance of the camera, and the point at which it looks. */
const VIEWS = {
  cell: { azimuth: -0.55, height: 0.36, away: 3.35, target: [0.35, 0.85, 0.86] },
  hands: { azimuth: -0.5, height: 0.3, away: 0.5, target: null },
  top: { azimuth: -Math.PI / 2 + 0.001, height: 1.5, away: 4.6, target: [0.3, 0.8, 0.6] },
};

/** Distance of the camera of the close-up from the cube (m), and its part of the canvas. */
const CLOSE = 0.17;
/** Distance of a view from which on it has a close-up (m). */
const FAR = 1.0;
/** Height of the close-up as a share of the canvas, and its gap to the edges (px). */
const INSET = { high: 0.42, gap: 10 };
/**
 * A scene is drawn in full detail once it has stood still for as long as this many frames take. A
 * frame that takes longer than `LONG` (ms) is followed by a rest as long as itself.
 */
const SETTLED = 8;
const LONG = 50;
/** Time in which the camera moves to a chosen view (ms). */
const GLIDE = 500;

/** Whether the person wants less motion on the screen. */
const calm = matchMedia("(prefers-reduced-motion: reduce)");

/** Returns the pose between `a` (t = 0) and `b` (t = 1). */
function mixPose(a, b, t) {
  const dot = a.rotation.reduce((sum, v, i) => sum + v * b.rotation[i], 0);
  const sign = dot < 0 ? -1 : 1;
  const q = a.rotation.map((v, i) => v * (1 - t) + sign * b.rotation[i] * t);
  const n = Math.hypot(...q) || 1;
  return {
    translation: a.translation.map((v, i) => v * (1 - t) + b.translation[i] * t),
    rotation: q.map((v) => v / n),
  };
}

/** Returns the matrix of a translation. */
function move(x, y, z) {
  return [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1];
}

const UNTURNED = move(0, 0, 0);

/** Returns the matrix of a rotation by `angle` about the unit vector `axis`. */
function turn(axis, angle) {
  const [s, h] = [Math.sin(angle / 2), Math.cos(angle / 2)];
  return matrix({ translation: [0, 0, 0], rotation: [...axis.map((v) => v * s), h] });
}

/** The 3-D view and its camera. */
export class Scene {
  /** `labels` is the element over the canvas for the names of the arms and the close-up's frame. */
  constructor(canvas, labels) {
    this.canvas = canvas;
    this.labels = labels;
    this.view = { ...VIEWS.cell };
    this.goal = null;
    this.frames = [];
    try {
      this.renderer = new Renderer(canvas);
    } catch (error) {
      canvas.replaceWith(Object.assign(document.createElement("p"), { className: "empty", textContent: `No 3-D view: ${error.message}.` }));
      return;
    }
    this.steer();
    const step = () => {
      this.draw();
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  /** Takes over the stage of a new run: its solids and the place of the hand. */
  set(stage) {
    this.stage = stage;
    const zone = stage.hand_zone?.translation;
    this.zone = zone;
    this.now = this.before = this.seen = undefined;
    const label = (text) => Object.assign(document.createElement("span"), { className: "label", textContent: text });
    this.names = stage.arms.map((arm) => label(arm.name));
    this.frame = Object.assign(document.createElement("span"), { className: "inset", hidden: true });
    this.labels.replaceChildren(...this.names, this.frame);
  }

  /** Shows the whole cell, centred between the bases and tools of all arms. */
  aim() {
    const arms = this.now.arms.map((arm) => [arm.frames[0].translation, arm.frames[6].translation]).flat();
    const mean = (i) => arms.reduce((sum, p) => sum + p[i], 0) / arms.length;
    VIEWS.cell.target = [mean(0), mean(1), 0.82];
    VIEWS.cell.away = this.now.arms.length > 1 ? 3.35 : 2.6;
    this.look("cell");
    this.view = { ...this.goal };
    this.first?.();
  }

  /** Shows a snapshot. The drawing moves to it smoothly from the snapshot before. */
  show(snapshot) {
    const first = !this.now;
    const moves = first || this.moved(snapshot);
    if (moves) {
      this.before = this.now ?? snapshot;
      if (this.before.arms.length !== snapshot.arms.length) this.before = snapshot;
      this.since = performance.now();
    }
    this.now = snapshot;
    if (first) this.aim();
  }

  /**
   * Returns whether the snapshot differs visibly from the last one that was shown. Encoder noise
   * does not count.
   */
  moved(snapshot) {
    const { cube, hand, arms } = snapshot;
    const poses = [cube.world_from_cube, hand?.world_from_cube, ...Object.values(snapshot.objects ?? {})].flatMap((p) => (p ? [...p.translation, ...p.rotation] : [9]));
    const numbers = [...arms.flatMap((arm) => [...arm.joints, arm.opening * 4]), ...poses, cube.turned?.angle ?? 9];
    const words = cube.facelets + arms.map((arm) => !!arm.fault);
    const same = this.seen?.words === words && this.seen.numbers.length === numbers.length
      && numbers.every((v, i) => Math.abs(v - this.seen.numbers[i]) < 4e-4);
    if (!same) this.seen = { words, numbers };
    return !same;
  }

  /** Chooses the view `name`; the camera glides there. The view "hands" follows the cube. */
  look(name) {
    const view = { ...VIEWS[name] };
    view.target ??= this.now?.cube.world_from_cube?.translation ?? this.tools() ?? VIEWS.cell.target;
    this.following = name === "hands";
    this.goal = view;
    this.from = { ...this.view, since: performance.now() };
  }

  /** Returns the mean position of all tools in the world; null without arms. */
  tools() {
    const at = this.now?.arms.map((arm) => arm.frames[6].translation);
    if (!at?.length) return null;
    return at[0].map((_, i) => at.reduce((sum, p) => sum + p[i], 0) / at.length);
  }

  /** Lets pointer, wheel and keys orbit and zoom the camera. */
  steer() {
    const { canvas } = this;
    const touches = new Map();
    let pinch = 0;
    const orbit = (dx, dy) => {
      this.goal = null;
      this.view.azimuth -= dx;
      this.view.height = Math.max(-0.1, Math.min(1.55, this.view.height + dy));
    };
    const zoom = (factor) => {
      this.goal = null;
      this.view.away = Math.max(0.15, Math.min(9, this.view.away * factor));
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      touches.set(event.pointerId, [event.clientX, event.clientY]);
      pinch = 0;
    });
    canvas.addEventListener("pointermove", (event) => {
      const last = touches.get(event.pointerId);
      if (!last) return;
      touches.set(event.pointerId, [event.clientX, event.clientY]);
      if (touches.size === 1) {
        orbit((event.clientX - last[0]) * 0.008, (event.clientY - last[1]) * 0.006);
      } else {
        const [a, b] = [...touches.values()];
        const wide = Math.hypot(a[0] - b[0], a[1] - b[1]);
        if (pinch) zoom(pinch / wide);
        pinch = wide;
      }
    });
    const up = (event) => touches.delete(event.pointerId);
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(Math.exp(event.deltaY * 0.001));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const keys = {
        ArrowLeft: () => orbit(0.1, 0), ArrowRight: () => orbit(-0.1, 0),
        ArrowUp: () => orbit(0, 0.08), ArrowDown: () => orbit(0, -0.08),
        "+": () => zoom(0.88), "=": () => zoom(0.88), "-": () => zoom(1.14),
        Home: () => this.look("cell"),
      };
      if (!keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
  }

  /** Moves the camera towards the chosen view, if it is not there yet, and then after the cube. */
  glide() {
    const at = this.following ? this.now.cube.world_from_cube?.translation ?? this.tools() : null;
    const { view, goal, from } = this;
    if (goal) {
      if (at) goal.target = at;
      const t = calm.matches ? 1 : Math.min(1, (performance.now() - from.since) / GLIDE);
      const ease = t * t * (3 - 2 * t);
      const mix = (a, b) => a + (b - a) * ease;
      const round = Math.atan2(Math.sin(goal.azimuth - from.azimuth), Math.cos(goal.azimuth - from.azimuth));
      view.azimuth = from.azimuth + round * ease;
      view.height = mix(from.height, goal.height);
      view.away = mix(from.away, goal.away);
      view.target = from.target.map((v, i) => mix(v, goal.target[i]));
      if (t === 1) this.goal = null;
    } else if (at && Math.hypot(...at.map((v, i) => v - view.target[i])) > 5e-4) {
      // A cube that trembles by less does not move the camera, so that its picture becomes sharp.
      view.target = view.target.map((v, i) => v + (at[i] - v) * (calm.matches ? 1 : 0.2));
    }
  }

  /** Returns the place of the camera of a view. */
  eye({ azimuth, height, away, target }) {
    return [
      target[0] + away * Math.cos(height) * Math.cos(azimuth),
      target[1] + away * Math.cos(height) * Math.sin(azimuth),
      Math.max(0.03, target[2] + away * Math.sin(height)),
    ];
  }

  /** Returns the views to draw: the chosen one, and a close-up of the cube if that one is far off. */
  views(cube) {
    const views = [{ eye: this.eye(this.view), target: this.view.target, part: [0, 0, 1, 1] }];
    const [wide, high] = [this.canvas.clientWidth, this.canvas.clientHeight];
    const close = !!cube && this.view.away > FAR;
    this.frame.hidden = !close;
    if (close) {
      const size = INSET.high * Math.min(high, wide);
      const target = cube.translation;
      const height = Math.min(0.8, Math.max(0.25, this.view.height));
      const part = [(wide - size - INSET.gap) / wide, (high - size - INSET.gap) / high, size / wide, size / high];
      views.push({ eye: this.eye({ ...this.view, height, away: CLOSE, target }), target, part });
      this.frame.style.width = this.frame.style.height = `${size}px`;
      this.frame.style.right = this.frame.style.top = `${INSET.gap}px`;
    }
    return views;
  }

  /** Writes the name of each arm over its shoulder. `view` is the matrix of the view. */
  name(view, pose) {
    this.names.forEach((label, i) => {
      const [x, y, z] = pose((s) => s.arms[i].frames[2]).translation;
      const at = [x, y, z + 0.2, 1];
      const seen = [0, 1, 3].map((r) => at.reduce((sum, v, k) => sum + view[k * 4 + r] * v, 0));
      const [u, v] = [seen[0] / seen[2], seen[1] / seen[2]];
      label.hidden = !(seen[2] > 0 && Math.abs(u) < 0.98 && Math.abs(v) < 0.96) || this.view.away < FAR;
      label.style.left = `${(50 * (1 + u)).toFixed(2)}%`;
      label.style.top = `${(50 * (1 - v)).toFixed(2)}%`;
    });
  }

  /** Draws one frame, unless nothing has changed since the last one. */
  draw() {
    if (!this.stage || !this.now || !this.renderer) return;
    const begun = performance.now();
    // Rendering in software takes CPU time from the robot; 20 frames/s match the rate of snapshots.
    if (this.renderer.software && begun - (this.frames.at(-1) ?? 0) < 44) return;
    if (this.rests(begun)) return;
    // A scene without motion is drawn once, and then once in full detail.
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    const size = `${this.canvas.clientWidth} ${this.canvas.clientHeight}`;
    const state = JSON.stringify([this.view, size, this.since, dark]);
    const still = this.goal ? 0 : begun - this.since;
    const settled = still > Math.max(90, SETTLED * this.renderer.took);
    if (still > 150 && this.drawn === state && (this.sharp || !settled)) return;
    this.sharp = settled;
    this.drawn = still > 90 ? state : "";
    const t = Math.max(0, Math.min(1, (begun - this.since) / 60));
    const pose = (path) => {
      const [a, b] = [path(this.before), path(this.now)];
      return a && b ? mixPose(a, b, t) : b;
    };
    this.glide();
    const solids = [];
    this.arms(solids, pose, t);
    this.objects(solids, pose);
    const cube = pose((s) => s.cube.world_from_cube);
    if (cube) this.cube(solids, matrix(cube));
    const hand = pose((s) => s.hand?.world_from_cube);
    if (hand) this.hand(solids, hand.translation);
    else if (this.zone && !this.now.cube.held_by.length) this.wanted(solids, this.zone);
    const triad = this.triad?.();
    if (triad) this.axes(solids, matrix(triad));
    const { floor, haze } = this.colours(dark);
    const [view] = this.renderer.draw(solids, this.views(cube), floor, haze, this.detail()) ?? [];
    if (view) this.name(view, pose);
    this.frames.push(begun);
    while (this.frames[0] < begun - 2000) this.frames.shift();
  }

  /**
   * Checks whether no frame is drawn now: the last one is not finished, or has just taken long. A
   * browser without a graphics processor draws the whole page by the same thread, and buttons and
   * texts would wait behind a queue of frames.
   */
  rests(now) {
    const { renderer } = this;
    const was = renderer.fence;
    if (renderer.busy()) return true;
    if (was && renderer.took > LONG) this.until = now + Math.min(renderer.took, 1000);
    return now < (this.until ?? 0);
  }

  /** Returns the colours of the page, read again after a change between light and dark. */
  colours(dark) {
    if (this.shades?.dark !== dark) {
      const style = getComputedStyle(this.canvas);
      const colour = (name) => rgb(style.getPropertyValue(name).trim() || "#888888");
      this.shades = { dark, floor: colour("--floor"), haze: colour("--haze") };
    }
    return this.shades;
  }

  /** Returns the level of detail: a slow machine gets fewer pixels, then no shadows. */
  detail() {
    const now = performance.now();
    this.level ??= this.renderer.software ? 1 : 0;
    this.judged ??= now;
    const rate = this.rate();
    if (now - this.judged > 2500 && this.frames.length > 3 && rate) {
      this.judged = now;
      if (rate < 12) this.level = Math.min(3, this.level + 1);
      // The load may have been temporary, so a finer level is tried after 20 s.
      else if (rate > 18 && this.level > 1 && now - (this.tried ?? 0) > 20000) [this.level, this.tried] = [this.level - 1, now];
    }
    if (this.sharp) return { ratio: 2, shadows: true, fine: true };
    return [{ ratio: 2, shadows: true }, { ratio: 1, shadows: true }, { ratio: 1, shadows: false }, { ratio: 0.75, shadows: false }][this.level];
  }

  /** Returns the frames per second over the last 2 s; 0 while no motion is drawn. */
  rate() {
    const [first, last] = [this.frames[0], this.frames.at(-1)];
    if (this.frames.length < 2 || performance.now() - last > 2000) return 0;
    return ((this.frames.length - 1) * 1000) / (last - first);
  }

  /**
   * Adds the solids of arms and cameras. `pose` interpolates a pose between the snapshots before
   * and now, `t` is the share of the way. A stopped arm is red.
   */
  arms(solids, pose, t) {
    const opening = (i) => this.before.arms[i].opening * (1 - t) + this.now.arms[i].opening * t;
    const frames = this.now.arms.map((arm, i) =>
      arm.frames.map((_, k) => matrix(pose((s) => s.arms[i].frames[k]))));
    for (const solid of this.stage.solids) {
      let base = solid.arm === null ? null : frames[solid.arm]?.[solid.frame];
      if (solid.arm !== null && !base) continue;
      let own = matrix(solid.pose);
      if (solid.jaw) own = multiply(move(0, (solid.jaw * opening(solid.arm)) / 2, 0), own);
      const scale = solid.shape === "box" ? solid.size : [solid.radius, solid.radius, solid.length];
      let colour = solid.colour.map((c) => c / 255);
      if (solid.arm !== null && this.now.arms[solid.arm].fault) colour = [0.75, 0.12 + colour[1] * 0.2, 0.12 + colour[2] * 0.2];
      solids.push({
        mesh: solid.shape, scale, colour, shadow: true,
        matrix: base ? multiply(base, own) : own,
      });
    }
  }

  /** Adds the objects: fixed ones where the scenario has them, loose ones where the plant has them. */
  objects(solids, pose) {
    for (const object of this.stage.objects ?? []) {
      const base = matrix(pose((s) => s.objects?.[object.name]) ?? object.pose);
      for (const solid of object.solids) {
        const scale = solid.shape === "box" ? solid.size : [solid.radius, solid.radius, solid.length];
        solids.push({
          mesh: solid.shape, scale, colour: solid.colour.map((c) => c / 255), shadow: true,
          matrix: multiply(base, matrix(solid.pose)),
        });
      }
    }
  }

  /** Adds 26 small cubes and 54 stickers; `world` is the matrix of the cube. */
  cube(solids, world) {
    const edge = this.stage.edge;
    const pitch = edge / 3;
    const { facelets, turned } = this.now.cube;
    const spin = turned && turn(NORMALS[turned.face], -turned.angle);
    const placed = (cell) => {
      const on = turned && cell.reduce((sum, v, i) => sum + v * NORMALS[turned.face][i], 0) > 0.5;
      return on ? multiply(world, spin) : world;
    };
    for (let x = -1; x <= 1; x++)
      for (let y = -1; y <= 1; y++)
        for (let z = -1; z <= 1; z++) {
          if (!x && !y && !z) continue;
          const size = pitch * 0.985;
          solids.push({
            mesh: "box", scale: [size, size, size], colour: [0.07, 0.075, 0.085], shadow: true,
            matrix: multiply(placed([x, y, z]), move(x * pitch, y * pitch, z * pitch)),
          });
        }
    for (let i = 0; i < 54; i++) {
      const [face, row, column] = [Math.floor(i / 9), Math.floor((i % 9) / 3) - 1, (i % 3) - 1];
      const cell = NORMALS[face].map((n, k) => n + COLUMNS[face][k] * column + ROWS[face][k] * row);
      const out = NORMALS[face].map((n, k) => cell[k] * pitch + n * (pitch / 2 - 0.0002));
      const scale = NORMALS[face].map((n) => (n ? 0.0014 : pitch * 0.84));
      const letter = LETTERS.indexOf(facelets[i]);
      solids.push({
        mesh: "box", scale, colour: letter < 0 ? UNKNOWN : STICKERS[letter],
        matrix: multiply(placed(cell), move(...out)),
      });
    }
  }

  /** Adds the hand that holds the cube at `at`, on the side away from the robot. */
  hand(solids, at) {
    const half = this.stage.edge / 2;
    const skin = [0.85, 0.65, 0.53];
    const part = (x, y, z, size) => solids.push({
      mesh: "box", scale: size, colour: skin, shadow: true, matrix: move(at[0] + x, at[1] + y, at[2] + z),
    });
    part(half + 0.016, 0, -0.012, [0.03, 0.085, 0.09]);
    for (const y of [-0.03, -0.01, 0.01, 0.03]) part(half - 0.004, y, 0.046, [0.05, 0.017, 0.016]);
    part(half - 0.002, 0.012, -0.05, [0.05, 0.022, 0.02]);
    solids.push({
      mesh: "box", scale: [0.26, 0.062, 0.062], colour: [0.3, 0.38, 0.5], shadow: true,
      matrix: move(at[0] + half + 0.16, at[1], at[2] - 0.02),
    });
  }

  /** Adds three rods along the axes of a frame: x red, y green, z blue. */
  axes(solids, frame) {
    const turns = [turn([0, 1, 0], Math.PI / 2), turn([1, 0, 0], -Math.PI / 2), UNTURNED];
    [[0.85, 0.15, 0.15], [0.1, 0.6, 0.2], [0.15, 0.35, 0.9]].forEach((colour, i) => {
      solids.push({ mesh: "cylinder", scale: [0.005, 0.005, 0.14], colour, matrix: multiply(frame, turns[i]) });
    });
  }

  /** Adds a transparent cube where the hand is expected. */
  wanted(solids, pose) {
    const e = this.stage.edge;
    const at = pose.translation ?? pose;
    solids.push({ mesh: "box", scale: [e, e, e], colour: [0.3, 0.6, 0.95], alpha: 0.22, matrix: move(...at) });
  }
}
