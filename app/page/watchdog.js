// Frozen is never mistaken for still: both links must show a heartbeat and the picture must be
// drawn, or the page says so.
//
// Silence is summed over the watchdog's own ticks, each counted as at most MAX_STEP_MS: a tab the
// browser put to sleep, or a slow picture, is not a silent link.

const TICK_MS = 50;
const MAX_STEP_MS = 120;
export const LIMIT_MS = 500;
const PICTURE_LIMIT_MS = 5000; // slow drawing is shown by its rate; this is no drawing at all

export class Watchdog extends EventTarget {
  constructor(viser, live) {
    super();
    this._links = [
      watch("pose link", LIMIT_MS, () => viser.tick),
      watch("status link", LIMIT_MS, () => (Number.isFinite(live.statusAt) ? live.statusAt : null)),
      watch("picture", PICTURE_LIMIT_MS, () => (document.hidden ? performance.now() : viser.frames)),
    ];
    this.frozen = false;
    this.silentMs = 0;
    this.silentLinks = [];
    this._before = performance.now();
    setInterval(() => this._tick(), TICK_MS);
  }

  /** Whether every link ever spoke. */
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
        link.seen = true;
        link.last = beat;
        link.silent = 0;
        link.silentFrom = now;
      } else {
        link.silent += step;
      }
    }
    const silent = this._links.filter((link) => link.seen && link.silent >= link.limit);
    this.frozen = silent.length > 0;
    this.silentLinks = silent.map((link) => link.name);
    this.drawing = !this.silentLinks.includes("picture");
    this.silentMs = Math.max(0, ...silent.map((link) => now - link.silentFrom));
    this.dispatchEvent(new Event("tick"));
  }
}

function watch(name, limit, beat) {
  return { name, limit, beat, last: null, silent: 0, silentFrom: 0, seen: false };
}
