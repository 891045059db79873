import { lastAtMost, wrapAngle } from "./geometry.js";

// What the page knows: curves over time, goals and events of each robot. A report fills it once, the live page appends.

const LIVE_ROWS = 40000;
const MAX_LANDMARKS = 500;
const IN_VIEW = 1; // [s] after a measurement
const TO_GO = ["t", "distance", "heading", "lateral"];
const SIDES = [["left", -0.5], ["right", 0.5]];

/** Columns of numbers over the column `t` [s]. */
export class Curve {
  constructor(columns, rows) {
    this.columns = columns;
    this.rows = rows;
  }

  /** An empty curve with these columns that grows by `append`. */
  static growing(names) {
    return new Curve(Object.fromEntries(names.map((name) => [name, new Float64Array(1024)])), 0);
  }

  get t() {
    return this.columns.t;
  }

  /** Add a row in the order of the columns; null stands for a missing number. When full, the older half is dropped. */
  append(row) {
    const time = row[0];
    if (this.rows && time < this.t[this.rows - 1]) this.rows = 0; // time has jumped back: a new run
    const names = Object.keys(this.columns);
    if (this.rows === this.t.length) {
      const drop = this.rows >= LIVE_ROWS ? this.rows >> 1 : 0;
      for (const name of names) {
        const old = this.columns[name];
        const grown = drop ? old : new Float64Array(2 * old.length);
        grown.set(old.subarray(drop));
        this.columns[name] = grown;
      }
      this.rows -= drop;
    }
    names.forEach((name, index) => {
      this.columns[name][this.rows] = row[index] ?? NaN;
    });
    this.rows += 1;
  }

  /** Bring the columns left and right up to date: speeds [m/s] of the rims of wheels at this distance [m]. */
  addRims(track) {
    const { v, omega } = this.columns;
    const begin = this.columns.left && this.rims <= this.rows ? this.rims : 0;
    for (const [side, share] of SIDES) {
      this.columns[side] ??= new Float64Array(v.length);
      for (let i = begin; i < this.rows; i += 1) this.columns[side][i] = v[i] + share * track * omega[i];
    }
    this.rims = this.rows;
  }

  /** Index of the last row at or before a time; -1 before the first. */
  indexAt(time) {
    return lastAtMost(this.t, this.rows, time);
  }

  /** The value of a column at a time, held since the last row; NaN before the first. */
  at(name, time) {
    const index = this.indexAt(time);
    return index < 0 || !this.columns[name] ? NaN : this.columns[name][index];
  }

  /** Time [s] of the row nearest to a point [m], the latest before `end` [s]; null if none is within `reach` [m]. */
  timeNear(x, y, reach, end) {
    const { columns } = this;
    let [found, best] = [null, reach * reach];
    for (let i = this.indexAt(end); i >= 0; i -= 1) {
      const [dx, dy] = [columns.x[i] - x, columns.y[i] - y];
      if (dx * dx + dy * dy < best) [found, best] = [columns.t[i], dx * dx + dy * dy];
    }
    return found;
  }

  /** x, y, theta at a time, interpolated; null before the first row. */
  poseAt(time) {
    const i = this.indexAt(time);
    if (i < 0) return null;
    const { t, x, y, theta } = this.columns;
    const next = Math.min(i + 1, this.rows - 1);
    const share = t[next] > t[i] && t[next] - t[i] < 10 ? (time - t[i]) / (t[next] - t[i]) : 0;
    const turn = wrapAngle(theta[next] - theta[i]);
    return { x: x[i] + share * (x[next] - x[i]), y: y[i] + share * (y[next] - y[i]), theta: wrapAngle(theta[i] + share * turn), index: i };
  }
}

/** One robot. */
export class Robot {
  constructor(name) {
    this.name = name;
    this.curves = {};
    this.goals = [];
    this.events = [];
    this.summary = [];
    this.status = null;
    this.states = [];
    this.plan = new Curve({ t: [], x: [], y: [] }, 0);
    this.landmarks = new Map();
    this.dock = null; // live: pose, detections, staging, halfWidth, isBackward
    this.size = {}; // wheels: radius and distance [m]; box: rear, front, right, left [m]
  }

  /** Add a row to a curve, which begins with its first row. */
  append(curve, names, row) {
    this.curves[curve] ??= Curve.growing(names);
    const added = this.curves[curve];
    added.append(row);
    if (added === this.main) {
      this.curves.toGo ??= Curve.growing(TO_GO);
      this.curves.toGo.append(this.toGoAt(added, added.rows - 1));
    }
  }

  /** Bring up to date what follows from other curves: the wheels' speeds, and fixes minus the estimate of their time. */
  derive() {
    const { odometry, truth, command, fixes, estimate } = this.curves;
    if (this.size.wheels) for (const one of [odometry, truth, command]) if (one?.columns.v) one.addRims(this.size.wheels[1]);
    if (!fixes?.rows || !estimate?.rows) return;
    const made = (this.curves.residual ??= Curve.growing(["t", "x", "y", "theta"]));
    const { t, x, y, theta } = fixes.columns;
    if (made.rows && made.t[made.rows - 1] > t[fixes.rows - 1]) made.rows = 0; // a new run
    const end = estimate.t[estimate.rows - 1];
    for (let i = made.rows ? fixes.indexAt(made.t[made.rows - 1]) + 1 : 0; i < fixes.rows && t[i] <= end; i += 1) {
      const pose = estimate.poseAt(t[i]);
      if (pose) made.append([t[i], x[i] - pose.x, y[i] - pose.y, wrapAngle(theta[i] - pose.theta)]);
    }
  }

  /** Hide the angles of the law, from a row on, where the distance is below a limit [m] and they are not defined. */
  hideAngles(limit, begin = 0) {
    const { law } = this.curves;
    if (!law) return;
    for (let i = Math.max(begin, 0); i < law.rows; i += 1) {
      if (law.columns.rho[i] < limit) law.columns.alpha[i] = law.columns.beta[i] = NaN;
    }
  }

  /** Set the goals [t, x, y, theta], in their order. */
  setGoals(goals) {
    this.goals = goals;
    const { main } = this;
    if (!main) return;
    const toGo = Curve.growing(TO_GO);
    for (let i = 0; i < main.rows; i += 1) toGo.append(this.toGoAt(main, i));
    this.curves.toGo = toGo;
  }

  /** Row of TO_GO: distance to the goal, heading and lateral error in its frame; NaN without a goal. */
  toGoAt({ columns }, i) {
    const goal = this.goalAt(columns.t[i]);
    if (!goal) return [columns.t[i], NaN, NaN, NaN];
    const [dx, dy] = [columns.x[i] - goal[1], columns.y[i] - goal[2]];
    const lateral = dy * Math.cos(goal[3]) - dx * Math.sin(goal[3]);
    return [columns.t[i], Math.hypot(dx, dy), wrapAngle(columns.theta[i] - goal[3]), lateral];
  }

  /** State of controller and filter at a time, as words.js takes it. */
  stateAt(time) {
    return this.status ?? this.states.findLast(([since]) => since <= time)?.[1];
  }

  /** Time [s] at a time until the goal is answered; NaN if that is not known. */
  timeLeft(time) {
    if (this.status) return this.status.left ?? NaN; // live: as the controller estimates it
    const row = this.summary.findLast((one) => one.time <= time);
    return (row?.ended ?? NaN) - time;
  }

  /** v and omega at a time: measured, else commanded. */
  speedAt(time) {
    const curve = this.curves.odometry?.columns.v ? this.curves.odometry : this.curves.command;
    return { v: curve?.at("v", time) ?? NaN, omega: curve?.at("omega", time) ?? NaN };
  }

  /** Estimate minus truth at a time: distance and heading; null without both. */
  errorAt(time) {
    const [a, b] = [this.curves.estimate?.poseAt(time), this.curves.truth?.poseAt(time)];
    return a && b ? { distance: Math.hypot(a.x - b.x, a.y - b.y), heading: wrapAngle(a.theta - b.theta) } : null;
  }

  /** Settling clock [s] at a time: since the goal was sent, at most until it was settled in; NaN without a goal. */
  clockAt(time) {
    if (this.status) return this.status.clock ?? NaN; // live
    const goal = this.goalAt(time);
    const settled = this.summary.find((one) => goal && one.time === goal[0])?.settled ?? Infinity;
    return goal ? Math.min(time - goal[0], settled) : NaN;
  }

  /** Set the planned path, which holds from a time on; no points: there is none. */
  setPlan([time, points]) {
    const rows = points.length ? points : [[NaN, NaN]];
    this.plan = new Curve({ t: rows.map(() => time), x: rows.map(([x]) => x), y: rows.map(([, y]) => y) }, rows.length);
  }

  /** The points [x, y] of the planned path at a time. */
  planAt(time) {
    const { t, x, y } = this.plan.columns;
    const points = [];
    for (let i = this.plan.indexAt(time), begin = t[i]; i >= 0 && t[i] === begin; i -= 1) {
      if (Number.isFinite(x[i])) points.unshift([x[i], y[i]]);
    }
    return points;
  }

  /** Set where landmarks [x, y, number] are, which were measured at a time. */
  see([time, landmarks]) {
    for (const [x, y, number] of landmarks) this.landmarks.set(number, { number, x, y, inView: [time, time + IN_VIEW] });
    for (const number of this.landmarks.keys()) {
      if (this.landmarks.size <= MAX_LANDMARKS) break;
      this.landmarks.delete(number);
    }
  }

  /** The curve that tells best where the robot is. */
  get main() {
    return this.curves.estimate ?? this.curves.truth ?? this.curves.odometry ?? null;
  }

  /** The newest goal [t, x, y, theta] at a time, or null. */
  goalAt(time) {
    return this.goals.findLast((goal) => goal[0] <= time) ?? null;
  }
}
