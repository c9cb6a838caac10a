// Panel of the parameters that the operator may change while a run goes on: for each a slider, a
// number, the present value, and a button that orders the scenario's value again.

import { $, el } from "./panels.js";

/** Returns a value as a short text, without trailing zeros. */
const short = (value) => String(Number(value.toPrecision(4)));

/** Time for which a slider shows the value that a key has given it (ms). */
const KEYED = 1000;

/** The panel, with a row for each parameter. */
export class Parameters {
  constructor(send) {
    this.send = send;
    this.rows = [];
  }

  /** Makes the rows for the parameters of a new run. */
  set(stage) {
    this.rows = (stage.parameters ?? []).map((it, index) => this.row(it, index));
    $("parameters-body").replaceChildren(...this.rows.map((row) => row.element));
  }

  /** Makes the row of one parameter. */
  row(it, index) {
    const fixed = it.least >= it.most;
    const step = (it.most - it.least) / 100;
    const name = el("span", { textContent: it.parameter, title: `${it.meaning} It changes by at most ${short(it.rate)} ${it.unit} in a second.` });
    const order = (value) => this.send({ command: "parameter", parameter: it.parameter, value });
    // The mark of the slider is the scenario's value.
    const marks = el("datalist", { id: `usual-${index}` }, el("option", { value: String(it.usual) }));
    const slider = el("input", { type: "range", min: String(it.least), max: String(it.most), step: "any", ariaLabel: `${it.parameter}, slider` });
    slider.setAttribute("list", marks.id);
    const number = el("input", { type: "number", min: String(it.least), max: String(it.most), step: "any", ariaLabel: it.parameter });
    // A slider that is dragged shows its value and orders it once, when it is released.
    slider.oninput = () => { number.value = short(Number(slider.value)); };
    slider.onchange = () => order(Number(slider.value));
    slider.onkeydown = (event) => {
      const sign = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
      if (!sign || slider.disabled) return;
      event.preventDefault();
      // The next key may come before the order is obeyed, and counts from this value.
      slider.value = String(Math.min(it.most, Math.max(it.least, Number(slider.value) + sign * step)));
      slider.oninput();
      row.keyed = performance.now();
      order(Number(slider.value));
    };
    // The program checks the bounds: the page shows its reason.
    number.onchange = () => {
      if (number.value !== "") order(Number(number.value));
      // Without the focus the number shows the value in force, also after a refusal.
      number.blur();
    };
    const value = el("output");
    const usual = el("button", { textContent: `default ${short(it.usual)}`, onclick: () => order(it.usual) });
    const unit = el("span", { className: "quiet", textContent: it.unit });
    const element = el("div", { className: "row" }, name, slider, marks, number, unit, value, usual);
    const row = { it, fixed, element, slider, number, value, usual, keyed: -Infinity };
    return row;
  }

  /** Shows the present values. `may` says whether this page may order values now. */
  show(snapshot, may) {
    const shown = snapshot.services.parameters && this.rows.length > 0;
    $("parameters").hidden = !shown;
    if (!shown) return;
    this.rows.forEach(({ it, fixed, slider, number, value, usual, keyed }, index) => {
      const now = snapshot.parameters[index];
      if (!now) return;
      for (const input of [slider, number]) input.disabled = fixed || !may;
      usual.disabled = fixed || !may || now.ordered === it.usual;
      // A control that the operator uses keeps what it shows.
      const used = document.activeElement === slider && (slider.matches(":active") || performance.now() - keyed < KEYED);
      if (!used) slider.value = String(now.ordered);
      if (document.activeElement !== number) number.value = short(now.ordered);
      const text = now.value === now.ordered ? "" : `now ${short(now.value)}`;
      if (value.textContent !== text) value.textContent = text;
    });
  }
}
