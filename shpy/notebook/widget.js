// The widget of a program or chain: a picture, its controls, and the time.

export default { render };

function render({ model, el }) {
  const [width, height] = model.get("extent");
  const moves = model.get("moves");
  const canvas = make("canvas", { width, height, role: "img", "aria-label": `picture of ${model.get("title")}` });
  const play = make("button", { type: "button", hidden: !moves, onclick: () => { playing = !playing; begun = null; label(); ask(); } });
  const back = make("button", { type: "button", hidden: !moves, onclick: () => { seconds = 0; frame = 0; changed(); } }, "Reset");
  const steps = make("input", { type: "number", min: 1, max: 1000, value: model.get("steps") });
  const pace = make("label", { hidden: !model.get("evolves") }, "Steps a frame ", steps);
  const told = make("output", {});
  const problem = make("p", { class: "problem", role: "alert", hidden: true });
  const place = make("div", { class: "controls" });
  el.classList.add("shpy-widget");
  el.append(make("div", { class: "stage" }, canvas, make("div", { class: "row" }, play, back, pace, told), problem), place);

  let playing = moves && !matchMedia("(prefers-reduced-motion: reduce)").matches;
  let seconds = 0, frame = 0, begun = null, waiting = false, dirty = true, visible = true;
  let mouse = [0, 0, 0, 0], wanted = {};

  const controls = new Controls(place, (name, value) => { wanted[name] = value; changed(); });
  controls.draw(model.get("controls"));

  function label() { play.textContent = playing ? "Pause" : "Play"; }
  function changed() { dirty = true; ask(); }

  // One question at a time: where frames take long, fewer are asked for.
  function ask() {
    if (waiting || !visible || !(dirty || playing)) return;
    const now = performance.now() / 1000;
    if (playing && begun !== null) { seconds += Math.min(now - begun, 0.25); frame += 1; }
    begun = playing ? now : null;
    waiting = true;
    dirty = false;
    const pace = Math.min(Math.max(Math.round(steps.valueAsNumber) || 1, 1), 1000);
    model.send({ time: seconds, frame, mouse, steps: pace, params: wanted });
    wanted = {};
  }

  function answered(answer, buffers) {
    waiting = false;
    problem.hidden = !answer.error;
    problem.textContent = answer.error ?? "";
    if (buffers?.length) {
      const { buffer, byteOffset = 0, byteLength } = buffers[0];
      const bytes = buffer ? new Uint8ClampedArray(buffer, byteOffset, byteLength) : new Uint8ClampedArray(buffers[0]);
      canvas.getContext("2d").putImageData(new ImageData(new Uint8ClampedArray(bytes), width, height), 0, 0);
      canvas.dataset.frame = frame;
      told.textContent = `${moves ? `${seconds.toFixed(2)} s, ` : ""}${answer.milliseconds.toFixed(0)} ms a frame`;
      if (!Object.keys(wanted).length) for (const [name, value] of Object.entries(answer.params)) controls.show(name, value);
    } else if (playing) {
      playing = false;
      label();
    }
    requestAnimationFrame(ask);
  }

  function point(event) {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) * width / box.width, (event.clientY - box.top) * height / box.height];
  }
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    mouse = [...point(event), ...point(event)];
    changed();
  });
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) { mouse = [...point(event), mouse[2], mouse[3]]; changed(); }
  });
  canvas.addEventListener("pointerup", () => { mouse = [mouse[0], mouse[1], -Math.abs(mouse[2]), -Math.abs(mouse[3])]; changed(); });

  const watch = new IntersectionObserver((seen) => { visible = seen.at(-1).isIntersecting; begun = null; ask(); });
  watch.observe(canvas);
  model.on("msg:custom", answered);
  label();
  ask();
  return () => { watch.disconnect(); model.off("msg:custom", answered); };
}
