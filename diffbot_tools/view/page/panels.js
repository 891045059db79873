import { degrees, lengthText, shown } from "./geometry.js";

// Texts beside the drawings. Texts from a bag or a robot are set as text, never as markup.

/** Events that are kept; beyond this number, the oldest are dropped. */
export const MAX_EVENTS = 2000;

const MANY = 5; // with more goals, a card shows its verdict only, and its lines as a hint

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

/** The result of a report: its health in words, and a card for each goal; a click on a card shows the end of its goal. */
export function showResult(parent, robot, onTime) {
  parent.replaceChildren();
  const head = add(parent, "p", "", { class: "health" });
  for (const [level, words] of robot.health) add(head, "span", words, { "data-level": String(level) });
  const cards = add(parent, "div", "", { class: robot.cards.length > MANY ? "cards many" : "cards" });
  const rows = robot.cards.map((one, index) => ({ ...one, number: index + 1 }));
  // With many goals, the missed goals come first.
  if (rows.length > MANY) rows.sort((one, other) => Math.max(other.level, 0) - Math.max(one.level, 0));
  for (const { goal: [x, y, theta], number, level: own, verdict, lines, ended, accepted } of rows) {
    const card = add(cards, "button", "", { type: "button", "data-level": String(own) });
    add(card, "small", `Goal ${number}: ${shown(x)}, ${shown(y)} m, ${degrees(theta, 0)} deg`);
    add(card, "strong", verdict);
    if (rows.length > MANY) card.title = lines.map(([, words]) => words).join("\n");
    else for (const [one, words] of lines) add(card, "span", words, { "data-level": String(one) });
    card.addEventListener("click", () => onTime(ended ?? accepted));
  }
}

const FIGURES = [
  ["time [s]", "time", 1],
  ["error [m]", "position_error", 4],
  ["heading error [deg]", "heading_error", 1, 180 / Math.PI],
  ["path [m]", "path_length", 2],
  ["direct [m]", "direct_distance", 2],
  ["turns", "revolutions", 2],
];

/** The table of goals and how they ended; in a comparison goal by goal, with the differences to the first run. */
export function showSummary(parent, robots) {
  const isComparison = robots.length > 1;
  const rows = [];
  for (let i = 0; i < Math.max(...robots.map(({ cards }) => cards.length)); i += 1) {
    for (const { name, cards } of robots) {
      const [one, first] = [cards[i], robots[0].cards[i]];
      if (!one) continue;
      const figures = FIGURES.map(([, key, digits, factor = 1]) => {
        const difference = factor * (one[key] - first?.[key]);
        const isOther = one !== first && one[key] !== null && (first?.[key] ?? null) !== null;
        return `${shown(factor * (one[key] ?? NaN), digits)}${isOther ? ` (${difference < 0 ? "" : "+"}${shown(difference, digits)})` : ""}`;
      });
      const [x, y, theta] = one.goal;
      const goal = `${shown(x)}, ${shown(y)}, ${degrees(theta)} deg`;
      rows.push([...(isComparison ? [name] : []), goal, shown(one.accepted, 1), [one.end || "–", one.level > 1 ? "bad" : ""], ...figures]);
    }
  }
  const head = ["goal (x, y, heading)", "accepted [s]", "end", ...FIGURES.map(([text]) => text)];
  const title = `Goals: time from acceptance to answer, error of the pose at the answer${isComparison ? "; differences to the first run" : ""}`;
  fillTable(parent, title, isComparison ? ["run", ...head] : head, rows);
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

/** The numbers below the map at a time. */
export function showValues(parent, robot, time) {
  const pose = robot.main?.poseAt(time);
  const at = (curve, column) => robot.curves[curve]?.at(column, time) ?? NaN;
  const error = robot.errorAt(time);
  const speed = robot.speedAt(time);
  const values = [
    ["to goal", lengthText(at("to_goal", "distance"))],
    ["heading error", degrees(at("to_goal", "heading")), "deg"],
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

/** The law's variables at a time, each with an explanation. */
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
