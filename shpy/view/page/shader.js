// The page of `shpy view`: connects the parts.

import { clockOf } from "./clock.js";
import { Connection } from "./connection.js";
import { Controls } from "./controls.js";
import { at, fill, fillSizes, make, onKeys } from "./elements.js";
import { Picture } from "./picture.js";
import { closePanel, endSearch, markStale, openPanel, showBusy, showComparison, showLost, showOdd, showPixel, showProblem, showTexts, showTrace } from "./report.js";
import { copied, fullScreen, saveFile } from "./taking.js";

const state = { params: {} };
let described = null;
let saved = null; // when the file was saved whose picture is awaited, and the worker before
let refused = null; // the error of a target in whose place another one draws
let times = [];
let sized = ""; // the size that the page has chosen, of which a chain may make another one

const connection = new Connection("/view", heard, (open) => {
  document.body.dataset.connected = open;
  if (!open) showLost("shpy view");
});

const picture = new Picture({
  acknowledge: ({ worker, number }) => connection.send({ do: "acknowledge", worker, number }),
  drawn: showFrame,
  pointed: (pixel) => connection.askOnce("value", pixel, picture.shown),
  chosen: (pixel) => {
    cancel();
    openPanel(`Trace of the pixel ${pixel[1]}, ${pixel[0]}`, "…");
    connection.ask("trace", picture.shown, { at: pixel });
  },
  dragged: (position, from, phase) => {
    if (!described?.mouse) return;
    const press = phase === "up" ? from.map((part) => -Math.abs(part)) : from;
    connection.set({ mouse: [...position, ...press] });
  },
});

const controls = new Controls(at("controls"), (name, value) => {
  state.params[name] = value;
  connection.set({ params: { [name]: value } });
});

function heard(header, bytes) {
  ({
    hello: () => { showProblem(null); Object.assign(state, header.state); showName(header.request); showState(); },
    state: () => { merge(header.changes); showState(); },
    recording: () => {
      endSearch("The search ended: the file is recorded again.");
      markStale();
      saved = { at: performance.now() - 1000 * header.age, worker: Number(document.body.dataset.worker) };
    },
    recorded: () => { described = header; showRecorded(); },
    frame: () => picture.take(header, bytes),
    error: () => { showProblem(header); at("empty").textContent = "There is no picture yet."; },
    well: () => showProblem(null),
    busy: () => showBusy(header, { recording: "Recording the new version", running: "Computing a frame" }),
    remark: () => { at("status").textContent = header.text; },
    answer: () => answered(header, bytes),
  })[header.kind]?.(header);
}

function answered(header, bytes) {
  if (header.about === "value") {
    connection.answered();
    const [row, column] = header.at ?? [0, 0];
    const { width, height } = picture.canvas;
    const [r, g, b] = picture.context.getImageData(Math.floor(column * width / picture.size[0]), Math.floor(row * height / picture.size[1]), 1, 1).data;
    const swatch = make("span", { class: "swatch" });
    swatch.style.background = `rgb(${r} ${g} ${b})`;
    showPixel(header, swatch);
  } else if (header.about === "trace" || header.about === "odd") {
    if (header.at) picture.pixel = header.at;
    showTrace(header);
    picture.mark(true);
  } else if (header.about === "picture") savePicture(header, bytes);
  else if (header.about === "text") showTexts(header);
  else if (header.about === "recipe") showRecipe(header);
  else if (header.about === "divergence") endSearch(header.divergence);
  else showComparison(header, bytes, cancel);
}

function merge({ params, ...changes }) {
  Object.assign(state, changes);
  for (const [name, value] of Object.entries(params ?? {})) {
    state.params[name] = value;
    controls.show(name, value ?? described?.controls.find((one) => one.name === name)?.first ?? []);
  }
}

function change(changes) {
  Object.assign(state, changes);
  connection.set(changes);
  showState();
}

function showName({ name, program }) {
  document.title = `${name}${program ? `:${program}` : ""} – shpy view`;
  at("name").textContent = name;
}

function showRecorded() {
  const { programs, program, backends, maths, moves, evolves, form } = described;
  fill(at("program"), programs.map((name) => [name, name]), program);
  at("programs").hidden = programs.length < 2;
  document.title = `${program} – ${at("name").textContent}`;
  for (const [id, chosen] of [["backend", form[0]], ["other-backend"]]) fill(at(id), backends.map((name) => [name, name]), chosen);
  for (const [id, chosen] of [["math", form[1]], ["other-math"]]) fill(at(id), maths.map((name) => [name, name]), chosen);
  state.backend ??= form[0];
  if (!at("other-backend").dataset.chosen) {
    at("other-backend").value = backends.find((name) => name !== form[0]) ?? form[0];
    at("other-backend").dataset.chosen = true;
  }
  for (const one of [at("params"), at("look"), at("taking"), ...document.querySelectorAll("header > .choice:not(#programs)")]) one.hidden = false;
  if (!at("pixel").textContent) at("pixel").textContent = "Point at a pixel for its value; click it for its trace.";
  at("clock").hidden = !moves;
  at("pace").hidden = !evolves;
  at("comparing").hidden = evolves;
  controls.draw(described.controls.map((one) => ({ ...one, value: present(one) })));
  showState();
}

// A version that was recorded before this page came describes the values of that time.
function present({ name, value, first }) {
  const set = state.params[name];
  return set && set.length === value.length && typeof set[0] === typeof value[0] ? set : first;
}

function showState() {
  if (!state.size) return;
  if (sized !== state.size.join()) picture.resize(state.size);
  sized = state.size.join();
  fillSizes(at("size"), state.size);
  if (state.backend) at("backend").value = state.backend;
  if (state.math) at("math").value = state.math;
  at("play").textContent = state.playing ? "Pause" : "Play";
  at("encode").checked = Boolean(state.encode);
  at("mark-odd").checked = Boolean(state.mark);
  at("steps").value = state.steps ?? 1;
}

function showFrame(header) {
  const now = performance.now();
  times = [...times.filter((time) => now - time < 1000), now];
  document.body.dataset.frames = Number(document.body.dataset.frames ?? 0) + 1;
  measure(header, now);
  const rate = described?.moves && state.playing && times.length > 1 ? `, ${times.length} frames a second` : "";
  at("speed").textContent = `${header.form}: ${header.milliseconds.toFixed(1)} ms${header.coarse ? " (coarse)" : ""}${rate}`;
  at("time").textContent = `${header.time.toFixed(2)} s, frame ${header.frame}`;
  const status = at("status");
  at("work").dataset.meanwhile = header.meanwhile ? `; ${header.form} draws meanwhile` : "";
  showOdd(header.odd);
  if (header.waiting) status.textContent = "";
  else if (header.refused) status.textContent = `${at("backend").value} refuses it; ${header.form} draws in its place.`;
  else status.textContent = document.body.dataset.full
    ? `Saved; first picture after ${document.body.dataset.first} ms, the full one after ${document.body.dataset.full} ms.`
    : described ? `${described.program} was recorded in ${(1000 * described.recording).toFixed(0)} ms.` : "";
  if (header.refused || refused) showProblem(header.refused);
  refused = header.refused;
  if (picture.pixel) connection.askOnce("value", picture.pixel, picture.shown);
}

function savePicture({ frame, problem, cure }, bytes) {
  if (problem) return openPanel("Save as PNG", make("p", {}, problem), cure ? make("p", {}, make("code", {}, cure)) : "");
  saveFile(bytes, `${described.program}${described.moves ? `-${frame}` : ""}.png`);
}

function showRecipe({ command, code, note, problem }) {
  if (problem) return openPanel("This picture", make("p", {}, problem));
  openPanel("The picture that was shown", copied("As a command", command), copied("As code", `import shpy as sh\n\npicture = ${code}`),
    note ? make("p", { id: "recipe-note" }, note) : "");
}

// How long the picture took since the file was saved, for people and for tests.
function measure(header, now) {
  const { dataset } = document.body;
  if (saved && header.worker !== saved.worker) {
    if (dataset.worker !== String(header.worker)) {
      dataset.first = Math.round(now - saved.at);
      delete dataset.full;
    }
    if (!header.coarse && !header.waiting) {
      dataset.full = Math.round(now - saved.at);
      saved = null;
    }
  }
  dataset.worker = header.worker;
  dataset.form = header.form;
}

// A search of a program of many statements takes minutes of a core.
function cancel() {
  if (endSearch("The search was cancelled.")) connection.send({ do: "cancel" });
}

function compare() {
  if (at("comparing").hidden) return;
  cancel();
  openPanel("Compare", "Computing both …");
  connection.ask("compare", picture.shown, { with: { backend: at("other-backend").value, math: at("other-math").value } });
}

const { play, step, reset } = clockOf(connection, state, change);
const close = () => { cancel(); closePanel(); picture.mark(false); };

at("backend").onchange = (event) => change({ backend: event.target.value });
at("math").onchange = (event) => change({ math: event.target.value });
at("size").onchange = (event) => change({ size: event.target.value.split("x").map(Number) });
at("encode").onchange = (event) => change({ encode: event.target.checked });
at("steps").onchange = (event) => change({ steps: Math.min(Math.max(Math.round(event.target.valueAsNumber) || 1, 1), 1000) });
at("program").onchange = (event) => connection.send({ do: "pick", program: event.target.value });
at("stop").onclick = () => connection.send({ do: "stop" });
at("compare").onclick = compare;
at("mark-odd").onchange = (event) => change({ mark: event.target.checked });
at("trace-odd").onclick = () => { cancel(); connection.ask("odd", picture.shown); };
const save = () => connection.ask("picture", picture.shown);
at("save").onclick = save;
at("full").onclick = fullScreen;
at("recipe").onclick = () => { cancel(); connection.ask("recipe", picture.shown); };
at("text").onclick = () => { cancel(); connection.ask("text", picture.shown); };
at("close").onclick = close;
addEventListener("keydown", (event) => { if (event.key === "Escape") close(); });
onKeys((key) => ({ c: compare, s: save, f: fullScreen }[key] ?? (at("clock").hidden ? null : { " ": play, ".": step, r: reset }[key])));
