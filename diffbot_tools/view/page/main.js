import { makeCharts } from "./charts.js";
import { readNumber, shown } from "./geometry.js";
import { Live } from "./live.js";
import { drawArrow, drawMap, layersOf } from "./map.js";
import { add, EventList, MAX_EVENTS, showDiagnostics, showLaw, showResult, showSummary, showTopics, showValues } from "./panels.js";
import { Player } from "./player.js";
import { Robot, unpackRobots } from "./store.js";
import { coloursOf, startTheme } from "./theme.js";
import { startPointer, View } from "./view.js";

// Connects the parts. The page is a report with its data inside, or shows live robots.

const $ = (id) => document.getElementById(id);
const page = {
  data: JSON.parse($("data").textContent),
  robots: [],
  robot: new Robot("", { xy_tolerance: 0.1, yaw_tolerance: 0.1, limits: {}, nees: [0, 0] }),
  runs: null, // in a comparison: the robots, each with the name of its colour
  view: new View(),
  tools: { current: "pan", draw: null },
  hidden: new Set(),
  hover: null, // [s] of the cursor, or null
  zoom: null, // [s] range that the charts show, or null for that of the window
  frames: 0,
};
globalThis.diffbotPage = page; // for the console and the tests
const WINDOWS = [["everything", Infinity], ["10 s", 10], ["60 s", 60], ["5 min", 300]];
const FAST_FRAME = 22; // [ms] of a display of 50 Hz
const PAUSE_FRAMES = 7; // a slow browser spends an eighth of its time on drawing new data
const REACH = 12; // [pixels] from the path within which the pointer shows its time
const CONFIRM = 3000; // [ms] for the second press of a button that asks
const RUNS = ["truth", "estimate", "plan"]; // whose colours the runs of a comparison have
const WORDS = { ellipses: "95 % ellipses", plan: "planned path" };

let colours = {};
let isDirty = true;
let areChartsDirty = true;
let lastCharts = 0;
let lastTime = NaN; // [s] that was drawn
let isFrameAsked = false;
let dataTimer = 0;
let frameTime = 0; // [ms] from one frame to the next when there is something to draw

function askFrame() {
  if (!isFrameAsked) requestAnimationFrame(drawFrame);
  isFrameAsked = true;
}

const redraw = (withCharts = false) => {
  isDirty = true;
  areChartsDirty ||= withCharts;
  askFrame();
};

/** Redraw for new data: at once in a fast browser, else seldom, so that the processor remains free for the robot. */
function redrawForData() {
  dataTimer ||= setTimeout(() => {
    dataTimer = 0;
    redraw();
  }, frameTime < FAST_FRAME ? 0 : PAUSE_FRAMES * frameTime);
}

const changeTheme = startTheme(document.documentElement, () => {
  colours = coloursOf(document.documentElement);
  redraw(true);
});

/** The time [s] that is shown: the time of the slider, or of the newest row. */
function timeNow() {
  if (page.player) return page.player.time;
  const curve = page.robot.main;
  return curve?.rows ? curve.t[curve.rows - 1] : 0;
}

/** Show a time; a live page only marks it. */
const goTo = (time) => (page.player ? page.player.go(time) : hoverAt(time));

function hoverAt(time) {
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

const charts = makeCharts(document, { onTime: goTo, onHover: hoverAt, onZoom: zoomTo });
const panels = document.querySelectorAll("details");
const events = new EventList($("events"), $("filters"), goTo);

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
  isFrameAsked = false;
  page.player?.step(now);
  if (!isDirty) return;
  isDirty = false;
  page.frames += 1;
  requestAnimationFrame((next) => {
    frameTime += 0.3 * (next - now - frameTime);
  });
  const time = timeNow();
  const { hover, hidden, robot, view } = page;
  if (!page.player) view.keep(robot, time);
  const context = drawMap($("map"), view, page.robots, robot, page.runs, { time, hover, hidden, colours });
  if (page.tools.draw) drawArrow(context, view, page.tools.draw, 50, page.tools.current === "goal" ? colours.goal : colours.plan);
  const isMoving = time !== lastTime && !page.zoom && (!page.player || Number($("window").value) < page.player.end - page.player.begin);
  lastTime = time;
  if ((areChartsDirty || isMoving) && now - lastCharts > (areChartsDirty ? 15 : page.player ? 90 : 200)) {
    const [t0, t1] = chartSpan(time);
    for (const chart of charts) chart.draw(robot, page.runs, t0, t1, robot.constants, colours);
    for (const panel of panels) panel.classList.toggle("hidden", !panel.querySelector(".chart:not(.hidden)"));
    lastCharts = now;
    areChartsDirty = false;
  } else if (areChartsDirty && page.player?.isPlaying !== true) redraw();
  for (const chart of charts) chart.point(hover ?? time, colours);
  events.point(time);
  showValues($("values"), robot, hover ?? time);
  showLaw($("law-values"), robot, hover ?? time);
  showLegend();
  showState(time);
  const clock = page.player ? `${shown(time, 1)} s of ${shown(page.player.end, 1)} s` : `${shown(time, 1)} s`;
  $("clock").textContent = hover === null ? clock : `${clock}, cursor at ${shown(hover)} s`;
}

/** The legend: the available layers, each with a box that hides it. */
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
    add(label, "span", WORDS[name] ?? name);
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
  if (page.player) {
    const [level, text] = page.robot.result;
    $("title").textContent = text;
    $("title").dataset.level = String(level);
    showResult($("result"), page.robot, goTo);
  } else showServices();
  // The size of the map depends on the parts around it.
  showLegend();
  showValues($("values"), page.robot, timeNow());
  Object.assign(page.view, { width: $("map").clientWidth, height: $("map").clientHeight });
  page.view.fit(page.robot);
  redraw(true);
}

function setRobots(robots) {
  page.robots = robots;
  $("robot").replaceChildren(...robots.map((one) => new Option(one.name, one.name)));
  $("robot-label").classList.toggle("hidden", robots.length < 2);
  chooseRobot(page.robot.name);
}

/** The state at a time; at the end of a recording the last state is only that the nodes have ended. */
function showState(time) {
  const [level, text] = page.player && time >= page.player.end ? [0, "end of the recording"] : page.robot.stateAt(time);
  if ($("state").textContent !== text) $("state").textContent = text;
  $("state").title = text;
  $("state").dataset.level = String(level);
}

let hintTimer = 0;
function alarm(text, seconds = 6, level = 2) {
  $("alarm").textContent = text;
  $("alarm").dataset.level = String(level);
  $("alarm").classList.toggle("hidden", !text);
  clearTimeout(hintTimer);
  if (text && seconds < Infinity) hintTimer = setTimeout(() => alarm(""), seconds * 1000);
}

const keys = new Map([["d", changeTheme]]);
function makeButton(text, key, action, isToggle = false) {
  const button = add($("tools"), "button", text, { type: "button", title: `${text} (${key})` });
  if (isToggle) button.setAttribute("aria-pressed", "false");
  button.addEventListener("click", action);
  keys.set(key, () => button.click());
  return button;
}

/** Act at the second press within CONFIRM; the first press asks for it. */
function confirmed(button, action) {
  const text = button.dataset.text;
  button.dataset.text = "";
  if (text) {
    button.textContent = text;
    action();
    return;
  }
  button.dataset.text = button.textContent;
  button.textContent = `${button.textContent}: press again`;
  setTimeout(() => {
    if (button.dataset.text) button.textContent = button.dataset.text;
    button.dataset.text = "";
  }, CONFIRM);
}

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  if (event.target.closest("input:not([type=range], [type=checkbox]), select")) return;
  if (event.key === " " && event.target.closest("button, input")) return;
  const action = keys.get(event.key);
  if (!action) return;
  event.preventDefault();
  action();
});

/** Show the coordinates under the pointer, and the time at which the robot was there. */
function hoverMap(place) {
  const [x, y] = place ? page.view.toWorld(...place) : [NaN, NaN];
  $("place").textContent = place ? `x ${shown(x)} m, y ${shown(y)} m` : "";
  hoverAt(place ? (page.robot.main?.timeNear(x, y, REACH / page.view.scale, timeNow()) ?? null) : null);
}

function startMap(onPose) {
  makeButton("Show all", "0", () => {
    page.view.fit(page.robot);
    redraw();
  });
  const follow = makeButton("Follow", "f", () => {
    page.view.follow = !page.view.follow;
    redraw();
  }, true);
  startPointer($("map"), page.view, page.tools, { onPose, onHint: alarm, onChange: () => redraw(), onHover: hoverMap });
  setInterval(() => follow.setAttribute("aria-pressed", String(page.view.follow)), 200);
  for (const [text, length] of WINDOWS) $("window").add(new Option(text, String(length)));
  $("window").addEventListener("change", () => zoomTo(null));
  $("unzoom").addEventListener("click", () => zoomTo(null));
  for (const panel of panels) panel.addEventListener("toggle", () => redraw(true));
  $("robot").addEventListener("change", () => chooseRobot($("robot").value));
  $("theme").addEventListener("click", changeTheme);
  new ResizeObserver(() => redraw(true)).observe(document.body);
}

async function startReport() {
  const { data } = page;
  const robots = await unpackRobots(data);
  if (data.isComparison) page.runs = robots.map((robot, index) => Object.assign(robot, { colour: RUNS[index % RUNS.length] }));
  document.title = `${robots.map(({ result }) => result[1]).join(", ")} – ${data.title}`;
  $("source").textContent = data.title;
  startMap(() => {});
  $("player").classList.remove("hidden");
  $("result").classList.remove("hidden");
  page.player = new Player({ slider: $("slider"), button: $("play"), speed: $("speed") }, data.span, () => redraw());
  keys.set(" ", () => page.player.toggle());
  showTopics($("topics"), data.topics);
  const notes = [`${data.messages} messages`, ...(data.malformed ? [`${data.malformed} unreadable`] : [])];
  if (!page.runs) add($("topics"), "p", `${new Date(data.origin).toISOString()}: ${notes.join(", ")}`);
  if (page.runs) $("robot-label").firstChild.textContent = "Run ";
  setRobots(robots);
  page.player.go(data.span[1]);
}

const buttons = {}; // of the live page, by tool or service

/** Enable the buttons whose services the robot has. */
function showServices() {
  for (const [name, { isThere, isOn }] of Object.entries({ pause: {}, reset: {}, dock: {}, ...page.robot.services, record: page.record ?? {} })) {
    for (const button of name === "dock" ? [buttons.dock, buttons.undock] : [buttons[name]]) {
      button.disabled = !isThere;
      if (name !== "dock") button.setAttribute("aria-pressed", String(Boolean(isOn)));
    }
    if (name === "pause") buttons.pause.textContent = isOn ? "Resume" : "Pause";
  }
}

function startLive() {
  const send = (request) => {
    if (!live.send({ robot: page.robot.name, ...request })) alarm("Not connected: nothing was sent.");
  };
  const choose = (tool) => {
    page.tools.current = tool;
    for (const name of ["goal", "initialpose"]) buttons[name].setAttribute("aria-pressed", String(name === tool));
    $("map").style.cursor = tool === "pan" ? "grab" : "crosshair";
  };
  const sendPose = (kind, { x, y, theta }) => {
    send({ type: kind, x, y, yaw: theta });
    choose("pan");
  };
  const isPressed = (name) => buttons[name].getAttribute("aria-pressed") === "true";
  const toggle = (tool) => choose(page.tools.current === tool ? "pan" : tool);
  startMap(sendPose);
  buttons.goal = makeButton("Goal pose", "g", () => toggle("goal"), true);
  buttons.initialpose = makeButton("Initial pose", "i", () => toggle("initialpose"), true);
  keys.set("Escape", () => choose("pan"));
  makeButton("Cancel goal", "c", () => send({ type: "cancel" }));
  buttons.dock = makeButton("Dock", "o", () => send({ type: "dock" }));
  buttons.undock = makeButton("Undock", "u", () => send({ type: "undock" }));
  buttons.pause = makeButton("Pause", "p", () => send({ type: "pause", on: !isPressed("pause") }), true);
  buttons.reset = makeButton("Reset", "x", () => confirmed(buttons.reset, () => send({ type: "reset" })));
  buttons.record = makeButton("Record", "r", () => send({ type: "record", on: !isPressed("record") }), true);
  for (const name of ["dock", "undock", "pause", "reset", "record"]) buttons[name].disabled = true;
  $("window").value = "60";
  $("pose-form").classList.remove("hidden");
  $("pose-form").addEventListener("submit", (event) => {
    event.preventDefault();
    const form = new FormData(event.target);
    try {
      const [x, y, heading] = ["x", "y", "heading"].map((name) => readNumber(name, form.get(name)));
      sendPose(event.submitter.value, { x, y, theta: (heading * Math.PI) / 180 });
    } catch (error) {
      alarm(error.message);
    }
  });
  let columns = {};
  const find = (name) => page.robots.find((one) => one.name === name);
  const live = new Live({
    onHello(message) {
      ({ columns } = message);
      const view = { ...page.view };
      const isFirst = !page.robots.length;
      setRobots(message.robots.map((name) => new Robot(name, message.constants)));
      if (!isFirst) Object.assign(page.view, view); // a page that connects again keeps its robot and its view
      choose("pan");
    },
    onHistory({ robot, curve, rows }) {
      for (const row of rows) find(robot)?.append(curve, columns[curve], row);
    },
    onState(message) {
      for (const [name, { rows, plan, landmarks, state, ...news }] of Object.entries(message.robots)) {
        const robot = find(name);
        if (!robot) continue;
        for (const [curve, row] of Object.entries(rows ?? {})) robot.append(curve, columns[curve], row);
        if (plan) robot.setPlan(plan);
        if (landmarks) robot.see(landmarks);
        if (state) robot.states = [[-Infinity, ...state.slice(1)]];
        Object.assign(robot, news); // goals, dock, constants, services
        robot.derive();
      }
      page.record = message.record ?? page.record;
      showServices();
      if (message.diagnostics) showDiagnostics($("diagnostics"), message.diagnostics);
      redrawForData();
    },
    onEvents(message) {
      const robot = find(message.robot);
      if (!robot) return;
      robot.events = [...robot.events, ...message.events].slice(-MAX_EVENTS);
      if (robot === page.robot) events.append(message.events);
    },
    onAnswer: (message) => alarm(message.text, message.level ? 12 : 5, message.level),
    onConnected: (isOn) => alarm(isOn ? "" : "No connection to diffbot watch: trying again ...", Infinity),
  });
}

if (page.data.kind === "report") await startReport();
else startLive();
askFrame();
