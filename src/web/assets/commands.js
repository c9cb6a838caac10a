// Commands of this page until the robot is seen to obey them: sent, then confirmed by a snapshot, or
// told as not confirmed.

/** Time after which a command without an effect counts as not confirmed (ms). */
const PATIENCE = 1000;
/** Time for which a confirmation is shown (ms). */
const SHOWN = 2500;

const over = (s) => s.control === "ended";
const stopped = (s) => s.arms.length > 0 && s.arms.every((arm) => arm.fault);
/**
 * For each command whose effect a snapshot shows: its name for people, and whether the snapshot `s`
 * shows the effect. Any other command is confirmed once the run has got it.
 */
const EFFECTS = {
  emergency_stop: ["Emergency stop", (s) => stopped(s) || over(s)],
  start: ["Start", (s) => s.control !== "waiting"],
  pause: ["Pause", (s) => s.control !== "running"],
  resume: ["Resume", (s) => s.control !== "paused"],
  terminate: ["Terminate", (s) => s.control === "terminated" || over(s)],
  speed: ["Speed", (s, rest) => s.speed === rest.factor],
};
/** Names for people of the other commands that are watched. */
const NAMES = { manual: "Order to the arm", answer: "Answer", parameter: "Parameter" };

/** Commands that are not confirmed yet, and the place where the page tells their state. */
export class Commands {
  /** `link` sends the commands, `tell` gets the command, its state and a sentence. */
  constructor(link, tell) {
    this.link = link;
    this.tell = tell;
    this.waiting = new Map();
    setInterval(() => this.look(), 100);
  }

  /** Sends a command with its arguments, and watches it until it is confirmed. */
  give(name, rest = {}) {
    const number = this.link.command(name, rest);
    const words = EFFECTS[name]?.[0] ?? NAMES[name];
    if (!words) return;
    // A newer command of the same kind replaces the older one.
    for (const [old, command] of this.waiting) if (command.name === name) this.waiting.delete(old);
    this.waiting.set(number, { name, words, rest, since: performance.now(), late: false });
    this.tell(name, "sent", `${words}: sent`);
  }

  /** Confirms each command whose effect this snapshot shows. */
  show(snapshot) {
    for (const [number, { name, rest }] of this.waiting) {
      if (EFFECTS[name]?.[1](snapshot, rest)) this.end(number, "confirmed");
    }
  }

  /** Confirms a command without a visible effect, once the run has got it. */
  taken(number) {
    if (!EFFECTS[this.waiting.get(number)?.name]) this.end(number, "confirmed");
  }

  /** Forgets a command that was refused; the reason is told elsewhere. */
  refused(number) {
    this.end(number, "refused");
  }

  /** Tells the end of a command. */
  end(number, state) {
    const command = this.waiting.get(number);
    if (!command) return;
    this.waiting.delete(number);
    const took = Math.round(performance.now() - command.since);
    this.took = { name: command.name, ms: took };
    this.tell(command.name, state, `${command.words}: ${state}${state === "confirmed" ? ` after ${took} ms` : ""}`);
    const shown = command.words;
    setTimeout(() => { if (![...this.waiting.values()].some((other) => other.words === shown)) this.tell(command.name, "", ""); }, SHOWN);
  }

  /** Tells the commands that have waited too long. */
  look() {
    for (const command of this.waiting.values()) {
      if (command.late || performance.now() - command.since < PATIENCE) continue;
      command.late = true;
      const rest = command.name === "emergency_stop" ? ": use the hardware stop" : "; the robot may obey later";
      this.tell(command.name, "late", `${command.words} NOT CONFIRMED${rest}`);
    }
  }
}
