// A small WebGL renderer: boxes and cylinders, one light, a floor with a grid, flat shadows.

const VERTEX = `#version 300 es
in vec3 position;
in vec3 normal;
in mat4 model;
in vec3 scale;
in vec4 paint;
uniform mat4 press;
uniform mat4 view;
out vec3 at;
out vec3 facing;
out vec4 colour;
void main() {
  vec4 world = press * model * vec4(position * scale, 1.0);
  at = world.xyz;
  facing = mat3(model) * (normal / max(scale, vec3(1e-6)));
  colour = paint;
  gl_Position = view * world;
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec3 at;
in vec3 facing;
in vec4 colour;
uniform vec3 eye;
uniform vec3 haze;
uniform int kind;
out vec4 pixel;
void main() {
  vec3 base = colour.rgb;
  float alpha = colour.a;
  float away = length(eye - at);
  if (kind == 1) {
    vec2 cell = at.xy / 0.25;
    vec2 width = fwidth(cell);
    vec2 line = 1.0 - smoothstep(vec2(0.0), width * 1.5, abs(fract(cell - 0.5) - 0.5));
    vec2 metre = at.xy;
    vec2 wide = fwidth(metre);
    vec2 thick = 1.0 - smoothstep(vec2(0.0), wide * 1.8, abs(fract(metre - 0.5) - 0.5));
    float mark = max(max(line.x, line.y) * 0.05, max(thick.x, thick.y) * 0.11);
    float dark = step(0.5, dot(haze, vec3(0.34)));
    base = mix(base, vec3(1.0 - dark), mark);
    pixel = vec4(mix(base, haze, smoothstep(2.5, 7.0, length(at.xy - vec2(0.6, 0.6)))), 1.0);
    return;
  }
  if (kind == 2) { pixel = vec4(0.0, 0.0, 0.0, 0.22); return; }
  vec3 n = normalize(facing);
  vec3 sun = normalize(vec3(0.35, -0.55, 0.85));
  vec3 to_eye = normalize(eye - at);
  float direct = max(dot(n, sun), 0.0);
  float sky = 0.5 + 0.5 * n.z;
  float shine = pow(max(dot(reflect(-sun, n), to_eye), 0.0), 24.0) * 0.18;
  vec3 lit = base * (0.34 + 0.22 * sky + 0.62 * direct) + shine;
  pixel = vec4(lit, alpha);
}`;

/** Returns the triangles of the unit box (+-0.5): six floats a corner, for place and normal. */
function box() {
  const out = [];
  for (let axis = 0; axis < 3; axis++) {
    for (const side of [-1, 1]) {
      const normal = [0, 0, 0];
      normal[axis] = side;
      const [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
      const corner = (a, b) => {
        const p = [0, 0, 0];
        p[axis] = side / 2;
        p[u] = a / 2;
        p[v] = b / 2;
        return [...p, ...normal];
      };
      const [a, b, c, d] = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
      out.push(...(side > 0 ? [a, b, c, a, c, d] : [a, c, b, a, d, c]));
    }
  }
  return new Float32Array(out.flat());
}

/** Returns the triangles of the unit cylinder about z: radius 1, from z = 0 to 1. */
function cylinder(parts = 24) {
  const out = [];
  for (let i = 0; i < parts; i++) {
    const [s, t] = [(2 * Math.PI * i) / parts, (2 * Math.PI * (i + 1)) / parts];
    const [a, b] = [[Math.cos(s), Math.sin(s)], [Math.cos(t), Math.sin(t)]];
    const side = (p, z) => [p[0], p[1], z, p[0], p[1], 0];
    out.push(side(a, 0), side(b, 0), side(b, 1), side(a, 0), side(b, 1), side(a, 1));
    const cap = (p, z, n) => [p[0], p[1], z, 0, 0, n];
    out.push(cap([0, 0], 1, 1), cap(a, 1, 1), cap(b, 1, 1));
    out.push(cap([0, 0], 0, -1), cap(b, 0, -1), cap(a, 0, -1));
  }
  return new Float32Array(out.flat());
}

const UNMOVED = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
// Projection of all solids along the light onto the floor, where it draws their shadows.
const PRESSED = [1, 0, 0, 0, 0, 1, 0, 0, -0.35 / 0.85, 0.55 / 0.85, 0, 0, 0, 0, 0.002, 1];
// The floor: a flat box.
const FLOOR = { matrix: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.6, 0.6, -0.012, 1], scale: [24, 24, 0.02] };
// Floats of one solid: matrix, scale, colour.
const SOLID = 23;

/** Returns the column-major matrix of a pose: { translation, rotation: [x, y, z, w] }. */
export function matrix(pose) {
  const [x, y, z, w] = pose.rotation;
  const [tx, ty, tz] = pose.translation;
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), 0,
    2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), 0,
    2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y), 0,
    tx, ty, tz, 1,
  ];
}

/** Returns the product of two column-major 4 x 4 matrices. */
export function multiply(a, b) {
  const out = new Array(16).fill(0);
  for (let c = 0; c < 4; c++)
    for (let r = 0; r < 4; r++)
      for (let k = 0; k < 4; k++) out[c * 4 + r] += a[k * 4 + r] * b[c * 4 + k];
  return out;
}

/** Returns the matrix of a perspective; `angle` is the vertical field of view (rad). */
function perspective(angle, aspect, near, far) {
  const f = 1 / Math.tan(angle / 2);
  const d = near - far;
  return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / d, -1, 0, 0, (2 * far * near) / d, 0];
}

/** Returns the matrix of a camera at `eye` that looks at the point `at`, with z upwards. */
function look(eye, at) {
  const sub = (a, b) => a.map((v, i) => v - b[i]);
  const unit = (a) => a.map((v) => v / Math.hypot(...a));
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const z = unit(sub(eye, at));
  const x = unit(cross([0, 0, 1], z));
  const y = cross(z, x);
  return [x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -dot(x, eye), -dot(y, eye), -dot(z, eye), 1];
}

/** Returns whether the browser renders without a graphics processor. */
function software() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

/** Renderer of one canvas. Throws an error if the browser has no WebGL 2. */
export class Renderer {
  constructor(canvas) {
    this.canvas = canvas;
    this.software = software();
    const wanted = { antialias: !this.software, stencil: true, alpha: false, powerPreference: "low-power" };
    const gl = canvas.getContext("webgl2", wanted);
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.gl = gl;
    this.took = 0;
    const shader = (type, source) => {
      const it = gl.createShader(type);
      gl.shaderSource(it, source);
      gl.compileShader(it);
      if (!gl.getShaderParameter(it, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(it));
      return it;
    };
    const program = gl.createProgram();
    gl.attachShader(program, shader(gl.VERTEX_SHADER, VERTEX));
    gl.attachShader(program, shader(gl.FRAGMENT_SHADER, FRAGMENT));
    gl.linkProgram(program);
    gl.useProgram(program);
    this.at = {};
    for (const name of ["press", "view", "eye", "haze", "kind"]) this.at[name] = gl.getUniformLocation(program, name);
    const attributes = (buffer, each, stride, parts) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      for (const [slot, size, offset] of parts) {
        gl.enableVertexAttribArray(slot);
        gl.vertexAttribPointer(slot, size, gl.FLOAT, false, stride * 4, offset * 4);
        gl.vertexAttribDivisor(slot, each);
      }
    };
    const slot = (name) => gl.getAttribLocation(program, name);
    // Each shape has a buffer for its triangles and one for all solids of that shape, so that one
    // call draws them all.
    const mesh = (data) => {
      const vao = gl.createVertexArray();
      gl.bindVertexArray(vao);
      const shape = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, shape);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      attributes(shape, 0, 6, [[slot("position"), 3, 0], [slot("normal"), 3, 3]]);
      const solids = gl.createBuffer();
      const model = slot("model");
      attributes(solids, 1, SOLID, [...[0, 1, 2, 3].map((i) => [model + i, 4, i * 4]), [slot("scale"), 3, 16], [slot("paint"), 4, 19]]);
      return { vao, solids, count: data.length / 6 };
    };
    this.meshes = { box: mesh(box()), cylinder: mesh(cylinder()), floor: mesh(box()) };
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  /**
   * Draws solids { mesh, matrix, scale, colour: [r, g, b] 0..1, alpha, shadow } once for each of the
   * `views` { eye, target, part }, in this part of the canvas: left, bottom, width and height as
   * shares. `floor` and `haze` are colours, `detail` says how finely it draws. Returns the matrix
   * of each view, from the world to the part (-1..1).
   */
  draw(solids, views, floor, haze, detail) {
    const { gl, canvas } = this;
    const own = window.devicePixelRatio || 1;
    // Without antialiasing, a larger picture that the browser scales down smooths the edges.
    const ratio = detail.fine && this.software ? 2 * own : Math.min(own, detail.ratio);
    const [w, h] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (!w || !h) return;
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    const parts = this.sorted(solids, floor);
    gl.enable(gl.SCISSOR_TEST);
    const drawn = views.map(({ eye, target, part }) => {
      const [left, bottom, wide, high] = part.map((share, i) => Math.round(share * (i % 2 ? h : w)));
      gl.viewport(left, bottom, wide, high);
      gl.scissor(left, bottom, wide, high);
      gl.clearColor(...haze, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
      return this.view(parts, eye, target, wide / high, haze, detail);
    });
    this.begun = performance.now();
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    return drawn;
  }

  /**
   * Checks whether the last picture is still being drawn. Once it is finished, `took` is the time
   * that it took (ms).
   */
  busy() {
    const { gl, fence } = this;
    if (!fence) return false;
    if (!gl.isContextLost() && gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) return true;
    this.took = performance.now() - this.begun;
    gl.deleteSync(fence);
    this.fence = null;
    return false;
  }

  /** Returns the numbers of the solids of each shape: first those with a shadow, transparent last. */
  sorted(solids, floor) {
    return Object.keys(this.meshes).map((name) => {
      const own = name === "floor" ? [{ ...FLOOR, colour: floor }] : solids.filter((solid) => solid.mesh === name);
      const rank = (solid) => (solid.alpha ? 2 : solid.shadow ? 0 : 1);
      const data = new Float32Array(own.length * SOLID);
      let [filled, ends] = [0, []];
      for (const part of [0, 1, 2]) {
        for (const solid of own) {
          if (rank(solid) !== part) continue;
          data.set(solid.matrix, filled * SOLID);
          data.set(solid.scale, filled * SOLID + 16);
          data.set([...solid.colour, solid.alpha || 1], filled * SOLID + 19);
          filled += 1;
        }
        ends.push(filled);
      }
      return { name, data, ends };
    });
  }

  /** Draws one view, whose width is `aspect` times its height. Returns its matrix. */
  view(parts, eye, target, aspect, haze, detail) {
    const { gl, at } = this;
    // In a narrow view the vertical angle grows, so that it shows the same width of the cell.
    const angle = aspect < 1.2 ? 2 * Math.atan(Math.tan(0.36) * 1.2 / aspect) : 0.72;
    const view = multiply(perspective(angle, aspect, 0.05, 40), look(eye, target));
    gl.uniformMatrix4fv(at.view, false, view);
    gl.uniform3fv(at.eye, eye);
    gl.uniform3fv(at.haze, haze);
    const some = (part, from, to) => {
      if (to <= from) return;
      const mesh = this.meshes[part.name];
      gl.bindVertexArray(mesh.vao);
      gl.bindBuffer(gl.ARRAY_BUFFER, mesh.solids);
      gl.bufferData(gl.ARRAY_BUFFER, part.data.subarray(from * SOLID, to * SOLID), gl.STREAM_DRAW);
      gl.drawArraysInstanced(gl.TRIANGLES, 0, mesh.count, to - from);
    };
    const [boxes, cylinders, ground] = parts;
    gl.uniformMatrix4fv(at.press, false, UNMOVED);
    gl.uniform1i(at.kind, 0);
    for (const part of [boxes, cylinders]) some(part, 0, part.ends[1]);
    // The floor is drawn after the solids, so its hidden pixels cost nothing.
    gl.uniform1i(at.kind, 1);
    some(ground, 0, 1);
    gl.enable(gl.BLEND);
    if (detail.shadows) {
      // With the stencil, shadows that overlap darken a pixel only once.
      gl.uniform1i(at.kind, 2);
      gl.uniformMatrix4fv(at.press, false, PRESSED);
      gl.enable(gl.STENCIL_TEST);
      gl.disable(gl.CULL_FACE);
      gl.depthMask(false);
      gl.stencilFunc(gl.EQUAL, 0, 255);
      gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
      for (const part of [boxes, cylinders]) some(part, 0, part.ends[0]);
      gl.depthMask(true);
      gl.enable(gl.CULL_FACE);
      gl.disable(gl.STENCIL_TEST);
      gl.uniformMatrix4fv(at.press, false, UNMOVED);
    }
    gl.uniform1i(at.kind, 0);
    for (const part of [boxes, cylinders]) some(part, part.ends[1], part.ends[2]);
    gl.disable(gl.BLEND);
    return view;
  }
}
