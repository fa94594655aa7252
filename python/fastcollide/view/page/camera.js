// A camera that looks at a point from a distance and turns around it; z is up.

const FIELD_OF_VIEW = (34 * Math.PI) / 180;

export class Camera {
  constructor() {
    this.lower = [0, 0, 0];
    this.upper = [1, 1, 1];
    this.margins = { left: 0, right: 0, top: 0, bottom: 0 };
    this.home();
  }

  setBox(lower, upper) {
    this.lower = lower;
    this.upper = upper;
    this.home();
  }

  home() {
    this.yaw = -1.05;
    this.pitch = 0.3;
    this.target = this.lower.map((low, axis) => (low + this.upper[axis]) / 2);
    this.size = Math.hypot(...this.lower.map((low, axis) => this.upper[axis] - low)) / 2;
    this.distance = null; // to suit the window
    this.isHome = true;
  }

  // What lies over the canvas has changed [CSS pixels].
  keepFree(margins) {
    this.margins = margins;
    if (this.isHome) this.distance = null;
  }

  get direction() {
    const [c, s] = [Math.cos(this.pitch), Math.sin(this.pitch)];
    return [c * Math.cos(this.yaw), c * Math.sin(this.yaw), s]; // from the target to the eye
  }

  get axes() {
    const [c, s] = [Math.cos(this.yaw), Math.sin(this.yaw)];
    const [x, y, z] = this.direction;
    const right = [-s, c, 0];
    return { right, up: [y * right[2] - z * right[1], z * right[0] - x * right[2], x * right[1] - y * right[0]] };
  }

  get eye() {
    const { direction } = this;
    return this.target.map((t, axis) => t + this.distance * direction[axis]);
  }

  turn(dx, dy) {
    this.isHome = false;
    this.yaw -= dx * 0.006;
    this.pitch = Math.min(1.55, Math.max(-1.55, this.pitch + dy * 0.006));
  }

  zoom(factor) {
    this.isHome = false;
    this.distance = Math.min(this.size * 40, Math.max(this.size * 0.005, this.distance * factor));
  }

  // Moves with the pointer, as far as a point in the target's plane does.
  pan(dx, dy, height) {
    this.isHome = false;
    const { right, up } = this.axes;
    const scale = (2 * this.distance * Math.tan(FIELD_OF_VIEW / 2)) / height;
    this.target = this.target.map((t, axis) => t + scale * (dy * up[axis] - dx * right[axis]));
  }

  // In pixels of the canvas, which may be finer than those of CSS. What lies over the canvas is kept free.
  matrices(width, height) {
    const scale = height / Math.max(1, this.cssHeight ?? height);
    const m = this.margins;
    const free = [width - scale * (m.left + m.right), height - scale * (m.top + m.bottom)].map((side) => Math.max(side, 50));
    const tan = Math.tan(FIELD_OF_VIEW / 2);
    if (this.distance === null) this.distance = this.#distanceFor((tan * free[0]) / height, (tan * free[1]) / height);
    const { right, up } = this.axes;
    const { direction, eye } = this;
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const view = new Float32Array([
      right[0], up[0], direction[0], 0, right[1], up[1], direction[1], 0, right[2], up[2], direction[2], 0,
      -dot(right, eye), -dot(up, eye), -dot(direction, eye), 1,
    ]);
    const away = Math.hypot(...eye.map((e, axis) => e - (this.lower[axis] + this.upper[axis]) / 2));
    const far = (away + 2 * this.size) * 1.5;
    const near = Math.max(far * 1e-5, away - 2 * this.size, this.distance * 0.01);
    const shift = [(scale * (m.right - m.left)) / width, (scale * (m.top - m.bottom)) / height];
    const [sx, sy] = [height / (width * tan), 1 / tan];
    const projection = new Float32Array([
      sx, 0, 0, 0, 0, sy, 0, 0, shift[0], shift[1], -(far + near) / (far - near), -1,
      0, 0, (-2 * far * near) / (far - near), 0,
    ]);
    return { view, projection, distance: away, extent: 2.2 * this.size };
  }

  // The ray through a point of the canvas, both in CSS pixels.
  ray(x, y, width, height) {
    const { projection } = this.matrices(width, height);
    const across = ((2 * x) / width - 1 + projection[8]) / projection[0];
    const along = (1 - (2 * y) / height + projection[9]) / projection[5];
    const { right, up } = this.axes;
    const ray = this.direction.map((d, axis) => across * right[axis] + along * up[axis] - d);
    const length = Math.hypot(...ray);
    return { eye: this.eye, ray: ray.map((component) => component / length) };
  }

  // The nearest distance from which all corners of the box are seen.
  #distanceFor(tanAcross, tanAlong) {
    const { right, up } = this.axes;
    const { direction } = this;
    let distance = 0;
    for (let i = 0; i < 8; ++i) {
      const corner = [0, 1, 2].map((axis) => (((i >> axis) & 1 ? this.upper : this.lower)[axis]) - this.target[axis]);
      const along = (axis) => corner[0] * axis[0] + corner[1] * axis[1] + corner[2] * axis[2];
      const toward = along(direction);
      distance = Math.max(distance, toward + Math.abs(along(right)) / tanAcross, toward + Math.abs(along(up)) / tanAlong);
    }
    return distance * 1.04;
  }
}
