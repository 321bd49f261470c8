// The way to the daemon: one WebSocket, opened again when it breaks, silent while nobody looks.

const QUIET_MS = 1500; // updates come every 100 ms
const AGAIN_MS = [250, 500, 1000, 2000];

/** Calls back with every message, and with `broken(reason, since_ms)` while there is no news. */
export class Link {
  constructor({ message, broken }) {
    Object.assign(this, { message, broken, span_s: 60, attempts: 0, heard_ms: Date.now(), why: null });
    document.addEventListener("visibilitychange", () => this.look());
    setInterval(() => this.watch(), 250);
    this.open();
  }

  open() {
    const socket = new WebSocket(`ws://${location.host}/live`);
    this.socket = socket;
    socket.onopen = () => this.look();
    socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      if (message.update) {
        this.heard_ms = Date.now();
        this.attempts = 0;
        this.why = null;
      }
      if (message.missed) this.look(); // the charts have a hole: the past again
      this.message(message);
    };
    socket.onclose = (event) => {
      this.why = event.reason ? `No connection (${event.reason})` : "No connection";
      this.broken(this.why, this.heard_ms);
      const wait = AGAIN_MS[Math.min(this.attempts++, AGAIN_MS.length - 1)];
      setTimeout(() => this.open(), wait);
    };
  }

  /** Says what is looked at, or that nothing is. */
  look(span_s = this.span_s) {
    this.span_s = span_s;
    if (this.socket.readyState !== WebSocket.OPEN) return;
    this.socket.send(JSON.stringify(document.hidden ? { pause: true } : { watch: span_s }));
    if (document.hidden) this.broken("Paused while hidden", this.heard_ms);
  }

  /** A connection that stands and brings nothing is no connection. */
  watch() {
    if (!document.hidden && Date.now() - this.heard_ms > QUIET_MS) {
      this.broken(this.why ?? "No news from the daemon", this.heard_ms);
    }
  }
}
