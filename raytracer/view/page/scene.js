// The page of `raytracer view`: connects the parts.

import { clockOf } from "./clock.js";
import { Connection } from "./connection.js";
import { Controls } from "./controls.js";
import { at, fill, fillSizes, list, make, onKeys, spoken } from "./elements.js";
import { Handle } from "./handle.js";
import { aimed, moved, nearer, turned } from "./orbit.js";
import { closePanel, openPanel, showBusy, showLost, showOdd, showProblem, showTexts } from "./report.js";
import { copy, fullScreen, saveFile } from "./taking.js";

const PLACES = ["position", "target", "up"];
const state = { params: {}, scene: {} };
const sent = new Map(); // when a camera was sent, by its stamp
let described = null;
let camera = null; // that of the page; the scene's own until it is turned
let picked = null;
let stamp = 0;
let saving = null; // the timer after which the camera's text is asked for
let unanswered = 0; // questions about it
let scrubbing = false;

const connection = new Connection("/view", heard, (open) => {
  document.body.dataset.connected = open;
  if (!open) showLost("raytracer view");
});

const handle = new Handle({
  acknowledge: ({ worker, number }) => connection.send({ do: "acknowledge", worker, number }),
  drawn: showFrame,
  pointed: (pixel) => connection.askOnce("object", pixel),
  chosen: (pixel) => connection.send({ do: "ask", about: "surface", at: pixel }),
  turn: (around, over) => look(turned(camera, around, over)),
  move: (across, down) => look(moved(camera, across, down, handle.size)),
  zoom: (factor) => look(nearer(camera, factor)),
});

const panels = Object.fromEntries(["material", "light", "display"].map((kind) => [kind,
  new Controls(at(`${kind}-controls`), (name, value) => {
    state.params[name] = value;
    connection.set({ params: { [name]: value } });
    handle.unmark();
    save();
  }, "")]));

function heard(header, bytes) {
  ({
    hello: () => { unanswered = 0; showProblem(null); Object.assign(state, { scene: {} }, header.state); showName(header.request); showState(); },
    state: () => { merge(header.changes); showState(); },
    recording: () => { at("status").replaceChildren(make("span", { class: "wait" }, "The scene is read …")); },
    recorded: () => { described = header; showDescribed(); },
    frame: () => handle.take(header, bytes),
    error: () => { showProblem(header); at("empty").textContent = "There is no picture yet."; showCount(); },
    well: () => showProblem(null),
    busy: () => showBusy(header, { recording: "Reading the scene", running: "Computing the picture" }),
    remark: () => { at("status").textContent = header.text; },
    answer: () => answered(header, bytes),
  })[header.kind]?.(header);
}

function answered(header, bytes) {
  if (header.about === "object") showObject(header);
  else if (header.about === "surface") showSurface(header);
  else if (header.about === "camera") {
    at("code").textContent = header.code ?? header.problem;
    at("command").textContent = header.command ?? "";
    at("picture-code").textContent = header.picture ?? "";
    at("note").textContent = header.note ?? "";
    at("animating").hidden = !header.animation;
    at("animation").textContent = header.animation ?? "";
    if (!--unanswered && !saving) for (const id of ["camera-section", "taking"]) at(id).ariaBusy = "false";
  } else if (header.about === "picture") savePicture(header, bytes);
  else if (header.about === "text") showTexts(header);
}

function merge({ params, ...changes }) {
  Object.assign(state, changes);
  for (const [name, value] of Object.entries(params ?? {})) {
    state.params[name] = value;
    for (const panel of Object.values(panels)) panel.show(name, value ?? firstOf(name));
  }
}

const everyControl = () => [...described.materials, ...described.lights].flatMap(({ controls }) => controls).concat(described.exposure);
const firstOf = (name) => (described ? everyControl().find((one) => one.name === name)?.first : null) ?? [];

function change(changes) {
  Object.assign(state, changes);
  connection.set(changes);
  showState();
}

// Another camera, null for the scene's own: the stamp tells which frame shows it.
function look(other) {
  if (!described) return;
  sent.set(++stamp, performance.now());
  handle.unmark();
  change({ scene: { ...state.scene, camera: other, stamp } });
}

function showName({ name }) {
  document.title = `${name} – raytracer view`;
  at("name").textContent = name;
}

function showDescribed() {
  const { backends, integrators, materials, lights, seconds, notices } = described;
  fill(at("backend"), backends.map((name) => [name, name]), state.backend ?? described.backend);
  fill(at("integrator"), integrators.map((name) => [name, name]), state.scene.integrator ?? described.integrator);
  fill(at("material"), materials.map(({ label, count }) => [label, count > 1 ? `${label} (${count} objects)` : label]), at("material").value || undefined);
  fill(at("light"), lights.map(({ label }, k) => [String(k), label]), at("light").value || undefined);
  for (const one of document.querySelectorAll("aside > section, header > .choice")) one.hidden = false;
  at("material-section").hidden = !materials.length;
  at("light-section").hidden = !lights.length;
  at("clock").hidden = !seconds;
  at("scrub").max = seconds || 1;
  if (!at("pixel").textContent) at("pixel").textContent = "Drag to turn, right-drag or two fingers to move, wheel or pinch to zoom; click a surface.";
  panels.display.draw([withValue(described.exposure)]);
  showMaterial();
  showLight();
  showState();
  if (notices.length) at("status").textContent = notices.join("; ");
  else showCount();
}

// The size of the scene that is shown, in place of a word on the work under way.
function showCount() {
  at("status").textContent = described ? `${described.triangles.toLocaleString("en")} triangles` : "";
}

const withValue = (one) => ({ ...one, value: state.params[one.name]?.length === one.first.length ? state.params[one.name] : one.first });

function showMaterial() {
  const found = described.materials.find(({ label }) => label === at("material").value) ?? described.materials[0];
  if (!found) return;
  at("material").value = found.label;
  const notes = [];
  if (found.count > 1) notes.push(`Shared by ${found.objects.join(", ")}${found.count > found.objects.length ? " …" : ""}.`);
  if (found.pictures.length) notes.push(`Read from pictures: ${found.pictures.join(", ")}.`);
  if (found.programs.length) notes.push("A program may replace these numbers.");
  at("material-notes").textContent = notes.join(" ");
  panels.material.draw(found.controls.map(withValue));
}

function showLight() {
  const found = described.lights[Number(at("light").value) || 0];
  if (!found) return;
  at("light-notes").textContent = found.controls.length ? "" : "The light from all around has no numbers here.";
  panels.light.draw(found.controls.map(withValue));
}

function showState() {
  if (!state.size) return;
  handle.resize(state.size);
  fillSizes(at("size"), state.size);
  if (!described) return;
  at("backend").value = state.backend ?? described.backend;
  at("integrator").value = state.scene.integrator ?? described.integrator;
  at("play").textContent = state.playing ? "Pause" : "Play";
  at("mark-odd").checked = Boolean(state.mark);
  camera = state.scene.camera ?? described.camera;
  showCamera();
  save();
}

// The numbers of the camera, as fields.
function showCamera() {
  const last = camera.projection === "orthographic" ? "span" : "fov";
  if (at("camera").dataset.last !== last) {
    const field = (name, k, text) => make("input", { type: "number", step: "any", "aria-label": text, "data-name": name, "data-part": k ?? "",
      class: k === null ? "alone" : "", onchange: typed });
    at("camera").dataset.last = last;
    at("camera").replaceChildren(...PLACES.flatMap((name) => [make("span", {}, name), ...["x", "y", "z"].map((axis, k) => field(name, k, `${name} ${axis}`))]),
      ...(camera.projection === "panorama" ? [] : [make("span", {}, last), field(last, null, last === "fov" ? "fov, in degrees" : "span")]));
  }
  for (const input of at("camera").querySelectorAll("input")) {
    const value = input.dataset.part === "" ? camera[input.dataset.name] : camera[input.dataset.name][Number(input.dataset.part)];
    if (document.activeElement !== input) input.value = spoken(Number(value.toPrecision(4)));
  }
}

function typed(event) {
  const { name, part } = event.target.dataset, value = event.target.valueAsNumber;
  if (Number.isNaN(value)) return;
  look({ ...camera, [name]: part === "" ? value : camera[name].map((old, k) => (k === Number(part) ? value : old)) });
}

// The camera as text, once it has come to rest.
function save() {
  clearTimeout(saving);
  for (const id of ["camera-section", "taking"]) at(id).ariaBusy = "true";
  saving = setTimeout(() => {
    saving = null;
    unanswered += 1;
    connection.send({ do: "ask", about: "camera" });
  }, 250);
}

function showFrame(header) {
  const { dataset } = document.body;
  if (sent.has(header.stamp)) {
    dataset.answer = Math.round(performance.now() - sent.get(header.stamp));
    for (const number of [...sent.keys()]) if (number <= header.stamp) sent.delete(number);
  }
  if (!dataset.first) dataset.first = Math.round(performance.now());
  Object.assign(dataset, { frames: Number(dataset.frames ?? 0) + 1, form: header.form, coarse: header.coarse, finished: header.finished,
    samples: header.samples, stamp: header.stamp ?? "", worker: header.worker });
  const what = header.coarse ? `coarse${header.plain ? ", without mirrors" : ""}` : `${header.samples} of ${header.of} samples`;
  at("speed").textContent = `${header.form}: ${what}, ${header.milliseconds.toFixed(0)} ms`;
  at("progress").value = header.coarse ? 0 : header.samples * (1 + header.share) / 2 / header.of;
  at("progress").classList.toggle("done", header.finished);
  at("time").textContent = `${header.time.toFixed(2)} s`;
  if (!scrubbing) at("scrub").value = header.time;
  at("work").dataset.meanwhile = header.waiting ? `; ${header.form} draws meanwhile` : "";
  showOdd(header.odd);
  if (at("status").querySelector(".wait")) showCount();
}

function showObject({ at: [row, column], number, object, material, problem }) {
  connection.answered();
  if (problem) return;
  at("pixel").replaceChildren(`x ${column}  y ${row}  `, number === null ? "background" : make("b", {}, object), material && material !== object ? `, material of ${material}` : "");
}

function showSurface(answer) {
  picked = answer.number === null || answer.problem ? null : answer;
  at("aim").disabled = !picked;
  at("found").hidden = !picked;
  at("unpicked").hidden = Boolean(picked);
  at("unpicked").textContent = answer.problem ?? "The background: no surface is there.";
  if (!picked) return;
  const short = (values) => list(values.map((value) => Number(value.toPrecision(6))));
  const rows = { object: `${answer.object} (number ${answer.number})`, material: answer.material, position: short(answer.position),
    normal: short(answer.normal.map((part) => Number(part.toFixed(5)))), distance: spoken(Number(answer.distance.toPrecision(6))) };
  at("found").replaceChildren(...Object.entries(rows).flatMap(([name, text]) => [make("dt", {}, name), make("dd", {}, text)]));
  at("material").value = answer.material;
  showMaterial();
  handle.mark(true);
}

function savePicture({ problem, cure }, bytes) {
  if (problem) return openPanel("Save as PNG", make("p", {}, problem), cure ? make("p", {}, make("code", {}, cure)) : "");
  saveFile(bytes, `${at("name").textContent.split("/").pop().replace(/\.\w+$/, "")}.png`);
}

const { play, step, reset } = clockOf(connection, state, change);
const home = () => look(null);
const aim = () => { if (picked) look(aimed(camera, picked.position)); };

at("backend").onchange = (event) => change({ backend: event.target.value });
at("integrator").onchange = (event) => change({ scene: { ...state.scene, integrator: event.target.value } });
at("size").onchange = (event) => change({ size: event.target.value.split("x").map(Number) });
at("material").onchange = showMaterial;
at("light").onchange = showLight;
at("scrub").oninput = (event) => { scrubbing = true; change({ time: event.target.valueAsNumber, playing: false }); };
at("scrub").onchange = () => { scrubbing = false; };
at("stop").onclick = () => connection.send({ do: "stop" });
at("home").onclick = home;
at("aim").onclick = aim;
for (const id of ["code", "command", "picture-code", "animation"]) at(`copy-${id}`).onclick = (event) => copy(event.target, at(id));
const saveImage = () => connection.ask("picture", handle.shown);
at("save").onclick = saveImage;
at("full").onclick = fullScreen;
at("text").onclick = () => connection.ask("text", handle.shown);
at("mark-odd").onchange = (event) => change({ mark: event.target.checked });
at("close").onclick = closePanel;
addEventListener("keydown", (event) => { if (event.key === "Escape") closePanel(); });
onKeys((key) => ({ h: home, t: aim, s: saveImage, f: fullScreen }[key] ?? (at("clock").hidden ? null : { " ": play, ".": step, 0: reset }[key])));
