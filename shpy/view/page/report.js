// Errors, the trace of a pixel, and the comparison of two forms.

import { at, fileName, list, make, spoken, withFileNames } from "./elements.js";
import { copied } from "./taking.js";

const SEARCHING = "Searching for the first statement at which they diverge …";

export function showProblem(error) {
  at("problem").hidden = !error;
  if (!error) return;
  const place = error.file ? `${fileName(error.file)}:${error.line}` : "";
  const title = [error.type, place].filter(Boolean).join(" at ");
  const source = error.source?.length ? make("pre", {}, ...error.source.map(([number, text]) =>
    make("span", number === error.line ? { class: "here" } : {}, `${number === error.line ? "→" : " "} ${String(number).padStart(4)}  ${text}\n`))) : null;
  at("problem").replaceChildren(
    make("h2", {}, title || "Stopped"), make("p", {}, withFileNames(error.message)),
    error.cure ? make("p", {}, make("strong", {}, "Cure: "), make("code", {}, error.cure)) : "",
    source ?? "");
}

// The connection has ended: `command` is what starts the server again.
export function showLost(command) {
  showBusy({ seconds: 0 });
  showProblem({ message: "The server has ended. The page connects again when it is back.", cure: `${command} ${at("name").textContent}` });
}

let ticking = null; // the work that is shown, and when it began: one clock, whoever tells of it

// Say what is done for the picture that is awaited, and for how long. Where the worker gives no answer, or there is no
// picture yet, this stands above the picture, and it can be stopped; the mistake of the version before counts no more.
export function showBusy({ stage, seconds, doing, silent }, working) {
  if (!seconds) return endBusy();
  const begun = performance.now() - 1000 * seconds;
  clearInterval(ticking?.timer);
  ticking = { begun: ticking ? Math.min(ticking.begun, begun) : begun, timer: null };
  const loud = silent || !at("empty").hidden;
  if (loud) at("problem").hidden = true;
  at("busy").hidden = !loud;
  const before = stage === "recording" && at("empty").hidden ? "; the picture is of the version before" : "";
  const text = doing ? doing[0].toUpperCase() + doing.slice(1) : working[stage];
  const tick = () => {
    const said = `${text}, ${Math.round((performance.now() - ticking.begun) / 1000)} s${before}`;
    if (loud) at("busy").firstElementChild.textContent = said;
    at("work").textContent = loud ? "" : `${said}${at("work").dataset.meanwhile ?? ""}`;
  };
  tick();
  ticking.timer = setInterval(tick, 500);
}

function endBusy() {
  clearInterval(ticking?.timer);
  ticking = null;
  at("busy").hidden = true;
  at("work").textContent = "";
}

export function openPanel(title, ...body) {
  at("panel-title").textContent = title;
  at("panel-body").replaceChildren(...body);
  at("panel").hidden = false;
}

// The file was saved: a trace or comparison that is open is not of the version that comes.
export function markStale() {
  if (at("panel").hidden || at("stale")) return;
  at("panel-body").prepend(make("p", { id: "stale" }, "This is of the version before the last save."));
}

export function closePanel() {
  at("panel").hidden = true;
}

export function showTrace({ at: place, program, frame, time, coarse, steps, cut, left_out: leftOut, inside, odd, problem, cure }) {
  const title = place ? `Trace of the pixel ${place[1]}, ${place[0]}` : "Trace";
  if (problem) return openPanel(title, make("p", {}, problem), cure ? make("p", {}, make("code", {}, cure)) : "");
  let last = null;
  const rows = steps.map((step, k) => {
    const fresh = step.line !== last;
    last = step.line;
    const gap = leftOut && k === cut ? [make("tr", {}, make("td", { colSpan: 5 }, `… ${leftOut} steps are left out …`))] : [];
    const kind = [fresh ? "next-line" : "", k === odd ? "odd" : ""].join(" ").trim();
    return [...gap, make("tr", kind ? { class: kind } : {},
      make("td", {}, fresh && step.file ? `${fileName(step.file)}:${step.line}` : ""),
      make("td", {}, step.iterations.join(", ")),
      make("td", {}, step.name), make("td", { class: "value" }, list(step.value)),
      make("td", { class: "source", title: step.source }, fresh ? step.source : ""))];
  });
  const further = inside ? `, and ${inside} inside functions of shpy` : "";
  const when = ` of frame ${frame}, ${time.toFixed(2)} s${coarse ? ", which is coarse" : ""}`;
  openPanel(`${title}${when}: ${program}, ${steps.length + leftOut} steps${further}`,
    odd === null ? "" : make("p", { class: "odd" }, `The marked step is the first whose value is ${steps[odd].value.includes("nan") ? "NaN" : "NaN or infinite"}.`), make("table", {},
    make("thead", {}, make("tr", {}, ...["Line", "Iteration", "Name", "Value", "Source"].map((text) => make("th", { scope: "col" }, text)))),
    make("tbody", {}, ...rows.flat())));
  at("panel").querySelector("tr.odd")?.scrollIntoView({ block: "center" });
}

export function showTexts({ form, texts, problem }) {
  if (problem) return openPanel("Emitted text", make("p", {}, problem));
  openPanel(`Emitted text for ${form}`, ...texts.map(({ name, text }) => copied(name, text, "emitted")));
}

// The pixels that are no colours, which the screen shows as black and white.
export function showOdd({ nan, infinite }) {
  at("odd").hidden = !(nan || infinite);
  const said = [nan ? `${nan.toLocaleString("en")} NaN` : "", infinite ? `${infinite.toLocaleString("en")} infinite` : ""];
  at("odd-count").textContent = `${said.filter(Boolean).join(", ")} ${nan + infinite === 1 ? "pixel" : "pixels"}`;
}

export function showPixel({ at: [row, column], value, problem }, swatch) {
  if (problem || !value) return;
  at("pixel").replaceChildren(swatch, ` x ${column}  y ${row}  `, make("b", {}, list(value)));
}

export function showComparison(answer, bytes, cancel) {
  if (answer.problem) return openPanel("Compare", make("p", {}, answer.problem), answer.cure ? make("p", {}, make("code", {}, answer.cure)) : "");
  const { width, height, names, count, differing, largest, ulp } = answer;
  const titles = [names[0], names[1], differing ? "Where they differ" : "They do not differ"];
  const figures = titles.map((title, k) => {
    const canvas = make("canvas", { width, height, role: "img", "aria-label": title });
    canvas.getContext("2d").putImageData(new ImageData(bytes.slice(k * 4 * width * height, (k + 1) * 4 * width * height), width, height), 0, 0);
    return make("figure", {}, canvas, make("figcaption", {}, title));
  });
  const text = differing
    ? `${differing} of ${count} pixels differ, by ${spoken(largest)}${ulp === null ? "" : ` and ${spoken(ulp)} ULP`} at most.`
    : `All ${count} pixels are the same to the bit.`;
  openPanel(`${names[0]} and ${names[1]}`, make("p", { id: "difference" }, text),
    answer.searching ? make("pre", { id: "divergence", class: "searching" }, SEARCHING) : "",
    answer.searching ? make("button", { id: "cancel", type: "button", onclick: cancel }, "Cancel the search") : "", make("div", { class: "sides" }, ...figures));
  if (answer.searching) countSeconds(at("divergence"));
}

// Say for how long the search has gone on: for a program of many statements it takes minutes.
function countSeconds(place) {
  const begun = performance.now();
  const timer = setInterval(() => {
    if (!place.isConnected || !place.classList.contains("searching")) return clearInterval(timer);
    place.textContent = `${SEARCHING} ${Math.round((performance.now() - begun) / 1000)} s`;
  }, 1000);
}

// Show a text in place of the search; return whether there was one that had not ended.
export function endSearch(text) {
  const place = at("divergence");
  if (!place?.classList.contains("searching")) return false;
  place.classList.remove("searching");
  place.textContent = withFileNames(text);
  at("cancel").remove();
  return true;
}
