// Calls the person: the state of the run in the title and the icon of the tab, and a sound while the
// robot waits for an answer.

/** Time between two sounds while a question is open (ms). */
const AGAIN = 15000;
/** Colours of the icon's dot by the class of the badge. */
const DOTS = { good: "#1f9a50", warn: "#e08a00", bad: "#d5232f", main: "#1c6fe0" };

let shown = "";
let called = 0;
let sound = null;

/** Returns the icon with a dot of this colour. */
function icon(colour) {
  const tiles = ["#f4f4f0", "#c8202c", "#1f8a46", "#f2c318"].map((fill, i) => `<rect x="${3 + 13 * (i % 2)}" y="${3 + 13 * (i >> 1)}" width="12" height="12" rx="2" fill="${fill}"/>`);
  const dot = colour ? `<circle cx="23" cy="23" r="8.5" fill="${colour}" stroke="white" stroke-width="2"/>` : "";
  return `data:image/svg+xml,${encodeURIComponent(`<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="31" height="31" rx="5" fill="#16191d"/>${tiles.join("")}${dot}</svg>`)}`;
}

/** Plays a short sound of two tones. A browser allows it once the person has touched the page. */
function play() {
  sound ??= new AudioContext();
  if (sound.state !== "running") return;
  [[660, 0], [880, 0.18]].forEach(([pitch, at]) => {
    const [tone, gain] = [sound.createOscillator(), sound.createGain()];
    tone.frequency.value = pitch;
    gain.gain.value = 0.12;
    tone.connect(gain).connect(sound.destination);
    tone.start(sound.currentTime + at);
    tone.stop(sound.currentTime + at + 0.15);
  });
}

/** Shows state and name of the run in the tab; calls while the robot `asks` this page. */
export function attend(state, kind, name, asks) {
  const title = `${asks ? "Question" : state} – ${name || "rubik-robot"}`;
  const key = `${title} ${kind} ${asks}`;
  if (key !== shown) {
    shown = key;
    document.title = title;
    document.querySelector("link[rel=icon]").href = icon(asks ? DOTS.warn : DOTS[kind]);
  }
  if (!asks) called = 0;
  else if (performance.now() - called > AGAIN || !called) {
    called = performance.now();
    play();
  }
}
addEventListener("pointerdown", () => { sound ??= new AudioContext(); sound.resume(); }, { once: true });
