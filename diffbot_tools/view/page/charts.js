import { rangeOf, roundStep, shown } from "./geometry.js";
import { cleared } from "./map.js";
import { add } from "./panels.js";

// Strip charts over time: the lines of each chart, and their drawing.

const DEGREES = 180 / Math.PI;
const line = (curve, column, colour, label, factor = 1) => ({ curve, column, colour, label, factor });
const plusMinus = (limit) => (Number.isFinite(limit) ? [limit, -limit] : []);
const error = (name, unit, column, factor = 1) => ({
  title: `Error of ${name}`,
  unit,
  lines: [line("error", column, "estimate", "estimate - truth", factor)],
  band: line("error", `three_sigma_${column}`, "", "", factor),
  shading: "3 sigma shaded",
});
const speed = (title, unit, column, limit) => ({
  title,
  unit,
  lines: [
    line("odometry", column, "odometry", "odometry"),
    line("truth", column, "truth", "truth"),
    line("command", column, "estimate", "command"),
  ],
  levels: ({ limits }) => plusMinus(limits[limit]),
});

/**
 * The charts of each panel. `dashed` lines and `levels` are drawn dashed, `band` is shaded around 0, and `isNear` shades the
 * times inside Omega_L. `turn` is a full turn in the unit of the chart; a line is interrupted where its angle wraps.
 */
const GROUPS = {
  "drive-charts": [
    { title: "Distance to the goal", unit: "m", lines: [line("to_goal", "distance", "goal", "distance")], isNear: true },
    { title: "Heading error to the goal", unit: "deg", lines: [line("to_goal", "heading", "goal", "heading", DEGREES)], isNear: true, turn: 360 },
    { title: "Distance from the axis of the dock", unit: "m", lines: [line("docking", "y", "dock", "distance")] },
    speed("v", "m/s", "v", "v"),
    speed("omega", "rad/s", "omega", "omega"),
    error("x", "m", "x"),
    error("y", "m", "y"),
    error("heading", "deg", "theta", DEGREES),
  ],
  "law-charts": [
    {
      title: "Distance rho, and radius eps_P of Omega_L",
      unit: "m",
      lines: [line("law", "rho", "truth", "rho"), line("law", "eps_P", "goal", "eps_P")],
      isNear: true,
      shading: "shaded inside",
    },
    {
      title: "Direction of the goal: alpha from the robot, beta from the goal",
      unit: "rad",
      lines: [line("law", "alpha", "truth", "alpha"), line("law", "beta", "estimate", "beta")],
      turn: 2 * Math.PI,
    },
    { title: "Lyapunov function of the region", unit: "", lines: [line("law", "V", "truth", "V")] },
  ],
  "filter-charts": [
    {
      title: "NIS per number, 95 % bounds dashed",
      unit: "",
      lines: [line("filter", "nis", "truth", "NIS")],
      dashed: [line("filter", "nis_low"), line("filter", "nis_high")],
    },
    { title: "NEES, 95 % bounds dashed", unit: "", lines: [line("error", "nees", "truth", "NEES")], levels: ({ nees }) => nees },
    {
      title: "Autocorrelation of innovations, 95 % bounds dashed",
      unit: "",
      lines: [line("filter", "whiteness", "truth", "autocorrelation")],
      dashed: [line("filter", "whiteness_bound"), line("filter", "whiteness_bound", "", "", -1)],
    },
    { title: "Fix minus estimate", unit: "m", lines: [line("residual", "x", "truth", "x"), line("residual", "y", "estimate", "y")] },
    { title: "Fix minus estimate, heading", unit: "deg", lines: [line("residual", "theta", "truth", "heading", DEGREES)] },
    { title: "Errors of wheel radii", unit: "", lines: [line("filter", "left", "truth", "left"), line("filter", "right", "estimate", "right")] },
  ],
  "wheel-charts": ["left", "right"].map((side) => speed(`Rim of the ${side} wheel`, "m/s", side, "rim")),
};
const HEIGHT = 92;
const LEFT = 62;
const MIN_ZOOM = 4; // [pixels] shortest drag that zooms

const columnOf = (robot, { curve, column }) => {
  const found = robot.curves[curve];
  return found?.columns[column] && found.rows ? found : null;
};
const hasNumbers = (robot, one) => {
  const found = columnOf(robot, one);
  return Boolean(found?.columns[one.column].some(Number.isFinite));
};

/** Return the lines of a chart, each with its robot; in a comparison, one line for each run in the colour of the run. */
const linesOf = ({ lines }, robot, runs) => {
  if (!runs) return lines.map((one) => ({ ...one, robot }));
  return runs.flatMap((run) => {
    const best = lines.find((one) => hasNumbers(run, one));
    return best ? [{ ...best, robot: run, colour: run.colour, label: run.name }] : [];
  });
};

/** Return a short text for a number on an axis whose labels have this step. */
function axisNumber(value, step) {
  const power = Math.floor(Math.log10(step));
  if (power >= -4 || value === 0) return value.toFixed(Math.min(Math.max(-power, 0), 4));
  return value.toExponential(Math.max(Math.floor(Math.log10(Math.abs(value))) - power, 0));
}

/** Trace a column between two times through the first, lowest, highest and last value of each column of pixels. */
function trace(context, curve, values, scale, factor, turn = Infinity) {
  const { t } = curve.columns;
  const begin = Math.max(curve.indexAt(scale.t0), 0);
  const end = Math.min(curve.indexAt(scale.t1) + 2, curve.rows);
  context.beginPath();
  let isDown = false;
  let last = NaN;
  for (let i = begin; i < end; ) {
    const pixel = Math.floor(scale.x(t[i]));
    let low = Infinity;
    let high = -Infinity;
    let first = NaN;
    let value = NaN;
    for (; i < end && Math.floor(scale.x(t[i])) === pixel; i += 1) {
      value = factor * values[i];
      if (!Number.isFinite(value)) continue;
      if (Number.isNaN(first)) first = value;
      if (value < low) low = value;
      if (value > high) high = value;
    }
    if (low > high) {
      isDown = false;
      continue;
    }
    if (!isDown || Math.abs(first - last) > turn / 2) context.moveTo(pixel, scale.y(first));
    else context.lineTo(pixel, scale.y(first));
    if (high > low && high - low <= turn / 2) {
      context.lineTo(pixel, scale.y(low));
      context.lineTo(pixel, scale.y(high));
    }
    last = Number.isFinite(value) ? value : first;
    context.lineTo(pixel, scale.y(last));
    isDown = true;
  }
  context.stroke();
}

/**
 * A strip chart. A click calls `onTime` with its time [s], a moving pointer calls `onHover` with its time or null, and a drag
 * calls `onZoom` with its begin and end. A double click calls `onZoom` with null.
 */
class Chart {
  constructor(definition, parent, { onTime, onHover, onZoom }) {
    Object.assign(this, { definition, labels: [], lines: [], scale: null });
    this.box = add(parent, "div", "", { class: "chart" });
    this.head = add(this.box, "p");
    this.title = add(this.head, "span");
    this.canvas = add(this.box, "canvas", "", { role: "img", "aria-label": definition.title });
    this.cursor = add(this.box, "div", "", { class: "cursor" });
    this.range = add(this.box, "div", "", { class: "range hidden" });
    let start = null; // [pixels] begin of a drag
    const place = (event) => {
      const x = event.clientX - this.canvas.getBoundingClientRect().left;
      return Math.min(Math.max(x, LEFT), this.canvas.clientWidth);
    };
    const timeAt = (x) => this.scale.t0 + ((x - LEFT) / (this.scale.width - LEFT)) * (this.scale.t1 - this.scale.t0);
    const showRange = (x) => {
      this.range.classList.toggle("hidden", x === null);
      this.range.style.left = `${Math.min(start, x)}px`;
      this.range.style.width = `${Math.abs(x - start)}px`;
    };
    const end = () => {
      start = null;
      showRange(null);
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !this.scale) return;
      start = place(event);
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (start !== null) showRange(place(event));
      if (this.scale) onHover(timeAt(place(event)));
    });
    this.canvas.addEventListener("pointerup", (event) => {
      if (start === null) return;
      const x = place(event);
      if (Math.abs(x - start) < MIN_ZOOM) onTime(timeAt(x));
      else onZoom([timeAt(Math.min(x, start)), timeAt(Math.max(x, start))]);
      end();
    });
    this.canvas.addEventListener("pointercancel", end);
    this.canvas.addEventListener("pointerleave", () => onHover(null));
    this.canvas.addEventListener("dblclick", () => onZoom(null));
  }

  /** Return the range of the values that are drawn between two times, with a margin. */
  valueRange(robot, t0, t1, levels) {
    const { dashed = [], band, turn = Infinity } = this.definition;
    let range = rangeOf(levels, 0, levels.length);
    const bands = band && !this.isComparison ? [band, { ...band, factor: -band.factor }] : [];
    for (const one of [...this.lines, ...dashed, ...bands]) {
      const found = columnOf(one.robot ?? robot, one);
      if (!found) continue;
      const own = rangeOf(found.columns[one.column], Math.max(found.indexAt(t0), 0), Math.min(found.indexAt(t1) + 1, found.rows));
      if (own) range = rangeOf(own.map((value) => one.factor * value), 0, 2, range);
    }
    range ??= [-1, 1];
    const margin = 0.06 * (range[1] - range[0]) || 0.1 * Math.abs(range[0]) || 1;
    const end = turn / 2 + margin / 2;
    return [Math.max(range[0] - margin, -end), Math.min(range[1] + margin, end)];
  }

  draw(robot, runs, t0, t1, colours) {
    const { definition, canvas } = this;
    this.isComparison = Boolean(runs);
    const shading = definition.shading && !runs ? `, ${definition.shading}` : "";
    this.title.textContent = `${definition.title}${shading}${definition.unit && ` [${definition.unit}]`}`;
    this.lines = linesOf(definition, robot, runs);
    const isShown = this.lines.some((one) => hasNumbers(one.robot, one));
    this.box.classList.toggle("hidden", !isShown);
    if (!isShown || !canvas.clientWidth) return; // a chart in a closed panel has no width
    const context = cleared(canvas);
    const width = canvas.clientWidth;
    const levels = definition.levels?.(robot.constants) ?? [];
    const [low, high] = this.valueRange(robot, t0, t1, levels);
    const scale = {
      t0,
      t1,
      width,
      x: (t) => LEFT + ((t - t0) / (t1 - t0)) * (width - LEFT),
      y: (value) => HEIGHT - 1 - ((value - low) / (high - low)) * (HEIGHT - 2),
    };
    this.scale = scale;
    context.save();
    context.beginPath();
    context.rect(LEFT, 0, width - LEFT, HEIGHT);
    context.clip();
    if (definition.isNear && !runs) shadeNear(context, robot.curves.law, scale, colours.near);
    if (definition.band && !runs) shadeBand(context, robot, definition.band, scale, colours.band);
    context.lineWidth = 1;
    context.strokeStyle = colours.faint;
    context.setLineDash([4, 3]);
    for (const one of definition.dashed ?? []) {
      const curve = columnOf(robot, one);
      if (curve) trace(context, curve, curve.columns[one.column], scale, one.factor);
    }
    for (const level of levels) context.strokeRect(LEFT - 2, scale.y(level), width, 0);
    context.setLineDash([]);
    context.lineWidth = 1.4;
    for (const one of this.lines) {
      const curve = columnOf(one.robot, one);
      if (!curve) continue;
      context.strokeStyle = colours[one.colour];
      trace(context, curve, curve.columns[one.column], scale, one.factor, definition.turn);
    }
    context.restore();
    drawAxes(context, scale, low, high, definition.unit, colours);
  }

  /** Move the cursor to a time, and show the values at this time beside the title. */
  point(time, colours) {
    if (!this.scale || this.box.classList.contains("hidden")) return;
    const { unit } = this.definition;
    const x = this.scale.x(time);
    this.cursor.classList.toggle("hidden", !(x >= LEFT && x <= this.scale.width));
    this.cursor.style.transform = `translateX(${Math.round(x)}px)`;
    while (this.labels.length < this.lines.length) this.labels.push(add(this.head, "span"));
    this.lines.forEach((one, index) => {
      const curve = columnOf(one.robot, one);
      const value = curve ? shown(one.factor * curve.at(one.column, time), unit === "deg" ? 1 : 3) : "";
      this.labels[index].style.color = colours[one.colour];
      this.labels[index].textContent = curve ? `${one.label} ${value} ${unit}` : "";
    });
  }
}

function shadeBand(context, robot, band, scale, colour) {
  const curve = columnOf(robot, band);
  if (!curve) return;
  const values = curve.columns[band.column];
  const end = Math.min(curve.indexAt(scale.t1) + 2, curve.rows);
  const begin = Math.max(curve.indexAt(scale.t0), 0);
  const every = Math.max(1, Math.floor((end - begin) / (2 * scale.width)));
  const rows = [];
  for (let i = begin; i < end; i += every) rows.push(i);
  context.fillStyle = colour;
  context.beginPath();
  for (const i of rows) context.lineTo(scale.x(curve.t[i]), scale.y(band.factor * values[i] || 0));
  for (const i of rows.reverse()) context.lineTo(scale.x(curve.t[i]), scale.y(-band.factor * values[i] || 0));
  context.fill();
}

/** Shade the times at which the region of the law is Omega_L. */
function shadeNear(context, law, scale, colour) {
  if (!law) return;
  context.fillStyle = colour;
  let begin = null;
  for (let i = Math.max(law.indexAt(scale.t0), 0); i < law.rows && law.t[i] <= scale.t1; i += 1) {
    const isNear = law.columns.region[i] === 1 && i < law.rows - 1;
    if (isNear) begin ??= scale.x(law.t[i]);
    else if (begin !== null) {
      context.fillRect(begin, 0, Math.max(scale.x(law.t[i]) - begin, 1), HEIGHT);
      begin = null;
    }
  }
  if (begin !== null) context.fillRect(begin, 0, scale.width - begin, HEIGHT);
}

function drawAxes(context, scale, low, high, unit, colours) {
  context.fillStyle = colours.faint;
  context.strokeStyle = colours.line;
  context.font = "10px system-ui, sans-serif";
  context.textAlign = "right";
  const step = roundStep((high - low) / 2);
  context.beginPath();
  for (let k = Math.ceil(low / step); k * step <= high; k += 1) {
    const y = scale.y(k * step);
    context.fillText(`${axisNumber(k * step, step)} ${unit}`, LEFT - 4, Math.min(Math.max(y + 3, 9), HEIGHT - 2));
    if (k === 0) context.rect(LEFT, y, scale.width, 0);
  }
  context.stroke();
  context.textAlign = "center";
  const every = roundStep((scale.t1 - scale.t0) / 4);
  for (let k = Math.ceil(scale.t0 / every); k * every <= scale.t1; k += 1) {
    const x = scale.x(k * every);
    if (x <= LEFT + 12 || x >= scale.width - 16) continue;
    const label = `${+(k * every).toFixed(3)} s`;
    const width = context.measureText(label).width + 4;
    context.fillStyle = colours.panel; // no line runs through the label
    context.fillRect(x - width / 2, HEIGHT - 13, width, 13);
    context.fillStyle = colours.faint;
    context.fillText(label, x, HEIGHT - 3);
  }
}

/** Make all charts, each in the panel of its group; for `reactions` see Chart. */
export function makeCharts(reactions) {
  return Object.entries(GROUPS).flatMap(([id, definitions]) =>
    definitions.map((definition) => new Chart(definition, document.getElementById(id), reactions)),
  );
}
