// Puts the operator's page together.

import { el } from "./dom.js";
import { Alarm, Header, Hints, ViewBar } from "./hud.js";
import { Live } from "./live.js";
import { ObjectList } from "./objects.js";
import { Overlay } from "./overlay.js";
import { Panels } from "./panels.js";
import { PRESETS, View } from "./view.js";
import { viserReady } from "./viser.js";
import { Watchdog } from "./watchdog.js";

const MARGIN = { top: 52, bottom: 68, left: 304, right: 12 };
const LAYERS = {
  KeyG: { name: "Raw poses", nodes: ["/site/raw"] },
  KeyF: { name: "Walls", pattern: /^\/site\/objects\/[^/]+\/walls$/ },
  KeyC: { name: "Cameras", nodes: ["/site/cameras"] },
};

/** Where a camera's image is fitted: beside the list, between header and bar. */
function stage() {
  return {
    x: MARGIN.left,
    y: MARGIN.top,
    width: Math.max(120, innerWidth - MARGIN.left - MARGIN.right),
    height: Math.max(90, innerHeight - MARGIN.top - MARGIN.bottom),
  };
}

class Page {
  constructor(viser) {
    this.viser = viser;
    this.live = new Live();
    this.hidden = new Set();
    this.header = new Header();
    this.objects = new ObjectList();
    this.hints = new Hints();
    this.alarm = new Alarm();
    this.overlay = new Overlay(viser, this.live, { stage });
    this.view = new View(viser, {
      targetNode: () => `/site/objects/${this.live.status?.target ?? ""}`,
      overlay: this.overlay,
      stage,
    });
    this.bar = new ViewBar({
      onPreset: (id) => this.view.go(id),
      onAlpha: (alpha) => this.setAlpha(alpha),
    });
    this.panels = new Panels(this.live, {
      onOpen: (camera) => {
        const preset = PRESETS.find((p) => p.camera === camera);
        if (preset) this.view.go(this.view.preset === preset ? "free" : preset.id);
      },
    });
    this.watchdog = new Watchdog(viser, this.live);
    this._ticks = [];
    this._framed = false;
    document.body.append(
      el(
        "div",
        "tp-hud",
        this.header.element,
        this.objects.element,
        this.panels.element,
        this.bar.element,
        this.hints.line,
        this.hints.card,
        this.hints.toast,
        this.alarm.waiting,
      ),
      this.alarm.element,
    );
    viser.canvas.classList.add("tp-scene");
    viser.beforeRender(() => this._hideLayers());
    this.view.addEventListener("change", () => this._viewChanged());
    this.watchdog.addEventListener("tick", () => this._tick());
    window.addEventListener("keydown", (event) => this._key(event), { capture: true });
    setInterval(() => this._remember(), 500);
  }

  setAlpha(alpha) {
    this.overlay.setAlpha(alpha);
    this.bar.setAlpha(this.overlay.alpha);
  }

  _viewChanged() {
    const preset = this.view.preset;
    this.bar.select(preset.id, this.view.locked);
    this.panels.lock(preset.camera ?? null);
    document.documentElement.classList.toggle("tp-locked", this.view.locked);
  }

  _tick() {
    const { watchdog, live } = this;
    const now = performance.now();
    const tick = this.viser.tick;
    if (tick !== null && tick !== this._ticks.at(-1)?.tick) this._ticks.push({ tick, at: now });
    while (this._ticks.length && now - this._ticks[0].at > 1000) this._ticks.shift();
    const first = this._ticks[0]?.tick ?? 0;
    const sceneHz = Math.max(0, (this._ticks.at(-1)?.tick ?? 0) - first);
    const since = live.status ? (now - live.statusAt) * live.status.rate : 0;
    const { frozen, started } = watchdog;
    this.header.update(live.status, { frozen, started, since, sceneHz });
    if (live.status) this.objects.update(live.status, since);
    this.panels.update();
    this.alarm.update(watchdog);
    this.bar.disable(frozen);
    if (started && !this._framed) this._frame();
  }

  /** First view: from the address, else everything. */
  _frame() {
    if (!this.viser.node("/site/robot")) return;
    this._framed = true;
    const wanted = new URLSearchParams(window.telepresence.hash.slice(1));
    this.view.frameAll();
    if (wanted.has("from")) this.view.pose = wanted.get("from");
    if (wanted.has("alpha")) this.setAlpha(Number(wanted.get("alpha")) / 100 || 0);
    if (wanted.has("view")) this.view.go(wanted.get("view"), { smooth: false });
  }

  /** Keep the view in the address, so that it can be shared. */
  _remember() {
    if (!this._framed) return;
    const { view, overlay } = this;
    const parts = [`view=${view.preset.id}`];
    if (view.locked) parts.push(`alpha=${Math.round(overlay.alpha * 100)}`);
    else parts.push(`from=${view.pose}`);
    const hash = `#${parts.join("&")}`;
    if (location.hash !== hash) history.replaceState(null, "", hash);
  }

  _hideLayers() {
    for (const [code, layer] of Object.entries(LAYERS)) {
      const inOwnEye = code === "KeyC" && this.view.locked;
      if (!this.hidden.has(code) && !inOwnEye) continue;
      const names =
        layer.nodes ??
        Object.keys(this.viser.mutable.nodePoseData).filter((name) => layer.pattern.test(name));
      for (const name of names) {
        const node = this.viser.node(name);
        if (node) node.visible = false;
      }
    }
  }

  _key(event) {
    if (event.target instanceof HTMLInputElement && event.target.type !== "range") return;
    const ours = this._act(event);
    // viser moves its orbit camera by letters and arrows, and has a palette of its own.
    if (ours || this.view.locked || this.watchdog.frozen || event.ctrlKey || event.metaKey) {
      event.stopImmediatePropagation();
      if (ours || event.code === "KeyK") event.preventDefault();
    }
  }

  _act(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return false;
    if (event.key === "?") this.hints.toggle();
    else if (this.watchdog.frozen) return false;
    else if (/^[1-9]$/.test(event.key)) this.view.go(PRESETS[event.key - 1].id);
    else if (event.key === "Home") {
      this.view.go("free");
      this.view.frameAll({ smooth: true });
    } else if (event.key === "[") this.setAlpha(this.overlay.alpha - 0.1);
    else if (event.key === "]") this.setAlpha(this.overlay.alpha + 0.1);
    else if (event.code in LAYERS) this._toggle(event.code);
    else if (event.code === "KeyT") document.documentElement.classList.toggle("tp-light");
    else return false;
    return true;
  }

  _toggle(code) {
    if (!this.hidden.delete(code)) this.hidden.add(code);
    this.hints.flash(`${LAYERS[code].name} ${this.hidden.has(code) ? "hidden" : "shown"}`);
    this.viser.requestRender();
  }
}

window.telepresence.page = new Page(await viserReady());
