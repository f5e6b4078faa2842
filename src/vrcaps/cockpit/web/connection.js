// WebSocket of the page: commands with acknowledgements out, values and images in.

const RETRY_MS = 1000;
const READY = "ready"; // confirms a status or an image, so that few are on the way to a slow browser
const IMAGES = { 1: "camera", 2: "map", 3: "other camera" };

export class Connection {
  /** handlers: setup, status, notice, image(kind, blob), online(isOnline) */
  constructor(handlers) {
    this.handlers = handlers;
    this.waiting = new Map();
    this.number = 0;
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    this.socket = new WebSocket(`${scheme}//${location.host}/cockpit`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onmessage = (event) => this.take(event.data);
    this.socket.onclose = () => {
      this.handlers.online(false);
      for (const { resolve } of this.waiting.values()) resolve({ error: "The connection is lost.", field: "" });
      this.waiting.clear();
      setTimeout(() => this.open(), RETRY_MS);
    };
  }

  take(data) {
    if (typeof data !== "string") {
      const kind = IMAGES[new Uint8Array(data, 0, 1)[0]];
      if (kind) this.handlers.image(kind, new Blob([new Uint8Array(data, 1)], { type: "image/jpeg" }));
      this.socket.send(READY);
      return;
    }
    const message = JSON.parse(data);
    if (message.type === "status") {
      this.handlers.status(message.values, message.viewpoint);
      this.socket.send(READY);
    } else if (message.type === "setup") {
      this.handlers.online(true);
      this.handlers.setup(message.values, message.client);
    } else if (message.type === "notice") this.handlers.notice(message.text, message.is_error);
    else if (message.type === "acknowledgement") this.acknowledge(message);
  }

  acknowledge({ id, error, field }) {
    const waiting = this.waiting.get(id);
    if (!waiting) {
      if (error) this.handlers.notice(error, true);
      return;
    }
    this.waiting.delete(id);
    performance.measure("acknowledgement", { start: waiting.start, end: performance.now(), detail: waiting.command });
    waiting.resolve({ error, field });
  }

  /** Send a command; the promise has its error, empty if it was accepted, and the error's field. */
  send(command, fields = {}) {
    if (this.socket.readyState !== WebSocket.OPEN) return Promise.resolve({ error: "The connection is lost.", field: "" });
    const id = ++this.number;
    return new Promise((resolve) => {
      this.waiting.set(id, { resolve, command, start: performance.now() });
      this.socket.send(JSON.stringify({ id, command, ...fields }));
    });
  }

  /** Send a command that is not acknowledged. */
  post(command, fields = {}) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ id: 0, command, ...fields }));
  }
}
