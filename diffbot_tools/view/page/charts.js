import { rangeOf, roundStep, shown } from "./geometry.js";
import { cleared } from "./map.js";

// Strip charts: the curves of each chart, and how they are drawn.

const DEGREES = 180 / Math.PI;
const line = (curve, column, colour, label, factor = 1) => ({ curve, column, colour, label, factor });
const error = (column, factor = 1) => ({
  lines: [line("error", column, "estimate", "estimate - truth", factor)],
  band: line("error", `three_sigma_${column}`, "", "", factor),
});
const speeds = (column) => [
  line("odometry", column, "odometry", "odometry"),
  line("truth", column, "truth", "truth"),
  line("command", column, "estimate", "command"),
];
const rim = (side) => ({ title: `Rim of the ${side} wheel`, unit: "m/s", lines: speeds(side), limit: "rim" });
const residual = (column, colour, factor = 1) => line("residual", column, colour, column === "theta" ? "heading" : column, factor);
const bound = (column, factor = 1) => line("filter", column, "", "", factor);

const GROUPS = {
  "drive-charts": [
    { title: "Distance to the goal", unit: "m", lines: [line("to_goal", "distance", "goal", "distance")], near: true },
    { title: "Heading error to the goal", unit: "deg", lines: [line("to_goal", "heading", "goal", "heading", DEGREES)], near: true, turn: 360 },
    { title: "v", unit: "m/s", lines: speeds("v"), limit: "v" },
    { title: "omega", unit: "rad/s", lines: speeds("omega"), limit: "omega" },
    { title: "Error of x, 3 sigma shaded", unit: "m", ...error("x") },
    { title: "Error of y, 3 sigma shaded", unit: "m", ...error("y") },
    { title: "Error of heading, 3 sigma shaded", unit: "deg", ...error("theta", DEGREES) },
  ],
  "law-charts": [
    { title: "Radius of Omega_L; shaded inside it", unit: "m", lines: [line("law", "rho", "truth", "rho"), line("law", "eps_P", "goal", "eps_P")], near: true },
    { title: "Angles, where rho defines them", unit: "rad", lines: [line("law", "alpha", "truth", "alpha"), line("law", "beta", "estimate", "beta")], turn: 2 * Math.PI },
    { title: "V", unit: "", lines: [line("law", "V", "truth", "V")] },
  ],
  "filter-charts": [
    { title: "NIS per number, 95 % bounds dashed", unit: "", lines: [line("filter", "nis", "truth", "NIS")], bounds: [bound("nis_low"), bound("nis_high")] },
    { title: "NEES, 95 % bounds dashed", unit: "", lines: [line("error", "nees", "truth", "NEES")], constant: "nees" },
    {
      title: "Whiteness of innovations, 95 % bounds dashed",
      unit: "",
      lines: [line("filter", "whiteness", "truth", "autocorrelation")],
      bounds: [bound("whiteness_bound"), bound("whiteness_bound", -1)],
    },
    { title: "Fix minus estimate", unit: "m", lines: [residual("x", "truth"), residual("y", "estimate")] },
    { title: "Fix minus estimate, heading", unit: "deg", lines: [residual("theta", "truth", DEGREES)] },
    { title: "Errors of wheel radii", unit: "", lines: [line("filter", "left", "truth", "left"), line("filter", "right", "estimate", "right")] },
  ],
  "wheel-charts": [rim("left"), rim("right")],
};
const HEIGHT = 92;
const LEFT = 62;
const SHADED = /[,;] [^,;]*shaded.*/; // words of a title about shading, which a comparison does not draw
const SHORTEST = 4; // [pixels] of a drag that zooms

const columnOf = (robot, { curve, column }) => {
  const found = robot.curves[curve];
  return found?.columns[column] && found.rows ? found : null;
};
const hasNumbers = (robot, one) => {
  const found = columnOf(robot, one);
  for (let i = 0; i < found?.rows; i += 1) if (Number.isFinite(found.columns[one.column][i])) return true;
  return false;
};

/** The lines of a chart, each with its robot; in a comparison, one line of each run in the colour of the run. */
const linesOf = ({ lines }, robot, runs) => {
  if (!runs) return lines.map((one) => ({ ...one, robot }));
  return runs.flatMap((run) => {
    const best = lines.find((one) => hasNumbers(run, one));
    return best ? [{ ...best, robot: run, colour: run.colour, label: run.name }] : [];
  });
};

/** A short text for a number of an axis with this step. */
function axisNumber(value, step) {
  const power = Math.floor(Math.log10(step));
  if (power >= -4 || value === 0) return value.toFixed(Math.min(Math.max(-power, 0), 4));
  return value.toExponential(Math.max(Math.floor(Math.log10(Math.abs(value))) - power, 0));
}

/** Trace a column between two times, with the first, lowest, highest and last value of each pixel. */
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
      if (first !== first) first = value;
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

/** A strip chart: `onTime` is called by a click, `onHover` with the time under the pointer or null, `onZoom` with a range. */
export class Chart {
  constructor(definition, parent, { onTime, onHover, onZoom }) {
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
    this.title = make("span", head);
    this.addLabel = () => make("span", head);
    this.labels = [];
    this.lines = [];
    this.canvas = make("canvas", this.box);
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", definition.title);
    this.cursor = make("div", this.box);
    this.cursor.className = "cursor";
    this.range = make("div", this.box);
    this.range.className = "range hidden";
    this.scale = null;
    let start = null;
    const place = (event) => event.clientX - this.canvas.getBoundingClientRect().left;
    const timeAt = (x) => this.scale.t0 + ((Math.max(x, LEFT) - LEFT) / (this.scale.width - LEFT)) * (this.scale.t1 - this.scale.t0);
    const showRange = (x) => {
      this.range.classList.toggle("hidden", x === null);
      if (x === null) return;
      this.range.style.left = `${Math.min(start, x)}px`;
      this.range.style.width = `${Math.abs(x - start)}px`;
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !this.scale) return;
      start = Math.max(place(event), LEFT);
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!this.scale) return;
      const x = Math.min(Math.max(place(event), LEFT), this.scale.width);
      if (start !== null) showRange(x);
      onHover(timeAt(x));
    });
    this.canvas.addEventListener("pointerup", (event) => {
      if (start === null) return;
      const x = Math.min(Math.max(place(event), LEFT), this.scale.width);
      if (Math.abs(x - start) < SHORTEST) onTime(timeAt(x));
      else onZoom([timeAt(Math.min(x, start)), timeAt(Math.max(x, start))]);
      start = null;
      showRange(null);
    });
    this.canvas.addEventListener("pointercancel", () => {
      start = null;
      showRange(null);
    });
    this.canvas.addEventListener("pointerleave", () => onHover(null));
    this.canvas.addEventListener("dblclick", () => onZoom(null));
  }

  /** Lowest and highest value of lines, bounds, band and limits in a range of times, with a margin. */
  valueRange(robot, t0, t1, constants) {
    const { bounds = [], limit, constant, band, turn = Infinity } = this.definition;
    let range = null;
    const add = (one, factor = one.factor) => {
      const found = columnOf(one.robot ?? robot, one);
      if (!found) return;
      const ends = [Math.max(found.indexAt(t0), 0), Math.min(found.indexAt(t1) + 1, found.rows)];
      const ownRange = rangeOf(found.columns[one.column], ...ends);
      if (ownRange) range = rangeOf(ownRange.map((value) => factor * value), 0, 2, range);
    };
    for (const one of [...this.lines, ...bounds]) add(one);
    if (band && !this.isComparison) [1, -1].forEach((sign) => add(band, sign * band.factor));
    if (limit && Number.isFinite(constants.limits[limit])) range = rangeOf([constants.limits[limit], -constants.limits[limit]], 0, 2, range);
    if (constant) range = rangeOf(constants[constant], 0, 2, range);
    range ??= [-1, 1];
    const margin = 0.06 * (range[1] - range[0]) || 0.1 * Math.abs(range[0]) || 1;
    const end = turn / 2 + margin / 2;
    return [Math.max(range[0] - margin, -end), Math.min(range[1] + margin, end)];
  }

  draw(robot, runs, t0, t1, constants, colours) {
    const { definition, canvas } = this;
    this.isComparison = Boolean(runs);
    const title = runs ? definition.title.replace(SHADED, "") : definition.title;
    this.title.textContent = definition.unit ? `${title} [${definition.unit}]` : title;
    this.lines = linesOf(definition, robot, runs);
    const isShown = this.lines.some((one) => hasNumbers(one.robot, one));
    this.box.classList.toggle("hidden", !isShown);
    if (!isShown || !canvas.clientWidth) return; // no width: its panel is closed
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
    if (definition.near && !runs) this.shadeNear(context, robot, scale, colours);
    if (definition.band && !runs) this.shadeBand(context, robot, scale, colours);
    context.lineWidth = 1;
    context.strokeStyle = colours.faint;
    context.setLineDash([4, 3]);
    for (const one of definition.bounds ?? []) {
      const curve = columnOf(robot, one);
      if (curve) trace(context, curve, curve.columns[one.column], scale, one.factor);
    }
    const limit = definition.limit ? constants.limits[definition.limit] : null;
    const levels = definition.constant ? constants[definition.constant] : Number.isFinite(limit) ? [limit, -limit] : [];
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
    this.drawAxes(context, scale, low, high, colours);
  }

  shadeBand(context, robot, scale, colours) {
    const { band } = this.definition;
    const curve = columnOf(robot, band);
    if (!curve) return;
    const values = curve.columns[band.column];
    const y = (i, sign) => scale.y(sign * band.factor * values[i] || 0);
    const end = Math.min(curve.indexAt(scale.t1) + 2, curve.rows);
    const begin = Math.max(curve.indexAt(scale.t0), 0);
    const every = Math.max(1, Math.floor((end - begin) / (2 * scale.width)));
    context.fillStyle = colours.band;
    context.beginPath();
    for (let i = begin; i < end; i += every) context.lineTo(scale.x(curve.t[i]), y(i, 1));
    for (let i = begin + every * Math.floor((end - 1 - begin) / every); i >= begin; i -= every) {
      context.lineTo(scale.x(curve.t[i]), y(i, -1));
    }
    context.fill();
  }

  shadeNear(context, robot, scale, colours) {
    const { law } = robot.curves;
    if (!law) return;
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
      context.fillText(`${axisNumber(k * step, step)} ${this.definition.unit}`, LEFT - 4, Math.min(Math.max(y + 3, 9), HEIGHT - 2));
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
      context.fillStyle = colours.panel; // no line may run through the label
      context.fillRect(x - width / 2, HEIGHT - 13, width, 13);
      context.fillStyle = colours.faint;
      context.fillText(label, x, HEIGHT - 3);
    }
  }

  /** Mark a time by the cursor, and show its values in the legend. */
  point(time, colours) {
    if (!this.scale || this.box.classList.contains("hidden")) return;
    const x = this.scale.x(time);
    this.cursor.classList.toggle("hidden", !(x >= LEFT && x <= this.scale.width));
    this.cursor.style.transform = `translateX(${Math.round(x)}px)`;
    while (this.labels.length < this.lines.length) this.labels.push(this.addLabel());
    this.lines.forEach((one, index) => {
      const curve = columnOf(one.robot, one);
      const value = curve ? shown(one.factor * curve.at(one.column, time), this.definition.unit === "deg" ? 1 : 3) : "";
      this.labels[index].style.color = colours[one.colour];
      this.labels[index].textContent = curve ? `${one.label} ${value} ${this.definition.unit}` : "";
    });
  }
}

/** All charts, each in the panel of its group; `reactions`: see Chart. */
export function makeCharts(document, reactions) {
  return Object.entries(GROUPS).flatMap(([id, definitions]) =>
    definitions.map((definition) => new Chart(definition, document.getElementById(id), reactions)),
  );
}
