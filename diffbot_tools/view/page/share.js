// The moment and the view as the end of an address.

const numbers = (text, count) => {
  const found = (text || "none").split(",").map(Number);
  return found.length === count && found.every(Number.isFinite) ? found : null;
};

/** What stands behind the # of a link to this moment. */
export function fragmentOf({ robot, zoom, view }, time) {
  const parts = { robot: robot.name, t: time.toFixed(3), map: [view.x, view.y, view.scale].map((one) => one.toFixed(3)).join(",") };
  if (zoom) parts.zoom = zoom.map((one) => one.toFixed(3)).join(",");
  return new URLSearchParams(parts).toString();
}

/** The moment of a fragment; null in place of what it does not give. */
export function readFragment(text) {
  const found = new URLSearchParams(text);
  const zoom = numbers(found.get("zoom"), 2);
  const map = numbers(found.get("map"), 3);
  return {
    robot: found.get("robot"),
    t: numbers(found.get("t"), 1)?.[0] ?? null,
    zoom: zoom && zoom[0] < zoom[1] ? zoom : null,
    map: map && map[2] > 0 ? { x: map[0], y: map[1], scale: map[2] } : null,
  };
}
