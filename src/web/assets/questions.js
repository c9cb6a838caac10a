// Questions of the controller: a choice, or the colours of stickers that it doubts.

import { COLOUR_NAMES } from "./scene.js";
import { NetEditor, nameOf } from "./net.js";
import { $, el, picturesOfFaces } from "./panels.js";

/** The open question as { number }, or null. */
let open = null;
/** Pictures that the dialog shows. */
let shown = null;

/** Returns the buttons that answer a choice. */
function choices(options, answer) {
  return options.map((option, k) => el("button", { textContent: option, className: k ? "" : "main", onclick: () => answer({ answer: "choice", option: k }) }));
}

/** Shows the last pictures of the faces with their camera and the time of the run. */
function showFaces() {
  if (shown === picturesOfFaces()) return;
  shown = picturesOfFaces();
  $("question-pictures").replaceChildren(...shown.map(({ camera, time: at, canvas }) => {
    const words = `${camera.replaceAll("_", " ")}, at ${at.toFixed(0)} s`;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Face of the cube, ${words}`);
    return el("figure", {}, canvas, el("figcaption", { textContent: words }));
  }));
  $("question-pictures").hidden = !shown.length;
}

/** Shows what the counts of the colours suggest, with a button that paints it. */
function propose(editor, found) {
  const place = $("question-proposal");
  place.hidden = !found;
  if (!found) return;
  const { colour, facelets } = found;
  const names = facelets.map(nameOf).join(", ");
  const words = `Only ${COLOUR_NAMES[colour]} is missing, and ${names} ${facelets.length === 1 ? "is" : "are"} open. `;
  const paint = el("button", { id: "question-propose", type: "button", textContent: `Paint ${names} ${COLOUR_NAMES[colour]}` });
  paint.onclick = () => {
    for (const i of facelets) editor.paint(i, colour);
    // The button is gone now.
    $("question-send").focus();
  };
  place.replaceChildren(words, paint);
}

/** Shows the net to correct, and returns the buttons that answer. */
function stickers({ read, doubtful }, answer) {
  const ok = el("button", { id: "question-send", textContent: "Send these colours", className: "main" });
  const editor = new NetEditor($("question-net"), read, doubtful, (right, found, own) => {
    ok.disabled = !right;
    propose(own, found);
  });
  ok.onclick = () => answer({ answer: "stickers", stickers: editor.stickers() });
  return [el("button", { id: "question-decline", textContent: "I do not know", onclick: () => answer({ answer: "declined" }) }), ok];
}

/**
 * Shows the open question in a modal dialog, or closes the dialog. `time` is that of the run (s);
 * `commands` says whether this page may answer; `send` sends the answer.
 */
export function showQuestion(question, time, commands, send) {
  const box = $("question");
  if (!question) {
    if (open) box.close();
    open = null;
    return;
  }
  const { subject } = question;
  const painted = subject?.subject === "stickers";
  if (open?.number !== question.number) {
    [open, shown] = [{ number: question.number }, null];
    $("question-text").textContent = question.text;
    $("question-net").replaceChildren();
    $("question-pictures").hidden = $("question-proposal").hidden = true;
    const answer = (value) => send({ command: "answer", question: question.number, answer: value });
    const buttons = painted ? stickers(subject, answer) : choices(subject.options, answer);
    // The dialog covers the page's button to take over, so it has its own.
    const take = el("button", { id: "question-take", textContent: "Take over", className: "main", hidden: true, onclick: () => send({ seat: "take" }) });
    $("question-buttons").replaceChildren(take, ...buttons);
    box.classList.remove("watching");
    if (!box.open) box.showModal();
    ($("question-net").querySelector("[tabindex='0'].tile") ?? buttons[0])?.focus();
  }
  // A page that lags gets the last pictures after the question.
  if (painted) showFaces();
  // The browser closes a dialog at the second Escape, although the page prevents it.
  if (!box.open) box.showModal();
  const left = Math.max(0, question.until - time);
  const who = commands ? "" : " Another page commands; only that page can answer.";
  const how = painted ? " Choose a colour, then its stickers; or use the arrow keys and W R G Y O B. The faces: U up, R right, F front, D down, L left, B back." : "";
  $("question-note").textContent = `${left.toFixed(0)} s left; ${question.otherwise}.${how}${who}`;
  if (box.classList.contains("watching") === commands) {
    box.classList.toggle("watching", !commands);
    $("question-take").hidden = commands;
    for (const button of $("question-buttons").querySelectorAll(":scope > :not(#question-take)")) button.hidden = !commands;
  }
}
$("question").addEventListener("cancel", (event) => event.preventDefault());
