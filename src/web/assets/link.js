// Connection to the robot: one WebSocket, which is reopened after it closes. Its first message has
// the token of the program.

const HEART_BEAT = 4000;

/** Names under which this tab keeps the token and its own name. */
const TOKEN = "token";
const PAGE = "page";

/**
 * Returns the token of the address, or the one that this tab has kept. The address bar shows it no
 * longer. A tab keeps it in its storage and not in a cookie, because a browser sends the cookies of a
 * host to all its ports.
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

/** Fetches a path of this server. */
export function ask(path) {
  return fetch(path, { headers: { "x-token": token } });
}

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
    // The address of a new start of the program may be opened in the same tab.
    addEventListener("hashchange", () => {
      token = takeToken();
      this.wait = 400;
      if (this.denied) this.open();
      else this.socket.close();
    });
  }

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
      // The program does not change its mind about a token.
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

  say(value) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(value));
  }

  command(name, rest = {}) {
    this.say({ command: name, ...rest });
  }
}
