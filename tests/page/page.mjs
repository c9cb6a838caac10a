// See run.sh. The effect of each button is checked in the page and, after the run, in its recording:
// the recording contains the operator's commands, and `replay --verify` repeats the servo periods to
// the bit.

import { execFile, spawn } from "node:child_process";
import { once } from "node:events";
import { createServer, request } from "node:http";
import { existsSync, readFileSync, readdirSync, rmSync, statSync } from "node:fs";
import { cpus, loadavg } from "node:os";
import { pathToFileURL } from "node:url";
import { promisify } from "node:util";

const [, , library, executablePath, binary, pictures] = process.argv;
const { chromium } = await import(pathToFileURL(library));
/** Checker of accessibility. */
const axe = readFileSync(new URL("../axe-core/axe.min.js", pathToFileURL(library)), "utf8");
const LEAST_RATE = Number(process.env.LEAST_RATE ?? 10);
const SIZES = { desktop: { width: 1280, height: 800 }, phone: { width: 390, height: 844 } };
/** Longest time of all parts (ms), because a browser or a program may hang. */
const LONGEST = 1200000;

let failures = 0;
function check(right, what) {
  if (!right) failures += 1;
  console.log(`${right ? "ok    " : "FAILED"} ${what}`);
}
/** Programs that still run. They are killed when this process ends, for any reason. */
const alive = new Set();
process.on("exit", () => alive.forEach((it) => it.kill("SIGKILL")));
for (const signal of ["SIGINT", "SIGTERM", "SIGHUP"]) process.on(signal, () => process.exit(1));
setTimeout(() => {
  console.log(`FAILED not over after ${LONGEST / 1000} s`);
  process.exit(1);
}, LONGEST).unref();

const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const command = promisify(execFile);

/** Run with a page, which records the run to a folder of states. */
class Run {
  static number = 0;

  constructor(...args) {
    // Recordings go to the folder of states, unless an argument names one.
    this.named = args[args.indexOf("--record") + 1 || args.length];
    this.states = `${pictures}/states${Run.number++}`;
    for (const old of [this.states, ...(this.named ? this.recordings() : [])]) rmSync(old, { recursive: true, force: true });
    const listen = args.includes("--listen") ? [] : ["--listen", "127.0.0.1:0"];
    // Another command than a run comes as one list of words.
    const [other] = args.filter(Array.isArray);
    const all = other ? [...other, "--ui", "web", ...listen] : ["run", ...args, "--ui", "web", ...listen];
    this.process = spawn(binary, all, { stdio: ["ignore", "pipe", "pipe"], env: { ...process.env, XDG_STATE_HOME: this.states } });
    alive.add(this.process);
    this.process.on("exit", () => alive.delete(this.process));
    this.told = "";
    this.summary = "";
    this.wanted = [];
    this.process.stdout.on("data", (data) => { this.summary += data; });
    this.process.stderr.on("data", (data) => { this.told += data; });
  }

  async url() {
    for (let i = 0; i < 600; i++) {
      const found = this.told.match(/page: (http:\S+)/);
      if (found) return found[1];
      await pause(100);
    }
    throw new Error(`no page: ${this.told}`);
  }

  /** Returns the recordings of all runs of the program, in the order of their ends. */
  recordings() {
    if (this.named) return [this.named, this.named.replace(".mcap", "-2.mcap")].filter(existsSync);
    const states = `${this.states}/rubik-robot`;
    return readdirSync(states).filter((name) => name.startsWith("run-"))
      .flatMap((folder) => readdirSync(`${states}/${folder}`).filter((name) => name.endsWith(".mcap")).map((name) => `${states}/${folder}/${name}`))
      .sort((a, b) => statSync(a).mtimeMs - statSync(b).mtimeMs);
  }

  /** Adds words that the recording must contain at the end. */
  records(...words) {
    this.wanted.push(...words);
  }

  /** Waits until the run ends, and checks its exit code, summary and recording. */
  async ends(code, summary) {
    if (this.process.exitCode === null) {
      const late = setTimeout(() => this.process.kill("SIGKILL"), 30000);
      await once(this.process, "exit");
      clearTimeout(late);
    }
    check(this.process.exitCode === code, `the program ends with exit code ${code} (${this.process.exitCode})`);
    check(summary.test(this.summary), `the summary matches ${summary}`);
    const [recording] = this.recordings();
    const shown = await command(binary, ["replay", recording, "--ui", "none"], { maxBuffer: 1 << 26 });
    for (const words of this.wanted) check(shown.stderr.includes(words), `the recording contains "${words}"`);
    const verified = await command(binary, ["replay", recording, "--verify", "--json"]).catch((error) => error);
    const { same, compared } = JSON.parse(verified.stdout || "{}");
    check(same === true && compared > 100, `the recording verifies to the bit (${compared} servo ticks)`);
    if (same !== true) console.log(verified.stdout, verified.stderr);
    else if (!process.env.KEEP) for (const path of [this.states, ...(this.named ? this.recordings() : [])]) rmSync(path, { recursive: true, force: true });
  }
}

const browser = await chromium.launch({
  executablePath,
  args: ["--no-sandbox", "--enable-unsafe-swiftshader", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    // Chromium takes a page of the working tree for one from elsewhere.
    ...(process.env.ASSETS ? ["--disable-features=LocalNetworkAccessChecks"] : [])],
});

async function open(run, size = "desktop", colorScheme = "light") {
  const page = await browser.newPage({ viewport: SIZES[size], colorScheme, isMobile: size === "phone", hasTouch: size === "phone" });
  const url = await run.url();
  page.on("pageerror", (error) => check(false, `an error in the page: ${error.message}`));
  page.on("request", (request) => {
    if (new URL(request.url()).host !== new URL(url).host && !request.url().startsWith("blob:")) check(false, `the page contacts a third party: ${request.url()}`);
  });
  page.setDefaultTimeout(120000);
  // Files of the page from the working tree instead of those in the program.
  if (process.env.ASSETS) await page.route(/\.(js|css)$|\/$/, (route) => {
    const { pathname } = new URL(route.request().url());
    route.fulfill({ path: `src/web/assets/${pathname === "/" ? "index.html" : pathname}` });
  });
  await page.goto(url);
  await page.waitForFunction(() => window.page?.snapshot);
  return page;
}

/** Waits until the page's snapshot `s` passes `test`, an expression in which `a` is `argument`. */
async function sees(page, what, test, argument, timeout = 240000) {
  const holds = new Function("s", "a", `return ${test}`);
  const begun = Date.now();
  for (;;) {
    const s = await snapshot(page);
    if (s && holds(s, argument)) return check(true, what);
    if (Date.now() - begun > timeout) return check(false, `${what}: not in ${timeout / 1000} s`);
    await pause(40);
  }
}

const snapshot = (page) => page.evaluate(() => window.page.snapshot);

/** Checks that the checker of accessibility finds nothing in the present state of the page. */
async function accessible(page, what) {
  await page.evaluate(axe);
  const found = await page.evaluate(async () => (await window.axe.run()).violations.map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.target).slice(0, 3)}`));
  check(!found.length, `${what}: axe finds nothing ${found.join("; ")}`);
}

/**
 * Takes screenshots of the page at desktop width and of a second page at phone width, and checks that
 * nothing is cut off or covered.
 */
async function picture(page, run, name, prepare = async () => {}) {
  await pause(700);
  await page.evaluate(() => {
    // An open question keeps the focus on its sticker.
    if (!document.querySelector("dialog[open]")) document.activeElement?.blur();
    scrollTo(0, 0);
  });
  await page.screenshot({ path: `${pictures}/${name}-desktop.png` });
  const phone = await open(run, "phone", "dark");
  await prepare(phone);
  await pause(1200);
  for (const [size, it] of [["desktop", page], ["phone", phone]]) {
    const [wide, seen] = [await it.evaluate(() => document.documentElement.scrollWidth), SIZES[size].width];
    check(wide <= seen, `${name}: no sideways scrolling on a ${size} (${wide} of ${seen} px)`);
    const cut = await it.evaluate(() => [...document.querySelectorAll("header button, .buttons button, .badge")]
      .filter((e) => e.offsetParent && e.scrollWidth > e.clientWidth + 1).map((e) => e.textContent));
    check(!cut.length, `${name}: no word of a button is cut off on a ${size} ${cut.join(", ")}`);
  }
  await accessible(page, `${name}, light, on a desktop`);
  await accessible(phone, `${name}, dark, on a phone`);
  for (const [size, it] of [["desktop", page], ["phone", phone]]) {
    const hidden = await it.evaluate(() => [...document.querySelectorAll("dialog[open] button")].filter((button) => {
      const { left, top, width, height } = button.getBoundingClientRect();
      return width && document.elementFromPoint(left + width / 2, top + height / 2)?.closest("button") !== button;
    }).map((button) => button.textContent));
    check(!hidden.length, `${name}: no button of a dialog is covered on a ${size} ${hidden.join(", ")}`);
  }
  const fullPage = !await phone.evaluate(() => !!document.querySelector("dialog[open]"));
  await phone.screenshot({ path: `${pictures}/${name}-phone.png`, fullPage });
  await phone.close();
}

/** Returns the highest rate of some tries, because other programs share the machine. */
async function rate(page) {
  let best = 0;
  for (let i = 0; i < 4 && best < LEAST_RATE; i++) {
    await pause(2200);
    best = Math.max(best, await page.evaluate(() => window.page.scene.rate()));
  }
  return best;
}

async function strangers(url) {
  const own = new URL(url);
  const server = createServer((_, answer) => answer.setHeader("Content-Type", "text/html").end("<p>a stranger's page</p>"));
  server.listen(0, "127.0.0.1");
  await once(server, "listening");
  const page = await browser.newPage();
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  const got = await page.evaluate((to) => new Promise((done) => {
    const socket = new WebSocket(to);
    socket.onopen = () => done("open");
    socket.onerror = () => done("refused");
  }), `ws://${own.host}/ws`);
  check(got === "refused", `the program refuses another site's WebSocket (${got})`);
  await page.close();
  server.close();
  const status = await new Promise((done, fail) => {
    const headers = { Connection: "Upgrade", Upgrade: "websocket", "Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", Origin: "http://evil.example" };
    const asked = request({ host: own.hostname, port: own.port, path: "/ws", headers }, (answer) => { answer.resume(); done(answer.statusCode); });
    asked.on("upgrade", (_, socket) => { socket.destroy(); done(101); }).on("error", fail).end();
  });
  check(status === 403, `a request with a foreign Origin gets ${status}`);
}

/** Checks that an outline is drawn only over the picture in which vision found it. */
async function outlines(page) {
  const canvas = () => page.evaluate(() => ({ ...document.querySelector("#cameras canvas")?.dataset }));
  const sees = async (what, so) => {
    for (let i = 0; i < 200; i++) {
      if (so(await canvas())) return check(true, what);
      await pause(50);
    }
    return check(false, `${what}: ${JSON.stringify(await canvas())}`);
  };
  await sees("an outline belongs to its picture", ({ frame, found }) => frame > 0 && frame === found);
  await page.evaluate(() => {
    const real = window.fetch;
    window.unfetch = () => { window.fetch = real; };
    window.fetch = async (...asked) => {
      const answer = await real(...asked);
      return new Response(await answer.blob(), { headers: { "x-frame": "999999" } });
    };
  });
  await sees("another picture has no outline", ({ frame, found }) => frame === "999999" && found === "");
  await page.evaluate(() => window.unfetch());
  await sees("the next picture has its own outline", ({ frame, found }) => frame > 0 && frame !== "999999" && frame === found);
}

/** Checks that the curves keep ten minutes of simulated time with their peaks. */
async function curves(page) {
  const kept = await page.evaluate(async () => {
    const { Curves } = await import("/curves.js");
    const all = new Curves(document.createElement("div"));
    for (let i = 0; i <= 20 * 900; i++) {
      const peak = i === 20 * 400 ? [50, 5] : [1, 0.1];
      all.show({ time: i / 20, arms: [{ peak, following: 0 }], servo: null });
    }
    const { points } = all;
    const shown = points.filter((p) => p.time >= 300);
    return { first: shown[0].time, count: points.length, most: Math.max(...shown.map((p) => p.arms[0].peak[0])) };
  });
  check(kept.first < 301 && kept.most === 50 && kept.count < 10000, `the curves keep ten minutes and their peaks: ${JSON.stringify(kept)}`);
}

/** Checks that the net of the cube as it is now follows the turns. */
async function nets(page) {
  const shown = await page.evaluate(() => {
    const colours = (figure) => [...figure.querySelectorAll(".tile")].map((tile) => tile.style.background).join(" ");
    const [now, read] = [...document.querySelectorAll("#net figure")].map(colours);
    return { turned: now !== read, empty: now.split(" ").filter(Boolean).length < 54 };
  });
  check(shown.turned && !shown.empty, `the net "now" differs from that as read after a turn: ${JSON.stringify(shown)}`);
}

/** Checks that a page that is opened now has the course of the run from its beginning. */
async function late(run) {
  const page = await open(run);
  await page.waitForFunction(() => window.page.timeline.spans.length > 0);
  const had = await page.evaluate(() => {
    const { curves, timeline } = window.page;
    const points = curves.points.filter((p) => p.arms.every((arm) => arm.joints.length === 7 && Number.isFinite(arm.peak[0])));
    const phases = timeline.spans.filter((span) => span.lane === "phase");
    const holders = timeline.spans.filter((span) => span.lane === "holder").map((span) => span.words);
    return { first: points[0].time, count: points.length, phases: phases.map((span) => span.words), ended: phases.slice(0, -1).every((span) => span.to !== null), holders };
  });
  check(had.first < 1 && had.count > 100, `a late page has the curves from the beginning: ${had.count} points from ${had.first} s`);
  check(had.phases[0] === "acquire" && had.phases.includes("solve") && had.ended, `and the timeline: ${had.phases}`);
  check(had.holders.some((words) => words.includes("track")), `with the holders of the cube: ${had.holders.slice(0, 4)}`);
  await page.close();
}

/** Checks the cursor, the zoom and the choice of the curves, and the words of the timeline. */
async function examine(page) {
  const box = await page.locator("#curves canvas").first().boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.waitForFunction(() => [...document.querySelectorAll("#curves figcaption")].every((it) => / at \d+\.\d s/.test(it.textContent)));
  check(true, "the cursor shows the values of all curves at one time");
  const long = () => page.evaluate(() => { const [from, to] = window.page.curves.shown(); return to - from; });
  const before = await long();
  await page.mouse.wheel(0, -500);
  await page.waitForFunction((length) => { const [from, to] = window.page.curves.shown(); return to - from < 0.7 * length; }, before);
  check(await page.isVisible("#follow"), "the wheel zooms the curves, which no longer follow the run");
  await page.click("#follow");
  check(Math.abs(await long() - before) < 1, "a button lets them follow again");
  const charts = () => page.locator("#curves canvas").count();
  const shown = await charts();
  await page.click(".curves summary");
  await page.getByLabel("Grip", { exact: true }).check();
  check(await charts() === shown + 1, "another signal is another chart");
  await page.getByLabel("Grip", { exact: true }).uncheck();
  await page.click(".curves summary");
  const strip = await page.locator("#timeline").boundingBox();
  await page.mouse.move(strip.x + 70, strip.y + 8);
  await page.waitForFunction(() => document.getElementById("timeline-words").textContent.includes("acquire"));
  check(/about .* left of the plan/.test(await page.textContent("#left")), `the page tells the time that is left: ${await page.textContent("#left")}`);
}

/** Checks that a finished plan shows every step as done, with the last step in view. */
async function planned(page) {
  const end = await page.evaluate(() => {
    const { showPlan, showStep } = window.page.panels;
    const lines = Array.from({ length: 30 }, (_, i) => ({ what: `turn ${i}`, why: "so", seconds: 1 }));
    showPlan(lines);
    showStep(29, true);
    const [plan, last] = [document.getElementById("plan"), document.querySelector("#plan li:last-child")];
    const below = last.getBoundingClientRect().bottom - plan.getBoundingClientRect().bottom;
    const told = { done: plan.querySelectorAll(".done").length, below, words: document.getElementById("progress-text").textContent };
    showPlan([...window.page.snapshot.plan ?? []]);
    return told;
  });
  check(end.done === 30 && end.below < 2 && end.words === "all 30 steps done", `a finished plan: ${JSON.stringify(end)}`);
}

async function mission() {
  console.log("# a mission: start, pause, resume, views, terminate");
  const run = new Run("scenarios/solve.toml", "--wait", "--speed", "10");
  const page = await open(run);
  await sees(page, "the run waits for its start", "s.control === 'waiting'");
  await strangers(await run.url());
  await picture(page, run, "idle");
  await page.click("#start");
  await sees(page, "the run starts", "s.control === 'running' && s.time > 3");
  for (const view of ["hands", "top", "cell"]) await page.click(`[data-view=${view}]`);
  await page.focus("#scene");
  // On a slow machine the view may still move to the chosen one, which can undo a key's step.
  await page.waitForFunction(() => !window.page.scene.goal);
  const before = await page.evaluate(() => window.page.scene.view.azimuth);
  for (const key of ["ArrowLeft", "ArrowUp", "+", "-"]) await page.keyboard.press(key);
  check(await page.evaluate((a) => Math.abs(window.page.scene.view.azimuth - a) > 0.05, before), "arrow keys orbit the cell");
  await page.keyboard.press("Home");
  for (const seconds of ["20", "600", "60"]) await page.click(`[data-window="${seconds}"]`);
  await curves(page);
  await page.selectOption("#class", "fatal");
  check(await page.locator("#messages p").count() === 0, "the console's filter hides messages that are not fatal");
  await page.selectOption("#class", "info");
  await page.fill("#search", "acquire");
  check(await page.locator("#messages p").count() >= 1, "the console's search finds a phase");
  await page.fill("#search", "");
  await sees(page, "the stand-alone camera shows the cube", "s.cameras[0].frame > 0 && s.cameras[0].outlines.length > 0");
  await sees(page, "the track arm holds the cube", "s.cube.held_by.includes(0)");
  await page.selectOption("#speed", "20");
  await sees(page, "the net shows the faces that were read", "s.net.facelets.filter(Boolean).length >= 18 && s.speed === 20");
  await page.selectOption("#speed", "2");
  const pictures = await rate(page);
  const words = `the 3-D view has ${pictures.toFixed(1)} frames per second (at least ${LEAST_RATE})`;
  // Without a graphics processor the CPU draws, so the rate at a high load says nothing about the
  // page.
  if (pictures < LEAST_RATE && loadavg()[0] > 2 * cpus().length) console.warn(`*** NOT JUDGED at a load of ${loadavg()[0].toFixed(1)}: ${words}`);
  else check(pictures >= LEAST_RATE, words);
  await picture(page, run, "reading");
  await page.selectOption("#speed", "0");
  await sees(page, "the steps of the plan are executed", "s.step > 1");
  await page.selectOption("#speed", "2");
  await sees(page, "the snapshot shows a turned layer", "s.cube.turned && Math.abs(s.cube.turned.angle) > 0.3");
  await nets(page);
  await late(run);
  await examine(page);
  await picture(page, run, "running");
  check(await page.locator("#plan li.now").count() === 1, "the plan's present step is marked");
  await page.click("#pause");
  await sees(page, "the run pauses", "s.control === 'paused'");
  await pause(1500);
  const [a, b] = [await snapshot(page), (await pause(1000), await snapshot(page))];
  const moved = Math.max(...a.arms.flatMap((arm, i) => arm.joints.map((q, k) => Math.abs(q - b.arms[i].joints[k]))));
  check(moved < 2e-4 && b.time > a.time, `no joint moves during the pause (${moved.toExponential(1)} rad in ${(b.time - a.time).toFixed(1)} s)`);
  await picture(page, run, "paused");
  await page.click("#resume");
  await sees(page, "the run resumes", "s.control === 'running'");
  await sees(page, "the time advances again", "s.time > a + 2", (await snapshot(page)).time);
  await page.click("#terminate");
  await page.click("#sure button[value=no]");
  check((await snapshot(page)).control === "running", "a terminate without confirmation has no effect");
  await page.click("#terminate");
  await page.click("#sure-yes");
  await sees(page, "the run ends", "s.control === 'ended'");
  const end = await snapshot(page);
  check(end.arms.every((arm) => !arm.fault), "both arms hold without a fault");
  check(/terminated by the operator; .* hold/.test(end.outcome.reason), "the reason says where the cube is");
  const paused = Number(/(\d+\.\d) s of them paused/.exec(await page.textContent("#outcome"))?.[1]);
  check(paused > 2 && paused < end.time, `the outcome tells the time of the pauses (${paused} s)`);
  await picture(page, run, "terminated");
  await page.click("#go-on");
  await sees(page, "the mission that goes on waits for its start, as the first one did", "!s.services.after && s.control === 'waiting'");
  await page.click("#start");
  await sees(page, "it goes on from where it was stopped", "s.control === 'running' && s.time > 1 && s.cube.held_by.length");
  await page.click("#terminate");
  await page.click("#sure-yes");
  await sees(page, "and ends again", "s.control === 'ended' && s.services.after");
  await page.click("#quit");
  await page.close();
  run.records("operator: start", "operator: pause", "operator: resume", "operator: terminate");
  check(run.recordings().length === 2, "both parts of the mission have a recording");
  await run.ends(1, /ABORTED\s+terminated by the operator/);
}

async function handOver() {
  console.log("# a whole hand-over");
  const run = new Run("scenarios/acquire.toml", "--speed", "0.5");
  const page = await open(run);
  await outlines(page);
  await page.selectOption("#speed", "0");
  await sees(page, "the run ends as done", "s.control === 'ended' && s.outcome.good");
  await planned(page);
  const { time } = (await snapshot(page)).outcome;
  const told = await page.textContent("#time");
  check(told === `${time.toFixed(1)} s`, `the clock shows the time at which the task ended (${told} of ${time} s)`);
  await picture(page, run, "done");
  await page.click("#quit");
  await page.close();
  run.records("acquire");
  await run.ends(0, /DONE\s+the cube is/);
}

async function fault() {
  console.log("# the emergency stop");
  const run = new Run("scenarios/acquire.toml", "--speed", "2");
  const page = await open(run);
  await sees(page, "the run advances", "s.time > 6");
  // The dialog covers the header, so it has an emergency stop of its own.
  const opens = (it) => it.evaluate(() => document.getElementById("sure").showModal());
  await opens(page);
  await picture(page, run, "sure", opens);
  check(await page.isEnabled("#sure .emergency"), "the dialog that confirms a terminate has an emergency stop");
  await page.click("#sure .emergency");
  await sees(page, "both arms stop with a fault", "s.arms.every((arm) => arm.fault)");
  await sees(page, "the run ends", "s.control === 'ended' && !s.outcome.good");
  const told = await page.textContent("#faults");
  check(/track and postument stopped: emergency stop\. .*new run/.test(told), `the page says what stopped and what to do: ${told}`);
  await page.selectOption("#class", "fatal");
  check(await page.locator("#messages p.fatal").count() >= 1, "the console shows the fatal error");
  await page.selectOption("#class", "info");
  await picture(page, run, "fault");
  await page.click("#quit");
  await page.close();
  run.records("operator: emergency stop", "emergency stop");
  await run.ends(3, /ABORTED\s+emergency stop[\s\S]*detected by\s+fatal, edp/);
}

/** Returns the time (ms) until `test` holds in the page, or NaN after 5 s. */
async function until(page, test) {
  const begun = Date.now();
  const found = await page.waitForFunction(test, null, { polling: 20, timeout: 5000 }).catch(() => null);
  return found ? Date.now() - begun : NaN;
}

/**
 * Checks that a page shows within about 1 s that the program is frozen, that an order from before is
 * dropped, and that each press of the emergency stop is confirmed or called not confirmed.
 */
async function frozen() {
  console.log("# a frozen program");
  const run = new Run("scenarios/idle.toml", "--speed", "1", "--record", `${pictures}/idle.mcap`);
  const page = await open(run);
  await sees(page, "the arms can be moved by hand", "s.services.manual && s.time > 1");
  // The program sends its clock five times a second, so a page may notice 0.2 s later.
  const slack = loadavg()[0] > cpus().length ? 3 : 1;
  const words = () => page.textContent("#state");
  run.process.kill("SIGSTOP");
  const noticed = await until(page, () => document.body.classList.contains("stale"));
  check(noticed <= 1200 * slack, `the page shows that no data come, after ${noticed} ms`);
  check(/^no data for \d+ s$/.test(await words()), `the state says so: ${await words()}`);
  check(await page.isDisabled("#pause") && await page.isDisabled("[aria-label^='joint 1 plus']"), "commands are disabled");
  check(await page.isEnabled("#emergency"), "the emergency stop is not");
  const grey = await page.evaluate(() => getComputedStyle(document.getElementById("scene")).filter);
  check(grey.includes("grayscale"), `the scene is grey (${grey})`);
  // Greater steps than the buttons make would be refused anyway.
  await page.evaluate(() => window.page.commands.give("manual", { effector: 0, order: { order: "joint", axis: 1, by: 0.05 } }));
  await pause(2500);
  await page.screenshot({ path: `${pictures}/frozen-desktop.png` });
  await accessible(page, "frozen");
  const before = (await snapshot(page)).arms[0].joints[1];
  run.process.kill("SIGCONT");
  await page.getByText(/manual: it came \d.\d s late/).first().waitFor();
  check(await until(page, () => !document.body.classList.contains("stale")) < 1000 * slack, "the data come again");
  await pause(1500);
  check(Math.abs((await snapshot(page)).arms[0].joints[1] - before) < 2e-3, "the late order did not move the arm");

  await page.click("#pause");
  check(await until(page, () => window.page.commands.took?.name === "pause") < 1000 * slack, "a pause is confirmed");
  run.process.kill("SIGSTOP");
  await until(page, () => document.body.classList.contains("stale"));
  await page.click("#emergency");
  const told = await until(page, () => document.getElementById("emergency-note").textContent.includes("NOT CONFIRMED: use the hardware stop"));
  check(told <= 1200 * slack, `the emergency stop is called not confirmed, after ${told} ms`);
  await page.screenshot({ path: `${pictures}/not-confirmed-desktop.png` });
  // After 5 s the page opens another connection. The stop is obeyed all the same.
  await pause(5500);
  run.process.kill("SIGCONT");
  await sees(page, "both arms stop after that", "s.arms.every((arm) => arm.fault)");
  await sees(page, "the run ends", "s.control === 'ended' && !s.outcome.good");
  await page.waitForFunction(() => window.page.commands.took?.name === "emergency_stop");
  await page.waitForFunction(() => !document.getElementById("quit").disabled);
  await page.click("#quit");
  await page.close();
  run.records("operator: pause", "operator: emergency stop");
  await run.ends(3, /ABORTED\s+emergency stop[\s\S]*detected by\s+fatal, edp/);
}

async function replayed() {
  console.log("# a replay: the whole run at once, and jumps in time");
  const recording = `${pictures}/replayed.mcap`;
  await command(binary, ["run", "scenarios/acquire.toml", "--ui", "none", "--record", recording]);
  const run = new Run(["replay", recording, "--speed", "1"]);
  const page = await open(run);
  await page.waitForFunction(() => window.page.timeline.spans.some((span) => span.lane === "holder" && span.words.includes("track")));
  const end = await page.evaluate(() => {
    const { curves, timeline, snapshot } = window.page;
    return { now: snapshot.time, points: curves.points.at(-1).time, whole: timeline.end() };
  });
  check(end.now < 8 && end.points > 12 && Math.abs(end.points - end.whole) < 1, `curves and timeline cover the whole recording: ${JSON.stringify(end)}`);
  const strip = await page.locator("#timeline").boundingBox();
  await page.mouse.click(strip.x + 64 + 0.75 * (strip.width - 68), strip.y + 25);
  await sees(page, "a click on the timeline jumps", "s.time > 0.7 * a && s.time < 0.95 * a", end.whole);
  await picture(page, run, "replay");
  await sees(page, "the replay ends with the verdict of the run", "s.outcome && s.outcome.good");
  await page.click("#quit");
  await page.close();
  rmSync(recording);
}

async function after() {
  console.log("# after a run: replay, report, another seed");
  const run = new Run("scenarios/acquire.toml", "--seed", "3", "--record", `${pictures}/named.mcap`);
  const page = await open(run);
  await sees(page, "the run ends as done", "s.control === 'ended' && s.services.after?.recorded");
  const end = (await snapshot(page)).time;
  check(!await page.isVisible("#go-on") && !await page.isVisible("#emergency"), "a run that is done is not continued, and has nothing to stop");
  await picture(page, run, "after");
  await page.click("#replay");
  await sees(page, "the replay begins", "s.services.seek_ms !== null && s.time < a", end);
  check(await page.textContent("#quit") === "Close replay", "the button closes the replay");
  await page.click("#quit");
  await sees(page, "the end of the run is shown again", "s.services.after && s.control === 'ended'");
  await page.click("#report");
  await page.getByText(/the report is written to .*\.html/).first().waitFor();
  check(existsSync(run.recordings()[0].replace(".mcap", ".html")), "the report is there");
  await page.click("#next-seed");
  await sees(page, "another run begins", "!s.services.after && s.control === 'running'");
  await page.waitForFunction(() => document.getElementById("version").textContent.includes("seed 4"));
  await sees(page, "and ends as done", "s.control === 'ended' && s.services.after?.seed === 4");
  const first = await page.evaluate(() => window.page.timeline.spans.filter((span) => span.lane === "phase").map((span) => span.words));
  check(first.filter((words) => words === "acquire").length === 1, `the timeline is that of the second run: ${first}`);
  await page.click("#quit");
  await page.close();
  const recordings = run.recordings();
  check(recordings.length === 2, `the second run has a recording of its own (${recordings})`);
  await run.ends(0, /DONE[\s\S]*DONE/);
}

async function byHand() {
  console.log("# motions by hand, and two pages");
  const run = new Run("scenarios/idle.toml", "--speed", "3", "--record", `${pictures}/by-hand.mcap`);
  const page = await open(run);
  await sees(page, "the arms can be moved by hand", "s.services.manual");
  const before = await snapshot(page);
  check(await page.locator("#parameters .row").count() === before.parameters.length, "each parameter has a row");
  await page.fill("[aria-label='grip_n']", "44");
  await page.press("[aria-label='grip_n']", "Enter");
  await sees(page, "the number orders a grip force, which rises step by step", "s.parameters[0].ordered === 44 && s.parameters[0].value > 40 && s.parameters[0].value < 44");
  await sees(page, "the grip force is reached", "s.parameters[0].value === 44");
  await page.fill("[aria-label='grip_n']", "90");
  await page.press("[aria-label='grip_n']", "Enter");
  await page.getByText("parameter grip_n: 90 is outside 40..55").first().waitFor();
  check((await snapshot(page)).parameters[0].ordered === 44, "a value out of bounds is refused with the reason");
  await page.locator("#parameters .row button").first().click();
  await sees(page, "the button orders the value of the scenario", "s.parameters[0].ordered === 40");
  await page.focus("[aria-label='exposure, slider']");
  // Three presses within one snapshot.
  await page.evaluate(() => {
    const press = () => document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true, cancelable: true }));
    for (let i = 0; i < 3; i++) press();
  });
  await sees(page, "each press of an arrow key moves a slider by a hundredth", "Math.abs(s.parameters[9].ordered - 1.045) < 1e-6");
  await page.click("[aria-label^='joint 1 plus']");
  await sees(page, "joint 1 moves by 5 deg", "Math.abs(s.arms[0].joints[1] - a - Math.PI / 36) < 2e-3", before.arms[0].joints[1]);
  await page.click("[data-pick='step 0']");
  await page.click("[aria-label^='joint 1 minus']");
  await sees(page, "joint 1 moves back by 1 deg", "Math.abs(s.arms[0].joints[1] - a - Math.PI / 45) < 2e-3", before.arms[0].joints[1]);
  await page.selectOption("[aria-label='axis that moves to the number']", "2");
  await page.fill("[aria-label='target of joint 2 in deg']", "-106.5");
  // A second Enter must not add the way once more.
  await page.press("[aria-label='target of joint 2 in deg']", "Enter");
  await page.press("[aria-label='target of joint 2 in deg']", "Enter");
  await sees(page, "joint 2 moves to its target of -106.5 deg", "Math.abs(s.arms[0].joints[2] + 106.5 * Math.PI / 180) < 2e-3");
  await pause(1500);
  await sees(page, "it stays there", "Math.abs(s.arms[0].joints[2] + 106.5 * Math.PI / 180) < 2e-3");
  await sees(page, "and the arm waits for another order", "s.actors.find((actor) => actor.name === `ecp ${s.arms[0].name}`).state === 'idle'");
  await page.click("[data-pick='move by tool']");
  await page.click("[data-pick='step 2']");
  const tool = (await snapshot(page)).arms[0].frames[6].translation;
  await page.click("[aria-label^='z minus']");
  await sees(page, "the tool moves back along its z by 10 mm", "Math.abs(Math.hypot(...s.arms[0].frames[6].translation.map((v, i) => v - a[i])) - 0.01) < 1e-3", tool);
  for (const [frame, along] of [["world", (a, b) => b.frames[6].translation[2] - a.frames[6].translation[2]], ["base", (a, b) => b.frames[6].translation[2] - a.frames[6].translation[2]]]) {
    await page.click(`[data-pick='move by ${frame}']`);
    const from = (await snapshot(page)).arms[0];
    const told = () => page.locator(".axes .row output").nth(2).textContent();
    const number = parseFloat(await told());
    await page.click("[aria-label^='z plus']");
    await sees(page, `the tool rises by 10 mm along the ${frame}'s z`, `Math.abs(s.arms[0].frames[6].translation[2] - a - 0.01) < 1e-3`, from.frames[6].translation[2]);
    await pause(1000);
    check(Math.abs(along(from, (await snapshot(page)).arms[0]) - 0.01) < 1e-3, "and stays there");
    check(Math.abs(parseFloat(await told()) - number - 10) < 1, `the number of that frame follows: from ${number} to ${await told()}`);
  }
  await page.click("[data-pick='step 0']");
  const low = (await snapshot(page)).arms[0].frames[6].translation[2];
  await page.hover("[aria-label^='z minus']");
  await page.mouse.down();
  await pause(3500);
  await page.mouse.up();
  const sank = low - (await snapshot(page)).arms[0].frames[6].translation[2];
  check(sank > 8e-4, `a button that is held repeats its step: ${(sank * 1e3).toFixed(1)} mm in steps of 0.5 mm`);
  await pause(1500);
  const rest = (await snapshot(page)).arms[0].frames[6].translation[2];
  await pause(500);
  check(Math.abs((await snapshot(page)).arms[0].frames[6].translation[2] - rest) < 2e-4, "and stops when it is released");
  await page.click("[data-pick='move by motor']");
  await page.click("[data-pick='step 1']");
  const motor = (await snapshot(page)).arms[0].motors[5];
  await page.click("[aria-label^='motor 5 plus']");
  await sees(page, "motor 5 turns by 2 rad", "Math.abs(s.arms[0].motors[5] - a - 2) < 0.05", motor);
  await page.getByRole("button", { name: "Open", exact: true }).click();
  await sees(page, "the jaws open", "s.arms[0].opening > 0.084");
  await page.getByRole("button", { name: "Close", exact: true }).click();
  await sees(page, "the jaws close", "s.arms[0].opening < 0.06");
  await page.getByRole("button", { name: "Zero force sensor" }).click();
  await sees(page, "the force sensor reads zero", "Math.hypot(...s.arms[0].wrench.slice(0, 3)) < 0.5");
  await page.getByRole("button", { name: "start", exact: true }).click();
  await sees(page, "the arm reaches its start pose", "s.arms[0].joints.slice(1).every((q, i) => Math.abs(q - a[i + 1]) < 3e-3)", before.arms[0].joints);
  await page.click("[data-pick='move by joint']");
  await picture(page, run, "by-hand");
  await page.getByRole("button", { name: "front", exact: true }).click();
  await sees(page, "the arm begins to move to its front pose", "s.actors.some((x) => x.name === 'ecp postument' && x.state === 'running')");

  const second = await open(run);
  await second.waitForSelector("#take", { state: "visible" });
  check(await second.isDisabled("#pause"), "a second page only watches");
  check(await second.isDisabled("[aria-label='grip_n']"), "a page that watches changes no parameter");
  await second.click("#take");
  await page.click(".asked [data-seat=keep]");
  await second.getByText("The other page keeps the right to command.").waitFor();
  check(await second.isDisabled("#pause"), "the first page keeps the command");
  await second.click("#take");
  await page.click(".asked [data-seat=give]");
  await second.waitForFunction(() => !document.getElementById("pause").disabled);
  check(true, "the second page takes over");
  await page.waitForSelector("#watching", { state: "visible" });
  check(await page.isDisabled("#pause"), "the first page only watches after that");
  await second.click("#pause");
  await sees(second, "the second page pauses the run", "s.control === 'paused'");
  check(await second.isDisabled("[aria-label^='joint 1 plus']"), "motions by hand are disabled during a pause");
  await second.click("#resume");
  const front = [0, -1.57, 0, 1.57, 1.57, -1.57];
  await sees(second, "the second page resumes the run: the arm reaches its front pose", "s.arms[0].joints.slice(1).every((q, i) => Math.abs(q - a[i]) < 3e-3)", front);
  await second.click("#terminate");
  await second.click("#sure-yes");
  await sees(second, "the second page ends the run as done", "s.control === 'ended' && s.outcome.good");
  await second.click("#quit");
  await page.close();
  await second.close();
  run.records("joint 1 by +5.0 deg", "joint 1 by -1.0 deg", "along the tool's z by -10.0 mm", "motor 5 by +2.0 rad", "jaws to 88.0 mm");
  run.records("operator: parameter grip_n to 44", "parameter grip_n: from 40 to 44 N, by the operator");
  run.records("zero the force sensor", "go to start", "go to front", "operator: pause", "operator: resume", "operator: terminate");
  await run.ends(0, /DONE\s+the arms were moved by hand/);
}

async function remote() {
  console.log("# access from another machine, with a token");
  const run = new Run("scenarios/acquire.toml", "--wait", "--listen", "0.0.0.0:0");
  const page = await open(run);
  check((await run.url()).includes("#token="), "the address has a token");
  check(!page.url().includes("token"), `the address bar does not keep the token (${page.url()})`);
  await page.reload();
  await page.waitForFunction(() => window.page?.snapshot);
  await page.waitForFunction(() => !document.getElementById("start").disabled);
  check(true, "a reloaded page keeps its token and the command");
  check(await page.evaluate(() => document.cookie === ""), "the token is no cookie");
  const stranger = await browser.newPage();
  await stranger.goto(new URL(await run.url()).origin);
  await stranger.getByText("open the address that the program printed").waitFor();
  check(!await stranger.evaluate(() => window.page.snapshot), "a page without the token sees nothing of the run");
  await stranger.close();
  const styled = await page.evaluate(() => getComputedStyle(document.querySelector("main")).display);
  check(styled === "grid", `the page has its style (${styled})`);
  await page.click("#start");
  await sees(page, "the page starts the run", "s.control !== 'waiting' && s.time > 1");
  await sees(page, "the page gets camera pictures", "s.cameras[0].frame > 0");
  await page.waitForFunction(() => !document.querySelector("#cameras canvas").classList.contains("dark"));
  check(true, "the page shows camera pictures");
  const without = await page.request.get(new URL("/camera/0", await run.url()).href);
  check(without.status() === 403, `a request without the token is refused (${without.status()})`);
  await sees(page, "the run ends as done", "s.control === 'ended' && s.outcome.good");
  await page.click("#quit");
  await page.close();
  await run.ends(0, /DONE/);
}

async function unsynchronised() {
  console.log("# an arm that is not synchronised");
  const run = new Run("scenarios/idle.toml", "--speed", "15", "--set", "effector.postument.start_synchronised=false", "--record", `${pictures}/unsynchronised.mcap`);
  const page = await open(run);
  await sees(page, "the arm is not synchronised", "s.services.manual && !s.arms[0].synchronised");
  await page.click("#synchronise");
  await sees(page, "the button synchronises the arm", "s.arms[0].synchronised");
  // Ctrl-C ends the run like the button.
  run.process.kill("SIGINT");
  await page.close();
  run.records("arm 0: synchronise");
  await run.ends(0, /DONE\s+the arms were moved by hand/);
}

async function question() {
  console.log("# a question: a misread sticker makes the cube impossible");
  const run = new Run("tests/page/question.toml", "--speed", "5");
  const page = await open(run);
  await page.waitForSelector("#question[open]", { timeout: 240000 });
  check(true, "the controller asks a question");
  await picture(page, run, "question");
  const { subject } = (await snapshot(page)).question;
  const counts = (letters) => Object.fromEntries([..."URFDLB"].map((l) => [l, [...letters].filter((x) => x === l).length]));
  const [many, few] = [10, 8].map((n) => Object.entries(counts(subject.read)).find(([, count]) => count === n)?.[0]);
  const wrong = subject.doubtful.filter((i) => subject.read[i] === many);
  check(wrong.length === 1, `one doubtful sticker has a colour that was read ten times (${wrong} of ${subject.doubtful})`);
  check(await page.isDisabled("#question-send"), "ten stickers of a colour cannot be sent");
  // On a busy machine they arrive after the question.
  await page.waitForSelector("#question-pictures canvas", { timeout: 30000 }).catch(() => {});
  const faces = await page.locator("#question-pictures canvas").count();
  check(faces > 0, `the question shows the last pictures of the faces (${faces})`);
  const proposed = await page.textContent("#question-propose").catch(() => "");
  const facelet = `${"URFDLB"[Math.floor(wrong[0] / 9)]}${(wrong[0] % 9) + 1}`;
  check(proposed.startsWith(`Paint ${facelet} `), `the counts of the colours propose the sticker (${proposed})`);
  const heard = await page.evaluate(() => {
    const { link } = window.page;
    const said = [];
    link.command = (name) => said.push(name);
    document.querySelector("#question .emergency").click();
    delete link.command;
    return said;
  });
  check(heard.length === 1 && heard[0] === "emergency_stop", `the question's dialog has an emergency stop (${heard})`);
  await page.keyboard.press("Escape");
  await page.keyboard.press("Escape");
  await page.waitForSelector("#question[open]");
  check(true, "Escape does not close the dialog");
  await page.click("#question-propose");
  check(await page.isEnabled("#question-send"), "the proposal makes nine of each colour");
  check(await page.isHidden("#question-proposal"), "an accepted proposal is gone");
  check(await page.evaluate(() => document.activeElement.id) === "question-send", "the focus goes to the button that sends");
  await page.evaluate(() => document.querySelector("#question-net [tabindex='0'].tile").focus());
  await page.keyboard.press("wrgyob"["URFDLB".indexOf(many)]);
  check(await page.isDisabled("#question-send"), "the keyboard undoes it");
  // The keyboard alone is enough: the doubtful sticker has the focus.
  await page.keyboard.press("wrgyob"["URFDLB".indexOf(few)]);
  check(await page.isEnabled("#question-send"), "nine of each colour can be sent");
  await page.click("#question-send");
  await sees(page, "the answer is accepted", "!s.question");
  await sees(page, "the net shows the answer", `s.net.decided && s.net.facelets.every(Boolean)`);
  const right = [...subject.read];
  right[wrong[0]] = few;
  await sees(page, "the mission ends as solved", "s.control === 'ended' && s.outcome.good");
  check(await page.locator("#net figure.solved").count() === 1, "the net \"now\" is solved");
  await picture(page, run, "solved");
  await page.click("#quit");
  await page.close();
  run.records(`operator: the stickers are ${right.join("")}`, "the operator has given the colours");
  await run.ends(0, /SOLVED/);
}

/** Returns the value below which this share of the sorted `values` lies. */
const share = (values, part) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(values.length * part))];

/** Measures the page: prints lines of a Markdown table. Runs only by name: ONLY=figures. */
async function figures() {
  const row = (what, value) => console.log(`| ${what} | ${value} |`);
  console.log("| figure of the page | value |\n|---|---|");
  const run = new Run("scenarios/idle.toml", "--speed", "1", "--record", `${pictures}/idle.mcap`);
  const page = await open(run);
  await sees(page, "ready", "s.services.manual && s.time > 1");
  const [noticed, took] = [[], []];
  for (let i = 0; i < 20; i++) {
    run.process.kill("SIGSTOP");
    noticed.push(await until(page, () => document.body.classList.contains("stale")));
    run.process.kill("SIGCONT");
    await page.waitForFunction(() => !document.body.classList.contains("stale"));
    await pause(300);
  }
  row("from a frozen program to the notice, greatest of 20", `${Math.max(...noticed)} ms`);
  const press = async (id) => {
    const ms = await page.evaluate((button) => new Promise((done) => {
      const { commands } = window.page;
      const look = () => (commands.took?.name === button ? done(commands.took.ms) : setTimeout(look, 5));
      const start = () => {
        // At a high load data may come late, and the button is off until they come.
        if (document.getElementById(button).disabled) return setTimeout(start, 20);
        commands.took = null;
        document.getElementById(button).click();
        look();
      };
      start();
    }), id);
    await page.waitForFunction((other) => !document.getElementById(other).disabled, id === "pause" ? "resume" : "pause");
    return ms;
  };
  const presses = async () => {
    took.length = 0;
    for (let i = 0; i < 50; i++) took.push(await press("pause"), await press("resume"));
    return `${share(took, 0.5)} ms, ${share(took, 0.99)} ms`;
  };
  row("from a press to its confirmation, median and 99th percentile of 100", await presses());
  const busy = cpus().map(() => spawn("sh", ["-c", "while :; do :; done"], { stdio: "ignore" }));
  for (const it of busy) alive.add(it);
  row("the same with all cores busy", await presses());
  for (const it of busy) it.kill("SIGKILL");
  await page.evaluate(() => window.page.commands.give("emergency_stop"));
  await page.waitForFunction(() => window.page.commands.took?.name === "emergency_stop");
  row("emergency stop, one press", `${await page.evaluate(() => window.page.commands.took.ms)} ms`);
  await page.close();
  run.process.kill("SIGKILL");

  const mission = new Run("scenarios/solve.toml", "--speed", "4");
  const seen = await open(mission);
  const session = await seen.context().newCDPSession(seen);
  let bytes = 0;
  await session.send("Network.enable");
  session.on("Network.webSocketFrameReceived", ({ response }) => { bytes += response.payloadData.length; });
  await session.send("Performance.enable");
  const worked = async () => (await session.send("Performance.getMetrics")).metrics.find(({ name }) => name === "TaskDuration").value;
  await sees(seen, "a turn", "s.step > 2");
  await seen.reload();
  await seen.waitForFunction(() => window.page?.snapshot);
  await pause(3000);
  bytes = 0;
  const before = await worked();
  await pause(10000);
  row("socket of a page at 20 snapshots/s", `${(bytes / 10240).toFixed(0)} kB/s`);
  row("main thread of a page in a run, drawn in software", `${((await worked() - before) * 10).toFixed(0)} % of a core`);
  row("3-D view, drawn in software", `${(await seen.evaluate(() => window.page.scene.rate())).toFixed(0)} frames/s`);
  const sizes = async () => seen.evaluate(() => {
    const { scene } = window.page;
    const cube = scene.now.cube.world_from_cube;
    return scene.views(cube).map(({ eye, target, part }) => {
      const high = part[3] * scene.canvas.clientHeight;
      const angle = part[2] * scene.canvas.clientWidth / high < 1.2 ? 2 * Math.atan(Math.tan(0.36) * 1.2 * high / (part[2] * scene.canvas.clientWidth)) : 0.72;
      const far = Math.hypot(...eye.map((v, i) => v - cube.translation[i]));
      return Math.round(scene.stage.edge / (2 * far * Math.tan(angle / 2)) * high);
    });
  });
  row("edge of the cube in the cell's view and in its close-up, 1280 x 800", `${(await sizes()).join(" px, ")} px`);
  await seen.click("[data-view=hands]");
  await pause(1500);
  row("edge of the cube in the view of the hands", `${(await sizes())[0]} px`);
  await seen.close();
  mission.process.kill("SIGKILL");

  const recording = `${pictures}/figures.mcap`;
  await command(binary, ["run", "scenarios/solve.toml", "--ui", "none", "--record", recording]);
  const since = Date.now();
  await command(binary, ["report", recording, "-o", `${recording}.html`]);
  row("report of a mission", `${((Date.now() - since) / 1000).toFixed(1)} s, ${(statSync(`${recording}.html`).size / 1e6).toFixed(1)} MB of ${(statSync(recording).size / 1e6).toFixed(0)} MB of recording`);
  for (const file of [recording, `${recording}.html`, run.states, mission.states, ...run.recordings()]) rmSync(file, { recursive: true, force: true });
  const files = readdirSync("src/web/assets");
  const text = files.map((file) => readFileSync(`src/web/assets/${file}`, "utf8"));
  const own = text.filter((_, i) => files[i].endsWith(".js")).map((all) => all.split("\n").length);
  row("own JavaScript; all files of the page", `${own.reduce((a, b) => a + b)} lines; ${(text.reduce((sum, all) => sum + all.length, 0) / 1024).toFixed(0)} kB`);
}

const parts = { mission, handOver, fault, frozen, replayed, after, byHand, remote, unsynchronised, question, figures };
const begun = Date.now();
for (const [name, part] of Object.entries(parts)) {
  if (process.env.ONLY ? !process.env.ONLY.split(",").includes(name) : name === "figures") continue;
  const since = Date.now();
  try {
    await part();
  } catch (error) {
    check(false, `${name}: ${error.message.split("\n")[0]}`);
    alive.forEach((it) => it.kill("SIGKILL"));
    for (const context of browser.contexts()) await context.close();
  }
  console.log(`# ${name}: ${((Date.now() - since) / 1000).toFixed(0)} s`);
}
await browser.close();
console.log(`${failures ? `${failures} failed` : "all well"}, ${((Date.now() - begun) / 1000).toFixed(0)} s; pictures in ${pictures}`);
process.exit(failures ? 1 : 0);
