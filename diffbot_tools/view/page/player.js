// The time of a report: slider, play button, speed.

const SPEEDS = [1, 2, 5, 10, 20];

export class Player {
  constructor({ slider, button, speed }, [begin, end], onTime) {
    Object.assign(this, { slider, button, begin, end, onTime, time: begin, isPlaying: false, last: null });
    slider.min = String(begin);
    slider.max = String(end);
    for (const one of SPEEDS) speed.add(new Option(`${one} x`, String(one)));
    this.speed = speed;
    slider.addEventListener("input", () => this.go(Number(slider.value)));
    button.addEventListener("click", () => this.toggle());
  }

  /** Show a time [s]. */
  go(time) {
    this.time = Math.min(Math.max(time, this.begin), this.end);
    this.slider.value = String(this.time);
    this.slider.setAttribute("aria-valuetext", `${this.time.toFixed(1)} seconds`);
    this.onTime();
  }

  toggle() {
    this.isPlaying = !this.isPlaying;
    if (this.isPlaying && this.time >= this.end) this.go(this.begin);
    this.last = null;
    this.button.textContent = this.isPlaying ? "Stop" : "Play";
    this.onTime();
  }

  /** Advance the time by that of one frame, which is drawn at `now` [ms]. */
  step(now) {
    if (!this.isPlaying) return;
    const passed = this.last === null ? 0 : Math.min(now - this.last, 250) / 1000;
    this.last = now;
    this.go(this.time + passed * Number(this.speed.value));
    if (this.time >= this.end) this.toggle();
  }
}
