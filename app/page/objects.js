// The list of objects: state by colour, shape and word; when it was seen, how far it is predicted.

import { age, el, level, say, svg } from "./dom.js";

const WORDS = { tracked: "Tracked", bridged: "Bridged", stale: "Stale", lost: "Lost" };
const MOVES = { nested: "on tool", flat: "in base" };

/** Shapes that differ without colour: disc, half disc, empty square, crossed ring. */
export function glyph(state) {
  const shapes = {
    tracked: [["circle", { cx: 8, cy: 8, r: 5 }]],
    bridged: [
      ["circle", { cx: 8, cy: 8, r: 5, class: "line" }],
      ["path", { d: "M8 3a5 5 0 0 1 0 10z" }],
    ],
    stale: [["rect", { x: 3.5, y: 3.5, width: 9, height: 9, rx: 1, class: "line" }]],
    lost: [
      ["circle", { cx: 8, cy: 8, r: 5, class: "line dash" }],
      ["path", { d: "M5.6 5.6l4.8 4.8M10.4 5.6l-4.8 4.8", class: "line" }],
    ],
  };
  return svg(16, shapes[state] ?? shapes.lost, `tp-glyph ${state}`);
}

export class ObjectList {
  constructor() {
    this.list = el("ol", "tp-objects");
    this.count = el("span", "tp-count");
    this.element = el(
      "section",
      "tp-card tp-objects-card",
      el("header", "tp-card-head", el("h2", "", "Objects"), this.count),
      this.list,
    );
    this._rows = new Map();
  }

  /** Show a status; `since` ms have passed since it was true. */
  update(status, since) {
    const slugs = new Set(status.objects.map((object) => object.slug));
    for (const [slug, row] of this._rows) {
      if (!slugs.has(slug)) {
        row.element.remove();
        this._rows.delete(slug);
      }
    }
    for (const object of status.objects) {
      if (!this._rows.has(object.slug)) this._add(object.slug);
      this._fill(this._rows.get(object.slug), object, status, since);
    }
    const good = status.objects.filter((object) => object.state === "tracked").length;
    say(this.count, `${good} of ${status.objects.length} tracked`);
  }

  _add(slug) {
    const row = { state: null };
    row.mark = el("span", "tp-mark");
    row.name = el("span", "tp-name");
    row.word = el("span", "tp-word");
    row.seen = el("b");
    row.predicted = el("b");
    row.bound = el("b");
    row.via = el("span", "tp-via");
    row.reason = el("p", "tp-reason");
    row.element = el(
      "li",
      "tp-object",
      el("div", "tp-line", row.mark, row.name, row.word),
      el(
        "div",
        "tp-ages",
        el("span", "", "seen ", row.seen),
        el("span", "", "pred ", row.predicted),
        el("span", "", "±", row.bound),
      ),
      row.reason,
    );
    row.element.dataset.slug = slug;
    this.list.append(row.element);
    this._rows.set(slug, row);
  }

  _fill(row, object, status, since) {
    if (row.state !== object.state) {
      row.state = object.state;
      row.mark.replaceChildren(glyph(object.state));
      row.element.dataset.state = object.state;
    }
    say(row.name, object.name);
    row.element.classList.toggle("target", object.slug === status.target);
    row.element.title = `${object.slug}: ${object.camera}, ${MOVES[object.hierarchy] ?? object.hierarchy}`;
    const seen = object.seen_ms === null ? null : object.seen_ms + since;
    const predicted = object.predicted_ms === null ? null : object.predicted_ms + since;
    say(row.word, WORDS[object.state] ?? object.state);
    say(row.seen, object.seen_ms === null ? "never" : age(seen));
    say(row.predicted, age(predicted));
    say(row.bound, object.bound_mm === null ? "–" : `${object.bound_mm.toFixed(object.bound_mm < 10 ? 1 : 0)} mm`);
    row.predicted.className = level(predicted, 200, 400);
    say(row.reason, object.state === "tracked" ? "" : object.reason);
  }
}
