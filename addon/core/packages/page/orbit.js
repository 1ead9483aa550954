// A camera that orbits around a target, moved by pointer, touch, wheel and keys. y is up, as in glTF.

const FIELD_OF_VIEW = 0.6; // radians, of the shorter side of the image
const MAX_ELEVATION = 1.56; // radians
const MIN_DISTANCE = 0.02, MAX_DISTANCE = 20; // times the distance that shows the whole object
const NEAR = 0.5; // of the radius: how much nearer than the center surfaces are that views from near show
const KEY_STEP = 0.1; // radians, or fraction of the distance
const { sin, cos, tan, hypot, min, max, exp } = Math;

export class Orbit {
  /** Move the camera by input to `canvas`, and call `changed` whenever it has moved. */
  constructor(canvas, changed) {
    Object.assign(this, { canvas, changed, radius: 1, center: [0, 0, 0] });
    this.reset();
    this.#listen();
  }

  /** Show a whole object between the corners `bounds`. */
  frame([low, high]) {
    this.center = low.map((value, axis) => (value + high[axis]) / 2);
    this.radius = hypot(...low.map((value, axis) => high[axis] - value)) / 2 || 1;
    this.reset();
  }

  /** Return to the first view. */
  reset() {
    this.set({ azimuth: 0.6, elevation: 0.3, zoom: 1, target: [...this.center] });
  }

  /** Set the view, or a part of it. azimuth, elevation: radians; zoom: 1 shows the whole object; target: position in the center. */
  set(view) {
    Object.assign(this, view);
    this.elevation = min(max(this.elevation, -MAX_ELEVATION), MAX_ELEVATION);
    this.zoom = min(max(this.zoom, 1 / MAX_DISTANCE), 1 / MIN_DISTANCE);
    this.changed();
  }

  /** The rows of the matrix from the object's space to the camera's, and the matrix to clip space by columns, for an image `aspect` times as
   * wide as high. */
  matrices(aspect) {
    const [sa, ca, se, ce] = [sin(this.azimuth), cos(this.azimuth), sin(this.elevation), cos(this.elevation)];
    const axes = [[ca, 0, -sa], [-se * sa, ce, -se * ca], [ce * sa, se, ce * ca]]; // right, up, towards the viewer
    const rows = axes.map((axis, i) => [...axis, -dot(axis, this.target) - (i === 2 ? this.distance : 0)]);
    const reach = this.radius + hypot(...this.target.map((value, i) => value - this.center[i]));
    const far = this.distance + reach, near = max(this.distance - reach, far * 1e-4);
    const focus = (1 / tan(FIELD_OF_VIEW / 2)) * min(aspect, 1);
    const scaled = [rows[0].map((value) => (value * focus) / aspect), rows[1].map((value) => value * focus)];
    const depth = rows[2].map((value, i) => (-(far + near) * value - (i === 3 ? 2 * far * near : 0)) / (far - near));
    const clip = [...scaled, depth, rows[2].map((value) => -value)];
    return { rows, clip: [0, 1, 2, 3].flatMap((column) => clip.map((row) => row[column])) };
  }

  get distance() {
    return this.#distanceAt(this.zoom);
  }

  /** The size of the object in an image of so many pixels, if all of it was as large as what is near. */
  pixels(width, height) {
    const reach = NEAR * this.radius;
    return (min(width, height) * (this.#distanceAt(1) - reach)) / max(this.distance - reach, 1e-6 * reach);
  }

  #distanceAt(zoom) {
    return (1.04 * this.radius) / sin(FIELD_OF_VIEW / 2) / zoom;
  }

  #turn(x, y) {
    this.set({ azimuth: this.azimuth - x, elevation: this.elevation + y });
  }

  /** Move the target by fractions of the image's shorter side. */
  #pan(x, y) {
    const { rows } = this.matrices(1), size = 2 * this.distance * tan(FIELD_OF_VIEW / 2);
    this.set({ target: this.target.map((value, axis) => value - size * (x * rows[0][axis] - y * rows[1][axis])) });
  }

  #listen() {
    const { canvas } = this, pointers = new Map();
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const after = [event.clientX, event.clientY], size = min(canvas.clientWidth, canvas.clientHeight);
      const [x, y] = after.map((value, axis) => (value - before[axis]) / size);
      const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
      pointers.set(event.pointerId, after);
      if (other) {
        const length = (point) => hypot(point[0] - other[0], point[1] - other[1]) || 1;
        this.set({ zoom: (this.zoom * length(after)) / length(before) });
        this.#pan(x / 2, y / 2);
      } else if (event.shiftKey || event.buttons & 6) this.#pan(x, y);
      else this.#turn(4 * x, 4 * y);
    });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.set({ zoom: this.zoom * exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)) });
    }, { passive: false });
    canvas.addEventListener("dblclick", () => this.reset());
    canvas.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      const zoom = { "+": 1, "=": 1, "-": -1 }[event.key];
      if (steps && event.shiftKey) this.#pan(steps[0] * KEY_STEP, steps[1] * KEY_STEP);
      else if (steps) this.#turn(-steps[0] * KEY_STEP, -steps[1] * KEY_STEP);
      else if (zoom) this.set({ zoom: this.zoom * exp(zoom * KEY_STEP) });
      else if (event.key === "Home") this.reset();
      else return;
      event.preventDefault();
    });
  }
}

function dot(a, b) {
  return a.reduce((sum, value, i) => sum + value * b[i], 0);
}
