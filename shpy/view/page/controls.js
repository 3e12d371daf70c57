// Sliders, colour pickers and switches of a program's Params.

import { make, spoken } from "./elements.js";

const COMPONENTS = ["x", "y", "z", "w"];

// Draw the controls anew only where their set has changed: a slider that is being dragged stays.
export class Controls {
  constructor(place, changed) {
    Object.assign(this, { place, changed, drawn: "", shown: new Map() });
  }

  draw(described) {
    const key = JSON.stringify(described.map(({ value, ...rest }) => rest));
    if (key !== this.drawn) {
      this.drawn = key;
      this.shown.clear();
      this.place.replaceChildren(...described.map((one) => this.control(one)));
      if (!described.length) this.place.append(make("p", { class: "none" }, "The program has no Params. ",
        make("code", {}, "gain = sh.Param(sh.Attrib1f, 1.0, range=(0, 4))"), " makes a slider."));
    }
    for (const { name, value } of described) this.show(name, value);
  }

  show(name, value) {
    this.shown.get(name)?.(value);
  }

  control(described) {
    const { name, title, description, form, first } = described;
    let value = [...described.value];
    const undo = make("button", { type: "button", class: "undo", title: "Back to the value in the file",
      "aria-label": `${title}: back to the value in the file`,
      onclick: () => { this.changed(name, null); show(first); } }, "reset");
    const tell = (changed) => { value = changed; mark(); this.changed(name, value); };
    const mark = () => { undo.hidden = JSON.stringify(value) === JSON.stringify(first); };
    const [body, refresh] = (form === "switch" ? switches : form === "color" ? color : numbers)(described, () => value, tell);
    const show = (shown) => { value = [...shown]; refresh(value); mark(); };
    this.shown.set(name, show);
    return make("fieldset", { class: "control", "data-name": name },
      make("legend", {}, make("span", {}, title), undo),
      description ? make("p", {}, description) : null, ...body);
  }
}

function switches({ title, value }, present, tell) {
  const boxes = value.map((on, k) => make("input", { type: "checkbox", role: "switch", checked: on,
    "aria-label": label(title, value, k),
    onchange: (event) => tell(replaced(present(), k, event.target.checked)) }));
  return [[make("div", { class: "row" }, ...boxes)], (shown) => boxes.forEach((box, k) => { box.checked = shown[k]; })];
}

function numbers({ title, value, range: [low, high], step, bounded, components = COMPONENTS }, present, tell) {
  const rows = value.map((number, k) => {
    const slider = make("input", { type: "range", min: low, max: high, step: "any", value: number, "aria-label": label(title, value, k, components) });
    const field = make("input", { type: "number", step, value: number, "aria-label": `${label(title, value, k, components)}, number` });
    if (bounded) Object.assign(field, { min: low, max: high });
    slider.addEventListener("input", () => {
      const stepped = Number((low + Math.round((slider.valueAsNumber - low) / step) * step).toPrecision(7));
      const inside = Math.min(Math.max(stepped, low), high);
      field.value = spoken(inside);
      tell(replaced(present(), k, inside));
    });
    field.addEventListener("change", () => {
      if (!field.checkValidity() && field.validity.rangeOverflow) field.value = high;
      if (!field.checkValidity() && field.validity.rangeUnderflow) field.value = low;
      if (Number.isNaN(field.valueAsNumber)) return;
      slider.value = field.value;
      tell(replaced(present(), k, field.valueAsNumber));
    });
    const row = make("div", { class: value.length > 1 ? "component" : "component alone" }, make("span", { "aria-hidden": "true" }, value.length > 1 ? components[k] : ""), slider, field);
    return { row, show: (shown) => { slider.value = shown; if (document.activeElement !== field) field.value = spoken(shown); } };
  });
  return [rows.map(({ row }) => row), (shown) => rows.forEach(({ show }, k) => show(shown[k]))];
}

function color({ title, value, linear }, present, tell) {
  const hex = (rgb) => hexOf(linear ? rgb.map(encoded) : rgb), parts = (text) => (linear ? partsOf(text).map(decoded) : partsOf(text));
  const picker = make("input", { type: "color", "aria-label": title,
    oninput: () => tell([...parts(picker.value), ...present().slice(3)]) });
  const text = make("code", {});
  const alpha = value.length > 3 ? make("input", { type: "range", min: 0, max: 1, step: 0.005, "aria-label": `${title}, alpha`,
    oninput: () => tell(replaced(present(), 3, alpha.valueAsNumber)) }) : null;
  const refresh = (shown) => {
    picker.value = hex(shown);
    text.textContent = shown.map((part) => spoken(Number(part.toFixed(3)))).join(", ");
    if (alpha) alpha.value = shown[3];
  };
  picker.addEventListener("input", () => refresh([...parts(picker.value), ...present().slice(3)]));
  return [[make("div", { class: "row" }, picker, text), ...(alpha ? [alpha] : [])], refresh];
}

const label = (title, value, k, components = COMPONENTS) => (value.length > 1 ? `${title} ${components[k]}` : title);
const replaced = (values, k, value) => values.map((old, n) => (n === k ? value : old));
const hexOf = (rgb) => `#${rgb.slice(0, 3).map((part) => Math.round(255 * Math.min(Math.max(part, 0), 1)).toString(16).padStart(2, "0")).join("")}`;
const partsOf = (text) => [1, 3, 5].map((k) => Number((parseInt(text.slice(k, k + 2), 16) / 255).toFixed(4)));
// Of linear light, which the picker and the screen have as sRGB (IEC 61966-2-1).
const encoded = (light) => (light <= 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055);
const decoded = (level) => Number((level <= 0.04045 ? level / 12.92 : ((level + 0.055) / 1.055) ** 2.4).toFixed(4));
