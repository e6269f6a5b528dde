// Where the operator looks from: presets, smooth moves, follow, and the lock on a real camera.
//
// viser's orbit controls keep working in a frame that may be carried: the picture is taken from
//     M = C . M_controls,   C = 1 (free) | shift of a node (follow) | motion of a node (ride)
// so following never fights the operator's hand and never drifts. Through a camera, M comes from
// the camera's pose and the projection from its K. Changes blend over MOVE_MS.

const MOVE_MS = 300;
const FOV_DEG = 42;
const NEAR_M = 0.01;
const CUT_M = 0.03; // below the base of the arm
const FLIP = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1];

export const PRESETS = [
  { key: "1", id: "free", label: "Free", hint: "Orbit freely; the view stays where it is" },
  { key: "2", id: "tool", label: "Tool", hint: "Follow the position of the tool" },
  { key: "3", id: "ride", label: "Ride", hint: "Follow position and attitude of the tool" },
  { key: "4", id: "hc", label: "Hand-eye", hint: "Through the hand-eye camera", camera: "hc" },
  { key: "5", id: "mako", label: "Mako", hint: "Through the camera on the platform", camera: "mako" },
  { key: "6", id: "top", label: "Top", hint: "From above", from: [-0.02, 0, 1] },
  { key: "7", id: "front", label: "Front", hint: "Along the platform's x", from: [1, 0, 0.18] },
  { key: "8", id: "side", label: "Side", hint: "Along the platform's y", from: [0, -1, 0.18] },
  { key: "9", id: "target", label: "Target", hint: "Close-up of the target" },
];

export class View extends EventTarget {
  constructor(viser, { targetNode, overlay, stage }) {
    super();
    this.viser = viser;
    this.preset = PRESETS[0];
    this._targetNode = targetNode;
    this._overlay = overlay;
    this._stage = stage; // rectangle the camera image is fitted into [CSS px]
    this._carry = null; // {name, turn, inverse}
    this._blend = null; // {from, projection, start}
    this._now = { position: new viser.Vector3(), quaternion: new viser.Quaternion() };
    this._projection = new viser.Matrix4();
    viser.camera.fov = FOV_DEG;
    viser.camera.updateProjectionMatrix();
    viser.beforeRender(() => this._render());
    this._watchHand();
  }

  get locked() {
    return Boolean(this.preset.camera);
  }

  /** Go to a preset by its id. */
  go(id, { smooth = true } = {}) {
    const preset = PRESETS.find((p) => p.id === id);
    if (!preset) return;
    this._snapshot(smooth);
    this._settle();
    this.preset = preset;
    if (preset.from) this._lookFrom(preset.from);
    else if (id === "tool") this._pivotOn("/site/tool", null);
    else if (id === "ride") this._pivotOn("/site/tool", null, { turn: true });
    else if (id === "target") this._pivotOn(this._targetNode(), 1.15, { from: [0.7, -0.65, 0.6] });
    this._overlay.lock(preset.camera ?? null);
    this.dispatchEvent(new Event("change"));
    this.viser.requestRender();
  }

  /** Put the view where everything is seen, from the front right above. */
  frameAll({ smooth = false } = {}) {
    this._snapshot(smooth);
    this._lookFrom([0.9, -0.75, 0.42]);
    this.viser.requestRender();
  }

  /** Numbers that bring this view back: "px,py,pz,tx,ty,tz" in the site's display axes. */
  get pose() {
    const { viser } = this;
    const { position, target } = this._orbit();
    const inverse = this._root().clone().invert();
    return [position, target]
      .flatMap((p) => p.applyMatrix4(inverse).toArray())
      .map((x) => x.toFixed(3))
      .join(",");
  }

  set pose(text) {
    const numbers = text.split(",").map(Number);
    if (numbers.length !== 6 || !numbers.every(Number.isFinite)) return;
    const root = this._root();
    const V = this.viser.Vector3;
    const position = new V(...numbers.slice(0, 3)).applyMatrix4(root);
    const target = new V(...numbers.slice(3)).applyMatrix4(root);
    this._place(position, target);
  }

  _root() {
    return this.viser.node("")?.matrixWorld ?? new this.viser.Matrix4();
  }

  /** Orbit position and pivot as seen, the carry included. */
  _orbit() {
    const { viser } = this;
    const position = viser.controls.getPosition(new viser.Vector3());
    const target = viser.controls.getTarget(new viser.Vector3());
    const carry = this._carrier();
    if (carry) for (const p of [position, target]) p.applyMatrix4(carry);
    return { position, target };
  }

  _place(position, target) {
    this._carry = null;
    this.viser.controls.setLookAt(...position.toArray(), ...target.toArray(), false);
  }

  /** Hand the view as it is to the orbit controls. */
  _settle() {
    const { viser } = this;
    if (this.locked) {
      const { position, quaternion } = this._now;
      const ahead = new viser.Vector3(0, 0, -1).applyQuaternion(quaternion);
      const distance = this._distanceAhead(position, ahead);
      this._place(position.clone(), ahead.multiplyScalar(distance).add(position));
    } else {
      const { position, target } = this._orbit();
      this._place(position, target);
    }
  }

  /** Distance to what the camera looks at: the nearest node ahead, else a metre. */
  _distanceAhead(position, ahead) {
    const tool = this.viser.position(this._targetNode()) ?? this.viser.position("/site/tool");
    const depth = tool ? tool.sub(position).dot(ahead) : 1;
    return Math.min(Math.max(depth, 0.2), 4);
  }

  _interesting() {
    const { viser } = this;
    const names = Object.keys(viser.mutable.nodePoseData).filter(
      (name) => /^\/site\/(objects|robot)\/[^/]+$/.test(name) || name === "/site/tool",
    );
    const shown = names.filter((name) => viser.node(name)?.visible);
    return shown.map((name) => viser.position(name)).filter(Boolean);
  }

  _lookFrom(direction) {
    const { viser } = this;
    const points = this._interesting();
    const centre = new viser.Vector3();
    const low = new viser.Vector3(Infinity, Infinity, Infinity);
    const high = new viser.Vector3(-Infinity, -Infinity, -Infinity);
    for (const p of points) {
      low.min(p);
      high.max(p);
    }
    if (points.length) centre.addVectors(low, high).multiplyScalar(0.5);
    const radius = points.length ? Math.max(0.5, low.distanceTo(high) * 0.58 + 0.1) : 1.5;
    const half = (FOV_DEG * Math.PI) / 360;
    const narrow = Math.min(1, viser.camera.aspect);
    const away = new viser.Vector3(...direction).normalize().transformDirection(this._root());
    this._place(away.multiplyScalar(radius / Math.sin(half) / narrow).add(centre), centre);
  }

  /** Turn around a node and go where it goes; keep the direction of view unless one is given. */
  _pivotOn(name, distance, { turn = false, from = null } = {}) {
    const { viser } = this;
    const pivot = viser.position(name);
    if (!pivot) return;
    const { position, target } = this._orbit();
    const away = position.sub(target);
    if (from) away.set(...from).transformDirection(this._root());
    const length = distance ?? Math.min(Math.max(away.length(), 0.5), 1.6);
    this._place(away.setLength(length).add(pivot), pivot);
    const inverse = viser.node(name).matrixWorld.clone().invert();
    this._carry = { name, turn, inverse, pivot: pivot.clone() };
  }

  _carrier() {
    const { viser } = this;
    const node = this._carry && viser.node(this._carry.name);
    if (!node) return null;
    const { turn, inverse, pivot } = this._carry;
    if (turn) return node.matrixWorld.clone().multiply(inverse);
    const shift = new viser.Vector3().setFromMatrixPosition(node.matrixWorld).sub(pivot);
    return new viser.Matrix4().makeTranslation(shift.x, shift.y, shift.z);
  }

  _snapshot(smooth) {
    this._blend = smooth
      ? {
          position: this._now.position.clone(),
          quaternion: this._now.quaternion.clone(),
          projection: this._projection.clone(),
          start: performance.now(),
        }
      : null;
  }

  _render() {
    const { viser } = this;
    const camera = viser.camera;
    const lock = this.locked ? this._overlay.camera(this.preset.camera) : null;
    const matrix = new viser.Matrix4();
    if (!lock?.sameStamp) viser.showNow();
    if (lock) {
      matrix.copy(lock.matrix).multiply(new viser.Matrix4().set(...FLIP));
    } else {
      matrix.copy(camera.matrixWorld);
      const carry = this._carrier();
      if (carry) matrix.premultiply(carry);
    }
    camera.near = this._near(matrix);
    camera.updateProjectionMatrix();
    if (lock) this._project(camera.projectionMatrix, lock);
    matrix.decompose(this._now.position, this._now.quaternion, new viser.Vector3());
    this._projection.copy(camera.projectionMatrix);
    if (this._blend) this._mix(camera.projectionMatrix);
    matrix.compose(this._now.position, this._now.quaternion, new viser.Vector3(1, 1, 1));
    camera.matrixWorld.copy(matrix);
    camera.matrixWorldInverse.copy(matrix).invert();
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  }

  /** Seen from above, the platform is cut away: it would hide all there is to see. */
  _near(matrix) {
    const { viser } = this;
    const site = viser.node("/site");
    if (this.preset.id !== "top" || this._blend || !site) return NEAR_M;
    const ahead = new viser.Vector3(0, 0, -1).transformDirection(matrix);
    const down = new viser.Vector3(0, 0, -1).transformDirection(this._root());
    if (ahead.dot(down) < 0.9) return NEAR_M;
    const origin = new viser.Vector3().setFromMatrixPosition(site.matrixWorld);
    const eye = new viser.Vector3().setFromMatrixPosition(matrix);
    return Math.max(NEAR_M, origin.sub(eye).dot(ahead) + CUT_M);
  }

  _mix(projection) {
    const t = (performance.now() - this._blend.start) / MOVE_MS;
    if (t >= 1) {
      this._blend = null;
      return;
    }
    const s = t * t * (3 - 2 * t);
    const { position, quaternion } = this._now;
    position.lerpVectors(this._blend.position, position.clone(), s);
    quaternion.slerpQuaternions(this._blend.quaternion, quaternion.clone(), s);
    const [a, b] = [this._blend.projection.elements, projection.elements];
    for (let i = 0; i < 16; i++) b[i] = a[i] + (b[i] - a[i]) * s;
    this.viser.requestRender();
  }

  /** Projection of a pinhole camera whose image lies in a rectangle of the canvas. */
  _project(projection, { K, width, height }) {
    const canvas = this.viser.canvas;
    const [w, h] = [canvas.clientWidth, canvas.clientHeight];
    const r = fit(this._stage(), width, height);
    const [fx, fy, cx, cy] = K;
    const e = projection.elements;
    // Pixel centres are integers: column u lies u + 0.5 pixels from the edge.
    e[0] = (2 * r.scale * fx) / w;
    e[5] = (2 * r.scale * fy) / h;
    e[8] = 1 - (2 * (r.x + r.scale * (cx + 0.5))) / w;
    e[9] = (2 * (r.y + r.scale * (cy + 0.5))) / h - 1;
  }

  /** Taking hold of a locked view frees it where it is. */
  _watchHand() {
    const free = (event) => {
      if (this.locked && event.target === this.viser.canvas) this.go("free", { smooth: false });
    };
    window.addEventListener("pointerdown", free, { capture: true });
    window.addEventListener("wheel", free, { capture: true, passive: true });
  }
}

/** Fit an image into a rectangle: {x, y, width, height, scale}, aspect kept, centred. */
export function fit(rect, width, height) {
  const scale = Math.min(rect.width / width, rect.height / height);
  const [w, h] = [width * scale, height * scale];
  return {
    x: rect.x + (rect.width - w) / 2,
    y: rect.y + (rect.height - h) / 2,
    width: w,
    height: h,
    scale,
  };
}
