import { readNumber } from "./geometry.js";
import { $, addButton, alarm, buttons, events, keys, page, redrawForData, setRobots, startPage } from "./page.js";
import { MAX_EVENTS, showDiagnostics } from "./panels.js";
import { Robot } from "./store.js";

// The page of `diffbot watch`: receives states and events, and sends goals and other requests.

const RETRY = 1500; // [ms] from the loss of the connection to the next attempt
const CONFIRM = 3000; // [ms] time in which Reset has to be pressed again

/** Connect, also after each loss of the connection, and return a function that sends. `handlers` are functions by message type. */
function connect(handlers, onConnected) {
  let socket = null;
  const open = () => {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    socket = new WebSocket(`${scheme}//${location.host}/ws${location.search}`);
    socket.addEventListener("open", () => onConnected(true));
    socket.addEventListener("message", (event) => {
      const message = JSON.parse(event.data);
      handlers[message.type](message);
    });
    socket.addEventListener("close", () => {
      onConnected(false);
      setTimeout(open, RETRY);
    });
  };
  open();
  return (request) => {
    if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(request));
    else alarm("Not connected: the request was not sent.");
  };
}

/** At the first press of a button, ask for a second one. At a second press within CONFIRM, call `action`. */
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

/** Enable the buttons whose services are available, and show which services are on. */
function showServices() {
  const { pause = {}, reset = {}, dock = {} } = page.robot.services;
  const { record = {} } = page;
  for (const [name, service] of Object.entries({ pause, reset, dock, undock: dock, record })) buttons[name].disabled = !service.isThere;
  buttons.pause.textContent = pause.isOn ? "Resume" : "Pause";
  for (const [name, { isOn }] of Object.entries({ pause, record })) buttons[name].setAttribute("aria-pressed", String(Boolean(isOn)));
}

function choose(tool) {
  page.tools.current = tool;
  for (const name of ["goal", "initialpose"]) buttons[name].setAttribute("aria-pressed", String(name === tool));
  $("map").style.cursor = tool === "pan" ? "grab" : "crosshair";
}

export function startLive() {
  const request = (type, content = {}) => send({ type, robot: page.robot.name, ...content });
  const sendPose = (kind, { x, y, theta }) => {
    request(kind, { x, y, yaw: theta });
    choose("pan");
  };
  const toggleTool = (tool) => choose(page.tools.current === tool ? "pan" : tool);
  const toggleService = (name) => request(name, { on: buttons[name].getAttribute("aria-pressed") !== "true" });
  startPage(sendPose);
  addButton("goal", "Goal pose", "g", () => toggleTool("goal"), true);
  addButton("initialpose", "Initial pose", "i", () => toggleTool("initialpose"), true);
  addButton("cancel", "Cancel goal", "c", () => request("cancel"));
  addButton("dock", "Dock", "o", () => request("dock"));
  addButton("undock", "Undock", "u", () => request("undock"));
  addButton("pause", "Pause", "p", () => toggleService("pause"), true);
  addButton("reset", "Reset", "x", () => confirmed(buttons.reset, () => request("reset")));
  addButton("record", "Record", "r", () => toggleService("record"), true);
  keys.set("Escape", () => choose("pan"));
  page.onRobot = showServices;
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
  showServices();
  const find = (name) => page.robots.find((one) => one.name === name);
  let columns = {};
  const handlers = {
    hello(message) {
      ({ columns } = message);
      const view = { ...page.view };
      const isFirst = !page.robots.length;
      setRobots(message.robots.map((name) => new Robot(name, message.constants)));
      if (!isFirst) Object.assign(page.view, view); // after a lost connection, the page keeps its view
      choose("pan");
    },
    history({ robot, curve, rows }) {
      for (const row of rows) find(robot).append(curve, columns[curve], row);
    },
    state(message) {
      for (const [name, { rows = {}, plan, landmarks, state, ...others }] of Object.entries(message.robots)) {
        const robot = find(name);
        for (const [curve, row] of Object.entries(rows)) robot.append(curve, columns[curve], row);
        if (plan) robot.setPlan(plan);
        if (landmarks) robot.addLandmarks(landmarks);
        if (state) robot.states = [[-Infinity, ...state.slice(1)]];
        Object.assign(robot, others); // goals, dock, constants, services
        robot.derive();
      }
      page.record = message.record ?? page.record;
      showServices();
      if (message.diagnostics) showDiagnostics($("diagnostics"), message.diagnostics);
      redrawForData();
    },
    events(message) {
      const robot = find(message.robot);
      robot.events = [...robot.events, ...message.events].slice(-MAX_EVENTS);
      if (robot === page.robot) events.append(message.events);
    },
    answer: ({ text, level }) => alarm(text, level ? 12 : 5, level),
  };
  const onConnected = (isOn) => alarm(isOn ? "" : "No connection to diffbot watch: trying again ...", Infinity);
  const send = connect(handlers, onConnected);
}
