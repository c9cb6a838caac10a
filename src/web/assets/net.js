// Net of the cube: shows each facelet with its confidence, or edits the colours for a question.

import { COLOURS, COLOUR_NAMES, LETTERS } from "./scene.js";

// Column and row of the first tile of each face in a grid of 12 x 9.
const PLACES = [[3, 0], [6, 3], [3, 3], [3, 6], [0, 3], [9, 3]];
/** Keys that paint a sticker, one for each colour. */
const KEYS = "wrgyob";
/** Confidence below which a colour is uncertain. */
const UNSURE = 0.5;

/** Returns the name of a facelet: letter of the face, number from 1 in reading order. */
export const nameOf = (index) => `${LETTERS[Math.floor(index / 9)]}${(index % 9) + 1}`;

/**
 * Returns what the counts of `colours` suggest, as { colour, facelets }: one colour alone is
 * missing, and just as many stickers are unknown, or in the set `doubtful` and of a colour that is
 * there too often. Returns null if the counts suggest nothing.
 */
export function proposal(colours, doubtful) {
  const counts = COLOUR_NAMES.map((_, c) => colours.filter((own) => own === c).length);
  const missing = counts.flatMap((count, c) => (count < 9 ? [c] : []));
  if (missing.length !== 1) return null;
  const [colour] = missing;
  const facelets = colours.flatMap((own, i) => (own < 0 || (counts[own] > 9 && doubtful.has(i)) ? [i] : []));
  return facelets.length === 9 - counts[colour] ? { colour, facelets } : null;
}

/** Returns an empty net and its 54 tiles, which are elements of this kind. */
function tiles(kind) {
  const net = Object.assign(document.createElement("div"), { className: "net" });
  const all = [];
  for (let i = 0; i < 54; i++) {
    const tile = Object.assign(document.createElement(kind), { className: "tile" });
    const [column, row] = PLACES[Math.floor(i / 9)];
    tile.style.gridColumn = column + (i % 3) + 1;
    tile.style.gridRow = row + Math.floor((i % 9) / 3) + 1;
    all.push(tile);
    net.append(tile);
  }
  return [net, all];
}

/** Two nets: the cube as it is now by the controller's count of turns, and as it was read. */
export class NetView {
  constructor(place, note) {
    const figure = (words) => {
      const [net, all] = tiles("span");
      net.setAttribute("role", "group");
      for (const tile of all) tile.setAttribute("role", "img");
      const caption = Object.assign(document.createElement("figcaption"), { textContent: words });
      const figure = document.createElement("figure");
      figure.append(caption, net);
      place.append(figure);
      return { figure, net, tiles: all, caption };
    };
    this.now = figure("now");
    this.read = figure("as read");
    this.note = note;
    this.last = this.lastNow = "";
  }

  /** Shows the colour of each facelet now and as it was read, with the confidence of uncertain ones. */
  show(net, facelets) {
    this.showNow(facelets);
    const text = JSON.stringify(net);
    if (text === this.last) return;
    this.last = text;
    let [known, unsure] = [0, 0];
    this.read.tiles.forEach((tile, i) => {
      const read = net.facelets[i];
      tile.style.background = read ? COLOURS[read.colour] : "";
      const dim = read && read.confidence < UNSURE;
      tile.classList.toggle("dim", !!dim);
      tile.title = read ? `${nameOf(i)}: ${COLOUR_NAMES[read.colour]}, confidence ${(read.confidence * 100).toFixed(0)} %` : `${nameOf(i)}: not read`;
      // Touch screens and keyboards show no tooltip, so each tile also has a label, and uncertain
      // tiles can be focused.
      tile.setAttribute("aria-label", tile.title);
      tile.textContent = dim ? (read.confidence * 100).toFixed(0) : i % 9 === 4 ? LETTERS[(i - 4) / 9] : "";
      if (dim) tile.tabIndex = 0;
      else tile.removeAttribute("tabindex");
      known += read ? 1 : 0;
      unsure += dim ? 1 : 0;
    });
    const doubts = unsure ? `, ${unsure} uncertain (confidence in %)` : "";
    this.note.textContent = !known ? "not read yet" : net.decided ? `all 54 decided${doubts}` : `${known} of 54 read${doubts}`;
    this.read.net.setAttribute("aria-label", `The cube as read: ${this.note.textContent}`);
  }

  /** Shows the cube as it is now: `facelets` are 54 letters, other signs where it is unknown. */
  showNow(facelets) {
    if (facelets === this.lastNow) return;
    this.lastNow = facelets;
    const { figure, net, caption } = this.now;
    let known = 0;
    this.now.tiles.forEach((tile, i) => {
      const colour = LETTERS.indexOf(facelets[i] || "-");
      tile.style.background = COLOURS[colour] ?? "";
      tile.textContent = i % 9 === 4 ? LETTERS[(i - 4) / 9] : "";
      tile.title = `${nameOf(i)}: ${COLOUR_NAMES[colour] ?? "unknown"}`;
      tile.setAttribute("aria-label", tile.title);
      known += colour < 0 ? 0 : 1;
    });
    const solved = known === 54 && [...facelets].every((letter, i) => letter === facelets[i - (i % 9) + 4]);
    figure.classList.toggle("solved", solved);
    caption.textContent = solved ? "now: solved" : "now";
    net.setAttribute("aria-label", `The cube ${caption.textContent}${known === 54 ? "" : `, ${known} of 54 stickers known`}`);
  }
}

/** Net that the operator corrects; `stickers()` returns the 54 letters. */
export class NetEditor {
  /**
   * `read` has the letters as they were read, `doubtful` the indices that the controller doubts.
   * `changed` is called with whether each colour has nine stickers, with the proposal for the
   * stickers that are open, and with this editor.
   */
  constructor(place, read, doubtful, changed) {
    this.colours = [...read].map((letter) => LETTERS.indexOf(letter));
    /** Stickers that the controller doubts and nobody has painted yet. */
    this.doubtful = new Set(doubtful);
    this.changed = changed;
    this.brush = 0;
    const palette = Object.assign(document.createElement("div"), { className: "palette" });
    palette.setAttribute("role", "group");
    palette.setAttribute("aria-label", "Colour to paint with");
    this.brushes = COLOUR_NAMES.map((name, c) => {
      const button = document.createElement("button");
      button.type = "button";
      const chip = document.createElement("i");
      chip.style.background = COLOURS[c];
      const count = document.createElement("span");
      button.append(chip, `${name} `, count);
      button.onclick = () => this.take(c);
      button.dataset.colour = name;
      palette.append(button);
      return { button, count };
    });
    [this.net, this.tiles] = tiles("button");
    this.tiles.forEach((tile, i) => {
      tile.type = "button";
      tile.tabIndex = i === (doubtful[0] ?? 0) ? 0 : -1;
      tile.dataset.facelet = nameOf(i);
      tile.classList.toggle("ask", doubtful.includes(i));
      if (i % 9 === 4) tile.textContent = LETTERS[(i - 4) / 9];
      tile.onclick = () => this.paint(i, this.brush);
      tile.onkeydown = (event) => this.key(event, i);
    });
    place.replaceChildren(palette, this.net);
    this.take(0);
    this.tiles.forEach((_, i) => this.show(i, this.colours[i]));
    this.tiles[doubtful[0] ?? 0].focus();
  }

  /** Chooses the colour with which a click paints. */
  take(colour) {
    this.brush = colour;
    this.brushes.forEach(({ button }, c) => button.setAttribute("aria-pressed", String(c === colour)));
  }

  /** Paints a sticker, which is no longer in doubt then. */
  paint(i, colour) {
    this.doubtful.delete(i);
    this.show(i, colour);
  }

  /** Shows the colour of a sticker and counts the stickers of each colour. */
  show(i, colour) {
    this.colours[i] = colour;
    const tile = this.tiles[i];
    tile.style.background = COLOURS[colour] ?? "";
    tile.setAttribute("aria-label", `${nameOf(i)}: ${COLOUR_NAMES[colour] ?? "unknown"}`);
    const counts = COLOUR_NAMES.map((_, c) => this.colours.filter((own) => own === c).length);
    this.brushes.forEach(({ count }, c) => {
      count.textContent = counts[c] === 9 ? "9" : `${counts[c]} of 9`;
      count.classList.toggle("wrong", counts[c] !== 9);
    });
    this.changed(counts.every((n) => n === 9), proposal(this.colours, this.doubtful), this);
  }

  /** Handles a key on sticker `i`: a digit or a letter paints it, an arrow moves the focus. */
  key(event, i) {
    const digit = "123456".indexOf(event.key);
    const letter = KEYS.indexOf(event.key.toLowerCase());
    const colour = digit >= 0 ? digit : letter;
    if (colour >= 0 && !event.ctrlKey && !event.metaKey) {
      event.preventDefault();
      return this.paint(i, colour);
    }
    const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const way = ways[event.key];
    if (!way) return;
    event.preventDefault();
    const place = (k) => [PLACES[Math.floor(k / 9)][0] + (k % 3), PLACES[Math.floor(k / 9)][1] + Math.floor((k % 9) / 3)];
    let [x, y] = place(i);
    for (let n = 0; n < 12; n++) {
      [x, y] = [(x + way[0] + 12) % 12, (y + way[1] + 9) % 9];
      const to = this.tiles.findIndex((_, k) => place(k)[0] === x && place(k)[1] === y);
      if (to < 0) continue;
      this.tiles[i].tabIndex = -1;
      this.tiles[to].tabIndex = 0;
      return this.tiles[to].focus();
    }
  }

  /** Returns the colours as 54 letters, `-` for an unknown one. */
  stickers() {
    return this.colours.map((c) => LETTERS[c] ?? "-").join("");
  }
}
