// Connection to the robot: one WebSocket, which is reopened after it closes. Its first message has
// the token of the program.

/** Time between two heartbeats (ms). */
const HEART_BEAT = 4000;

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
   * denied; and `line`, which gets whether the connection is open.
   */
  constructor(on) {
    this.on = on;
    this.wait = 400;
    this.denied = false;
    this.open();
    setInterval(() => this.say({ alive: true }), HEART_BEAT);
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
    this.socket = new WebSocket(`${scheme}://${location.host}/ws`);
    this.socket.onopen = () => {
      this.wait = 400;
      this.say({ token, page: ownName() });
      this.on.line(true);
    };
    this.socket.onclose = () => {
      this.on.line(false);
      // A token that was refused once is always refused, so it is not tried again.
      if (this.denied) return;
      setTimeout(() => this.open(), this.wait);
      this.wait = Math.min(this.wait * 1.6, 5000);
    };
    this.socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      if ("denied" in message) this.denied = true;
      for (const [kind, value] of Object.entries(message)) this.on[kind]?.(value);
    };
  }

  /** Sends a value as JSON; does nothing while there is no connection. */
  say(value) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(value));
  }

  /** Sends an input of the operator: its name, and its arguments `rest`. */
  command(name, rest = {}) {
    this.say({ command: name, ...rest });
  }
}
