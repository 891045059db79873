import { shown } from "./geometry.js";

// Texts beside the drawings. Whatever comes from a bag or a robot is set as text, never as markup.

/** Events that are kept; the oldest go first. */
export const MAX_EVENTS = 2000;

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
  const table = add(add(parent, "div", "", { class: "scroll" }), "table");
  const first = add(add(table, "thead"), "tr");
  for (const text of head) add(first, "th", text, { scope: "col" });
  const body = add(table, "tbody");
  for (const row of rows) {
    const line = add(body, "tr");
    for (const cell of row) {
      if (Array.isArray(cell)) add(line, "td", cell[0], { class: cell[1] });
      else add(line, "td", cell);
    }
  }
}

const degrees = (angle) => shown((angle * 180) / Math.PI, 1);

/** The table of goals and how they ended. */
export function showSummary(parent, robot) {
  const head = ["goal (x, y, heading)", "sent [s]", "end", "error [m]", "heading error [deg]", "settled [s]", "path [m]", "direct [m]"];
  const rows = robot.summary.map((one) => {
    const [x, y, theta] = one.goal;
    const isBad = /^(not reached|pose lost)/.test(one.end);
    return [
      `${shown(x)}, ${shown(y)}, ${degrees(theta)} deg`,
      shown(one.time, 1),
      [one.end || "–", isBad ? "bad" : ""],
      shown(one.position_error, 4),
      degrees(one.heading_error),
      shown(one.settled, 1),
      shown(one.path),
      shown(one.direct),
    ];
  });
  fillTable(parent, "Goals", head, rows);
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
  const words = ["ok", "warning", "ERROR", "no news"];
  const rows = [...diagnostics]
    .sort((a, b) => b.level - a.level)
    .map((one) => [one.name, [words[one.level] ?? "unknown", one.level > 1 ? "bad" : ""], one.message]);
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

/** The present numbers below the map. */
export function showValues(parent, robot, time) {
  const pose = robot.main?.poseAt(time);
  const at = (curve, column) => robot.curves[curve]?.at(column, time) ?? NaN;
  const values = [
    ["x", shown(pose?.x, 3), "m"],
    ["y", shown(pose?.y, 3), "m"],
    ["heading", degrees(pose?.theta), "deg"],
    ["v", shown(at("command", "v"), 3), "m/s"],
    ["omega", shown(at("command", "omega"), 3), "rad/s"],
    ["rho", shown(at("law", "rho"), 3), "m"],
    ["alpha", shown(at("law", "alpha"), 3), "rad"],
    ["beta", shown(at("law", "beta"), 3), "rad"],
    ["eps_P", shown(at("law", "eps_P"), 3), "m"],
    ["NIS", shown(at("filter", "nis")), ""],
    ["since goal", shown(robot.clockAt(time), 1), "s"],
  ];
  if (parent.children.length !== values.length) {
    parent.replaceChildren();
    for (const [name] of values) {
      const row = add(parent, "div");
      add(row, "dt", name);
      add(row, "dd");
    }
  }
  values.forEach(([, text, unit], index) => {
    parent.children[index].lastChild.textContent = `${text} ${text === "–" ? "" : unit}`;
  });
}
