import { $, goTo, keys, page, redraw, setRobots, startPage } from "./page.js";
import { add, showResult, showTopics } from "./panels.js";
import { unpackRobots } from "./store.js";

// The page of a report: unpacks the data, and plays the recording.

const SPEEDS = [1, 2, 5, 10, 20];
const RUNS = ["truth", "estimate", "plan"]; // colours of the runs of a comparison

/** The time of a report: slider, play button and speed. */
class Player {
  constructor([begin, end]) {
    Object.assign(this, { begin, end, time: begin, isPlaying: false, last: null });
    Object.assign($("slider"), { min: String(begin), max: String(end) });
    for (const one of SPEEDS) $("speed").add(new Option(`${one} x`, String(one)));
    $("slider").addEventListener("input", () => this.go(Number($("slider").value)));
    $("play").addEventListener("click", () => this.toggle());
  }

  /** Show a time [s]. */
  go(time) {
    this.time = Math.min(Math.max(time, this.begin), this.end);
    $("slider").value = String(this.time);
    $("slider").setAttribute("aria-valuetext", `${this.time.toFixed(1)} seconds`);
    redraw();
  }

  toggle() {
    this.isPlaying = !this.isPlaying;
    if (this.isPlaying && this.time >= this.end) this.go(this.begin);
    this.last = null;
    $("play").textContent = this.isPlaying ? "Stop" : "Play";
    redraw();
  }

  /** Advance the time for a frame that is drawn at `now` [ms]. */
  step(now) {
    if (!this.isPlaying) return;
    const elapsed = this.last === null ? 0 : Math.min(now - this.last, 250) / 1000;
    this.last = now;
    this.go(this.time + elapsed * Number($("speed").value));
    if (this.time >= this.end) this.toggle();
  }
}

export async function startReport() {
  const { data } = page;
  const robots = await unpackRobots(data);
  document.title = `${robots.map(({ result }) => result[1]).join(", ")} – ${data.title}`;
  $("source").textContent = data.title;
  for (const id of ["player", "result"]) $(id).classList.remove("hidden");
  startPage();
  page.player = new Player(data.span);
  keys.set(" ", () => page.player.toggle());
  if (data.isComparison) {
    page.runs = robots.map((robot, index) => Object.assign(robot, { colour: RUNS[index % RUNS.length] }));
    $("robot-label").firstChild.textContent = "Run ";
  } else {
    const unreadable = data.malformed ? `, ${data.malformed} unreadable` : "";
    showTopics($("topics"), data.topics);
    add($("topics"), "p", `${new Date(data.origin).toISOString()}: ${data.messages} messages${unreadable}`);
  }
  page.onRobot = () => {
    const [level, text] = page.robot.result;
    $("title").textContent = text;
    $("title").dataset.level = String(level);
    showResult($("result"), page.robot, goTo);
  };
  setRobots(robots);
  page.player.go(data.span[1]);
}
