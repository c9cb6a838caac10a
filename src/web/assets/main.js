// Entry point of the page: shows what the program sends, and sends the commands of the buttons.

import { Link } from "./link.js";
import { Commands } from "./commands.js";
import { Scene } from "./scene.js";
import { Curves } from "./curves.js";
import { Timeline, inWords } from "./timeline.js";
import { NetView } from "./net.js";
import { Manual } from "./manual.js";
import { Parameters } from "./parameters.js";
import { attend } from "./attention.js";
import { keep, kept } from "./settings.js";
import * as panels from "./panels.js";
import { showQuestion } from "./questions.js";

const $ = (id) => document.getElementById(id);
/** Text and CSS class of the states of a replay that differ from those of a run. */
const REPLAYED = { running: ["replay", "main"], paused: ["replay, paused", "warn"] };
/** Text and CSS class of each state of the run. */
const STATES = {
  waiting: ["waiting for start", "warn"], running: ["running", "main"], paused: ["paused", "warn"],
  terminated: ["ending", "warn"], ended: ["ended", ""],
};

const scene = new Scene($("scene"), $("labels"));
const curves = new Curves($("curves"), $("signals"));
const timeline = new Timeline($("timeline"), $("timeline-words"), (time, span) => {
  if (snapshot?.services.seek_ms !== null) commands.give("seek", { time: span?.from ?? time });
  else if (span && span.from < snapshot.time) curves.zoom([span.from - 1, Math.max(span.from + 4, (span.to ?? snapshot.time) + 1)]);
});
const net = new NetView($("net"), $("net-note"));
/** Latest snapshot of the run. */
let snapshot = null;
/** Whether this page commands, whether any page does, and which page asks for that right. */
let seat = { own: false, taken: false, request: null };
/** Whether the connection to the program is open, and whether the program ever sent a seat. */
let line = false;
let met = false;
/** Time for which the program has sent nothing (s), 0 while it sends; it is told from 0.8 s on. */
let silent = 0;
/** Time of the run that was last seen to change, and the page's time then (ms). */
let advanced = { time: -1, at: 0 };
/** Name of the run for the title of the tab. */
let name = "";
/** Whether the page shows a camera alone. */
let scan = false;
/** Reason why the program does not admit this page. */
let denied = "";

const link = new Link({
  stage(stage) {
    $("title").textContent = stage.title || "no run yet";
    $("title").title = stage.title;
    name = stage.title.split("/").at(-1);
    const facts = [stage.task && `task ${stage.task}`, stage.plant, stage.pace, stage.coordination, stage.task && `seed ${stage.seed}`];
    if (stage.version) $("version").textContent = `${facts.filter(Boolean).join(", ")} – version ${stage.version}`;
    if (!stage.version) return;
    panels.setCameras(stage.cameras);
    // A cube before a camera has no cell, no plan and no motion to stop.
    scan = stage.task === "scan";
    document.body.classList.toggle("scan", scan);
    if (scan) return;
    scene.set(stage);
    const loose = (stage.objects ?? []).filter((object) => !object.fixed).map((object) => object.name);
    $("truth").hidden = !loose.length;
    $("truth").textContent = `true place in the simulated plant: ${loose.join(", ")}`;
    curves.set(stage);
    timeline.clear();
    manual.set(stage);
    parameters.set(stage);
  },
  plan(lines) {
    panels.showPlan(lines);
    timeline.plans(lines);
  },
  history: (points) => curves.history(points),
  timeline(changed) {
    timeline.take(changed);
    curves.bands = timeline.bands();
  },
  messages: panels.addMessages,
  snapshot(fresh) {
    snapshot = fresh;
    if (fresh.time !== advanced.time || fresh.control !== "running") advanced = { time: fresh.time, at: performance.now() };
    commands.show(fresh);
    show();
  },
  taken: (number) => commands.taken(number),
  number: (number) => commands.refused(number),
  silent(seconds) {
    if (!seconds && !silent) return;
    silent = seconds;
    show();
  },
  seat(fresh) {
    met = true;
    // A page that lost the right while the browser suspended it takes it again if no page has it.
    if (seat.own && !fresh.taken) link.say({ seat: "take" });
    if (seat.request === "own" && !fresh.request && fresh.taken && !fresh.own) notice("The other page keeps the right to command.");
    seat = fresh;
    show();
  },
  refused(why) {
    notice(why);
  },
  denied(why) {
    denied = why;
  },
  line(up) {
    line = up;
    if (up) denied = "";
    if (!up) {
      $("state").textContent = "no connection";
      $("state").className = "badge bad";
    }
    show();
  },
});
const commands = new Commands(link, tellCommand);
const send = ({ command, ...rest }) => commands.give(command, rest);
const manual = new Manual(send);
const parameters = new Parameters(send);

/** Tells the state of a command: at the stop for an emergency stop, else under the header. */
function tellCommand(name, state, words) {
  const urgent = name === "emergency_stop";
  const place = $(urgent ? "emergency-note" : "command");
  place.className = `${urgent ? "quiet" : "notice"} ${state}`;
  if (urgent) place.textContent = words || place.dataset.words;
  // A command that is obeyed at once would only flicker.
  else [place.hidden, place.textContent] = [state !== "late", words];
  if (urgent && state === "late") notice(words);
}

/** Shows the latest snapshot, the seat and the state of the connection in all parts of the page. */
function show() {
  const s = snapshot;
  const stale = silent > 0 || !line;
  const own = line && !stale && seat.own;
  const asks = seat.request === "own";
  $("seat").textContent = denied || (!line ? "The program does not answer; reconnecting."
    : !seat.taken ? "No page commands."
    : asks ? "The page that commands is asked; it has ten seconds to answer."
    : "Another page commands; this page only watches.");
  $("watching").hidden = own || (stale && line) || !(met || denied);
  $("take").hidden = !line || asks;
  // The page and the modal dialog each have a notice that another page asks.
  for (const notice of document.querySelectorAll(".asked")) notice.hidden = !(own && seat.request === "other");
  document.body.classList.toggle("watching", !own);
  document.body.classList.toggle("stale", stale && !!s);
  const badge = () => attend($("state").textContent, $("state").className.split(" ")[1], name, !!s?.question && own);
  if (stale && met) [$("state").textContent, $("state").className] = [silent ? `no data for ${silent.toFixed(0)} s` : "no connection", "badge bad"];
  if (!s) return badge();
  const control = s.control;
  const stopped = s.arms.some((arm) => arm.fault);
  const replay = s.services.seek_ms !== null;
  const still = (performance.now() - advanced.at) / 1000;
  if (!stale) {
    const [text, kind] = (replay && REPLAYED[control]) || STATES[control];
    const failed = control === "ended" && s.outcome && !s.outcome.good;
    const shown = stopped && control !== "ended" ? ["fault", "bad"] : failed ? [s.outcome.verdict, "bad"] : control === "ended" ? [s.outcome?.verdict ?? text, "good"] : [text, kind];
    // A run whose time stands still computes, or hangs.
    if (control === "running" && !replay && still > 2) [shown[0], shown[1]] = [`stands still for ${still.toFixed(0)} s`, "warn"];
    [$("state").textContent, $("state").className] = [shown[0], `badge ${shown[1]}`];
  }
  badge();
  $("phase").textContent = control === "ended" ? "" : s.phase;
  // The run holds the arms after its task, so the clock shows the time at which the task ended.
  const time = (control === "ended" ? s.outcome?.time : null) ?? s.time;
  $("time").textContent = `${time.toFixed(1)} s`;
  $("factor").textContent = control === "ended" ? "" : `${s.factor.toFixed(s.factor < 10 ? 1 : 0)}×`;
  $("start").disabled = !(own && control === "waiting");
  $("pause").disabled = !(own && control === "running");
  $("resume").disabled = !(own && control === "paused");
  $("terminate").disabled = !(own && ["waiting", "running", "paused"].includes(control));
  // The emergency stop can be pressed without a connection: it is sent as soon as there is one.
  for (const button of stops) button.disabled = control === "ended";
  if (control === "ended") $("sure").close();
  $("start").hidden = replay || control === "ended" || (control !== "waiting" && s.time > 0);
  $("pause").hidden = $("resume").hidden = control === "ended";
  // A replay has no motion to stop, and can be closed at any time.
  $("terminate").hidden = control === "ended" || replay;
  $("quit").hidden = control !== "ended" && !replay;
  $("quit").disabled = !own;
  $("quit").textContent = replay ? "Close replay" : "Close program";
  const after = control === "ended" && !replay ? s.services.after : null;
  for (const [id, shown] of [["go-on", after?.resumes], ["again", after], ["next-seed", after], ["replay", after?.recorded], ["report", after?.recorded]]) {
    $(id).hidden = !shown;
    $(id).disabled = !own;
  }
  // Neither a replay nor the time after a run has anything to stop.
  document.querySelector(".stop").hidden = replay || !!after;
  $("speed-label").hidden = !s.services.speed;
  $("speed").disabled = !own;
  if (document.activeElement !== $("speed")) {
    const known = [...$("speed").options].some((o) => Number(o.value) === s.speed);
    if (!known) $("speed").append(Object.assign(document.createElement("option"), { value: String(s.speed), textContent: `${s.speed}×` }));
    $("speed").value = String(s.speed);
  }
  const length = s.services.seek_ms;
  $("seek-bar").hidden = length === null;
  if (length !== null) {
    $("seek").max = String(length / 1000);
    if (!seeking) $("seek").value = String(s.time);
    $("seek-time").textContent = `${s.time.toFixed(1)} of ${(length / 1000).toFixed(1)} s`;
  }
  const byHand = s.services.manual;
  $("manual").hidden = !byHand;
  document.querySelector("main").classList.toggle("by-hand", byHand);
  for (const button of document.querySelectorAll("#manual button")) if (button.id !== "synchronise") button.disabled = !(own && control === "running");
  if (byHand) manual.show(s, own && control === "running");
  parameters.show(s, own && ["running", "paused"].includes(control));
  document.querySelector("main").classList.toggle("blind", !s.cameras.length);
  if (!scan) {
    scene.show(s);
    curves.show(s);
    timeline.show(s);
    const left = timeline.left();
    $("left").textContent = left === null ? "" : `about ${inWords(left)} left of the plan`;
  }
  net.show(s.net, s.cube.facelets);
  $("cube-with").hidden = !s.cube.with;
  $("cube-with").textContent = `cube: ${s.cube.with}`;
  panels.showActors(s.actors);
  panels.showPhases(s.phases, control === "ended");
  panels.showOutcome(s.outcome);
  panels.showFaults(s.arms);
  panels.showFacts(s.facts);
  panels.showLatest(control === "ended");
  // The panels above change the height of the plan, so the plan scrolls after them.
  panels.showStep(s.step, control === "ended" && !!s.outcome?.good);
  panels.showCameras(s.cameras, s.time);
  showQuestion(s.question, s.time, own, (value) => (value.command ? send(value) : link.say(value)));
}

/** Timer that hides the notice. */
let hush;
/** Shows a notice for 6 s. */
function notice(text) {
  $("notice").textContent = text;
  $("notice").hidden = false;
  clearTimeout(hush);
  hush = setTimeout(() => { $("notice").hidden = true; }, 6000);
}

$("go-on").onclick = () => commands.give("go_on");
$("again").onclick = () => commands.give("again", { seed: snapshot.services.after.seed });
$("next-seed").onclick = () => commands.give("again", { seed: snapshot.services.after.seed + 1 });
for (const name of ["replay", "report"]) $(name).onclick = () => commands.give(name);
for (const name of ["start", "pause", "resume", "quit"]) $(name).onclick = () => commands.give(name);
$("terminate").onclick = () => $("sure").showModal();
$("sure-yes").onclick = () => commands.give("terminate");
// A modal dialog blocks the rest of the page, so each dialog has its own emergency stop.
const stops = document.querySelectorAll("button.emergency");
for (const button of stops) button.onclick = () => { commands.give("emergency_stop"); $("sure").close(); $("help").close(); };
$("help-open").onclick = () => $("help").showModal();
$("take").onclick = () => link.say({ seat: "take" });
for (const button of document.querySelectorAll("[data-seat]")) button.onclick = () => link.say({ seat: button.dataset.seat });
$("speed").onchange = () => commands.give("speed", { factor: Number($("speed").value) });
let seeking = false;
$("seek").onpointerdown = () => { seeking = true; };
$("seek").onpointerup = $("seek").onpointercancel = () => { seeking = false; };
// Dragging fires an event for each pixel, so a time is sent at most every 100 ms, and the last one
// always. `sought` is the time to send next (s), `later` the timer.
let [sought, later] = [null, 0];
/** Sends the time that is sought, and calls itself again after 100 ms. */
function seek() {
  later = 0;
  if (sought === null) return;
  link.command("seek", { time: sought });
  sought = null;
  later = setTimeout(seek, 100);
}
$("seek").oninput = () => {
  sought = Number($("seek").value);
  if (!later) seek();
};
const look = (view) => {
  scene.look(view);
  keep("view", view);
  for (const button of document.querySelectorAll("[data-view]")) button.setAttribute("aria-pressed", String(button.dataset.view === view));
};
for (const button of document.querySelectorAll("[data-view]")) button.onclick = () => look(button.dataset.view);
scene.triad = () => (snapshot?.services.manual ? manual.axes() : null);
scene.first = () => look(kept("view", "cell"));
// F8 and F9 work everywhere on the page, also in a dialog or a field.
addEventListener("keydown", (event) => {
  if (event.key === "F8" && !$("emergency").disabled && $("emergency").checkVisibility()) commands.give("emergency_stop");
  else if (event.key === "F9") for (const id of ["pause", "resume"]) { if (!$(id).disabled) { $(id).click(); break; } }
  else return;
  event.preventDefault();
}, true);
for (const button of document.querySelectorAll("[data-window]")) {
  button.onclick = () => {
    curves.window = Number(button.dataset.window);
    keep("window", curves.window);
    curves.zoom(null);
    for (const other of document.querySelectorAll("[data-window]")) other.setAttribute("aria-pressed", String(other === button));
  };
}
document.querySelector(`[data-window="${kept("window", 60)}"]`)?.click();
curves.onrange = (range) => { $("follow").hidden = !range; };
$("follow").onclick = () => curves.zoom(null);
$("export").onclick = () => {
  const file = URL.createObjectURL(new Blob([curves.table()], { type: "text/csv" }));
  Object.assign(document.createElement("a"), { href: file, download: "curves.csv" }).click();
  URL.revokeObjectURL(file);
};
setInterval(() => {
  const rate = scene.renderer && document.visibilityState === "visible" ? scene.rate() : 0;
  $("rate").textContent = rate ? `${rate.toFixed(0)} frames/s` : "";
}, 1000);
// State of the page, for the tests.
window.page = { scene, panels, get snapshot() { return snapshot; }, link, commands, timeline, curves };
