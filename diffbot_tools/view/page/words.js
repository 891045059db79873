import { shown } from "./geometry.js";

// States and lengths in words. The states are those of the controller's status (diffbot_control/goals/states.py).

const AT_REST = { v: 0.02, omega: 0.05 }; // [m/s], [rad/s]

/** A length in words: centimetres below one metre; result.py does the same. */
export function lengthText(metres) {
  if (!Number.isFinite(metres)) return "–";
  return metres < 0.995 ? `${shown(100 * metres, metres < 0.0995 ? 1 : 0)} cm` : `${shown(metres)} m`;
}

export const degrees = (angle, digits = 1) => shown((angle * 180) / Math.PI, digits);

/**
 * What a robot is doing, as [level, text]: `status` with text, level, reason, finish, waypoint, filter, isHeld, docking;
 * `toGo` with distance [m], heading and lateral error, NaN without a goal; `speed` v, omega; `left` [s], NaN if unknown.
 */
export function inWords(status, toGo, speed, left, tolerance) {
  if (!status?.text) return [0, ""];
  if (status.isPaused) return [0, "paused"];
  const { text, reason } = status;
  if (status.docking && text !== "driving") return status.docking;
  const hasGoal = Number.isFinite(toGo.distance);
  const rest = hasGoal ? `: ${lengthText(toGo.distance)} and ${degrees(Math.abs(toGo.heading), 0)} deg to go` : "";
  const isMoving = Math.abs(speed.v) > AT_REST.v || Math.abs(speed.omega) > AT_REST.omega;
  switch (text) {
    case "driving": {
      const where = status.waypoint ? ` (goal ${status.waypoint})` : "";
      if (["to and fro", "out and in"].includes(status.finish)) return [0, `correcting sideways, ${lengthText(Math.abs(toGo.lateral))}${where}`];
      return [0, `driving${where}${rest}${left >= 0.5 ? `, ${shown(left, 0)} s` : ""}`];
    }
    case "goal reached":
      if (isMoving) return [0, `moving after the goal was reached${rest}`];
      if (hasGoal && toGo.distance > 2 * tolerance) return [1, `away from the goal that was reached${rest}`];
      return [0, `${status.isHeld ? "holding" : "at the goal"}${hasGoal ? `, ${lengthText(toGo.distance)} off` : ""}`];
    case "stale pose":
      return [2, `stopped: ${status.filter || "no pose comes"}`];
    case "goal not reached":
      return [2, `gave up${reason ? `: ${reason}` : ""}`];
    case "waiting for pose":
      return [1, `goal accepted, waiting for a pose${status.filter ? `: ${status.filter}` : ""}`];
    case "tolerance below uncertainty":
      return [1, "standing at the goal, too uncertain of its pose to say so"];
    case "cancelling":
      return [0, "braking: goal cancelled"];
    case "inactive":
      return [0, "controller inactive"];
    case "idle":
      return [0, status.filter ? `idle, filter: ${status.filter}` : "idle"];
    default:
      return [status.level, reason ? `${text}: ${reason}` : text];
  }
}
