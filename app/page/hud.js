// Header, view bar, hints and the alarm around it all.

import { age, clock, el, level, say, svg } from "./dom.js";
import { PRESETS } from "./view.js";

const HELP = [
  ["drag", "orbit"],
  ["right drag", "move"],
  ["wheel", "closer, farther"],
  ["1 – 9", "views"],
  ["Home", "see everything"],
  ["[  ]", "image weaker, stronger"],
  ["G", "raw poses"],
  ["F", "walls"],
  ["C", "cameras"],
  ["T", "light or dark"],
  ["?", "this list"],
];

export class Header {
  constructor() {
    this.site = el("span", "tp-site", "Remote site");
    this.link = el("span", "tp-link");
    this.dot = el("i", "tp-dot");
    this.word = el("span", "", "Connecting");
    this.link.append(this.dot, this.word);
    this.badge = el("span", "tp-badge", "Replay");
    this.badge.hidden = true;
    this.note = el("span", "tp-note");
    this._figures = {};
    const figures = el("dl", "tp-figures");
    for (const [id, name, title] of [
      ["instant", "T*", "The one instant this picture shows, on the clock of the site (UTC)"],
      ["robot", "Robot", "Age of the newest joint sample"],
      ["scene", "Scene", "States of the scene that arrived in the last second"],
      ["clock", "Clock", "Stated bound of the site's clock against this one"],
    ]) {
      const value = el("dd");
      const group = el("div", "", el("dt", "", name), value);
      group.title = title;
      this._figures[id] = value;
      figures.append(group);
    }
    const mark = svg(24, [
      ["path", { d: "M4 5h16M12 5v6", class: "line" }],
      ["path", { d: "M12 11l-4 4 4 5 4-5z", class: "line" }],
    ], "tp-logo");
    this.element = el(
      "header",
      "tp-header",
      el("div", "tp-brand", mark, this.site),
      this.link,
      this.badge,
      this.note,
      figures,
    );
  }

  update(status, { frozen, started, since, sceneHz }) {
    const replay = status?.session === "replay";
    const quiet = status?.link === "lost";
    const state = !started ? "waiting" : frozen ? "frozen" : quiet ? "lost" : "live";
    this.link.dataset.state = state;
    const words = {
      waiting: "Connecting",
      frozen: "No data",
      lost: "Site silent",
      live: replay ? "Recording" : "Live",
    };
    say(this.word, words[state]);
    this.badge.hidden = !replay;
    if (!status) return;
    say(this.site, status.site);
    say(this.note, status.note);
    this._figure("instant", clock(status.instant_ms));
    const robot = status.robot_ms === null ? null : status.robot_ms + since;
    this._figure("robot", age(robot), level(robot, 150, 500));
    this._figure("scene", `${sceneHz} Hz`, sceneHz < 15 ? "warn" : "");
    const bound = status.clock_bound_ms;
    this._figure("clock", bound === null ? "shared" : `± ${bound.toFixed(1)} ms`, level(bound, 20, 100));
  }

  _figure(id, text, grade = "") {
    const value = this._figures[id];
    say(value, text);
    if (value.className !== grade) value.className = grade;
  }
}

export class ViewBar {
  constructor({ onPreset, onAlpha }) {
    this._buttons = new Map();
    const bar = el("nav", "tp-views");
    for (const preset of PRESETS) {
      const button = el("button", "", el("kbd", "", preset.key), el("span", "", preset.label));
      button.type = "button";
      button.title = preset.hint;
      button.dataset.view = preset.id;
      button.addEventListener("click", () => onPreset(preset.id));
      this._buttons.set(preset.id, button);
      bar.append(button);
    }
    this.slider = el("input");
    Object.assign(this.slider, { type: "range", min: "0", max: "100", value: "50" });
    this.slider.setAttribute("aria-label", "Strength of the live image");
    this.slider.addEventListener("input", () => onAlpha(this.slider.value / 100));
    this.value = el("output", "", "50 %");
    this.alpha = el(
      "label",
      "tp-alpha",
      el("span", "", "Scene"),
      this.slider,
      el("span", "", "Image"),
      this.value,
    );
    this.element = el("footer", "tp-bar tp-card", bar, this.alpha);
    this.select("free", false);
  }

  select(id, locked) {
    for (const [key, button] of this._buttons) {
      button.setAttribute("aria-pressed", String(key === id));
    }
    this.alpha.classList.toggle("shown", locked);
  }

  setAlpha(alpha) {
    this.slider.value = String(Math.round(alpha * 100));
    say(this.value, `${Math.round(alpha * 100)} %`);
  }

  disable(disabled) {
    for (const button of this._buttons.values()) button.disabled = disabled;
    this.slider.disabled = disabled;
  }
}

export class Hints {
  constructor() {
    const rows = HELP.map(([key, what]) => el("div", "", el("kbd", "", key), el("span", "", what)));
    this.card = el("section", "tp-card tp-help", el("h2", "", "Hand and keys"), ...rows);
    this.card.hidden = true;
    this.toast = el("div", "tp-toast");
    this.toast.setAttribute("role", "status");
    const line = el("p", "tp-hints");
    for (const [key, what] of [HELP[0], HELP[1], HELP[2], HELP[10]]) {
      line.append(el("kbd", "", key), el("span", "", key === "?" ? "keys" : what));
    }
    this.line = line;
  }

  toggle() {
    this.card.hidden = !this.card.hidden;
  }

  /** Say something for a moment. */
  flash(text) {
    say(this.toast, text);
    this.toast.classList.add("shown");
    clearTimeout(this._timer);
    this._timer = setTimeout(() => this.toast.classList.remove("shown"), 1600);
  }
}

export class Alarm {
  constructor() {
    this.title = el("b", "", "No data");
    this.text = el("span", "tp-alarm-text");
    this.detail = el("span", "tp-alarm-detail");
    this.element = el(
      "div",
      "tp-alarm",
      el("div", "tp-alarm-banner", this.title, this.text, this.detail),
    );
    this.element.setAttribute("role", "alert");
    this.element.hidden = true;
    this.waiting = el(
      "div",
      "tp-waiting tp-card",
      el("b", "", "Waiting for the station"),
      el("span", "", "The picture appears with the first data."),
    );
  }

  update({ frozen, started, drawing, silentMs, silentLinks }) {
    this.waiting.hidden = started;
    this.element.hidden = !frozen;
    document.documentElement.classList.toggle("tp-frozen", frozen);
    // A machine that is too slow to draw must not also have to filter.
    document.documentElement.classList.toggle("tp-grey", frozen && drawing);
    if (!frozen) return;
    say(this.title, drawing ? "No data" : "Not drawn");
    say(this.text, `for ${age(silentMs)} – the picture is frozen`);
    say(this.detail, silentLinks.join(" and "));
  }
}
