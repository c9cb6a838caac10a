// See run.sh. What a button does is looked for in the run's record (the tape's messages on stderr, the summary), not
// only in the page.

import { spawn } from "node:child_process";
import { once } from "node:events";
import { pathToFileURL } from "node:url";

const [, , library, executablePath, binary, pictures] = process.argv;
const { chromium } = await import(pathToFileURL(library));
const LEAST_RATE = Number(process.env.LEAST_RATE ?? 10);
const SIZES = { desktop: { width: 1280, height: 800 }, phone: { width: 390, height: 844 } };

let failures = 0;
function check(right, what) {
  if (!right) failures += 1;
  console.log(`${right ? "ok    " : "FAILED"} ${what}`);
}

class Run {
  constructor(...args) {
    const env = { ...process.env, RUST_LOG: "warn,rubik_robot::tape=trace" };
    this.process = spawn(binary, ["run", ...args, "--ui", "web", "--listen", "127.0.0.1:0"], { env, stdio: ["ignore", "pipe", "pipe"] });
    this.record = "";
    this.rest = "";
    this.summary = "";
    this.process.stdout.on("data", (data) => { this.summary += data; });
    this.process.stderr.on("data", (data) => {
      // Of the tape only what the operator did and what MP asked of its ECPs is kept.
      const lines = (this.rest + data).split("\n");
      this.rest = lines.pop();
      this.record += lines.filter((l) => !l.includes("rubik_robot::tape") || /operator>ui|mp>ecp|kernel>mp/.test(l)).join("\n") + "\n";
    });
  }

  async url() {
    for (let i = 0; i < 600; i++) {
      const found = this.record.match(/page: (http:\S+)/);
      if (found) return found[1];
      await pause(100);
    }
    throw new Error(`no page: ${this.record}`);
  }

  recorded(words) {
    return this.record.includes(words);
  }

  async end() {
    if (this.process.exitCode === null) {
      this.process.kill("SIGINT");
      const late = setTimeout(() => this.process.kill("SIGKILL"), 8000);
      await once(this.process, "exit");
      clearTimeout(late);
    }
  }
}

const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const browser = await chromium.launch({
  executablePath,
  args: ["--no-sandbox", "--enable-unsafe-swiftshader", "--disable-background-networking", "--disable-component-update", "--disable-sync"],
});

async function open(run, size = "desktop", colorScheme = "light") {
  const page = await browser.newPage({ viewport: SIZES[size], colorScheme, isMobile: size === "phone", hasTouch: size === "phone" });
  const url = await run.url();
  page.on("pageerror", (error) => check(false, `the page's own error: ${error.message}`));
  page.on("request", (request) => {
    if (new URL(request.url()).host !== new URL(url).host && !request.url().startsWith("blob:")) check(false, `a third party is contacted: ${request.url()}`);
  });
  page.setDefaultTimeout(60000);
  await page.goto(url);
  return page;
}

/** Waits until the page's snapshot `s` is so; `a` is what it is held against. */
async function sees(page, what, test, argument, timeout = 120000) {
  const holds = new Function("s", "a", `return ${test}`);
  const begun = Date.now();
  for (;;) {
    const s = await snapshot(page);
    if (s && holds(s, argument)) return check(true, what);
    if (Date.now() - begun > timeout) return check(false, `${what}: not in ${timeout / 1000} s`);
    await pause(60);
  }
}

const snapshot = (page) => page.evaluate(() => window.page.snapshot);

async function picture(page, run, name) {
  await pause(900);
  await page.screenshot({ path: `${pictures}/${name}-desktop.png` });
  await page.screenshot({ path: `${pictures}/${name}-desktop-whole.png`, fullPage: true });
  const phone = await open(run, "phone", "dark");
  await phone.waitForFunction(() => window.page.snapshot);
  await pause(1500);
  const wide = await phone.evaluate(() => document.documentElement.scrollWidth);
  check(wide <= SIZES.phone.width, `${name}: no sideways scrolling on a phone (${wide} px)`);
  await phone.screenshot({ path: `${pictures}/${name}-phone.png` });
  await phone.screenshot({ path: `${pictures}/${name}-phone-whole.png`, fullPage: true });
  await phone.close();
}

async function mission() {
  console.log("# a mission: start, pause, resume, views, terminate");
  const run = new Run("scenarios/solve.toml", "--wait", "--speed", "4");
  const page = await open(run);
  await sees(page, "it waits for its start", "s.control === 'waiting'");
  await picture(page, run, "idle");
  await page.click("#start");
  await sees(page, "it runs", "s.control === 'running' && s.time > 5");
  check(run.recorded("operator>ui:Start"), "the start is in the record");
  for (const view of ["hands", "top", "cell"]) await page.click(`[data-view=${view}]`);
  await page.focus("#scene");
  for (const key of ["ArrowLeft", "ArrowUp", "+", "-", "Home"]) await page.keyboard.press(key);
  for (const seconds of ["20", "600", "60"]) await page.click(`[data-window="${seconds}"]`);
  await page.selectOption("#class", "fatal");
  check(await page.locator("#messages p").count() === 0, "the console's filter hides what is not fatal");
  await page.selectOption("#class", "info");
  await page.fill("#search", "acquire");
  check(await page.locator("#messages p").count() >= 1, "and its search finds a phase");
  await page.fill("#search", "");
  await sees(page, "the stand-alone camera shows the cube", "s.cameras[0].frame > 0 && s.cameras[0].outlines.length > 0");
  await sees(page, "the cube is held by the track", "s.cube.held_by.includes(0)");
  await page.selectOption("#speed", "10");
  await sees(page, "faces are read into the net", "s.net.facelets.filter(Boolean).length >= 9");
  check(run.recorded("Speed { factor: 10.0 }"), "the change of speed is in the record");
  await page.selectOption("#speed", "2");
  await pause(3500);
  const rate = await page.evaluate(() => window.page.scene.rate());
  check(rate >= LEAST_RATE, `the 3-D view has ${rate.toFixed(1)} pictures a second (at least ${LEAST_RATE})`);
  await picture(page, run, "running");
  await page.click("#pause");
  await sees(page, "it pauses", "s.control === 'paused'");
  check(run.recorded("operator>ui:Pause"), "the pause is in the record");
  await pause(1500);
  const [a, b] = [await snapshot(page), (await pause(1500), await snapshot(page))];
  const moved = Math.max(...a.arms.flatMap((arm, i) => arm.joints.map((q, k) => Math.abs(q - b.arms[i].joints[k]))));
  check(moved < 2e-4 && b.time > a.time, `nothing moves meanwhile (${moved.toExponential(1)} rad in ${(b.time - a.time).toFixed(1)} s)`);
  await picture(page, run, "paused");
  await page.click("#resume");
  await sees(page, "it resumes", "s.control === 'running'");
  check(run.recorded("operator>ui:Resume"), "the resume is in the record");
  await page.selectOption("#speed", "0");
  await sees(page, "there is a plan, and its steps are carried out", "s.step > 2");
  check(await page.locator("#plan li.now").count() === 1, "the plan's present step is marked");
  await sees(page, "a layer is seen turned", "s.cube.turned && Math.abs(s.cube.turned.angle) > 0.1");
  await page.selectOption("#speed", "1");
  await page.click("#terminate");
  await page.click("#sure button[value=no]");
  check((await snapshot(page)).control === "running", "a terminate that is not confirmed is none");
  await page.click("#terminate");
  await page.click("#sure-yes");
  await sees(page, "it ends", "s.control === 'ended'");
  check(run.recorded("operator>ui:Terminate"), "the terminate is in the record");
  check((await snapshot(page)).arms.every((arm) => !arm.fault), "both arms hold without a fault");
  check(/terminated by the operator; .* hold/.test((await snapshot(page)).outcome.reason), "the end says where the cube is");
  await picture(page, run, "terminated");
  await page.click("#quit");
  await Promise.race([once(run.process, "exit"), pause(8000)]);
  check(run.process.exitCode === 1, `the program ends when the page closes it (exit code ${run.process.exitCode})`);
  check(/ABORTED\s+terminated by the operator/.test(run.summary), "the summary says so");
  await page.close();
  await run.end();
}

async function done() {
  console.log("# a mission to its end");
  const run = new Run("scenarios/acquire.toml", "--speed", "0");
  const page = await open(run);
  await sees(page, "the mission ends well", "s.control === 'ended' && s.outcome.good", null, 240000);
  await picture(page, run, "done");
  await page.close();
  await run.end();
}

async function fault() {
  console.log("# the emergency stop");
  const run = new Run("scenarios/solve.toml", "--speed", "4");
  const page = await open(run);
  await sees(page, "it runs", "s.time > 12");
  await page.click("#emergency");
  await sees(page, "both arms stop with a fault", "s.arms.every((arm) => arm.fault)");
  await sees(page, "and the run is over", "s.control === 'ended' && !s.outcome.good");
  check(run.recorded("operator>ui:EmergencyStop"), "the stop is in the record");
  await page.selectOption("#class", "fatal");
  check(await page.locator("#messages p.fatal").count() >= 1, "the console has the fatal error");
  await page.selectOption("#class", "info");
  await picture(page, run, "fault");
  await page.close();
  await run.end();
}

async function byHand() {
  console.log("# by hand, and two pages");
  const run = new Run("scenarios/idle.toml");
  const page = await open(run);
  await sees(page, "the arms can be moved by hand", "s.services.manual");
  const before = await snapshot(page);
  await page.click("[aria-label^='joint 1 plus']");
  await sees(page, "joint 1 goes by 5 deg", "Math.abs(s.arms[0].joints[1] - a - Math.PI / 36) < 2e-3", before.arms[0].joints[1]);
  await page.click("[data-pick='step 0']");
  await page.click("[aria-label^='joint 1 minus']");
  await sees(page, "and back by 1 deg", "Math.abs(s.arms[0].joints[1] - a - Math.PI / 45) < 2e-3", before.arms[0].joints[1]);
  await page.click("[data-pick='move by tool']");
  await page.click("[data-pick='step 2']");
  const tool = (await snapshot(page)).arms[0].frames[6].translation;
  await page.click("[aria-label^='z minus']");
  await sees(page, "the tool goes back along its z by 10 mm", "Math.abs(Math.hypot(...s.arms[0].frames[6].translation.map((v, i) => v - a[i])) - 0.01) < 1e-3", tool);
  await page.click("[data-pick='move by motor']");
  await page.click("[data-pick='step 1']");
  const motor = (await snapshot(page)).arms[0].motors[5];
  await page.click("[aria-label^='motor 5 plus']");
  await sees(page, "motor 5 turns by 2 rad", "Math.abs(s.arms[0].motors[5] - a - 2) < 0.05", motor);
  check(run.recorded("mp>ecp postument:MoveCommand"), "the motor's motion is in the record");
  await page.getByRole("button", { name: "Open", exact: true }).click();
  await sees(page, "the jaws open", "s.arms[0].opening > 0.084");
  await page.getByRole("button", { name: "Close", exact: true }).click();
  await sees(page, "the jaws close", "s.arms[0].opening < 0.06");
  await page.getByRole("button", { name: "Zero force sensor" }).click();
  for (const pose of ["front", "synchronisation", "start"]) {
    await page.getByRole("button", { name: pose, exact: true }).click();
    await sees(page, `the arm begins to go to ${pose}`, "s.actors.some((x) => x.name === 'ecp postument' && x.state === 'running')");
    await sees(page, `and comes to rest`, "s.actors.every((x) => x.name !== 'ecp postument' || x.state === 'idle')");
  }
  await sees(page, "the arm is back at its start", "s.arms[0].joints.slice(1).every((q, i) => Math.abs(q - a[i + 1]) < 3e-3)", before.arms[0].joints);
  await picture(page, run, "by-hand");

  const second = await open(run);
  await second.waitForSelector("#take", { state: "visible" });
  check(await second.isDisabled("#pause"), "a second page only watches");
  await second.click("#take");
  await second.waitForFunction(() => !document.getElementById("pause").disabled);
  check(true, "and may take over");
  await page.waitForSelector("#watching", { state: "visible" });
  check(await page.isDisabled("#pause"), "the first page then watches");
  await second.click("#pause");
  await sees(second, "the second page pauses", "s.control === 'paused'");
  await second.click("#resume");
  await second.click("#terminate");
  await second.click("#sure-yes");
  await sees(second, "and ends the run", "s.control === 'ended'");
  await run.end();
  await page.close();
  await second.close();
}

async function blind() {
  console.log("# an arm that is not synchronised");
  const run = new Run("scenarios/idle.toml", "--set", "effector.postument.start_synchronised=false");
  const page = await open(run);
  await sees(page, "the EDP is not synchronised", "s.services.manual && !s.arms[0].synchronised", null, 20000);
  await page.click("#synchronise");
  await sees(page, "it synchronises when told", "s.arms[0].synchronised", null, 240000);
  check(run.recorded('mp>ecp postument:"synchronise"'), "the order is in the record");
  await run.end();
  await page.close();
}

async function question() {
  console.log("# a question: the cameras are too noisy for a face");
  const cube = "DRLUUBFBRBLURRLRUBLRDDFDLFUFUFFDBRDUBRUFLLFDDBFLUBLRBD";
  const run = new Run("scenarios/solve.toml", "--set", "plant.noise.image=60", "--cube", cube);
  const page = await open(run);
  await page.waitForSelector("#question[open]", { timeout: 240000 });
  check(true, "the controller asks");
  await picture(page, run, "question");
  const { subject } = (await snapshot(page)).question;
  check(subject.doubtful.length > 0 && subject.read.length === 54, `${subject.doubtful.length} stickers are in doubt`);
  // Any cube that can exist shows that a correction arrives; the solved one is quickly entered.
  const LETTERS = "URFDLB";
  for (let i = 0; i < 54; i++) {
    const wanted = Math.floor(i / 9);
    if (subject.read[i] === LETTERS[wanted]) continue;
    await page.evaluate(([i, c]) => {
      document.querySelectorAll("#question .palette button")[c].click();
      document.querySelectorAll("#question .net .tile")[i].click();
    }, [i, wanted]);
  }
  await page.focus("#question .tile[tabindex='0']");
  await page.keyboard.press("ArrowRight");
  check(await page.isEnabled("#question-send"), "nine of each colour can be sent");
  await page.click("#question-send");
  await sees(page, "the answer is taken", "!s.question");
  check(run.recorded("operator>ui:Answer"), "the answer is in the record");
  await sees(page, "and the net shows it", "s.net.decided && s.net.facelets.every(Boolean)");
  await page.close();
  await run.end();
}

const parts = { mission, done, fault, byHand, blind, question };
for (const [name, part] of Object.entries(parts)) {
  if (process.env.ONLY && !process.env.ONLY.split(",").includes(name)) continue;
  try {
    await part();
  } catch (error) {
    check(false, `${name}: ${error.message.split("\n")[0]}`);
  }
}
await browser.close();
console.log(failures ? `${failures} failed` : `all well; pictures in ${pictures}`);
process.exit(failures ? 1 : 0);
