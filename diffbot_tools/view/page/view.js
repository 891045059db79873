import { rangeOf } from "./geometry.js";

// The part of the plane that the map shows (x to the right, y up), and how mouse, touch and keys move it.

const MIN_SCALE = 0.5; // [pixels/m]
const MAX_SCALE = 5000;
const MIN_SIZE = 5; // [m] smallest width and height that are shown
const EDGE = 10; // [pixels] a point that is closer to the border counts as out of view
const MIN_DRAG = 8; // [pixels] shortest drag that gives a heading

export class View {
  constructor() {
    Object.assign(this, { x: 0, y: 0, scale: 60, width: 300, height: 200, follow: false, isMoved: false });
  }

  /** Return the pixels of a point [m]. */
  toScreen(x, y) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  /** Return the point [m] of pixels. */
  toWorld(px, py) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  /** Move the content by pixels. */
  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
    this.follow = false;
    this.isMoved = true; // by the user
  }

  /** Zoom; the point [m] at the pixel (px, py) keeps its place on the screen. */
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toWorld(px, py);
    this.scale = Math.min(Math.max(this.scale * factor, MIN_SCALE), MAX_SCALE);
    const [newX, newY] = this.toWorld(px, py);
    this.x += x - newX;
    this.y += y - newY;
    this.isMoved = true; // by the user
  }

  /** Show all paths, goals and landmarks of a robot. */
  fit(robot) {
    const curves = ["truth", "estimate", "odometry"].flatMap((name) => robot.curves[name] ?? []);
    const points = robot.goals.map(([, x, y]) => [x, y]);
    for (const { x, y } of robot.landmarks.values()) points.push([x, y]);
    if (robot.dock?.pose) points.push(robot.dock.pose);
    const [xs, ys] = ["x", "y"].map((axis, index) => {
      const own = rangeOf(points.map((point) => point[index]), 0, points.length);
      return [...curves, robot.plan].reduce((range, { columns, rows }) => rangeOf(columns[axis], 0, rows, range), own);
    });
    if (!xs || !ys) return;
    this.x = (xs[0] + xs[1]) / 2;
    this.y = (ys[0] + ys[1]) / 2;
    const [width, height] = [xs[1] - xs[0], ys[1] - ys[0]];
    const margin = 0.15 * Math.max(width, height) + 0.5;
    const wide = Math.min(this.width / Math.max(width + margin, MIN_SIZE), this.height / Math.max(height + margin, MIN_SIZE));
    this.scale = Math.min(Math.max(wide, MIN_SCALE), MAX_SCALE);
    this.follow = this.isMoved = false;
  }

  /** If the robot, its goal or its dock is out of view, show all again, unless the user has moved the view. */
  keep(robot, time) {
    if (this.isMoved || this.follow) return;
    const [pose, goal] = [robot.main?.poseAt(time), robot.goalAt(time)];
    const points = [...(pose ? [[pose.x, pose.y]] : []), ...(goal ? [[goal[1], goal[2]]] : [])];
    if (robot.dock?.pose) points.push(robot.dock.pose);
    const isOut = ([x, y]) => {
      const [px, py] = this.toScreen(x, y);
      return !(px > EDGE && py > EDGE && px < this.width - EDGE && py < this.height - EDGE);
    };
    if (points.some(isOut)) this.fit(robot);
  }
}

/**
 * Make the map of `view` react to mouse, touch and keys. `tools.current` is "pan", "goal" or "initialpose". To draw a pose,
 * press at its position, drag in the direction of its heading and release; `tools.draw` is the pose being drawn.
 */
export function startPointer(canvas, view, tools, { onPose, onChange, onHint, onHover }) {
  const pressed = new Map();
  let start = null;

  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const drawn = ([px, py]) => {
    const [x, y] = view.toWorld(...start);
    const theta = Math.atan2(start[1] - py, px - start[0]);
    return { x, y, theta, isLong: Math.hypot(px - start[0], py - start[1]) >= MIN_DRAG };
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    pressed.set(event.pointerId, place(event));
    start = pressed.size === 1 ? place(event) : null;
    tools.draw = null;
  });

  canvas.addEventListener("pointermove", (event) => {
    const before = pressed.get(event.pointerId);
    const now = place(event);
    onHover(now);
    if (!before) return;
    if (pressed.size === 2) {
      const [other] = [...pressed].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
      const apart = (at) => Math.max(Math.hypot(at[0] - other[0], at[1] - other[1]), 1);
      view.zoom(apart(now) / apart(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
      view.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
    } else if (tools.current === "pan") view.pan(now[0] - before[0], now[1] - before[1]);
    else if (start) tools.draw = drawn(now);
    pressed.set(event.pointerId, now);
    onChange();
  });

  canvas.addEventListener("pointerup", (event) => {
    if (!pressed.delete(event.pointerId)) return;
    const kind = tools.current;
    if (kind !== "pan" && start) {
      const pose = drawn(place(event));
      if (pose.isLong) onPose(kind, pose);
      else onHint("Drag to set the heading: press at the position, drag towards the heading, release.");
    }
    start = null;
    tools.draw = null;
    onChange();
  });

  canvas.addEventListener("pointerleave", () => onHover(null));

  canvas.addEventListener("pointercancel", (event) => {
    pressed.delete(event.pointerId);
    start = null;
    tools.draw = null;
  });

  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      view.zoom(Math.exp(-0.0015 * event.deltaY), ...place(event));
      onChange();
    },
    { passive: false },
  );

  const moves = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
  canvas.addEventListener("keydown", (event) => {
    if (moves[event.key]) view.pan(...moves[event.key]);
    else if (event.key === "+" || event.key === "=") view.zoom(1.25);
    else if (event.key === "-") view.zoom(0.8);
    else return;
    event.preventDefault();
    onChange();
  });
}
