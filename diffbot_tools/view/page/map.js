import { ellipseOf, lastAtMost, roundStep, shown, TWO_PI } from "./geometry.js";

// Draws the map: grid, paths, fixes, goals with tolerance and region, landmarks, the dock, robots.

const PATHS = ["odometry", "truth", "estimate"];
const MIN_RADIUS = 9; // [pixels] smallest radius of a robot, and radius of a robot of unknown size
const MAX_ELLIPSES = 60;
const MAX_WAYPOINTS = 50; // the waypoints of a longer path are not drawn
const CROSS = 4; // [pixels] half the size of a detection of the dock

/** Clear a canvas, adapt it to the resolution of the screen, and return its context in units of CSS pixels. */
export function cleared(canvas) {
  const ratio = Math.min(globalThis.devicePixelRatio || 1, 2);
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return context;
}

function drawGrid(context, view, colours) {
  const step = roundStep(110 / view.scale);
  const [left, top] = view.toWorld(0, 0);
  const [right, bottom] = view.toWorld(view.width, view.height);
  context.strokeStyle = colours.line;
  context.fillStyle = colours.faint;
  context.lineWidth = 1;
  context.font = "11px system-ui, sans-serif";
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  context.beginPath();
  for (let k = Math.ceil(left / step); k * step <= right; k += 1) {
    const [px] = view.toScreen(k * step, 0);
    context.moveTo(px, 0);
    context.lineTo(px, view.height);
    if (px < view.width - 50) context.fillText(`${(k * step).toFixed(digits)} m`, px + 2, view.height - 4);
  }
  for (let k = Math.ceil(bottom / step); k * step <= top; k += 1) {
    const [, py] = view.toScreen(0, k * step);
    context.moveTo(0, py);
    context.lineTo(view.width, py);
    if (py > 12 && py < view.height - 16) context.fillText(`${(k * step).toFixed(digits)} m`, 2, py - 2);
  }
  context.stroke();
}

/** Trace rows from `begin` to `end`; skip points that are closer than 3 pixels to the previous point. */
function tracePath(context, view, curve, begin, end) {
  const { x, y } = curve.columns;
  let lastX = Infinity;
  let lastY = Infinity;
  context.beginPath();
  for (let i = begin; i < end; i += 1) {
    const px = view.width / 2 + (x[i] - view.x) * view.scale;
    const py = view.height / 2 - (y[i] - view.y) * view.scale;
    if (Math.abs(px - lastX) + Math.abs(py - lastY) < 3 && i < end - 1) continue;
    if (lastX === Infinity) context.moveTo(px, py);
    else context.lineTo(px, py);
    lastX = px;
    lastY = py;
  }
}

/**
 * An image of the paths. Paths of many minutes cannot be drawn within a frame. As long as the view does not change, a frame
 * adds only the new rows to the image.
 */
class PathLayer {
  constructor() {
    this.canvas = document.createElement("canvas");
    this.key = "";
    this.drawn = {};
  }

  /** Draw the paths, bright up to a time and pale after it. */
  draw(context, view, robot, time, hidden, colours) {
    const { width, height } = context.canvas;
    const shown = PATHS.filter((name) => robot.curves[name] && !hidden.has(name));
    const ends = Object.fromEntries(shown.map((name) => [name, robot.curves[name].indexAt(time) + 1]));
    const key = [view.x, view.y, view.scale, width, height, robot.name, colours.page, ...shown].join(" ");
    const layer = this.canvas.getContext("2d");
    if (key !== this.key || shown.some((name) => !(ends[name] >= this.drawn[name]))) {
      this.key = key;
      this.drawn = Object.fromEntries(shown.map((name) => [name, 0]));
      Object.assign(this.canvas, { width, height }); // clears it
      layer.setTransform(context.getTransform());
      for (const name of shown) {
        const curve = robot.curves[name];
        if (ends[name] < curve.rows) this.add(layer, view, curve, Math.max(ends[name] - 1, 0), curve.rows, name, colours, 0.22);
      }
    }
    for (const name of shown) {
      // The last drawn point is drawn again, so that the parts are joined.
      if (ends[name] > this.drawn[name]) this.add(layer, view, robot.curves[name], Math.max(this.drawn[name] - 1, 0), ends[name], name, colours, 1);
      this.drawn[name] = ends[name];
    }
    context.save();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.canvas, 0, 0);
    context.restore();
  }

  add(layer, view, curve, begin, end, name, colours, alpha) {
    layer.strokeStyle = colours[name];
    layer.lineWidth = name === "truth" ? 3 : 1.5;
    layer.lineJoin = "bevel"; // the fastest to draw
    layer.globalAlpha = alpha;
    tracePath(layer, view, curve, begin, end);
    layer.stroke();
  }
}
const pathLayer = new PathLayer();

function drawFixes(context, view, curve, time, colour) {
  const { x, y } = curve.columns;
  const end = curve.indexAt(time) + 1;
  const every = Math.max(1, Math.floor(end / 3000));
  context.fillStyle = colour;
  context.globalAlpha = 0.7;
  for (let i = (end - 1) % every; i < end; i += every) {
    const [px, py] = view.toScreen(x[i], y[i]);
    if (px > 0 && py > 0 && px < view.width && py < view.height) context.fillRect(px - 1, py - 1, 2, 2);
  }
  context.globalAlpha = 1;
}

function addEllipse(context, view, columns, index) {
  const { a, b, angle } = ellipseOf(columns.xx[index], columns.xy[index], columns.yy[index]);
  const [px, py] = view.toScreen(columns.x[index], columns.y[index]);
  if (!Number.isFinite(a)) return;
  const radius = a * view.scale;
  context.moveTo(px + radius * Math.cos(angle), py - radius * Math.sin(angle));
  context.ellipse(px, py, radius, b * view.scale, -angle, 0, TWO_PI);
}

/** Draw at most MAX_ELLIPSES 95 % ellipses along the path, at least 60 pixels apart, and fill the ellipse at `time`. */
function drawEllipses(context, view, curve, time, colours) {
  if (!curve.columns.xx) return;
  const { x, y } = curve.columns;
  const now = curve.indexAt(time);
  const chosen = [];
  for (let i = 0, last = -1; i < now; i += 1) {
    if (last >= 0 && Math.hypot(x[i] - x[last], y[i] - y[last]) * view.scale < 60) continue;
    last = i;
    chosen.push(i);
  }
  const every = Math.ceil(chosen.length / MAX_ELLIPSES);
  context.strokeStyle = colours.estimate;
  context.lineWidth = 1;
  context.globalAlpha = 0.55;
  context.beginPath();
  for (let k = 0; k < chosen.length; k += every) addEllipse(context, view, curve.columns, chosen[k]);
  context.stroke();
  context.globalAlpha = 1;
  if (now < 0) return;
  context.beginPath();
  addEllipse(context, view, curve.columns, now);
  context.fillStyle = colours.band;
  context.fill();
  context.stroke();
}

/** Draw an arrow of `length` pixels from a pose. */
export function drawArrow(context, view, pose, length, colour) {
  const [px, py] = view.toScreen(pose.x, pose.y);
  const [dx, dy] = [Math.cos(pose.theta), -Math.sin(pose.theta)];
  context.strokeStyle = colour;
  context.fillStyle = colour;
  context.lineWidth = 3;
  context.beginPath();
  context.moveTo(px, py);
  context.lineTo(px + length * dx, py + length * dy);
  context.stroke();
  context.beginPath();
  context.moveTo(px + (length + 8) * dx, py + (length + 8) * dy);
  context.lineTo(px + (length - 4) * dx - 6 * dy, py + (length - 4) * dy + 6 * dx);
  context.lineTo(px + (length - 4) * dx + 6 * dy, py + (length - 4) * dy - 6 * dx);
  context.fill();
}

function drawGoal(context, view, robot, time, constants, colours) {
  const goal = robot.goalAt(time);
  for (const [, x, y, theta] of robot.goals) {
    context.globalAlpha = goal && goal[1] === x && goal[2] === y ? 1 : 0.35;
    drawArrow(context, view, { x, y, theta }, 26, colours.goal);
  }
  context.globalAlpha = 1;
  if (!goal) return;
  const [px, py] = view.toScreen(goal[1], goal[2]);
  context.lineWidth = 1.5;
  context.beginPath();
  context.arc(px, py, constants.xy_tolerance * view.scale, 0, TWO_PI);
  context.stroke();
  const { law } = robot.curves;
  const radius = law ? law.at("eps_P", time) : NaN;
  if (!(radius > 0)) return;
  context.beginPath();
  context.arc(px, py, radius * view.scale, 0, TWO_PI);
  const isNear = law.at("region", time) === 1;
  context.fillStyle = colours.near;
  if (isNear) context.fill();
  context.setLineDash([5, 4]);
  context.stroke();
  context.setLineDash([]);
  context.fillStyle = colours.goal;
  const text = `${isNear ? "in Omega_L" : "Omega_L"}, eps_P ${shown(radius)} m`;
  context.fillText(text, Math.min(px + 10, view.width - context.measureText(text).width - 4), py + radius * view.scale + 14);
}

/** Draw a robot: its wheels, the circle through them, and a line to the front. A robot of unknown size has no wheels. */
function drawRobot(context, view, pose, wheels, colour, filled, name = "") {
  const [px, py] = view.toScreen(pose.x, pose.y);
  const [radius, track] = wheels ?? [0, 0];
  const scale = track ? Math.max(view.scale, (2 * MIN_RADIUS) / track) : 0; // [pixels/m]
  const r = (scale * track) / 2 || MIN_RADIUS;
  context.save();
  context.translate(px, py);
  context.rotate(-pose.theta);
  context.strokeStyle = context.fillStyle = colour;
  context.lineWidth = 2;
  context.beginPath();
  context.arc(0, 0, r, 0, TWO_PI);
  context.globalAlpha = 0.25;
  if (filled) context.fill();
  context.globalAlpha = 1;
  context.moveTo(0, 0);
  context.lineTo(r, 0);
  context.stroke();
  if (wheels) for (const side of [-1, 1]) context.fillRect(-scale * radius, side * r - 2, 2 * scale * radius, 4);
  context.restore();
  context.fillStyle = colour;
  if (name) context.fillText(name, px + r + 4, py - r - 2);
}

function drawPlan(context, view, points, colour) {
  context.strokeStyle = colour;
  context.fillStyle = colour;
  context.lineWidth = 2;
  context.beginPath();
  for (const [x, y] of points) context.lineTo(...view.toScreen(x, y));
  context.setLineDash([9, 5]);
  context.stroke();
  context.setLineDash([]);
  if (points.length > MAX_WAYPOINTS) return;
  context.beginPath();
  for (const [x, y] of points) {
    const [px, py] = view.toScreen(x, y);
    context.moveTo(px, py);
    context.arc(px, py, 3.5, 0, TWO_PI);
  }
  context.fill();
}

/** Draw each landmark as a diamond with its number; fill the diamond while the landmark is in view. */
function drawLandmarks(context, view, robot, time, colours) {
  context.strokeStyle = colours.landmarks;
  context.fillStyle = colours.landmarks;
  context.lineWidth = 1.5;
  for (const { number, x, y, inView } of robot.landmarks.values()) {
    const [px, py] = view.toScreen(x, y);
    if (!(px > -9 && py > -9 && px < view.width + 9 && py < view.height + 9)) continue;
    context.beginPath();
    for (const [dx, dy] of [[0, -7], [7, 0], [0, 7], [-7, 0]]) context.lineTo(px + dx, py + dy);
    context.closePath();
    // In `inView`, begins and ends of intervals alternate.
    if (lastAtMost(inView, time) % 2 === 0) context.fill();
    context.stroke();
    context.fillText(String(number), px + 8, py - 5);
  }
}

/**
 * Draw the dock as model.py describes it: the axis up to the staging pose, the corridor of the approach, a bar in front of
 * the docked robot, and the newest detections. Without a `pose`, only the detections are drawn.
 */
function drawDock(context, view, dock, wheels, colours) {
  context.lineWidth = 1.5;
  if (dock.pose) {
    const [x, y, theta] = dock.pose;
    const side = dock.isBackward ? -1 : 1;
    const at = (along, across) => {
      const [c, s] = [Math.cos(theta), Math.sin(theta)];
      return view.toScreen(x + side * along * c - across * s, y + side * along * s + across * c);
    };
    const line = (...points) => {
      context.beginPath();
      for (const [along, across] of points) context.lineTo(...at(along, across));
    };
    const { staging, halfWidth } = dock;
    line([-staging, halfWidth], [0, halfWidth], [0, -halfWidth], [-staging, -halfWidth]);
    context.fillStyle = colours.near;
    context.fill();
    context.strokeStyle = context.fillStyle = colours.dock;
    line([-staging, 0], [0, 0]);
    context.setLineDash([6, 4]);
    context.stroke();
    context.setLineDash([]);
    const half = (wheels?.[1] ?? 0.3) / 2;
    context.lineWidth = 6;
    line([half, half], [half, -half]);
    context.stroke();
    context.lineWidth = 1.5;
    context.beginPath();
    context.arc(...at(-staging, 0), 3, 0, 2 * Math.PI);
    context.fill();
  }
  context.strokeStyle = colours.dock;
  context.beginPath();
  for (const [x, y] of dock.detections) {
    const [px, py] = view.toScreen(x, y);
    for (const side of [-1, 1]) {
      context.moveTo(px - CROSS, py - side * CROSS);
      context.lineTo(px + CROSS, py + side * CROSS);
    }
  }
  context.stroke();
}

/** Return the names of the map layers that a robot has, in the order of the legend. */
export function layersOf({ curves, plan, landmarks, dock }) {
  const has = {
    ellipses: curves.estimate?.columns.xx && curves.estimate.rows,
    plan: plan.rows,
    landmarks: landmarks.size,
    dock,
    ...Object.fromEntries(["truth", "estimate", "odometry", "fixes"].map((name) => [name, curves[name]?.rows])),
  };
  return ["truth", "estimate", "odometry", "fixes", "ellipses", "plan", "landmarks", "dock"].filter((name) => has[name]);
}

/** Draw the best path of each run up to a time, and the robot, in the colour of the run. */
function drawRuns(context, view, runs, { time, hidden, colours }) {
  for (const { name, main, colour, constants } of runs) {
    if (!main || hidden.has(name)) continue;
    context.strokeStyle = colours[colour];
    context.lineWidth = 2;
    tracePath(context, view, main, 0, main.indexAt(time) + 1);
    context.stroke();
    const pose = main.poseAt(time);
    if (pose) drawRobot(context, view, pose, constants.wheels, colours[colour], false);
  }
}

/** Draw all layers of one robot at a time, and the poses of other robots. Mark the pose at `hover` [s] unless it is null. */
export function drawMap(canvas, view, robots, robot, runs, { time, hover, hidden, colours }) {
  const { constants } = robot;
  const context = cleared(canvas);
  view.width = canvas.clientWidth;
  view.height = canvas.clientHeight;
  const present = robot.main?.poseAt(time);
  if (view.follow && present) Object.assign(view, { x: present.x, y: present.y });
  drawGrid(context, view, colours);
  const marked = hover === null ? null : robot.main?.poseAt(hover);
  if (marked) drawArrow(context, view, marked, 16, colours.text);
  if (runs) {
    drawGoal(context, view, robot, time, constants, colours);
    drawRuns(context, view, runs, { time, hidden, colours });
    return context;
  }
  const { curves } = robot;
  if (curves.fixes && !hidden.has("fixes")) drawFixes(context, view, curves.fixes, time, colours.fixes);
  pathLayer.draw(context, view, robot, time, hidden, colours);
  if (curves.estimate && !hidden.has("ellipses")) drawEllipses(context, view, curves.estimate, time, colours);
  if (!hidden.has("plan")) drawPlan(context, view, robot.planAt(time), colours.plan);
  if (!hidden.has("landmarks")) drawLandmarks(context, view, robot, time, colours);
  if (robot.dock && !hidden.has("dock")) drawDock(context, view, robot.dock, constants.wheels, colours);
  drawGoal(context, view, robot, time, constants, colours);
  for (const other of robots) {
    for (const name of ["truth", "estimate", "odometry"]) {
      const curve = other.curves[name];
      const isMain = curve === other.main;
      const isShown = isMain || (other === robot && name !== "odometry");
      const pose = isShown && !hidden.has(name) && curve?.poseAt(time);
      if (!pose) continue;
      const colour = other === robot ? colours[name] : colours.faint;
      drawRobot(context, view, pose, other.constants.wheels, colour, name !== "truth", robots.length > 1 && isMain ? other.name : "");
    }
  }
  return context;
}
