import { rangeOf, roundStep, shown } from "./geometry.js";
import { cleared } from "./map.js";

// Strip charts: which curves belong together, and how they are drawn.

const line = (curve, column, colour, label) => ({ curve, column, colour, label });
const error = (column) => ({ lines: [line("error", column, "estimate", "estimate - truth")], band: ["error", `three_sigma_${column}`] });

const CHARTS = [
  { title: "Error of x [m], 3 sigma shaded", ...error("x") },
  { title: "Error of y [m], 3 sigma shaded", ...error("y") },
  { title: "Error of heading [rad], 3 sigma shaded", ...error("theta") },
  {
    title: "v [m/s]",
    lines: [line("odometry", "v", "odometry", "odometry"), line("truth", "v", "truth", "truth"), line("command", "v", "estimate", "command")],
    limit: "v",
  },
  {
    title: "omega [rad/s]",
    lines: [
      line("odometry", "omega", "odometry", "odometry"),
      line("truth", "omega", "truth", "truth"),
      line("command", "omega", "estimate", "command"),
    ],
    limit: "omega",
  },
  { title: "Distance [m]; shaded in Omega_L", lines: [line("law", "rho", "truth", "rho"), line("law", "eps_P", "goal", "eps_P")], near: true },
  { title: "Angles [rad]", lines: [line("law", "alpha", "truth", "alpha"), line("law", "beta", "estimate", "beta")], isAngle: true },
  { title: "V", lines: [line("law", "V", "truth", "V")] },
  {
    title: "NIS per number, 95 % bounds dashed",
    lines: [line("filter", "nis", "truth", "NIS")],
    bounds: [line("filter", "nis_low", "faint"), line("filter", "nis_high", "faint")],
  },
  { title: "NEES, 95 % bounds dashed", lines: [line("error", "nees", "truth", "NEES")], constant: "nees" },
  {
    title: "Whiteness of innovations, 95 % bounds dashed",
    lines: [line("filter", "whiteness", "truth", "autocorrelation")],
    bounds: [line("filter", "whiteness_bound", "faint"), { ...line("filter", "whiteness_bound", "faint"), sign: -1 }],
  },
  { title: "Errors of wheel radii", lines: [line("filter", "left", "truth", "left"), line("filter", "right", "estimate", "right")] },
];
const HEIGHT = 92;
const LEFT = 44;

const columnOf = (robot, { curve, column }) => {
  const found = robot.curves[curve];
  return found?.columns[column] && found.rows ? found : null;
};
const hasNumbers = (robot, one) => {
  const found = columnOf(robot, one);
  return found !== null && rangeOf(found.columns[one.column], 0, found.rows) !== null;
};

/** A number of an axis with this step, short enough to stand beside it. */
function axisNumber(value, step) {
  const power = Math.floor(Math.log10(step));
  if (power >= -4 || value === 0) return value.toFixed(Math.min(Math.max(-power, 0), 4));
  return value.toExponential(Math.max(Math.floor(Math.log10(Math.abs(value))) - power, 0));
}

/** Trace a column between two times, at most a low and a high point a pixel. */
function trace(context, curve, values, scale, sign, isAngle) {
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
      value = sign * values[i];
      if (!Number.isFinite(value)) continue;
      if (first !== first) first = value;
      if (value < low) low = value;
      if (value > high) high = value;
    }
    if (low > high) {
      isDown = false;
      continue;
    }
    if (!isDown || (isAngle && Math.abs(first - last) > Math.PI)) context.moveTo(pixel, scale.y(first));
    else context.lineTo(pixel, scale.y(first));
    if (high > low && !(isAngle && high - low > Math.PI)) {
      context.lineTo(pixel, scale.y(low));
      context.lineTo(pixel, scale.y(high));
    }
    last = Number.isFinite(value) ? value : first;
    context.lineTo(pixel, scale.y(last));
    isDown = true;
  }
  context.stroke();
}

export class Chart {
  constructor(definition, parent, onTime) {
    this.definition = definition;
    const document = parent.ownerDocument;
    const make = (tag, owner, text = "") => {
      const element = owner.appendChild(document.createElement(tag));
      element.textContent = text;
      return element;
    };
    this.box = make("div", parent);
    this.box.className = "chart";
    const head = make("p", this.box);
    make("span", head, definition.title);
    this.labels = definition.lines.map((one) => [one, make("span", head)]);
    this.canvas = make("canvas", this.box);
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", definition.title);
    this.cursor = make("div", this.box);
    this.cursor.className = "cursor";
    this.scale = null;
    this.canvas.addEventListener("click", (event) => {
      const x = event.clientX - this.canvas.getBoundingClientRect().left;
      if (this.scale) onTime(this.scale.t0 + ((x - LEFT) / (this.scale.width - LEFT)) * (this.scale.t1 - this.scale.t0));
    });
  }

  /** Lowest and highest value in a range of times, with what is to be seen beside the lines. */
  valueRange(robot, t0, t1, constants) {
    const { lines, bounds = [], limit, constant, band } = this.definition;
    let range = null;
    const add = (curve, column, sign = 1) => {
      const found = columnOf(robot, { curve, column });
      if (!found) return;
      const ends = [Math.max(found.indexAt(t0), 0), Math.min(found.indexAt(t1) + 1, found.rows)];
      const values = found.columns[column];
      const one = rangeOf(values, ...ends);
      if (one) range = rangeOf(one.map((value) => sign * value), 0, 2, range);
    };
    for (const one of [...lines, ...bounds]) add(one.curve, one.column, one.sign);
    if (band) [1, -1].forEach((sign) => add(...band, sign));
    if (limit && Number.isFinite(constants.limits[limit])) range = rangeOf([constants.limits[limit], -constants.limits[limit]], 0, 2, range);
    if (constant) range = rangeOf(constants[constant], 0, 2, range);
    range ??= [-1, 1];
    const margin = 0.06 * (range[1] - range[0]) || 0.1 * Math.abs(range[0]) || 1;
    return [range[0] - margin, range[1] + margin];
  }

  draw(robot, t0, t1, constants, colours) {
    const { definition, canvas } = this;
    const isShown = definition.lines.some((one) => hasNumbers(robot, one));
    this.box.classList.toggle("hidden", !isShown);
    if (!isShown) return;
    const context = cleared(canvas);
    const width = canvas.clientWidth;
    const [low, high] = this.valueRange(robot, t0, t1, constants);
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
    if (definition.near) this.shadeNear(context, robot, scale, colours);
    if (definition.band) this.shadeBand(context, robot, scale, colours);
    context.lineWidth = 1;
    context.strokeStyle = colours.faint;
    context.setLineDash([4, 3]);
    for (const one of definition.bounds ?? []) {
      const curve = columnOf(robot, one);
      if (curve) trace(context, curve, curve.columns[one.column], scale, one.sign ?? 1, false);
    }
    const limit = definition.limit ? constants.limits[definition.limit] : null;
    const levels = definition.constant ? constants[definition.constant] : Number.isFinite(limit) ? [limit, -limit] : [];
    for (const level of levels) context.strokeRect(LEFT - 2, scale.y(level), width, 0);
    context.setLineDash([]);
    context.lineWidth = 1.4;
    for (const one of definition.lines) {
      const curve = columnOf(robot, one);
      if (!curve) continue;
      context.strokeStyle = colours[one.colour];
      trace(context, curve, curve.columns[one.column], scale, 1, definition.isAngle);
    }
    context.restore();
    this.drawAxes(context, scale, low, high, colours);
  }

  shadeBand(context, robot, scale, colours) {
    const curve = columnOf(robot, { curve: this.definition.band[0], column: this.definition.band[1] });
    if (!curve) return;
    const values = curve.columns[this.definition.band[1]];
    const end = Math.min(curve.indexAt(scale.t1) + 2, curve.rows);
    const begin = Math.max(curve.indexAt(scale.t0), 0);
    const every = Math.max(1, Math.floor((end - begin) / (2 * scale.width)));
    context.fillStyle = colours.band;
    context.beginPath();
    for (let i = begin; i < end; i += every) context.lineTo(scale.x(curve.t[i]), scale.y(values[i] || 0));
    for (let i = begin + every * Math.floor((end - 1 - begin) / every); i >= begin; i -= every) {
      context.lineTo(scale.x(curve.t[i]), scale.y(-values[i] || 0));
    }
    context.fill();
  }

  shadeNear(context, robot, scale, colours) {
    const { law } = robot.curves;
    context.fillStyle = colours.near;
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

  drawAxes(context, scale, low, high, colours) {
    context.fillStyle = colours.faint;
    context.strokeStyle = colours.line;
    context.font = "10px system-ui, sans-serif";
    context.textAlign = "right";
    const step = roundStep((high - low) / 2);
    context.beginPath();
    for (let k = Math.ceil(low / step); k * step <= high; k += 1) {
      const y = scale.y(k * step);
      context.fillText(axisNumber(k * step, step), LEFT - 4, Math.min(Math.max(y + 3, 9), HEIGHT - 2));
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
      context.fillStyle = colours.panel; // so that no line runs through the label
      context.fillRect(x - width / 2, HEIGHT - 13, width, 13);
      context.fillStyle = colours.faint;
      context.fillText(label, x, HEIGHT - 3);
    }
  }

  /** Show a time by the line and by the numbers of the legend. */
  point(robot, time, colours) {
    if (!this.scale || this.box.classList.contains("hidden")) return;
    const x = this.scale.x(time);
    this.cursor.classList.toggle("hidden", !(x >= LEFT && x <= this.scale.width));
    this.cursor.style.transform = `translateX(${Math.round(x)}px)`;
    for (const [one, label] of this.labels) {
      const curve = columnOf(robot, one);
      label.style.color = colours[one.colour];
      label.textContent = curve ? `${one.label} ${shown(curve.at(one.column, time), 3)}` : "";
    }
  }
}

/** All charts, in their order. */
export function makeCharts(parent, onTime) {
  return CHARTS.map((definition) => new Chart(definition, parent, onTime));
}
