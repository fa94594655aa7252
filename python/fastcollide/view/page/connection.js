// The WebSocket: JSON both ways, pictures as binary float32.

const MAGIC = 0x31564346; // "FCV1", little-endian
const HEADER_BYTES = 32;
const HAS_RADII = 1, HAS_VALUES = 2;

export class Connection {
  // on: functions by the type of a message, and picture, lost.
  constructor(on) {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    this.socket = new WebSocket(`${scheme}//${location.host}/socket`);
    this.socket.binaryType = "arraybuffer";
    this.socket.addEventListener("message", ({ data }) => {
      if (data instanceof ArrayBuffer) on.picture(unpack(data));
      else {
        const message = JSON.parse(data);
        on[message.type](message);
      }
    });
    this.socket.addEventListener("close", () => on.lost());
    this.waiting = null;
  }

  send(type, content = {}) {
    this.#sendWaiting();
    this.#sendNow(type, content);
  }

  // For what comes faster than pictures do, from a slider that moves: with the next picture, or before the next message.
  sendSoon(type, content) {
    if (this.waiting?.type !== type) {
      this.#sendWaiting();
      this.waiting = { type, content: {} };
      requestAnimationFrame(() => this.#sendWaiting());
    }
    Object.assign(this.waiting.content, content);
  }

  #sendWaiting() {
    if (!this.waiting) return;
    const { type, content } = this.waiting;
    this.waiting = null;
    this.#sendNow(type, content);
  }

  #sendNow(type, content) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ type, ...content }));
  }
}

export function unpack(data) {
  const header = new DataView(data);
  if (header.getUint32(0, true) !== MAGIC) throw new Error("The server speaks another language: reload the page.");
  const [frame, index, moments, count, follows] = [4, 8, 12, 16, 20].map((place) => header.getUint32(place, true));
  const picture = { frame, index, moments, time: header.getFloat64(24, true) };
  let place = HEADER_BYTES;
  const take = (length) => {
    const array = new Float32Array(data, place, length);
    place += 4 * length;
    return array;
  };
  picture.positions = take(3 * count);
  if (follows & HAS_RADII) picture.radii = take(count);
  if (follows & HAS_VALUES) picture.values = take(count);
  return picture;
}
