import { makeCharts } from "./charts.js";
import { shown } from "./geometry.js";
import { drawArrow, drawMap, layersOf } from "./map.js";
import { add, EventList, showSummary, showValues } from "./panels.js";
import { Robot } from "./store.js";
import { startPointer, View } from "./view.js";

// The state of the page and its drawing, for a report and for live robots.

export const $ = (id) => document.getElementById(id);
export const page = {
  data: JSON.parse($("data").textContent),
  robots: [],
  robot: new Robot("", { xy_tolerance: 0.1, yaw_tolerance: 0.1, limits: {}, nees: [0, 0] }), // the robot that is shown
  runs: null, // in a comparison: the robots, each with the name of its colour
  player: null, // in a report
  view: new View(),
  tools: { current: "pan", draw: null },
  hidden: new Set(), // names of layers of the map
  hover: null, // [s] time at the pointer, or null
  zoom: null, // [s] begin and end of the charts, or null for the length in the select box
  frames: 0,
  onRobot() {}, // called when another robot is shown
};
globalThis.diffbotPage = page; // for the console and the tests
const WINDOWS = [["everything", Infinity], ["10 s", 10], ["60 s", 60], ["5 min", 300]];
const CHART_PERIOD = { report: 90, live: 200 }; // [ms] shortest time between two drawings of moving charts
const FAST_FRAME = 22; // [ms] longest frame of a fast browser; a display of 50 Hz has frames of 20 ms
const PAUSE_FRAMES = 7; // pause after each frame of a slow browser, which then draws for an eighth of the time
const REACH = 12; // [pixels] largest distance from the path at which the pointer shows its time
const LAYERS = { ellipses: "95 % ellipses", plan: "planned path" };
const COLOURS = ["page", "panel", "text", "faint", "line", "mark", "truth", "estimate", "odometry", "fixes", "goal", "plan", "landmarks", "dock", "near", "band", "alarm"];

let colours = {};
let isDirty = true;
let areChartsDirty = true;
let lastCharts = 0;
let lastTime = NaN; // [s] time that was drawn
let isFrameRequested = false;
let dataTimer = 0;
let frameTime = 0; // [ms] mean time between two frames with something to draw

function requestFrame() {
  if (!isFrameRequested) requestAnimationFrame(drawFrame);
  isFrameRequested = true;
}

export function redraw(withCharts = false) {
  isDirty = true;
  areChartsDirty ||= withCharts;
  requestFrame();
}

/** Redraw for new data: at once in a fast browser, else after a pause, which leaves the processor to the robot. */
export function redrawForData() {
  dataTimer ||= setTimeout(() => {
    dataTimer = 0;
    redraw();
  }, frameTime < FAST_FRAME ? 0 : PAUSE_FRAMES * frameTime);
}

function setTheme(isDark) {
  const root = document.documentElement;
  root.dataset.theme = isDark ? "dark" : "light";
  const style = getComputedStyle(root);
  colours = Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  redraw(true);
}

/** Return the time [s] that is shown: the time of the slider, or of the newest row. */
function timeNow() {
  if (page.player) return page.player.time;
  const curve = page.robot.main;
  return curve?.rows ? curve.t[curve.rows - 1] : 0;
}

/** Show a time [s]; a live page only marks the time. */
export function goTo(time) {
  if (page.player) page.player.go(time);
  else setHover(time);
}

function setHover(time) {
  if (page.hover === time) return;
  page.hover = time;
  redraw();
}

function zoomTo(range) {
  page.zoom = range;
  if (range && page.player) {
    const { begin, end } = page.player;
    page.zoom = [Math.max(range[0], begin), Math.min(range[1], end)];
    if (page.zoom[1] - page.zoom[0] >= end - begin) page.zoom = null;
  }
  $("unzoom").classList.toggle("hidden", !page.zoom);
  redraw(true);
}

const charts = makeCharts({ onTime: goTo, onHover: setHover, onZoom: zoomTo });
const panels = document.querySelectorAll("details");
export const events = new EventList($("events"), $("filters"), goTo);

/** Return begin and end [s] of the charts. */
function chartSpan(time) {
  if (page.zoom) return page.zoom;
  const length = Number($("window").value);
  if (page.player) {
    const { begin, end } = page.player;
    if (length >= end - begin) return [begin, Math.max(end, begin + 1e-3)];
    const from = Math.min(Math.max(time - length / 2, begin), end - length);
    return [from, from + length];
  }
  const main = page.robot.main;
  return [Math.max(time - length, main?.rows ? main.t[0] : 0), time + 1e-3];
}

function drawFrame(now) {
  isFrameRequested = false;
  page.player?.step(now);
  if (!isDirty) return;
  isDirty = false;
  page.frames += 1;
  requestAnimationFrame((next) => {
    frameTime += 0.3 * (next - now - frameTime);
  });
  const time = timeNow();
  const { hover, hidden, robot, runs, tools, view } = page;
  if (!page.player) view.keep(robot, time);
  const context = drawMap($("map"), view, page.robots, robot, runs, { time, hover, hidden, colours });
  if (tools.draw) drawArrow(context, view, tools.draw, 50, tools.current === "goal" ? colours.goal : colours.plan);
  drawCharts(now, time);
  for (const chart of charts) chart.point(hover ?? time, colours);
  events.point(time);
  showValues($("values"), robot, hover ?? time);
  showLegend();
  showState(time);
  buttons.follow.setAttribute("aria-pressed", String(view.follow));
  const clock = page.player ? `${shown(time, 1)} s of ${shown(page.player.end, 1)} s` : `${shown(time, 1)} s`;
  $("clock").textContent = hover === null ? clock : `${clock}, cursor at ${shown(hover)} s`;
}

/** Draw the charts if they have changed, and every CHART_PERIOD if they move with the time. */
function drawCharts(now, time) {
  const [t0, t1] = chartSpan(time);
  const isMoving = time !== lastTime && !page.zoom && !(page.player && t1 >= page.player.end && t0 <= page.player.begin);
  lastTime = time;
  const period = areChartsDirty ? 15 : CHART_PERIOD[page.player ? "report" : "live"];
  if ((areChartsDirty || isMoving) && now - lastCharts > period) {
    for (const chart of charts) chart.draw(page.robot, page.runs, t0, t1, colours);
    for (const panel of panels) panel.classList.toggle("hidden", !panel.querySelector(".chart:not(.hidden)"));
    lastCharts = now;
    areChartsDirty = false;
  } else if (areChartsDirty) redraw();
}

/** Show the available layers of the map, each with a check box that shows or hides the layer. */
function showLegend() {
  const layers = page.runs?.map(({ name }) => name) ?? layersOf(page.robot);
  if ($("legend").dataset.layers === layers.join()) return;
  $("legend").dataset.layers = layers.join();
  $("legend").replaceChildren();
  for (const name of layers) {
    const label = add($("legend"), "label");
    const box = add(label, "input", "", { type: "checkbox" });
    box.checked = !page.hidden.has(name);
    const swatch = add(label, "span", "", { class: "swatch" });
    const colour = page.runs?.find((run) => run.name === name).colour ?? (name === "ellipses" ? "estimate" : name);
    swatch.style.background = `var(--${colour})`;
    if (name === "ellipses") swatch.style.opacity = "0.4";
    add(label, "span", LAYERS[name] ?? name);
    box.addEventListener("change", () => {
      page.hidden[box.checked ? "delete" : "add"](name);
      redraw();
    });
  }
}

function chooseRobot(name) {
  page.robot = page.robots.find((one) => one.name === name) ?? page.robots[0];
  $("robot").value = page.robot.name;
  events.clear();
  events.append(page.robot.events);
  showSummary($("summary"), page.runs ?? [page.robot]);
  page.onRobot();
  // The parts around the map are drawn first, since they determine its size.
  showLegend();
  showValues($("values"), page.robot, timeNow());
  Object.assign(page.view, { width: $("map").clientWidth, height: $("map").clientHeight });
  page.view.fit(page.robot);
  redraw(true);
}

export function setRobots(robots) {
  page.robots = robots;
  $("robot").replaceChildren(...robots.map((one) => new Option(one.name, one.name)));
  $("robot-label").classList.toggle("hidden", robots.length < 2);
  chooseRobot(page.robot.name);
}

/** Show the state at a time. The last state of a bag is not shown, since it only reports that the nodes have ended. */
function showState(time) {
  const [level, text] = page.player && time >= page.player.end ? [0, "end of the recording"] : page.robot.stateAt(time);
  if ($("state").textContent !== text) $("state").textContent = text;
  $("state").title = text;
  $("state").dataset.level = String(level);
}

let alarmTimer = 0;
export function alarm(text, seconds = 6, level = 2) {
  $("alarm").textContent = text;
  $("alarm").dataset.level = String(level);
  $("alarm").classList.toggle("hidden", !text);
  clearTimeout(alarmTimer);
  if (text && seconds < Infinity) alarmTimer = setTimeout(() => alarm(""), seconds * 1000);
}

export const keys = new Map(); // function of each key
export const buttons = {};
export function addButton(name, text, key, action, isToggle = false) {
  const button = add($("tools"), "button", text, { type: "button", title: `${text} (${key})` });
  if (isToggle) button.setAttribute("aria-pressed", "false");
  button.addEventListener("click", action);
  keys.set(key, () => button.click());
  buttons[name] = button;
}

function onKey(event) {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  if (event.target.closest("input:not([type=range], [type=checkbox]), select")) return;
  if (event.key === " " && event.target.closest("button, input")) return;
  const action = keys.get(event.key);
  if (!action) return;
  event.preventDefault();
  action();
}

/** Show the coordinates under the pointer, and the time at which the robot was there. */
function hoverMap(place) {
  const [x, y] = place ? page.view.toWorld(...place) : [NaN, NaN];
  $("place").textContent = place ? `x ${shown(x)} m, y ${shown(y)} m` : "";
  setHover(place ? (page.robot.main?.timeNear(x, y, REACH / page.view.scale, timeNow()) ?? null) : null);
}

/** Connect map, charts, keys and theme. When the user has drawn a pose on the map, `onPose` is called with kind and pose. */
export function startPage(onPose = () => {}) {
  addButton("all", "Show all", "0", () => {
    page.view.fit(page.robot);
    redraw();
  });
  addButton("follow", "Follow", "f", () => {
    page.view.follow = !page.view.follow;
    redraw();
  }, true);
  startPointer($("map"), page.view, page.tools, { onPose, onHint: alarm, onChange: () => redraw(), onHover: hoverMap });
  for (const [text, length] of WINDOWS) $("window").add(new Option(text, String(length)));
  $("window").addEventListener("change", () => zoomTo(null));
  $("unzoom").addEventListener("click", () => zoomTo(null));
  for (const panel of panels) panel.addEventListener("toggle", () => redraw(true));
  $("robot").addEventListener("change", () => chooseRobot($("robot").value));
  const preferred = matchMedia("(prefers-color-scheme: dark)");
  const toggleTheme = () => setTheme(document.documentElement.dataset.theme !== "dark");
  preferred.addEventListener("change", () => setTheme(preferred.matches));
  $("theme").addEventListener("click", toggleTheme);
  keys.set("d", toggleTheme);
  document.addEventListener("keydown", onKey);
  new ResizeObserver(() => redraw(true)).observe(document.body);
  setTheme(preferred.matches);
}
