// Elements of the page, found and made.

export const at = (id) => document.getElementById(id);

export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name in element && typeof value !== "string") element[name] = value;
    else if (value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

export function fill(select, options, chosen) {
  const same = [...select.options].map((option) => option.value).join() === options.map(([value]) => value).join();
  if (!same) select.replaceChildren(...options.map(([value, text]) => make("option", { value }, text)));
  if (chosen !== undefined && chosen !== null) select.value = chosen;
}

const SIZES = [[256, 256], [512, 512], [768, 768], [1024, 1024], [640, 360], [1280, 720], [1920, 1080]];

// The sizes of pictures to choose from, with the present one.
export function fillSizes(select, [width, height]) {
  const sizes = SIZES.some(([w, h]) => w === width && h === height) ? SIZES : [[width, height], ...SIZES];
  fill(select, sizes.map(([w, h]) => [`${w}x${h}`, `${w} × ${h}`]), `${width}x${height}`);
}

// A number as a person reads it: seven digits tell binary32 numbers apart for the eye, nine are exact.
export function spoken(value) {
  if (typeof value !== "number") return String(value);
  if (Number.isInteger(value)) return String(value);
  const short = Number(value.toPrecision(7));
  return Math.abs(short) < 1e-4 || Math.abs(short) >= 1e7 ? short.toExponential() : String(short);
}

export const list = (values) => values.map(spoken).join(", ");

export const fileName = (path) => path.split("/").pop();

// A text with the files of its places by their names alone, as the page names them everywhere.
export const withFileNames = (text) => text.replace(/\/(?:[^\/\s:]+\/)+(?=[^\/\s:]+\.py:\d)/g, "");

// Keys act wherever the focus is, but where it takes them itself: a slider takes arrows, and a person who has moved it
// goes on with Space.
export function onKeys(actionOf) {
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("input:not([type=range]), select, button, summary")) return;
    const action = actionOf(event.key);
    if (!action) return;
    event.preventDefault();
    action();
  });
}
