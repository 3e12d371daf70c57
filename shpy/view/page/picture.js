// The picture: the frames that come, and the pixel that the pointer or the arrow keys choose. A click is no drag.

import { at } from "./elements.js";

const CLICK = 4; // a pointer that moves less far between down and up, in pixels of the page, has clicked

export class Picture {
  constructor({ acknowledge, drawn, pointed, chosen, dragged }) {
    Object.assign(this, { canvas: at("picture"), acknowledge, drawn, pointed, chosen, dragged, waiting: null, size: [1, 1] });
    this.context = this.canvas.getContext("2d", { willReadFrequently: true });
    this.pixel = null; // [row, column] that was pointed at
    this.shown = {}; // the worker and the number of the frame that is drawn, which questions are about
    this.press = null;
    for (const kind of ["pointerdown", "pointermove", "pointerup", "pointercancel", "pointerleave"])
      this.canvas.addEventListener(kind, (event) => this[kind](event));
    this.canvas.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.mark(!at("mark").hidden)).observe(this.canvas); // a panel takes room from the picture
  }

  // Take a frame; it is drawn, and acknowledged, when the screen is drawn: a hidden page asks for no further ones.
  take(header, bytes) {
    this.waiting = [header, bytes];
    requestAnimationFrame(() => this.draw());
  }

  draw() {
    if (!this.waiting) return;
    const [header, bytes] = this.waiting;
    this.waiting = null;
    const { width, height, worker, number } = header;
    this.shown = { worker, number };
    if (header.extent) this.resize(header.extent);
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    this.context.putImageData(new ImageData(bytes, width, height), 0, 0);
    this.canvas.classList.toggle("coarse", header.coarse);
    this.canvas.classList.toggle("grown", this.canvas.clientWidth >= 2 * width);
    at("empty").hidden = true;
    this.acknowledge(header);
    this.drawn(header);
  }

  resize([width, height]) {
    if (width === this.size[0] && height === this.size[1]) return;
    this.size = [width, height];
    for (const element of [this.canvas, at("frame")]) {
      element.style.setProperty("--wide", width);
      element.style.setProperty("--high", height);
    }
    if (this.pixel && (this.pixel[0] >= height || this.pixel[1] >= width)) this.point(null);
  }

  // The position of an event in pixels of the picture.
  position(event) {
    const box = this.canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width * this.size[0], (event.clientY - box.top) / box.height * this.size[1]];
  }

  point(pixel) {
    this.pixel = pixel;
    if (pixel) this.pointed(pixel);
  }

  mark(shown) {
    const mark = at("mark");
    mark.hidden = !shown || !this.pixel;
    if (mark.hidden) return;
    const [row, column] = this.pixel;
    const box = this.canvas.getBoundingClientRect(), outer = at("frame").getBoundingClientRect();
    mark.style.left = `${box.left - outer.left + (column + 0.5) / this.size[0] * box.width}px`;
    mark.style.top = `${box.top - outer.top + (row + 0.5) / this.size[1] * box.height}px`;
  }

  under(event) {
    const [x, y] = this.position(event);
    const inside = (value, most) => Math.min(Math.max(Math.floor(value), 0), most - 1);
    return [inside(y, this.size[1]), inside(x, this.size[0])];
  }

  pointerdown(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.press = { at: [event.clientX, event.clientY], from: this.position(event), far: false };
  }

  pointermove(event) {
    this.point(this.under(event));
    if (!this.press) return;
    const [x, y] = this.press.at;
    this.press.far ||= Math.hypot(event.clientX - x, event.clientY - y) >= CLICK;
    if (this.press.far) this.dragged(this.position(event), this.press.from, "move");
  }

  pointerup(event) {
    if (!this.press) return;
    const { far, from } = this.press;
    this.press = null;
    if (far) this.dragged(this.position(event), from, "up");
    else this.choose(this.under(event));
  }

  pointercancel() { this.press = null; }

  pointerleave() { if (!this.press && document.activeElement !== this.canvas) this.pixel = null; }

  choose(pixel) {
    this.point(pixel);
    this.mark(true);
    this.chosen(pixel);
  }

  key(event) {
    const [width, height] = this.size;
    const move = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[event.key];
    const pixel = this.pixel ?? [height >> 1, width >> 1];
    if (move) {
      const step = event.shiftKey ? 10 : 1;
      const inside = (value, most) => Math.min(Math.max(value, 0), most - 1);
      this.point([inside(pixel[0] + step * move[0], height), inside(pixel[1] + step * move[1], width)]);
      this.mark(true);
    } else if (event.key === "Enter") this.choose(pixel);
    else return;
    event.preventDefault();
  }
}
