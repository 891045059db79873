// Angles, ellipses, scales and searches with plain numbers.

export const TWO_PI = 2 * Math.PI;

/** Wrap an angle [rad] to (-pi, pi]. */
export function wrapAngle(angle) {
  const wrapped = angle - TWO_PI * Math.floor((angle + Math.PI) / TWO_PI);
  return wrapped === -Math.PI ? Math.PI : wrapped;
}

/** Return semi-axes and direction [rad] of the 95 % ellipse of a position with this covariance. */
export function ellipseOf(xx, xy, yy) {
  const mean = (xx + yy) / 2;
  const spread = Math.hypot((xx - yy) / 2, xy);
  const axis = (variance) => Math.sqrt(5.991 * Math.max(variance, 0));
  return { a: axis(mean + spread), b: axis(mean - spread), angle: Math.atan2(2 * xy, xx - yy) / 2 };
}

/** Return the largest number 1, 2 or 5 times a power of ten that is at most `length`. */
export function roundStep(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  const share = length / power;
  return power * (share >= 5 ? 5 : share >= 2 ? 2 : 1);
}

/** Return the index of the last of increasing `values` that is at most `value`; -1 if all are larger. */
export function lastAtMost(values, value) {
  let low = 0;
  let high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] <= value) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** Return the smallest and the largest finite value from `begin` to `end` and in `extra`; null if there is no value. */
export function rangeOf(values, begin, end, extra = null) {
  let [low, high] = extra ?? [Infinity, -Infinity];
  for (let i = begin; i < end; i += 1) {
    const value = values[i];
    if (value < low && value > -Infinity) low = value;
    if (value > high && value < Infinity) high = value;
  }
  return low <= high ? [low, high] : null;
}

/** Return a number with this many digits and a unit, or a dash if it is not finite. */
export function shown(value, digits = 2, unit = "") {
  if (!Number.isFinite(value)) return "–";
  return `${value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1")}${unit && ` ${unit}`}`;
}

/** Return a length [m] as text, in centimetres below one metre. */
export const lengthText = (length) => (length < 0.995 ? shown(100 * length, 1, "cm") : shown(length, 2, "m"));

export const degrees = (angle) => (angle * 180) / Math.PI;

const NUMBER = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;

/** Convert a text to a number; throw an error that names the field if it is not a number. */
export function readNumber(name, text) {
  const word = text.trim();
  const value = NUMBER.test(word) ? Number(word) : NaN;
  if (Number.isFinite(value)) return value;
  const advice = word.includes(",") ? "a number with a decimal point, not a comma" : "a number, such as -1.5";
  throw new Error(`${name} = '${word.slice(0, 20)}': must be ${advice}.`);
}
