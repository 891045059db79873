import { lastAtMost, wrapAngle } from "./geometry.js";

// What the page knows: curves over time, goals and events of each robot. A report fills it once, the live page appends.

const LIVE_ROWS = 40000;
const MAX_LANDMARKS = 500;
const IN_VIEW = 1; // [s] after a measurement

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

  /** Index of the last row at or before a time; -1 before the first. */
  indexAt(time) {
    return lastAtMost(this.t, this.rows, time);
  }

  /** The value of a column at a time, held since the last row; NaN before the first. */
  at(name, time) {
    const index = this.indexAt(time);
    return index < 0 || !this.columns[name] ? NaN : this.columns[name][index];
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
    this.plan = new Curve({ t: [], x: [], y: [] }, 0);
    this.landmarks = new Map();
  }

  /** Add a row to a curve, which begins with its first row. */
  append(curve, names, row) {
    this.curves[curve] ??= Curve.growing(names);
    this.curves[curve].append(row);
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
