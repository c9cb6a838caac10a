// Connection to the robot: one WebSocket, which is reopened after it closes. Its first message has
// the token of the program.

/** Time between two heartbeats (ms). */
const HEART_BEAT = 4000;
/**
 * Time without a message after which the data are out of date, after which the connection is opened
 * anew, and between two looks at it (ms). The program sends its clock each 200 ms.
 */
const SILENT = 800;
const GIVEN_UP = 5000;
const LOOK = 100;

/** Keys under which the tab's storage keeps the token and the name of the tab. */
const TOKEN = "token";
const PAGE = "page";

/**
 * Returns the token in the page's address, or else the one that this tab has kept. Removes it from
 * the address bar. A tab keeps the token in its storage and not in a cookie, because a browser
 * sends the cookies of a host to all its ports.
 */
function takeToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get(TOKEN);
  if (given) {
    sessionStorage.setItem(TOKEN, given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem(TOKEN) ?? "";
}

/** Returns the name by which the program recognises this tab after a lost connection. */
function ownName() {
  const kept = sessionStorage.getItem(PAGE);
  const name = kept ?? [...crypto.getRandomValues(new Uint32Array(4))].map((n) => n.toString(16)).join("");
  sessionStorage.setItem(PAGE, name);
  return name;
}

let token = takeToken();

/** Fetches a path of this server with the token. Returns the promise of the response. */
export function ask(path) {
  return fetch(path, { headers: { "x-token": token } });
}

/** Connection to the program, which is reopened whenever it closes. */
export class Link {
  /**
   * `on` has a function for each kind of message: stage, snapshot, plan, messages, seat, refused,
   * number, taken, denied; and `line`, which gets whether the connection is open, and `silent`,
   * which gets for how long (s) no message has come, 0 while messages come.
   */
  constructor(on) {
    this.on = on;
    this.wait = 400;
    this.denied = false;
    this.commands = 0;
    this.urgent = [];
    this.open();
    setInterval(() => this.say({ alive: true }), HEART_BEAT);
    let looked = performance.now();
    setInterval(() => {
      const now = performance.now();
      // After a pause of the page itself, messages may wait to be read.
      if (now - looked < 5 * LOOK) this.look(now - this.heard);
      looked = now;
    }, LOOK);
    // The address that the program prints at a new start may be opened in the same tab.
    addEventListener("hashchange", () => {
      token = takeToken();
      this.wait = 400;
      if (this.denied) this.open();
      else this.socket.close();
    });
  }

  /** Opens the WebSocket and sends the token. Opens it again after a close, later each time. */
  open() {
    this.denied = false;
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws`);
    this.socket = socket;
    this.heard = performance.now();
    // The program's clock minus that of the page (ms): the greatest value has the least delay.
    this.ahead = null;
    socket.onopen = () => {
      this.wait = 400;
      this.heard = performance.now();
      this.say({ token, page: ownName() });
      for (const value of this.urgent.splice(0)) this.say(value);
      this.on.line(true);
    };
    socket.onclose = () => this.closed();
    socket.onmessage = (event) => {
      this.heard = performance.now();
      const message = JSON.parse(event.data);
      if ("denied" in message) this.denied = true;
      if ("clock" in message) this.ahead = Math.max(this.ahead ?? -Infinity, message.clock - this.heard);
      for (const [kind, value] of Object.entries(message)) this.on[kind]?.(value);
    };
  }

  /** Tells that the connection is lost, and opens another one after a while. */
  closed() {
    this.on.line(false);
    // A token that was refused once is always refused, so it is not tried again.
    if (this.denied) return;
    setTimeout(() => this.open(), this.wait);
    this.wait = Math.min(this.wait * 1.6, 5000);
  }

  /** Tells for how long no message has come (ms); opens a new connection if it is too long. */
  look(silent) {
    if (this.denied) return;
    this.on.silent(silent > SILENT ? silent / 1000 : 0);
    if (silent < GIVEN_UP || this.socket.readyState !== WebSocket.OPEN) return;
    // A program that does not answer does not answer a close either. It still reads what was sent.
    this.socket.onclose = this.socket.onmessage = null;
    this.socket.close();
    this.closed();
  }

  /** Sends a value as JSON; does nothing while there is no connection. */
  say(value) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(value));
  }

  /**
   * Sends an input of the operator: its name, and its arguments `rest`. Returns its number, which
   * the program's answer repeats. An emergency stop waits for a connection, if there is none.
   */
  command(name, rest = {}) {
    const number = ++this.commands;
    const sent = this.ahead === null ? undefined : Math.max(0, Math.round(performance.now() + this.ahead));
    const value = { command: name, number, sent, ...rest };
    if (name === "emergency_stop" && this.socket.readyState !== WebSocket.OPEN) this.urgent.push(value);
    else this.say(value);
    return number;
  }
}
