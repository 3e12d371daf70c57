// The camera: turned about its target, moved across the picture, nearer and farther.

const add = (a, b, factor = 1) => a.map((part, k) => part + factor * b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const length = Math.hypot(...a); return a.map((part) => part / length); };
const POLE = 0.02; // radians that the line of sight keeps from what is up

// The camera as the fields of the page show it, and as the code says it: six digits.
export const rounded = (camera) => Object.fromEntries(Object.entries(camera).map(([name, value]) =>
  [name, Array.isArray(value) ? value.map(six) : typeof value === "number" ? six(value) : value]));
const six = (value) => (Math.abs(value) < 1e-9 ? 0 : Number(value.toPrecision(6)));

export function axes({ position, target, up }) {
  const forward = unit(add(target, position, -1));
  const right = unit(cross(forward, up));
  return { forward, right, above: cross(right, forward) };
}

// Turn about the target by angles in radians: around what is up, and over the top.
export function turned(camera, around, over) {
  const up = unit(camera.up);
  const away = add(camera.position, camera.target, -1), distance = Math.hypot(...away);
  const height = Math.asin(Math.max(-1, Math.min(1, dot(away, up) / distance)));
  const level = unit(add(away, up, -dot(away, up)));
  const most = Math.PI / 2 - POLE;
  const higher = Math.max(-most, Math.min(most, height + over));
  const side = cross(up, level);
  const facing = add(level.map((part) => part * Math.cos(around)), side, Math.sin(around));
  const offset = add(facing.map((part) => part * Math.cos(higher)), up, Math.sin(higher));
  return rounded({ ...camera, position: add(camera.target, offset, distance) });
}

// The shorter side of a picture in shorter sides of the camera's frame, all of which it shows.
function frames(aspect, [width, height]) {
  return Math.min(width, height) * Math.max(Math.max(aspect, 1) / width, Math.max(1 / aspect, 1) / height);
}

// Move across a picture of a size by shares of its shorter side: what lies at the target follows the pointer.
export function moved(camera, across, down, size) {
  const { right, above } = axes(camera);
  const distance = Math.hypot(...add(camera.target, camera.position, -1));
  const frame = camera.projection === "orthographic" ? camera.span : 2 * distance * Math.tan(camera.fov * Math.PI / 360);
  const span = frame * frames(camera.aspect, size);
  const by = add(right.map((part) => -part * across * span), above, down * span);
  return rounded({ ...camera, position: add(camera.position, by), target: add(camera.target, by) });
}

// Nearer by a factor below 1: an orthographic camera shows less instead.
export function nearer(camera, factor) {
  if (camera.projection === "orthographic") return rounded({ ...camera, span: camera.span * factor });
  return rounded({ ...camera, position: add(camera.target, add(camera.position, camera.target, -1), factor) });
}

// The same place, another target.
export const aimed = (camera, target) => rounded({ ...camera, target });
