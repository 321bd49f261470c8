// The connection to the daemon: one WebSocket, reopened after a failure, paused while the page is hidden.

const QUIET_MS = 1500; // updates arrive every 100 ms
const AGAIN_MS = [250, 500, 1000, 2000];

/** Calls `message` with every message, and `broken(reason, since_ms)` while no updates arrive. */
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
      if (message.missed) this.look(); // the charts have a gap: request the history again
      this.message(message);
    };
    socket.onclose = (event) => {
      this.why = event.reason ? `No connection (${event.reason})` : "No connection";
      this.broken(this.why, this.heard_ms);
      const wait = AGAIN_MS[Math.min(this.attempts++, AGAIN_MS.length - 1)];
      setTimeout(() => this.open(), wait);
    };
  }

  /** Sends the time span of the charts to the daemon, or a pause while the page is hidden. */
  look(span_s = this.span_s) {
    this.span_s = span_s;
    if (this.socket.readyState !== WebSocket.OPEN) return;
    this.socket.send(JSON.stringify(document.hidden ? { pause: true } : { watch: span_s }));
    if (document.hidden) this.broken("Paused while hidden", this.heard_ms);
  }

  /** An open connection without updates counts as broken. */
  watch() {
    if (!document.hidden && Date.now() - this.heard_ms > QUIET_MS) {
      this.broken(this.why ?? "No updates from the daemon", this.heard_ms);
    }
  }
}
