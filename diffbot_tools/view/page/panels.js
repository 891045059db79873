import { shown } from "./geometry.js";
import { degrees, lengthText } from "./words.js";

// Texts beside the drawings. Whatever comes from a bag or a robot is set as text, never as markup.

/** Events that are kept; the oldest go first. */
export const MAX_EVENTS = 2000;

const MANY = 8; // goals whose cards do not fit onto the first screen

/** Append an element with a text and attributes; return it. */
export function add(parent, tag, text = "", attributes = {}) {
  const element = parent.ownerDocument.createElement(tag);
  element.textContent = text;
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  parent.append(element);
  return element;
}

/** Replace the content of an element by a heading and a table; rows are texts, or [text, class]. */
export function fillTable(parent, title, head, rows) {
  parent.replaceChildren();
  if (!rows.length) return;
  add(parent, "h2", title);
  const table = add(parent, "table");
  const first = add(add(table, "thead"), "tr");
  const kinds = rows[0].map((cell) => (/^[-–\d]/.test([cell].flat()[0]) ? "" : "text"));
  head.forEach((text, index) => add(first, "th", text, { scope: "col", class: kinds[index] }));
  const body = add(table, "tbody");
  for (const row of rows) {
    const line = add(body, "tr");
    row.forEach((cell, index) => {
      const [text, kind] = [cell].flat();
      add(line, "td", text, { class: `${kinds[index]} ${kind ?? ""}`, "data-head": head[index] });
    });
  }
}

/** The result of a report: health, and a card for each goal, which goes to its end. */
export function showResult(parent, robot, onTime) {
  parent.replaceChildren();
  const rows = robot.summary;
  const reached = rows.filter((one) => one.end.startsWith("reached") && one.level === 0).length;
  // A path is one goal, which is its last pose.
  const total = rows.filter((one) => one.end !== "passed").length;
  const head = add(parent, "p", "", { class: "health" });
  if (total) add(head, "strong", `${reached} of ${total} ${total === 1 ? "goal" : "goals"} reached`);
  for (const [level, text] of robot.health) add(head, "span", text, { "data-level": String(level) });
  const cards = add(parent, "div", "", { class: "cards" });
  // Of many goals, those that failed come first.
  const shownRows = rows.length > MANY ? [...rows].sort((a, b) => b.level - a.level) : rows;
  shownRows.forEach((one) => {
    const [x, y, theta] = one.goal;
    const card = add(cards, "button", "", { type: "button", "data-level": String(one.level) });
    add(card, "small", `Goal ${rows.indexOf(one) + 1}: ${shown(x)}, ${shown(y)} m, ${degrees(theta, 0)} deg`);
    add(card, "strong", one.verdict, { "data-level": String(one.level) });
    for (const [level, text] of one.lines) add(card, "span", text, { "data-level": String(level) });
    card.addEventListener("click", () => onTime(one.ended ?? one.time));
  });
}

/** The table of goals and how they ended; of several runs goal by goal, with the differences to the first run. */
export function showSummary(parent, robots) {
  const isComparison = robots.length > 1;
  const head = ["goal (x, y, heading)", "sent [s]", "end", "error [m]", "heading error [deg]", "settled [s]", "path [m]", "direct [m]"];
  const rows = [];
  for (let i = 0; i < Math.max(...robots.map(({ summary }) => summary.length)); i += 1) {
    for (const { name, summary } of robots) {
      const [one, first] = [summary[i], robots[0].summary[i]];
      if (!one) continue;
      const value = (key, digits, factor = 1) => {
        const difference = factor * (one[key] - first?.[key]);
        const isOther = one !== first && Number.isFinite(one[key]) && Number.isFinite(first?.[key]);
        return `${shown(one[key] === undefined ? NaN : factor * (one[key] ?? NaN), digits)}${isOther ? ` (${difference < 0 ? "" : "+"}${shown(difference, digits)})` : ""}`;
      };
      const [x, y, theta] = one.goal;
      const end = [one.end || "–", /^(not reached|pose lost)/.test(one.end) ? "bad" : ""];
      const goal = `${shown(x)}, ${shown(y)}, ${degrees(theta)} deg`;
      const figures = [value("position_error", 4), value("heading_error", 1, 180 / Math.PI), value("settled", 1), value("path", 2), value("direct", 2)];
      rows.push([...(isComparison ? [name] : []), goal, shown(one.time, 1), end, ...figures]);
    }
  }
  fillTable(parent, isComparison ? "Goals, with the differences to the first run" : "Goals", isComparison ? ["run", ...head] : head, rows);
}

/** The table of topics: rates, gaps and delays. */
export function showTopics(parent, topics) {
  const head = ["topic", "type", "messages", "rate [Hz]", "largest gap [s]", "delay, median [ms]", "delay, 99 % [ms]"];
  const rows = topics.map((one) => [
    one.name,
    one.type,
    String(one.count),
    shown(one.rate, 1),
    shown(one.gap, 3),
    shown(one.delay * 1000, 1),
    shown(one.delay99 * 1000, 1),
  ]);
  fillTable(parent, "Topics", head, rows);
}

/** The newest diagnoses, the worst first. */
export function showDiagnostics(parent, diagnostics) {
  const words = ["ok", "warning", "ERROR", "no news", "ended"];
  const rows = [...diagnostics]
    .sort((a, b) => (b.level % 4) - (a.level % 4))
    .map((one) => [one.name, [words[one.level] ?? "unknown", one.level === 2 || one.level === 3 ? "bad" : ""], one.message]);
  fillTable(parent, "Diagnostics", ["node", "level", "in words"], rows);
}

/** The list of events, with a box per kind that hides it. */
export class EventList {
  constructor(list, filters, onTime) {
    Object.assign(this, { list, filters, onTime, hidden: new Set(), kinds: new Set(), items: [] });
  }

  clear() {
    this.list.replaceChildren();
    this.filters.replaceChildren();
    this.kinds.clear();
    this.items = [];
  }

  /** Add events [t, kind, level, text]. */
  append(events) {
    const isAtEnd = this.list.scrollTop + this.list.clientHeight >= this.list.scrollHeight - 4;
    for (const [time, kind, level, text] of events) {
      const item = add(this.list, "li");
      const button = add(item, "button", `${shown(time, 1)} s  ${text}`, { type: "button", "data-level": String(level) });
      button.addEventListener("click", () => this.onTime(time));
      item.classList.toggle("hidden", this.hidden.has(kind));
      this.items.push({ time, kind, item, button });
      if (!this.kinds.has(kind)) this.addKind(kind);
    }
    while (this.items.length > MAX_EVENTS) this.items.shift().item.remove();
    if (isAtEnd) this.list.scrollTop = this.list.scrollHeight;
  }

  addKind(kind) {
    this.kinds.add(kind);
    const label = add(this.filters, "label", kind);
    const box = add(label, "input", "", { type: "checkbox" });
    box.checked = !this.hidden.has(kind);
    box.addEventListener("change", () => {
      if (box.checked) this.hidden.delete(kind);
      else this.hidden.add(kind);
      for (const one of this.items) one.item.classList.toggle("hidden", this.hidden.has(one.kind));
    });
  }

  /** Mark the last event before a time. */
  point(time) {
    const last = this.items.findLast((one) => one.time <= time);
    if (last === this.marked) return;
    this.marked?.button.classList.remove("past");
    last?.button.classList.add("past");
    this.marked = last;
  }
}

/** The present numbers below the map; live ones and those of a report are the same. */
export function showValues(parent, robot, time) {
  const pose = robot.main?.poseAt(time);
  const at = (curve, column) => robot.curves[curve]?.at(column, time) ?? NaN;
  const error = robot.errorAt(time);
  const speed = robot.speedAt(time);
  const values = [
    ["to goal", lengthText(at("toGo", "distance"))],
    ["heading error", degrees(at("toGo", "heading")), "deg"],
    ["since goal", shown(robot.clockAt(time), 1), "s"],
    ["v", shown(speed.v), "m/s"],
    ["omega", shown(speed.omega), "rad/s"],
    ["x", shown(pose?.x), "m"],
    ["y", shown(pose?.y), "m"],
    ["heading", degrees(pose?.theta), "deg"],
    ["off the truth", error ? `${lengthText(error.distance)}, ${degrees(error.heading)} deg` : "–"],
  ];
  fillValues(parent, values);
}

const LAW = [
  ["rho", "m", "distance to the goal"],
  ["alpha", "rad", "direction of the goal, seen from the robot's heading; undefined at the goal"],
  ["beta", "rad", "direction of the goal, seen from the goal's heading; undefined at the goal"],
  ["V", "", "Lyapunov function of the region: falls as long as the law acts without disturbance"],
  ["eps_P", "m", "radius of Omega_L around the goal"],
  ["region", "", "Omega_G: far, the law drives and steers; Omega_L: near, it drives and holds the heading"],
];

/** The law's variables, with a line each on what it is. */
export function showLaw(parent, robot, time) {
  const { law } = robot.curves;
  if (!law) return;
  const region = law.at("region", time);
  const values = LAW.map(([name, unit, text]) => {
    const value = name === "region" ? (["Omega_G", "Omega_L"][region] ?? "–") : shown(law.at(name, time), 3);
    return [name, value, unit, text];
  });
  fillValues(parent, values);
}

function fillValues(parent, values) {
  if (parent.children.length !== values.length) {
    parent.replaceChildren();
    for (const [name, , , text] of values) {
      const row = add(parent, "div");
      add(row, "dt", name);
      add(row, "dd");
      if (text) add(row, "dd", text, { class: "what" });
    }
  }
  values.forEach(([, text, unit], index) => {
    parent.children[index].children[1].textContent = `${text} ${text === "–" || !unit ? "" : unit}`;
  });
}
