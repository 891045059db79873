import { lastAtMost, wrapAngle } from "./geometry.js";

// The data of the page: curves over time, goals and events of each robot. A report sets them once, a live page appends.

const LIVE_ROWS = 40000;
const MAX_LANDMARKS = 500;
const IN_VIEW = 1; // [s] time for which a landmark counts as in view after a measurement
const SIDES = [["left", -0.5], ["right", 0.5]];
const MISSING = -2147483648;

/** Columns of numbers, with their times [s] in the column `t`. */
export class Curve {
  constructor(columns) {
    this.columns = columns;
    this.names = Object.keys(columns);
  }

  get t() {
    return this.columns.t;
  }

  get rows() {
    return this.t.length;
  }

  /** Append a row in the order of the columns; null is a missing number. With LIVE_ROWS rows, first drop the older half. */
  append(row) {
    const isNewRun = row[0] < this.t.at(-1); // the time has jumped back
    const dropped = isNewRun ? this.rows : this.rows < LIVE_ROWS ? 0 : LIVE_ROWS / 2;
    if (dropped) {
      for (const name of this.names) this.columns[name].splice(0, dropped);
      for (const [side] of SIDES) delete this.columns[side];
    }
    this.names.forEach((name, index) => this.columns[name].push(row[index] ?? NaN));
  }

  /** Compute the speeds [m/s] of the rims of both wheels for rows without them; `track` [m] is the wheel separation. */
  addRims(track) {
    const { v, omega } = this.columns;
    if (!v || !omega) return;
    for (const [side, share] of SIDES) {
      const rim = (this.columns[side] ??= []);
      for (let i = rim.length; i < this.rows; i += 1) rim.push(v[i] + share * track * omega[i]);
    }
  }

  /** Return the index of the last row at or before a time; -1 before the first row. */
  indexAt(time) {
    return lastAtMost(this.t, time);
  }

  /** Return the value of a column in the last row at or before a time; NaN before the first row. */
  at(name, time) {
    const index = this.indexAt(time);
    return index < 0 || !this.columns[name] ? NaN : this.columns[name][index];
  }

  /** Return the time [s] of the row before `end` [s] that is nearest to a point [m]; null if no row is within `reach` [m]. */
  timeNear(x, y, reach, end) {
    const { columns } = this;
    let [found, best] = [null, reach * reach];
    for (let i = this.indexAt(end); i >= 0; i -= 1) {
      const [dx, dy] = [columns.x[i] - x, columns.y[i] - y];
      if (dx * dx + dy * dy < best) [found, best] = [columns.t[i], dx * dx + dy * dy];
    }
    return found;
  }

  /** Return the interpolated x, y, theta at a time; null before the first row. */
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

/** The data of one robot. */
export class Robot {
  constructor(name, constants) {
    Object.assign(this, { name, constants, curves: {}, goals: [], events: [], cards: [], states: [], services: {}, dock: null });
    this.plan = new Curve({ t: [], x: [], y: [] });
    this.landmarks = new Map();
  }

  /** Append a row to a curve; the first row creates the curve. */
  append(curve, names, row) {
    (this.curves[curve] ??= new Curve(Object.fromEntries(names.map((name) => [name, []])))).append(row);
  }

  /** Compute the speeds of the wheel rims for new rows. */
  derive() {
    const { odometry, truth, command } = this.curves;
    if (this.constants.wheels) for (const one of [odometry, truth, command]) one?.addRims(this.constants.wheels[1]);
  }

  /** Return level and text of the state at a time. */
  stateAt(time) {
    const [, level, text] = this.states.findLast(([since]) => since <= time) ?? [0, 0, ""];
    return [level, text];
  }

  /** Return v and omega at a time: measured, or else commanded. */
  speedAt(time) {
    const curve = this.curves.odometry ?? this.curves.command;
    return { v: curve?.at("v", time) ?? NaN, omega: curve?.at("omega", time) ?? NaN };
  }

  /** Return the error of the estimate at a time: distance and heading; null without an estimate or a truth. */
  errorAt(time) {
    const [a, b] = [this.curves.estimate?.poseAt(time), this.curves.truth?.poseAt(time)];
    return a && b ? { distance: Math.hypot(a.x - b.x, a.y - b.y), heading: wrapAngle(a.theta - b.theta) } : null;
  }

  /** Return the time [s] from the acceptance of the newest goal to its answer or to a time; NaN without a goal. */
  sinceGoalAt(time) {
    const goal = this.goalAt(time);
    return goal ? Math.min(time, goal[4] ?? Infinity) - goal[0] : NaN;
  }

  /** Set the planned path from a time on; without points, the path ends. */
  setPlan([time, points]) {
    const rows = points.length ? points : [[NaN, NaN]];
    this.plan = new Curve({ t: rows.map(() => time), x: rows.map(([x]) => x), y: rows.map(([, y]) => y) });
  }

  /** Return the points [x, y] of the planned path at a time. */
  planAt(time) {
    const { t, x, y } = this.plan.columns;
    const points = [];
    for (let i = this.plan.indexAt(time), begin = t[i]; i >= 0 && t[i] === begin; i -= 1) {
      if (Number.isFinite(x[i])) points.unshift([x[i], y[i]]);
    }
    return points;
  }

  /** Add landmarks [x, y, number] that were measured at a time [s]. */
  addLandmarks([time, landmarks]) {
    for (const [x, y, number] of landmarks) this.landmarks.set(number, { number, x, y, inView: [time, time + IN_VIEW] });
    for (const number of this.landmarks.keys()) {
      if (this.landmarks.size <= MAX_LANDMARKS) break;
      this.landmarks.delete(number);
    }
  }

  /** Return the best available curve of the pose of the robot. */
  get main() {
    return this.curves.estimate ?? this.curves.truth ?? this.curves.odometry ?? null;
  }

  /** Return the newest goal [t, x, y, theta, end] at a time, or null. */
  goalAt(time) {
    return this.goals.findLast((goal) => goal[0] <= time) ?? null;
  }
}

/** Unpack a column: sum the differences of its integers, see `pack` in diffbot_tools/view/report.py. */
function column(bytes, { unit, at }, rows) {
  const values = new Float64Array(rows);
  let sum = 0;
  for (let i = 0, p = at; i < rows; i += 1, p += 1) {
    sum = (sum + (bytes[p] | (bytes[p + rows] << 8) | (bytes[p + 2 * rows] << 16) | (bytes[p + 3 * rows] << 24))) | 0;
    values[i] = sum === MISSING ? NaN : sum * unit;
  }
  return values;
}

/** Return the robots of a report, whose columns diffbot_tools/view/report.py has packed. */
export async function unpackRobots(data) {
  const packed = Uint8Array.from(atob(data.packed), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  return data.robots.map((one) => {
    const curves = Object.entries(one.curves).map(([name, { rows, columns }]) => {
      const unpacked = Object.entries(columns).map(([key, place]) => [key, column(bytes, place, rows)]);
      return [name, new Curve(Object.fromEntries(unpacked))];
    });
    const { plan, ...shown } = Object.fromEntries(curves);
    const landmarks = new Map(one.landmarks.map(([number, x, y, inView]) => [number, { number, x, y, inView }]));
    const robot = Object.assign(new Robot(one.name, one.constants), one, { curves: shown, plan, landmarks });
    robot.derive();
    return robot;
  });
}
