// Connection to the robot: one WebSocket, which is reopened after it closes.

const HEART_BEAT = 4000;

export class Link {
  /**
   * `on` has a function for each kind of message: stage, snapshot, plan, messages, seat, refused;
   * and `line`, which gets whether the connection is open.
   */
  constructor(on) {
    this.on = on;
    this.wait = 400;
    this.open();
    setInterval(() => this.say({ alive: true }), HEART_BEAT);
  }

  open() {
    this.socket = new WebSocket(`ws://${location.host}/ws`);
    this.socket.onopen = () => {
      this.wait = 400;
      this.on.line(true);
    };
    this.socket.onclose = () => {
      this.on.line(false);
      setTimeout(() => this.open(), this.wait);
      this.wait = Math.min(this.wait * 1.6, 5000);
    };
    this.socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
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
