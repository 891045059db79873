// Mouse, touch and keys on the map: moving, zooming, and drawing a pose (press: position, drag: heading, release: send).

const SHORTEST_DRAG = 8;

/** Make the map of `view` react; `tools.current` is "pan", "goal" or "initialpose", `tools.draw` the pose being drawn. */
export function startPointer(canvas, view, tools, { onPose, onChange, onHint, onHover }) {
  const pressed = new Map();
  let start = null;

  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const drawn = ([px, py]) => {
    const [x, y] = view.toWorld(...start);
    const theta = Math.atan2(start[1] - py, px - start[0]);
    return { x, y, theta, isLong: Math.hypot(px - start[0], py - start[1]) >= SHORTEST_DRAG };
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    pressed.set(event.pointerId, place(event));
    start = pressed.size === 1 ? place(event) : null;
    tools.draw = null;
  });

  canvas.addEventListener("pointermove", (event) => {
    const before = pressed.get(event.pointerId);
    const now = place(event);
    onHover(now);
    if (!before) return;
    if (pressed.size === 2) {
      const [other] = [...pressed].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
      const apart = (at) => Math.max(Math.hypot(at[0] - other[0], at[1] - other[1]), 1);
      view.zoom(apart(now) / apart(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
      view.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
    } else if (tools.current === "pan") view.pan(now[0] - before[0], now[1] - before[1]);
    else if (start) tools.draw = drawn(now);
    pressed.set(event.pointerId, now);
    onChange();
  });

  canvas.addEventListener("pointerup", (event) => {
    if (!pressed.delete(event.pointerId)) return;
    const kind = tools.current;
    if (kind !== "pan" && start) {
      const pose = drawn(place(event));
      if (pose.isLong) onPose(kind, pose);
      else onHint("Drag to give the heading: press where the robot should stand, release where it should look.");
    }
    start = null;
    tools.draw = null;
    onChange();
  });

  canvas.addEventListener("pointerleave", () => onHover(null));

  canvas.addEventListener("pointercancel", (event) => {
    pressed.delete(event.pointerId);
    start = null;
    tools.draw = null;
  });

  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      view.zoom(Math.exp(-0.0015 * event.deltaY), ...place(event));
      onChange();
    },
    { passive: false },
  );

  const moves = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
  canvas.addEventListener("keydown", (event) => {
    if (moves[event.key]) view.pan(...moves[event.key]);
    else if (event.key === "+" || event.key === "=") view.zoom(1.25);
    else if (event.key === "-") view.zoom(0.8);
    else return;
    event.preventDefault();
    onChange();
  });
}
