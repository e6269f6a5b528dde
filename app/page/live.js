// The /live channel: status and video, on a socket of its own; it comes back by itself.

const RETRY_MS = 500;

export class Live extends EventTarget {
  constructor() {
    super();
    this.status = null;
    this.statusAt = -Infinity;
    this.cameras = [];
    this.connected = false;
    this.video = new Map();
    this._wishes = new Map();
    this._decoding = new Map();
    this._open();
  }

  /** Ask for a camera: "off", "half", "full" or "overlay". */
  subscribe(camera, mode) {
    if (this._wishes.get(camera) === mode) return;
    this._wishes.set(camera, mode);
    this._send({ kind: "subscribe", camera, mode });
  }

  /** The site's clock now [ms], as far as the newest status tells; it stops when that stops. */
  get siteNow() {
    if (!this.status) return null;
    const since = Math.min(performance.now() - this.statusAt, 60_000);
    return this.status.instant_ms + since * this.status.rate;
  }

  _open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    this._socket = socket;
    socket.onopen = () => {
      this.connected = true;
      for (const [camera, mode] of this._wishes) this._send({ kind: "subscribe", camera, mode });
    };
    socket.onmessage = (event) => {
      if (typeof event.data === "string") this._hear(event.data);
      else this._see(event.data);
    };
    socket.onclose = () => {
      this.connected = false;
      this._decoding.clear();
      setTimeout(() => this._open(), RETRY_MS);
    };
  }

  _send(message) {
    if (this._socket.readyState === WebSocket.OPEN) this._socket.send(JSON.stringify(message));
  }

  _hear(text) {
    const message = JSON.parse(text);
    if (message.kind === "hello") {
      this.cameras = message.cameras;
      this.dispatchEvent(new Event("cameras"));
    } else if (message.kind === "status") {
      this.status = message;
      this.statusAt = performance.now();
      this.dispatchEvent(new Event("status"));
    }
  }

  /** One image is decoded at a time per camera; a newer one replaces the one that waits. */
  _see(data) {
    const length = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const jpeg = new Uint8Array(data, 4 + length);
    const slot = this._decoding.get(header.camera) ?? { busy: false, next: null };
    this._decoding.set(header.camera, slot);
    if (slot.next) this._send({ kind: "ack", id: slot.next.header.id });
    slot.next = { header, jpeg };
    if (!slot.busy) this._decode(slot);
  }

  async _decode(slot) {
    slot.busy = true;
    while (slot.next) {
      const { header, jpeg } = slot.next;
      slot.next = null;
      try {
        const bitmap = await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" }));
        this._count(header);
        this.dispatchEvent(new CustomEvent("frame", { detail: { header, bitmap } }));
        bitmap.close();
      } catch (error) {
        console.warn("an image could not be decoded", error);
      }
      this._send({ kind: "ack", id: header.id });
    }
    slot.busy = false;
  }

  _count(header) {
    const now = performance.now();
    const seen = this.video.get(header.camera) ?? { times: [], frames: 0, dropped: 0 };
    seen.times.push(now);
    while (seen.times.length && now - seen.times[0] > 2000) seen.times.shift();
    seen.frames += 1;
    seen.dropped += header.dropped;
    seen.stampMs = header.stamp_ms;
    seen.at = now;
    this.video.set(header.camera, seen);
  }

  /** Rate and age of a camera's image on this page. */
  figures(camera) {
    const seen = this.video.get(camera);
    if (!seen) return { fps: 0, ageMs: null, silentMs: Infinity };
    const now = performance.now();
    const fps = seen.times.filter((t) => now - t < 2000).length / 2;
    const site = this.siteNow;
    return {
      fps,
      ageMs: site === null ? null : site - seen.stampMs,
      silentMs: now - seen.at,
    };
  }
}
