// The live image laid over the scene, as the real camera saw it, with the scene of the same stamp.

import { el } from "./dom.js";
import { fit } from "./view.js";

const DEFAULT_FOV = 1.1; // width over focal length, until the first image tells K

export class Overlay {
  constructor(viser, live, { stage }) {
    this.viser = viser;
    this.live = live;
    this.canvas = el("canvas", "tp-overlay");
    this.alpha = 0.5;
    this.header = null;
    this._camera = null;
    this._pending = null;
    this._stage = stage;
    document.body.append(this.canvas);
    live.addEventListener("frame", (event) => this._take(event.detail));
    viser.beforeRender(() => this._draw());
    addEventListener("resize", () => this._layout());
  }

  /** Follow a camera, or none. */
  lock(camera) {
    if (this._camera !== camera) {
      this.header = null;
      this._drop();
    }
    this._camera = camera;
    this._paint();
  }

  setAlpha(alpha) {
    this.alpha = Math.min(1, Math.max(0, alpha));
    this._paint();
  }

  /** Pose and intrinsics to look through: of the image shown, else of the camera's node. */
  camera(name) {
    const { viser, header } = this;
    const site = viser.node("/site");
    const node = viser.node(`/site/cameras/${name}`);
    if (!site || !node) return null;
    if (!header?.K) {
      const f = 1280 / DEFAULT_FOV;
      return { matrix: node.matrixWorld, K: [f, f, 639.5, 479.5], width: 1280, height: 960 };
    }
    const { K, width, height, T_base_cam: T, stamp_ms: stampMs } = header;
    const sameStamp = viser.showAt(stampMs);
    let matrix = node.matrixWorld;
    if (T) matrix = new viser.Matrix4().set(...T).premultiply(site.matrixWorld);
    return { matrix, K, width, height, sameStamp };
  }

  _take({ header, bitmap }) {
    if (header.camera !== this._camera || header.variant !== "overlay") return;
    // Drawn with the next picture, so that image and scene change in one frame.
    this._drop();
    const copy = new OffscreenCanvas(bitmap.width, bitmap.height);
    copy.getContext("2d").drawImage(bitmap, 0, 0);
    this._pending = { header, image: copy };
    this.viser.requestRender();
  }

  _drop() {
    this._pending = null;
  }

  _draw() {
    if (!this._pending) return;
    const { header, image } = this._pending;
    this._pending = null;
    if (this.canvas.width !== image.width || this.canvas.height !== image.height) {
      this.canvas.width = image.width;
      this.canvas.height = image.height;
    }
    this.canvas.getContext("2d").drawImage(image, 0, 0);
    const first = !this.header;
    this.header = header;
    if (first) this._paint();
  }

  _paint() {
    const shown = this._camera !== null && this.header !== null;
    this.canvas.style.opacity = shown ? String(this.alpha) : "0";
    this._layout();
    this.viser.requestRender();
  }

  _layout() {
    if (!this.header) return;
    const r = fit(this._stage(), this.header.width, this.header.height);
    Object.assign(this.canvas.style, {
      left: `${r.x}px`,
      top: `${r.y}px`,
      width: `${r.width}px`,
      height: `${r.height}px`,
    });
  }
}
