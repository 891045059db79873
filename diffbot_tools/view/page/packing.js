import { Curve, Robot } from "./store.js";

// Unpacks the columns that diffbot_tools/view/packing.py packs.

const MISSING = -2147483648;

/** The bytes of a base64 text of zlib data. */
async function inflate(text) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function column(bytes, { unit, at }, rows) {
  const values = new Float64Array(rows);
  let sum = 0;
  for (let i = 0, p = at; i < rows; i += 1, p += 1) {
    sum = (sum + (bytes[p] | (bytes[p + rows] << 8) | (bytes[p + 2 * rows] << 16) | (bytes[p + 3 * rows] << 24))) | 0;
    values[i] = sum === MISSING ? NaN : sum * unit;
  }
  return values;
}

/** The robots of a report. */
export async function unpackRobots(data) {
  const bytes = await inflate(data.packed);
  return data.robots.map((one) => {
    const robot = new Robot(one.name);
    for (const [name, { rows, columns }] of Object.entries(one.curves)) {
      const unpacked = Object.entries(columns).map(([key, place]) => [key, column(bytes, place, rows)]);
      robot.curves[name] = new Curve(Object.fromEntries(unpacked), rows);
    }
    const { plan, ...curves } = robot.curves;
    const landmarks = new Map(one.landmarks.map(([number, x, y, inView]) => [number, { number, x, y, inView }]));
    const { goals, events, summary, health, states, constants } = one;
    const size = { wheels: constants.wheels, box: one.box };
    Object.assign(robot, { curves, plan, landmarks, events, summary, health, states, constants, size });
    robot.setGoals(goals);
    robot.derive();
    robot.hideAngles(constants.xy_tolerance);
    return robot;
  });
}
