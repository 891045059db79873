import { makeCharts } from "./charts.js";
import { readNumber, shown } from "./geometry.js";
import { Live } from "./live.js";
import { drawArrow, drawMap, layersOf } from "./map.js";
import { unpackRobots } from "./packing.js";
import { add, EventList, MAX_EVENTS, showDiagnostics, showLaw, showResult, showSummary, showTopics, showValues } from "./panels.js";
import { Player } from "./player.js";
import { startPointer } from "./pointer.js";
import { fragmentOf, readFragment } from "./share.js";
import { Robot } from "./store.js";
import { coloursOf, startTheme } from "./theme.js";
import { View } from "./view.js";
import { inWords } from "./words.js";

// Puts the parts together: one page for a report with its data inside, and for a live robot.

const $ = (id) => document.getElementById(id);
const page = {
  data: JSON.parse($("data").textContent),
  robots: [],
  robot: new Robot(""),
  runs: null, // in a comparison: the robots, each with the name of its colour
  constants: { xy_tolerance: 0.1, yaw_tolerance: 0.1, limits: {}, nees: [0, 0] },
  view: new View(),
  tools: { current: "pan", draw: null },
  hidden: new Set(),
  hover: null, // [s] of the cursor, or null
  zoom: null, // [s] range that the charts show, or null for that of the window
  isPaused: false,
  frames: 0,
};
globalThis.diffbotPage = page; // for the console and the tests
const WINDOWS = [["everything", Infinity], ["10 s", 10], ["60 s", 60], ["5 min", 300]];
const FAST_FRAME = 22; // [ms] of a display of 50 Hz
const PAUSE_FRAMES = 7; // a slow browser draws new data an eighth of the time
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

/** Redraw for new data: at once where a frame costs nothing, else seldom enough to leave the processor to the robot. */
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

/** The time [s] that is shown: the slider's, or that of the newest row. */
function timeNow() {
  if (page.player) return page.player.time;
  const curve = page.robot.main;
  return curve?.rows ? curve.t[curve.rows - 1] : 0;
}

/** Show a time; a live page goes on, and marks it. */
function goTo(time) {
  if (page.player) page.player.go(time);
  else hoverAt(time);
}

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
  const { hover, constants, hidden } = page;
  const context = drawMap($("map"), page.view, page.robots, page.robot, page.runs, { time, hover, constants, hidden, colours });
  if (page.tools.draw) drawArrow(context, page.view, page.tools.draw, 50, page.tools.current === "goal" ? colours.goal : colours.plan);
  const isMoving = time !== lastTime && !page.zoom && (!page.player || Number($("window").value) < page.player.end - page.player.begin);
  lastTime = time;
  if ((areChartsDirty || isMoving) && now - lastCharts > (areChartsDirty ? 15 : page.player ? 90 : 200)) {
    const [t0, t1] = chartSpan(time);
    for (const chart of charts) chart.draw(page.robot, page.runs, t0, t1, page.constants, colours);
    for (const panel of panels) panel.classList.toggle("hidden", !panel.querySelector(".chart:not(.hidden)"));
    lastCharts = now;
    areChartsDirty = false;
  } else if (areChartsDirty && page.player?.isPlaying !== true) redraw();
  for (const chart of charts) chart.point(hover ?? time, colours);
  events.point(time);
  showValues($("values"), page.robot, hover ?? time);
  showLaw($("law-values"), page.robot, hover ?? time);
  showLegend();
  showState(time);
  const clock = page.player ? `${shown(time, 1)} s of ${shown(page.player.end, 1)} s` : `${shown(time, 1)} s`;
  $("clock").textContent = hover === null ? clock : `${clock}, cursor at ${shown(hover)} s`;
}

/** The legend holds what is there, each with a box that hides it. */
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
  page.robot = page.robots.find((one) => one.name === name) ?? page.robot;
  if (page.robot.constants) page.constants = page.robot.constants;
  events.clear();
  events.append(page.robot.events);
  showSummary($("summary"), page.runs ?? [page.robot]);
  if (page.player) showResult($("result"), page.robot, goTo);
  // What stands around the map, and so its size.
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
  chooseRobot(robots[0].name);
}

function showState(time) {
  const { robot } = page;
  const at = (column) => robot.curves.toGo?.at(column, time) ?? NaN;
  const toGo = { distance: at("distance"), heading: at("heading"), lateral: at("lateral") };
  const status = { ...robot.stateAt(time), isPaused: page.isPaused };
  const [level, text] = inWords(status, toGo, robot.speedAt(time), robot.timeLeft(time), page.constants.xy_tolerance);
  if ($("state").textContent !== text) $("state").textContent = text;
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

function makeButton(text, key, action, isToggle = false) {
  const button = add($("tools"), "button", text, { type: "button", title: `${text} (${key})` });
  if (isToggle) button.setAttribute("aria-pressed", "false");
  button.addEventListener("click", action);
  keys.set(key, () => button.click());
  return button;
}

/** Act at the second press within some seconds; the first one asks. */
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

const keys = new Map([["d", changeTheme]]);
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
  if (!place) {
    $("place").textContent = "";
    hoverAt(null);
    return;
  }
  const [x, y] = page.view.toWorld(...place);
  $("place").textContent = `x ${shown(x)} m, y ${shown(y)} m`;
  hoverAt(page.robot.main?.timeNear(x, y, REACH / page.view.scale, timeNow()) ?? null);
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
  makeButton("Copy link", "l", copyLink);
  addEventListener("hashchange", goToLink);
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

/** Put this moment into the address, and the address into the clipboard where the browser allows it. */
async function copyLink() {
  const time = timeNow();
  // A live page goes on: its link leads to what the charts show now.
  history.replaceState(null, "", `#${fragmentOf({ ...page, zoom: page.player ? page.zoom : chartSpan(time) }, time)}`);
  try {
    await navigator.clipboard.writeText(location.href);
    alarm("Link to this moment and view copied.", 5, 0);
  } catch {
    alarm("The address of this page now leads to this moment and view.", 5, 0);
  }
}

function goToLink() {
  const { robot, t, zoom, map } = readFragment(location.hash.slice(1));
  if (robot && robot !== page.robot.name) {
    chooseRobot(robot);
    $("robot").value = page.robot.name;
  }
  if (t !== null) goTo(t);
  if (map) Object.assign(page.view, map, { follow: false });
  if (zoom) zoomTo(zoom);
}

async function startReport() {
  const { data } = page;
  document.title = `${data.title} – diffbot`;
  $("title").textContent = data.title;
  const robots = await unpackRobots(data);
  if (data.isComparison) page.runs = robots.map((robot, index) => Object.assign(robot, { colour: RUNS[index % RUNS.length] }));
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
  goToLink();
}

function startLive() {
  const send = (request) => {
    if (!live.send({ robot: page.robot.name, ...request })) alarm("Not connected: nothing was sent.");
  };
  const sendPose = (kind, { x, y, theta }) => {
    send({ type: kind, x, y, yaw: theta });
    choose("pan");
  };
  const buttons = {};
  const choose = (tool) => {
    page.tools.current = tool;
    for (const [name, button] of Object.entries(buttons)) button.setAttribute("aria-pressed", String(name === tool));
    $("map").style.cursor = tool === "pan" ? "grab" : "crosshair";
  };
  const toggle = (tool) => choose(page.tools.current === tool ? "pan" : tool);
  startMap(sendPose);
  buttons.goal = makeButton("Goal pose", "g", () => toggle("goal"), true);
  buttons.initialpose = makeButton("Initial pose", "i", () => toggle("initialpose"), true);
  keys.set("Escape", () => choose("pan"));
  makeButton("Cancel goal", "c", () => send({ type: "cancel" }));
  const extras = {
    pause: makeButton("Pause", "p", () => send({ type: "pause", on: extras.pause.getAttribute("aria-pressed") !== "true" }), true),
    reset: makeButton("Reset", "x", () => confirmed(extras.reset, () => send({ type: "reset" }))),
    record: makeButton("Record", "r", () => send({ type: "record", on: extras.record.getAttribute("aria-pressed") !== "true" }), true),
  };
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
  let isFitted = false; // once; a page that connects again keeps its view
  const find = (name) => page.robots.find((one) => one.name === name);
  const live = new Live({
    onHello(message) {
      ({ columns } = message);
      page.constants = message.constants;
      setRobots(message.robots.map((name) => new Robot(name)));
      choose("pan");
    },
    onHistory({ robot, curve, rows }) {
      for (const row of rows) find(robot)?.append(curve, columns[curve], row);
      find(robot)?.hideAngles(page.constants.xy_tolerance);
    },
    onState(message) {
      if (message.constants) {
        page.constants = message.constants;
        for (const { size } of page.robots) size.wheels = page.constants.wheels;
      }
      for (const [name, news] of Object.entries(message.robots)) {
        const robot = find(name);
        if (!robot) continue;
        for (const [curve, row] of Object.entries(news.rows ?? {})) robot.append(curve, columns[curve], row);
        if (news.rows?.law) robot.hideAngles(page.constants.xy_tolerance, robot.curves.law.rows - 1);
        if (news.status) robot.status = news.status;
        if (news.plan) robot.setPlan(news.plan);
        if (news.landmarks) robot.see(news.landmarks);
        if (news.dock) robot.dock = news.dock;
        if (news.goals) robot.setGoals(news.goals);
        if (news.box) robot.size.box = news.box;
        robot.derive();
      }
      if (!isFitted && page.robot.main) {
        isFitted = true;
        page.view.fit(page.robot);
        goToLink();
      }
      if (message.diagnostics) showDiagnostics($("diagnostics"), message.diagnostics);
      for (const [name, { isThere, isOn }] of Object.entries(message.services ?? {})) {
        extras[name].disabled = !isThere;
        extras[name].setAttribute("aria-pressed", String(isOn));
        if (name === "pause") {
          page.isPaused = isOn;
          extras.pause.textContent = isOn ? "Resume" : "Pause";
        }
      }
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
