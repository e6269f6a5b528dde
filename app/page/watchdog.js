// Frozen is never mistaken for still: both links must show a heartbeat, or the page says so.
//
// Silence is summed over the watchdog's own ticks, each counted as at most MAX_STEP_MS: a tab the
// browser put to sleep, or a slow picture, is not a silent link.

const TICK_MS = 50;
const MAX_STEP_MS = 120;
export const LIMIT_MS = 500;

export class Watchdog extends EventTarget {
  constructor(viser, live) {
    super();
    this._links = [
      { name: "pose link", beat: () => viser.tick, last: null, silent: 0, seen: false },
      { name: "status link", beat: () => live.statusAt, last: -Infinity, silent: 0, seen: false },
    ];
    this.frozen = false;
    this.silentMs = 0;
    this.silentLinks = [];
    this._before = performance.now();
    setInterval(() => this._tick(), TICK_MS);
  }

  /** Whether both links ever spoke. */
  get started() {
    return this._links.every((link) => link.seen);
  }

  _tick() {
    const now = performance.now();
    const gap = now - this._before;
    const step = Math.min(gap, MAX_STEP_MS);
    this._before = now;
    for (const link of this._links) {
      const beat = link.beat();
      if (beat !== null && beat !== link.last) {
        link.seen = link.seen || Number.isFinite(beat);
        link.last = beat;
        link.silent = 0;
        link.silentFrom = now;
      } else {
        link.silent += step;
      }
    }
    const silent = this._links.filter((link) => link.seen && link.silent >= LIMIT_MS);
    this.frozen = silent.length > 0;
    this.silentLinks = silent.map((link) => link.name);
    this.silentMs = Math.max(0, ...silent.map((link) => now - link.silentFrom));
    this.dispatchEvent(new Event("tick"));
  }
}
