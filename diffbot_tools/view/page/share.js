// The moment and the view as the end of an address, and what is seen as a picture.

const GAP = 8; // [pixels]
const TEXT = 18; // [pixels] of a line

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

/** A canvas with title, map and the charts that are open beside it, as they are drawn. */
export function pictureOf(map, charts, title, colours) {
  const shown = charts.filter(({ canvas }) => canvas.clientWidth);
  const ratio = map.width / map.clientWidth;
  const canvas = document.createElement("canvas");
  const chartHeight = shown.reduce((sum, one) => sum + one.canvas.clientHeight + TEXT + GAP, 0);
  const chartWidth = Math.max(0, ...shown.map((one) => one.canvas.clientWidth));
  canvas.width = ratio * (map.clientWidth + chartWidth + 3 * GAP);
  canvas.height = ratio * (Math.max(map.clientHeight, chartHeight) + TEXT + 2 * GAP);
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  context.fillStyle = colours.page;
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.font = "13px system-ui, sans-serif";
  const put = (source, x, y) => {
    context.fillStyle = colours.panel;
    context.fillRect(x, y, source.clientWidth, source.clientHeight);
    context.drawImage(source, x, y, source.clientWidth, source.clientHeight);
    context.fillStyle = colours.text;
  };
  context.fillStyle = colours.text;
  context.fillText(title, GAP, TEXT);
  put(map, GAP, TEXT + GAP);
  let y = TEXT + GAP;
  for (const one of shown) {
    const x = map.clientWidth + 2 * GAP;
    context.fillText([...one.box.querySelectorAll("span")].map((span) => span.textContent).join("   "), x, y + 13);
    put(one.canvas, x, y + TEXT);
    y += one.canvas.clientHeight + TEXT + GAP;
  }
  return canvas;
}
