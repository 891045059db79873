import { degrees, lengthText, shown } from "./geometry.js";

// Texts beside the drawings. Texts from a bag or a robot are set as text, never as markup.

/** Number of events that are kept. The oldest are dropped. */
export const MAX_EVENTS = 2000;

const MANY = 5; // if there are more cards, a card shows its lines only as a tooltip

/** Append an element with a text and attributes; return it. */
export function add(parent, tag, text = "", attributes = {}) {
  const element = parent.ownerDocument.createElement(tag);
  element.textContent = text;
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  parent.append(element);
  return element;
}

/** Replace the content of an element by a heading and a table. A cell is a text, or [text, class]. */
function fillTable(parent, title, head, rows) {
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

/** Show the health in words, and a card for each goal and docking; a click on a card shows the time at which the goal ended. */
export function showResult(parent, robot, onTime) {
  parent.replaceChildren();
  const head = add(parent, "p", "", { class: "health" });
  for (const [level, text] of robot.health) add(head, "span", text, { "data-level": String(level) });
  const isMany = robot.cards.length > MANY;
  const box = add(parent, "div", "", { class: isMany ? "cards many" : "cards" });
  const cards = [...robot.cards];
  // Of many cards, the missed goals come first.
  if (isMany) cards.sort((one, other) => Math.max(other.level, 0) - Math.max(one.level, 0));
  for (const { title, level, verdict, lines, ended, accepted } of cards) {
    const card = add(box, "button", "", { type: "button", "data-level": String(level) });
    add(card, "small", title);
    add(card, "strong", verdict);
    if (isMany) card.title = lines.map(([, text]) => text).join("\n");
    else for (const [own, text] of lines) add(card, "span", text, { "data-level": String(own) });
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

/** Show the table of goals and their ends; in a comparison, goal by goal with the differences to the first run. */
export function showSummary(parent, robots) {
  const isComparison = robots.length > 1;
  const rows = [];
  for (let i = 0; i < Math.max(...robots.map(({ cards }) => cards.length)); i += 1) {
    for (const { name, cards } of robots) {
      const [one, first] = [cards[i], robots[0].cards[i]];
      if (!one) continue;
      const figures = FIGURES.map(([, key, digits, factor = 1]) => {
        const text = shown(factor * (one[key] ?? NaN), digits);
        const difference = factor * (one[key] - first?.[key]);
        if (one === first || one[key] === null || (first?.[key] ?? null) === null) return text;
        return `${text} (${difference < 0 ? "" : "+"}${shown(difference, digits)})`;
      });
      const end = [one.end || "–", one.level > 1 ? "bad" : ""];
      rows.push([...(isComparison ? [name] : []), one.title, shown(one.accepted, 1), end, ...figures]);
    }
  }
  const head = [...(isComparison ? ["run"] : []), "goal", "accepted [s]", "end", ...FIGURES.map(([text]) => text)];
  const differences = isComparison ? "; in brackets the difference to the first run" : "";
  fillTable(parent, `Goals: time from acceptance to answer, error at the answer${differences}`, head, rows);
}

/** Show the table of topics: rates, gaps and delays. */
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

/** Show the newest diagnoses, the worst first. */
export function showDiagnostics(parent, diagnostics) {
  const words = ["ok", "warning", "error", "stale", "ended"];
  const rows = [...diagnostics]
    .sort((a, b) => (b.level % 4) - (a.level % 4)) // ended (4) is sorted like ok (0)
    .map((one) => [one.name, [words[one.level] ?? "unknown", one.level === 2 || one.level === 3 ? "bad" : ""], one.message]);
  fillTable(parent, "Diagnostics", ["node", "level", "message"], rows);
}

/** The list of events, with a check box for each kind of event that shows or hides these events. */
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

  /** Mark the last event at or before a time. */
  point(time) {
    const last = this.items.findLast((one) => one.time <= time);
    if (last === this.marked) return;
    this.marked?.button.classList.remove("past");
    last?.button.classList.add("past");
    this.marked = last;
  }
}

/** Show the numbers below the map at a time. */
export function showValues(parent, robot, time) {
  const pose = robot.main?.poseAt(time);
  const at = (curve, column) => robot.curves[curve]?.at(column, time) ?? NaN;
  const error = robot.errorAt(time);
  const speed = robot.speedAt(time);
  const values = {
    "to goal": lengthText(at("to_goal", "distance")),
    "heading error": shown(degrees(at("to_goal", "heading")), 1, "deg"),
    "since goal": shown(robot.sinceGoalAt(time), 1, "s"),
    v: shown(speed.v, 2, "m/s"),
    omega: shown(speed.omega, 2, "rad/s"),
    x: shown(pose?.x, 2, "m"),
    y: shown(pose?.y, 2, "m"),
    heading: shown(degrees(pose?.theta), 1, "deg"),
    "true error": error ? `${lengthText(error.distance)}, ${shown(degrees(error.heading), 1, "deg")}` : "–",
  };
  for (const [index, [name, text]] of Object.entries(values).entries()) {
    const row = parent.children[index] ?? add(parent, "div");
    if (!row.children.length) add(row, "dt", name);
    (row.children[1] ?? add(row, "dd")).textContent = text;
  }
}
