// Draws the dock: its axis out to the staging pose, the corridor of the approach, and the newest detections.

const CROSS = 4; // [pixels]

/** The dock in map, as live_dock.py places it: `pose` may be null; the bar is where the front of the docked robot, or its back, touches. */
export function drawDock(context, view, dock, { wheels, box }, colours) {
  context.lineWidth = 1.5;
  if (dock.pose) {
    const [x, y, theta] = dock.pose;
    const side = dock.isBackward ? -1 : 1;
    const at = (along, across) => {
      const [c, s] = [Math.cos(theta), Math.sin(theta)];
      return view.toScreen(x + side * along * c - across * s, y + side * along * s + across * c);
    };
    const line = (...points) => {
      context.beginPath();
      for (const [along, across] of points) context.lineTo(...at(along, across));
    };
    const { staging, halfWidth } = dock;
    line([-staging, halfWidth], [0, halfWidth], [0, -halfWidth], [-staging, -halfWidth]);
    context.fillStyle = colours.near;
    context.fill();
    context.strokeStyle = context.fillStyle = colours.dock;
    line([-staging, 0], [0, 0]);
    context.setLineDash([6, 4]);
    context.stroke();
    context.setLineDash([]);
    const half = (box ? box[3] - box[2] : (wheels?.[1] ?? 0.3)) / 2;
    const reach = box ? (dock.isBackward ? -box[0] : box[1]) : half;
    context.lineWidth = 6;
    line([reach, half], [reach, -half]);
    context.stroke();
    context.lineWidth = 1.5;
    context.beginPath();
    context.arc(...at(-staging, 0), 3, 0, 2 * Math.PI);
    context.fill();
  }
  context.strokeStyle = colours.dock;
  context.beginPath();
  for (const [x, y] of dock.detections) {
    const [px, py] = view.toScreen(x, y);
    for (const side of [-1, 1]) {
      context.moveTo(px - CROSS, py - side * CROSS);
      context.lineTo(px + CROSS, py + side * CROSS);
    }
  }
  context.stroke();
}
