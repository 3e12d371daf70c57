// The WebSocket: messages with a header in JSON and bytes behind it; it connects again when the server is back.

export class Connection {
  constructor(path, heard, changed) {
    Object.assign(this, { path, heard, changed, socket: null, pending: new Map(), scheduled: false, asking: false, next: null });
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = this.socket = new WebSocket(`${scheme}://${location.host}${this.path}`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.changed(true);
    socket.onclose = () => { this.changed(false); setTimeout(() => this.open(), 1000); };
    socket.onmessage = ({ data }) => {
      const length = new DataView(data).getUint32(0, true);
      const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
      this.heard(header, new Uint8ClampedArray(data, 4 + length));
    };
  }

  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  // Ask something, about the frame that is `shown` if there is one.
  ask(about, shown = {}, rest = {}) {
    this.send({ do: "ask", about, ...shown, ...rest });
  }

  // One question about a pixel at a time, however fast the pointer is. The last one that came meanwhile follows the answer,
  // or a second without an answer: a worker that was replaced gives none.
  askOnce(about, pixel, shown) {
    if (this.asking) {
      this.next = [about, pixel, shown];
      return;
    }
    this.asking = true;
    this.patience = setTimeout(() => this.answered(), 1000);
    this.ask(about, shown, { at: pixel });
  }

  answered() {
    clearTimeout(this.patience);
    this.asking = false;
    const next = this.next;
    this.next = null;
    if (next) this.askOnce(...next);
  }

  // Changes of the state go once in each frame of the screen, so that a slider that is dragged never floods the server.
  set(changes) {
    const params = { ...this.pending.get("params"), ...changes.params };
    for (const [name, value] of Object.entries(changes)) this.pending.set(name, value);
    if (Object.keys(params).length) this.pending.set("params", params);
    if (this.scheduled) return;
    this.scheduled = true;
    setTimeout(() => {
      this.scheduled = false;
      this.send({ do: "set", changes: Object.fromEntries(this.pending) });
      this.pending.clear();
    }, 15);
  }
}
