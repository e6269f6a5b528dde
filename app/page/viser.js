// The one module that knows viser's page: its scene, its camera and the poses of its nodes.

const POSES_KEPT = 120;
const MODULO_MS = 1e6;

/** Wait for viser's page to expose itself. */
export async function viserReady() {
  for (;;) {
    const mutable = window.__viserMutable;
    if (mutable?.scene && mutable.camera && mutable.cameraControl && mutable.canvas) {
      return new Viser(mutable);
    }
    await new Promise((resolve) => setTimeout(resolve, 30));
  }
}

class Viser {
  constructor(mutable) {
    this.mutable = mutable;
    this.Vector3 = mutable.camera.position.constructor;
    this.Quaternion = mutable.camera.quaternion.constructor;
    this.Matrix4 = mutable.camera.matrixWorld.constructor;
    this.frames = 0;
    this.history = [];
    this._hooks = [];
    this._held = false;
    mutable.scene.onBeforeRender = (renderer, scene, camera) => {
      if (camera !== this.mutable.camera) return;
      this.frames += 1;
      this._remember();
      for (const hook of this._hooks) hook();
    };
  }

  /** Call before every picture of the main camera, after matrices are up to date. */
  beforeRender(hook) {
    this._hooks.push(hook);
  }

  get camera() {
    return this.mutable.camera;
  }

  get controls() {
    return this.mutable.cameraControl;
  }

  get canvas() {
    return this.mutable.canvas;
  }

  node(name) {
    const node = this.mutable.nodeRefFromName[name];
    return node?.parent ? node : undefined;
  }

  position(name) {
    const node = this.node(name);
    return node ? new this.Vector3().setFromMatrixPosition(node.matrixWorld) : null;
  }

  requestRender() {
    this.mutable.requestRender();
  }

  /** Tick of the newest state that arrived, drawn or not; null before the first. */
  get tick() {
    const waiting = this.mutable.messageQueue;
    for (let i = waiting.length - 1; i >= 0; i--) {
      const message = waiting[i];
      if (message.name === "/heartbeat" && message.position) return message.position[0];
    }
    return this.mutable.nodePoseData["/heartbeat"]?.position?.[0] ?? null;
  }

  /** Show all nodes of the site as they were at a stamp; false when that is not known. */
  showAt(stampMs) {
    const entries = this.history;
    const wanted = stampMs % MODULO_MS;
    let later = -1;
    for (let i = entries.length - 1; i >= 0 && entries[i].ms >= wanted; i--) later = i;
    if (later <= 0) return false;
    const [a, b] = [entries[later - 1], entries[later]];
    const share = (wanted - a.ms) / Math.max(b.ms - a.ms, 1e-6);
    const [p, q] = [new this.Vector3(), new this.Quaternion()];
    for (const [name, [position, wxyz]] of b.poses) {
      const node = this.node(name);
      const before = a.poses.get(name);
      if (!node || !before) continue;
      node.position.fromArray(before[0]).lerp(p.fromArray(position), share);
      node.quaternion.copy(quaternion(new this.Quaternion(), before[1]));
      node.quaternion.slerp(quaternion(q, wxyz), share);
    }
    this._held = true;
    this.node("/site")?.updateMatrixWorld(true);
    return true;
  }

  /** Back to the newest poses after `showAt`. */
  showNow() {
    if (!this._held) return;
    this._held = false;
    for (const pose of Object.values(this.mutable.nodePoseData)) {
      if (pose && pose.poseUpdateState === "updated") pose.poseUpdateState = "needsUpdate";
    }
    this.requestRender();
  }

  _remember() {
    const data = this.mutable.nodePoseData;
    const beat = data["/heartbeat"]?.position;
    if (!beat) return;
    const newest = this.history.at(-1);
    if (newest && newest.tick === beat[0]) return;
    if (newest && (beat[1] < newest.ms || beat[0] < newest.tick)) this.history.length = 0;
    const poses = new Map();
    for (const [name, pose] of Object.entries(data)) {
      if (pose && name.startsWith("/site/")) poses.set(name, [pose.position, pose.wxyz]);
    }
    this.history.push({ tick: beat[0], ms: beat[1], poses });
    if (this.history.length > POSES_KEPT) this.history.shift();
  }
}

function quaternion(target, wxyz) {
  return target.set(wxyz[1], wxyz[2], wxyz[3], wxyz[0]);
}
