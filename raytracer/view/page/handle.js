// The picture in the hand: one pointer turns, two move and zoom, the right button and Shift move, a click picks.

import { Picture } from "./picture.js";
import { at } from "./elements.js";

const CLICK = 4; // pixels of the page within which a pointer has clicked
const TURN = 0.008; // radians a pixel
const KEY = 0.1; // radians, and shares of the picture, a key

export class Handle extends Picture {
  constructor({ turn, move, zoom, ...rest }) {
    super({ dragged: () => {}, ...rest });
    Object.assign(this, { turn, move, zoom, pointers: new Map(), far: false });
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
      this.zoom(Math.exp(0.0015 * lines * Math.max(-200, Math.min(200, event.deltaY))));
    }, { passive: false });
    this.canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  pointerdown(event) {
    this.canvas.setPointerCapture(event.pointerId);
    if (!this.pointers.size) Object.assign(this, { far: false, begun: [event.clientX, event.clientY] });
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    this.far ||= this.pointers.size > 1;
    this.canvas.classList.add("turning");
  }

  pointermove(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return this.point(this.under(event));
    const here = [event.clientX, event.clientY];
    this.far ||= Math.hypot(here[0] - this.begun[0], here[1] - this.begun[1]) >= CLICK;
    if (!this.far) return;
    const [x, y] = [here[0] - before[0], here[1] - before[1]];
    const box = this.canvas.getBoundingClientRect(), side = Math.min(box.width, box.height);
    const others = [...this.pointers].filter(([number]) => number !== event.pointerId).map(([, place]) => place);
    if (others.length) {
      const gap = ([a, b]) => Math.hypot(a - others[0][0], b - others[0][1]);
      this.move(x / 2 / side, y / 2 / side);
      if (gap(here) > 10) this.zoom(gap(before) / gap(here));
    } else if (event.buttons & 6 || event.shiftKey) this.move(x / side, y / side);
    else this.turn(-TURN * x, TURN * y);
    this.pointers.set(event.pointerId, here);
  }

  pointerup(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    if (this.pointers.size) return;
    this.canvas.classList.remove("turning");
    if (!this.far && event.button === 0) this.choose(this.under(event));
  }

  pointercancel(event) {
    this.pointers.delete(event.pointerId);
    this.canvas.classList.remove("turning");
  }

  pointerleave() { if (!this.pointers.size) this.pixel = null; }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (way && event.shiftKey) this.move(-KEY / 2 * way[0], KEY / 2 * way[1]);
    else if (way) this.turn(KEY * way[0], KEY * way[1]);
    else if (event.key === "+" || event.key === "=") this.zoom(1 / 1.15);
    else if (event.key === "-") this.zoom(1.15);
    else if (event.key === "Enter") this.choose([this.size[1] >> 1, this.size[0] >> 1]);
    else return;
    event.preventDefault();
  }

  // The mark is of a place in the scene: it leaves with the camera.
  unmark() { at("mark").hidden = true; }
}
