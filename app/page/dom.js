// Small helpers over the DOM. Text from the network only ever becomes text nodes.

const SVG = "http://www.w3.org/2000/svg";

/** Make an element: tag, class, then text or children. */
export function el(tag, className = "", ...children) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...children);
  return element;
}

/** Make an SVG from plain attribute lists: [[tag, {name: value}], ...]. */
export function svg(size, shapes, className = "") {
  const root = document.createElementNS(SVG, "svg");
  root.setAttribute("viewBox", `0 0 ${size} ${size}`);
  root.setAttribute("aria-hidden", "true");
  if (className) root.setAttribute("class", className);
  for (const [tag, attributes] of shapes) {
    const shape = document.createElementNS(SVG, tag);
    for (const [name, value] of Object.entries(attributes)) shape.setAttribute(name, value);
    root.append(shape);
  }
  return root;
}

/** Set text only when it changed: no layout for figures that rest. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** A duration in ms as people read it: "8 ms", "1.4 s", "2 min". */
export function age(ms) {
  if (ms === null || ms === undefined || !Number.isFinite(ms)) return "–";
  const value = Math.max(0, ms);
  if (value < 1000) return `${Math.round(value)} ms`;
  if (value < 100_000) return `${(value / 1000).toFixed(1)} s`;
  return `${Math.round(value / 60_000)} min`;
}

/** Level of an age: "" while normal, then "warn", then "bad". */
export function level(ms, warn, bad) {
  if (ms === null || ms === undefined) return "";
  return ms >= bad ? "bad" : ms >= warn ? "warn" : "";
}

/** Clock time of a stamp, with tenths, in UTC. */
export function clock(ms) {
  return new Date(ms).toISOString().slice(11, 21);
}
