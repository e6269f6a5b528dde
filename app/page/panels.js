// Docked live images, each with its rate and its age.

import { age, el, level, say } from "./dom.js";

const SILENT_MS = 1000;
const TITLES = { hc: "Hand-eye", mako: "Mako" };

export class Panels {
  constructor(live, { onOpen }) {
    this.live = live;
    this.element = el("aside", "tp-panels");
    this._panels = new Map();
    this._onOpen = onOpen;
    this._locked = null;
    live.addEventListener("cameras", () => this._sync());
    live.addEventListener("frame", (event) => this._draw(event.detail));
  }

  /** The camera the view looks through gets its image undistorted and whole. */
  lock(camera) {
    this._locked = camera;
    this._subscribe();
  }

  update() {
    for (const [camera, panel] of this._panels) {
      const { fps, ageMs, silentMs } = this.live.figures(camera);
      const silent = silentMs > SILENT_MS;
      panel.element.classList.toggle("silent", silent && panel.open);
      say(panel.fps, panel.open && !silent ? `${Math.round(fps)} fps` : "");
      say(panel.age, !panel.open ? "off" : silentMs === Infinity ? "no image yet" : age(ageMs));
      panel.age.className = `tp-age ${panel.open ? level(ageMs, 400, 1000) : ""}`;
    }
  }

  _sync() {
    for (const camera of this.live.cameras) if (!this._panels.has(camera)) this._add(camera);
    this._subscribe();
  }

  _add(camera) {
    const panel = { open: true };
    panel.canvas = el("canvas");
    panel.canvas.width = 4;
    panel.canvas.height = 3;
    panel.context = panel.canvas.getContext("2d", { alpha: false });
    panel.fps = el("span", "tp-fps");
    panel.age = el("span", "tp-age");
    panel.toggle = el("button", "tp-fold", "–");
    panel.toggle.type = "button";
    panel.toggle.title = "Show or hide this image";
    const picture = el("div", "tp-picture", panel.canvas, el("span", "tp-silent", "no image"));
    picture.title = "Look through this camera";
    panel.element = el(
      "figure",
      "tp-card tp-panel",
      el(
        "figcaption",
        "",
        el("span", "tp-title", TITLES[camera] ?? camera),
        panel.fps,
        panel.age,
        panel.toggle,
      ),
      picture,
    );
    panel.element.dataset.camera = camera;
    panel.toggle.addEventListener("click", () => {
      panel.open = !panel.open;
      panel.element.classList.toggle("folded", !panel.open);
      say(panel.toggle, panel.open ? "–" : "+");
      this._subscribe();
    });
    picture.addEventListener("click", () => this._onOpen(camera));
    this._panels.set(camera, panel);
    this.element.append(panel.element);
  }

  _subscribe() {
    for (const [camera, panel] of this._panels) {
      const mode = camera === this._locked ? "overlay" : panel.open ? "half" : "off";
      this.live.subscribe(camera, mode);
      panel.element.classList.toggle("locked", camera === this._locked);
    }
  }

  _draw({ header, bitmap }) {
    const panel = this._panels.get(header.camera);
    if (!panel?.open) return;
    const width = Math.min(bitmap.width, 640);
    const height = Math.round((bitmap.height * width) / bitmap.width);
    if (panel.canvas.width !== width || panel.canvas.height !== height) {
      panel.canvas.width = width;
      panel.canvas.height = height;
    }
    panel.context.drawImage(bitmap, 0, 0, width, height);
    panel.element.dataset.frames = String((Number(panel.element.dataset.frames) || 0) + 1);
  }
}
