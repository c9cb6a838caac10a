// Panels of text and pictures: actors, phases, plan, outcome, console, cameras.

import { ask } from "./link.js";
import { COLOURS } from "./scene.js";

export const $ = (id) => document.getElementById(id);
export const el = (tag, props = {}, ...children) => {
  const it = Object.assign(document.createElement(tag), props);
  it.append(...children);
  return it;
};

/** Text and CSS class of each state of an actor. */
const STATES = {
  absent: ["absent", ""], not_synchronised: ["not synchronised", "warn"], idle: ["idle", ""],
  running: ["running", "main"], held: ["held", "good"], fault: ["fault", "bad"],
};

/** Returns in plain words what an actor does, by the first word of its name. */
function work(actor) {
  const [kind, ...rest] = actor.split(" ");
  const of = rest.join(" ");
  const words = {
    mp: "decides what all arms do next", ui: "shows the run and passes on commands",
    ecp: `plans the motions of the ${of} arm`, edp: `drives the ${of} arm`, vsp: `reads the sensor ${of}`,
  };
  return words[kind] ?? "";
}

/** Shows the actors with their states and words. */
export function showActors(actors) {
  const list = $("actors");
  actors.forEach((actor, i) => {
    let row = list.children[i];
    if (!row) {
      row = el("li", {}, el("b"), el("span"), el("span"));
      list.append(row);
    }
    const [name, badge, words] = row.children;
    const [text, kind] = STATES[actor.state] ?? [actor.state, ""];
    if (name.textContent !== actor.name) [name.textContent, name.title] = [actor.name, work(actor.name)];
    if (badge.textContent !== text) [badge.textContent, badge.className] = [text, `badge ${kind}`];
    // An actor without words of its own is explained.
    const told = actor.words || work(actor.name);
    if (words.textContent !== told) words.textContent = words.title = told;
  });
  while (list.children.length > actors.length) list.lastChild.remove();
}

let phasesShown = "";
/** Shows the phases until now; the last one is marked unless the run is `over`. */
export function showPhases(phases, over) {
  const key = JSON.stringify([phases, over]);
  if (key === phasesShown) return;
  phasesShown = key;
  // Pictures of the cube before its turns would mislead.
  if (phases.at(-1)?.[0] === "solve") seen = [];
  $("phases").replaceChildren(...phases.map(([name, at], i) =>
    el("li", { textContent: name, title: `from ${at.toFixed(1)} s`, className: i === phases.length - 1 && !over ? "now" : "" })));
}

let plan = [];
/** Shows the steps of a new plan with their reasons and planned times. */
export function showPlan(lines) {
  plan = lines;
  $("plan").replaceChildren(...(lines.length
    ? lines.map((line) => el("li", {}, el("span", { textContent: line.what }), el("span", { className: "quiet number", textContent: `${line.seconds.toFixed(1)} s` }), el("small", { textContent: line.why })))
    : [el("li", { className: "empty", textContent: "no plan yet" })]));
  stepShown = undefined;
}

/** Shows the facts of a task that the page does not know otherwise: a row for each name. */
export function showFacts(facts) {
  const rows = Object.entries(facts ?? {});
  const text = (value) => typeof value === "number" ? String(Number(value.toPrecision(5))) : typeof value === "string" ? value : JSON.stringify(value);
  $("facts").hidden = rows.length === 0;
  $("facts").replaceChildren(...rows.map(([name, value]) => el("tr", {}, el("th", { scope: "row", textContent: name }), el("td", { textContent: text(value) }))));
}

let stepShown;
/** Marks the current step of the plan, or all steps as done after the run has ended `well`. */
export function showStep(step, well) {
  const all = step !== null && plan.length > 0 && (step >= plan.length || (well && step === plan.length - 1));
  const done = all ? plan.length : step ?? 0;
  $("progress").max = Math.max(1, plan.length);
  $("progress").value = done;
  $("progress-text").textContent = all ? `all ${plan.length} steps done` : plan.length && step !== null ? `step ${step + 1} of ${plan.length}` : "";
  const shown = `${step} ${all}`;
  if (shown === stepShown) return;
  stepShown = shown;
  [...$("plan").children].forEach((line, i) => {
    line.classList.toggle("now", !all && i === step);
    line.classList.toggle("done", i < done);
  });
  if (all) $("plan").scrollTop = $("plan").scrollHeight;
  const now = $("plan").children[step];
  if (now && !all) $("plan").scrollTop = now.offsetTop - $("plan").offsetTop - $("plan").clientHeight / 3;
}

/** Shows verdict, reason and figures once the run is over. */
export function showOutcome(outcome) {
  const box = $("outcome");
  const key = JSON.stringify(outcome);
  if (box.dataset.key === key) return;
  box.dataset.key = key;
  box.hidden = !outcome;
  if (!outcome) return;
  box.className = outcome.good ? "good" : "";
  // Its rows may scroll, which a keyboard does in an element with the focus.
  const list = el("dl", { tabIndex: 0 });
  for (const [name, value] of outcome.figures) if (value) list.append(el("dt", { textContent: name }), el("dd", { textContent: value }));
  box.replaceChildren(el("strong", { textContent: outcome.verdict }), el("p", { textContent: outcome.reason }), list);
}

let faultsShown = "";
/** Shows the arms that have stopped, each with its fault and the remedy; equal faults only once. */
export function showFaults(arms) {
  const stopped = arms.filter((arm) => arm.fault);
  const key = JSON.stringify(stopped.map((arm) => [arm.name, arm.fault]));
  if (key === faultsShown) return;
  faultsShown = key;
  $("faults").hidden = !stopped.length;
  const same = stopped.length > 1 && stopped.every((arm) => arm.fault === stopped[0].fault);
  const rows = same ? [{ ...stopped[0], name: stopped.map((arm) => arm.name).join(" and ") }] : stopped;
  $("faults").replaceChildren(...rows.map((arm) => el("p", {},
    el("b", { textContent: `${arm.name} stopped: ${arm.fault}. ` }), arm.remedy ?? "")));
}

// ---- console ----
const RANK = { info: 0, warning: 1, non_fatal: 2, fatal: 3, system: 3 };
const NAMES = { info: "info", warning: "warning", non_fatal: "non-fatal", fatal: "fatal", system: "system" };
let messages = [];
let latest = false;
/** Shows the latest warning or error until the outcome replaces it. */
export function showLatest(over) {
  $("latest").hidden = !latest || over;
}

/** Adds new messages to the console. Clears it first if they belong to another run. */
export function addMessages(fresh) {
  if (!fresh.length || (messages.length && fresh[0].number <= messages.at(-1).number)) {
    messages = [];
    $("messages").replaceChildren();
  }
  const known = new Set(messages.map((m) => m.source));
  messages.push(...fresh);
  if (messages.length > 1000) {
    messages.splice(0, 250);
    refilter();
  }
  for (const { source } of fresh) {
    if (!known.has(source) && ![...$("source").options].some((o) => o.value === source)) $("source").append(el("option", { value: source, textContent: source }));
    known.add(source);
  }
  append(fresh);
  const grave = messages.findLast((m) => RANK[m.class] > 0);
  latest = !!grave;
  if (grave) [$("latest").textContent, $("latest").className] = [`${grave.time.toFixed(1)} s: ${grave.text}`, grave.class];
}

/** Returns whether the filters of the console let a message through. */
function wanted(message) {
  const words = $("search").value.trim().toLowerCase();
  return RANK[message.class] >= RANK[$("class").value]
    && (!$("source").value || message.source === $("source").value)
    && (!words || message.text.toLowerCase().includes(words));
}

/** Appends the messages that pass the filters, and scrolls along if the end was visible. */
function append(some) {
  const list = $("messages");
  const atEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 30;
  list.append(...some.filter(wanted).map((m) => el("p", { className: m.class },
    el("span", { textContent: `${m.time.toFixed(2)} s` }), el("span", { textContent: NAMES[m.class] }),
    el("span", { textContent: m.source }), el("span", { textContent: m.text }))));
  if (atEnd) list.scrollTop = list.scrollHeight;
}

/** Shows all messages again, after a filter has changed. */
function refilter() {
  $("messages").replaceChildren();
  append(messages);
  $("messages").scrollTop = $("messages").scrollHeight;
}
for (const id of ["class", "source", "search"]) $(id).addEventListener("input", refilter);

// ---- cameras ----
const views = [];
/** Number of pictures with stickers that are kept for a question about the cube. */
const SEEN = 8;
/**
 * Latest pictures with a whole face of stickers since the last turns, each as
 * { key, camera, time, canvas }.
 */
let seen = [];
/** Returns those pictures, the latest last. */
export const picturesOfFaces = () => seen;

/** Keeps a small copy of a picture in which a whole face was read, in place of one like it. */
function keepFace(view, camera) {
  const colours = camera.marks.map((mark) => mark.colour);
  if (colours.length < 9 || colours.includes(null)) return;
  const key = camera.name + colours.join("");
  const canvas = el("canvas", { width: 320, height: Math.round(320 * view.canvas.height / view.canvas.width) });
  canvas.getContext("2d").drawImage(view.canvas, 0, 0, canvas.width, canvas.height);
  seen = [...seen.filter((other) => other.key !== key), { key, camera: camera.name, time: camera.time, canvas }].slice(-SEEN);
}

/** Makes an empty picture for each camera of a new run. */
export function setCameras(cameras) {
  views.length = 0;
  seen = [];
  $("cameras").replaceChildren(...cameras.map((camera, i) => {
    const canvas = el("canvas", { width: camera.size[0] || 4, height: camera.size[1] || 3 });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Camera ${camera.name}: no picture yet`);
    const words = el("span", { textContent: "no picture yet" });
    canvas.className = "dark";
    views[i] = { canvas, words, frame: 0, busy: false, known: new Map(), waits: null };
    return el("figure", {}, canvas, el("figcaption", {}, el("b", { textContent: camera.name.replaceAll("_", " ") }), words));
  }));
  if (!cameras.length) $("cameras").append(el("p", { className: "empty", textContent: "this cell has no cameras" }));
}

/** Number of frames for which the results of vision are kept, for pictures that arrive late. */
const KNOWN = 8;

/** Age from which on a picture is marked as old (s of the run). */
const OLD = 2;

/** Tells the result for the picture that is shown, and its age, if the picture is old. */
function tellAge(view, camera, time) {
  const age = time - camera.time;
  const old = age > OLD;
  view.canvas.classList.toggle("old", old);
  const words = `${old ? `${age.toFixed(0)} s old · ` : ""}${camera.words}`;
  if (view.words.textContent !== words) view.words.textContent = view.words.title = words;
}

/** Fetches and shows the new pictures of all cameras, with the results of vision; `time` is now. */
export function showCameras(cameras, time) {
  cameras.forEach(async (camera, i) => {
    const view = views[i];
    if (!view || !camera.frame) return;
    if (view.frame === camera.frame) tellAge(view, camera, time);
    view.known.set(camera.frame, camera);
    if (view.known.size > KNOWN) view.known.delete(view.known.keys().next().value);
    // The picture has arrived before the snapshot with the results for it.
    if (view.waits?.frame === camera.frame) show(view, view.waits.image, camera.frame);
    if (view.busy || view.frame === camera.frame) return;
    view.busy = true;
    try {
      const answer = await ask(`/camera/${i}?f=${camera.frame}`);
      if (!answer.ok) throw new Error(answer.statusText);
      // The answer is the latest picture of the camera, which may be newer than the requested one.
      const frame = Number(answer.headers.get("x-frame"));
      const image = await createImageBitmap(await answer.blob());
      view.frame = camera.frame;
      show(view, image, frame);
    } catch (error) {
      view.words.textContent = String(error.message ?? error);
      view.frame = camera.frame;
    } finally {
      view.busy = false;
    }
  });
}

/** Paints a picture with the results of vision; keeps it until they arrive if they have not yet. */
function show(view, image, frame) {
  const found = view.known.get(frame);
  if (view.waits && view.waits.image !== image) view.waits.image.close();
  view.waits = found ? null : { frame, image };
  view.canvas.dataset.frame = frame;
  view.canvas.dataset.found = found?.frame ?? "";
  paint(view, image, found ?? { outlines: [], marks: [] });
  if (found) {
    view.frame = Math.max(view.frame, frame);
    keepFace(view, found);
    image.close();
  }
}

/** Paints a picture, the outlines of the faces found in it, and a dot on each sticker read. */
function paint(view, image, camera) {
  const { canvas } = view;
  canvas.className = "";
  const show = Math.min(1, 640 / image.width);
  [canvas.width, canvas.height] = [Math.round(image.width * show), Math.round(image.height * show)];
  canvas.style.aspectRatio = `${image.width} / ${image.height}`;
  const at = canvas.getContext("2d");
  at.drawImage(image, 0, 0, canvas.width, canvas.height);
  at.scale(show, show);
  const thick = 2.2 / show;
  const trace = (points) => {
    at.beginPath();
    points.forEach(([x, y], k) => (k ? at.lineTo(x, y) : at.moveTo(x, y)));
    at.closePath();
    at.stroke();
  };
  for (const outline of camera.outlines) {
    [at.strokeStyle, at.lineWidth] = ["#000a", thick * 2.2];
    trace(outline);
    [at.strokeStyle, at.lineWidth] = ["#39e6ff", thick];
    trace(outline);
  }
  for (const mark of camera.marks) {
    const [x, y] = mark.at;
    const r = 7 / show;
    at.beginPath();
    at.arc(x, y, r, 0, 7);
    at.fillStyle = mark.colour === null ? "#0006" : COLOURS[mark.colour];
    at.fill();
    [at.strokeStyle, at.lineWidth] = [mark.colour === null || mark.confidence < 0.5 ? "#ff3b46" : "#000c", thick];
    at.stroke();
  }
  if (!camera.frame) return;
  view.words.textContent = view.words.title = camera.words;
  canvas.setAttribute("aria-label", `Camera ${canvas.parentElement.querySelector("b").textContent}: ${camera.words}`);
}
