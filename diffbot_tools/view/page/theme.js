// The colours of the style sheet for the drawings, and the change between light and dark.

const NAMES = ["page", "panel", "text", "faint", "line", "mark", "truth", "estimate", "odometry", "fixes", "goal", "plan", "landmarks", "dock", "near", "band", "alarm"];

/** The current colours by name. */
export function coloursOf(root) {
  const style = getComputedStyle(root);
  return Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

/** Start with the preference of the system; return a function that changes between light and dark. */
export function startTheme(root, onChange) {
  const set = (dark) => {
    root.dataset.theme = dark ? "dark" : "light";
    onChange();
  };
  const preferred = matchMedia("(prefers-color-scheme: dark)");
  preferred.addEventListener("change", () => set(preferred.matches));
  set(preferred.matches);
  return () => set(root.dataset.theme !== "dark");
}
