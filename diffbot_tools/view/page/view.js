import { extentOf, rangeOf } from "./geometry.js";

// What part of the plane the map shows: x to the right and y up, as on paper.

const SMALLEST = 0.5;
const LARGEST = 5000;
const LARGEST_FIT = 1500;

export class View {
  constructor() {
    Object.assign(this, { x: 0, y: 0, scale: 60, width: 300, height: 200, follow: false });
  }

  /** Pixels of a point [m]. */
  toScreen(x, y) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  /** Point [m] of pixels. */
  toWorld(px, py) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  /** Move the content by pixels. */
  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
    this.follow = false;
  }

  /** Zoom about a pixel, which keeps its point. */
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toWorld(px, py);
    this.scale = Math.min(Math.max(this.scale * factor, SMALLEST), LARGEST);
    const [newX, newY] = this.toWorld(px, py);
    this.x += x - newX;
    this.y += y - newY;
  }

  /** Show all paths, goals and landmarks of a robot. */
  fit(robot) {
    let xs = null;
    let ys = null;
    for (const name of ["truth", "estimate", "odometry"]) {
      const curve = robot.curves[name];
      if (!curve) continue;
      xs = rangeOf(curve.columns.x, 0, curve.rows, xs);
      ys = rangeOf(curve.columns.y, 0, curve.rows, ys);
    }
    const { plan } = robot;
    const points = [...robot.goals.map(([, x, y]) => ({ x, y })), ...robot.landmarks.values()];
    xs = rangeOf([...points.map(({ x }) => x), ...plan.columns.x], 0, points.length + plan.rows, xs);
    ys = rangeOf([...points.map(({ y }) => y), ...plan.columns.y], 0, points.length + plan.rows, ys);
    if (!xs || !ys) return;
    this.x = (xs[0] + xs[1]) / 2;
    this.y = (ys[0] + ys[1]) / 2;
    const [width, height] = [xs[1] - xs[0], ys[1] - ys[0]];
    const margin = 0.15 * Math.max(width, height) + 1.5 * (extentOf(robot.size) || 0.5);
    const wide = Math.min(this.width / (width + margin), this.height / (height + margin));
    this.scale = Math.min(Math.max(wide, SMALLEST), LARGEST_FIT);
    this.follow = false;
  }
}
