"""`shpy view` in the installed Chromium: saves, frames a second, memory.

    python -m benchmarks view                                       # every example: some minutes
    python -m benchmarks view --only mandelbrot,planet --rounds 9
    python -m benchmarks view --only marble --frames 10000          # memory over so many frames

A save changes a constant of the file and one beside it, so that no driver's cache knows the kernel, and the caches are
new folders. Time runs from the moment before the file is written to the moment when the page has drawn the first
picture of the new version, and the full one of the kernel that was asked for. Frames are counted in the page at
512 x 512 on OpenCL: the example's colours times a level that a slider sets and the time changes, so that each frame is
another one. The lag is that of the last picture behind the last change of the slider while the time stands.

The exit status is 1 where a limit is missed: 300 ms for the first picture, 1.5 s for the full one, 30 frames a second
for mandelbrot, planet and marble.
"""

from __future__ import annotations

import os
import random
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.pages import Browsed, View, browsed, end_by_signal, viewed
from benchmarks.studies import Table, backend, spread

FOLDER: Final = Path(__file__).parents[1] / "examples"
ALLOWED_FIRST, ALLOWED_FULL, LEAST_FRAMES = 300.0, 1500.0, 30.0
_SECONDS: Final = 4.0
"""Seconds in which frames are counted, and a slider is dragged."""
_PLAY: Final = "document.getElementById('play').click()"
"""Pauses a picture that moves, and goes on with one that is paused."""
_PAUSE: Final = 1.5
"""Seconds between saves, in which the next worker becomes warm."""
_WATCH: Final = """
window.seen = [];
new MutationObserver((changes) => {
    for (const { attributeName: name } of changes)
        window.seen.push([name, performance.timeOrigin + performance.now(), document.body.getAttribute(name)]);
}).observe(document.body, { attributes: true, attributeFilter: ATTRIBUTES });
"""
_DRAG: Final = """new Promise((done) => {
    const slider = document.querySelector("[aria-label='Level']"), begun = performance.now();
    const move = () => {
        const passed = performance.now() - begun;
        slider.value = 0.5 + 0.5 * Math.sin(passed / 300);
        slider.dispatchEvent(new Event("input", { bubbles: true }));
        if (passed < 1000 * SECONDS) requestAnimationFrame(move);
        else done(performance.timeOrigin + performance.now());
    };
    move();
})"""


@dataclass(frozen=True)
class Example:
    """A file in the folder of examples, its program, the program's inputs, and a constant that each save changes."""

    file: str
    program: str
    constant: str
    inputs: str = ""
    fast: bool = False

    def saved(self, digits: int) -> str:
        """Return the file's text with other digits behind the constant."""
        text = (FOLDER / f"{self.file}.py").read_text()
        if text.count(self.constant) != 1:
            raise ValueError(f"{self.constant} stands {text.count(self.constant)} times in {self.file}.py")
        return text.replace(self.constant, f"{self.constant}{digits}")

    def moving(self) -> str:
        """Return the file's text, followed by a program whose picture differs from frame to frame."""
        inputs = [word.split(":")[0] for word in self.inputs.split(", ") if word]
        parameters = ", ".join(word for word in (self.inputs, "" if "time" in inputs else "time: sh.Attrib1f") if word)
        return (FOLDER / f"{self.file}.py").read_text() + (
            '\n\nlevel = sh.Param(sh.Attrib1f, 1, range=(0, 1), title="Level")\n\n\n'
            f"@sh.program\ndef moving({parameters}) -> sh.Color3f:\n"
            f"    return {self.program}({', '.join(inputs)}) * level * (0.75 + 0.25 * sh.sin(time))\n"
        )


_TOY: Final = "uv: sh.TexCoord2f, resolution: sh.Attrib2f, time: sh.Attrib1f"
EXAMPLES: Final = {
    "mandelbrot": Example("mandelbrot", "picture", "6.2832", "pixel: sh.Attrib2i, resolution: sh.Attrib2f", fast=True),
    "planet": Example("planet", "planet", "1.35", fast=True),
    "marble": Example("patterns", "marbled", "0.07", fast=True),
    "raymarch": Example("raymarch", "raymarch", "turn = 0.25", _TOY),
    "voronoi": Example("voronoi", "voronoi", "0.38", _TOY),
    "warp": Example("warp", "warp", "17.3", _TOY),
}


@contextmanager
def shown(example: Example, text: str, program: str) -> Iterator[tuple[View, Browsed]]:
    """Serve the text of an example, with empty caches, and yield its view and its page once OpenCL draws it."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name, "examples")
        shutil.copytree(FOLDER, folder)
        path = folder / f"{example.file}.py"
        path.write_text(text)
        caches = {"SHPY_CACHE_DIR": name, "POCL_CACHE_DIR": name, "MESA_SHADER_CACHE_DIR": name}
        options = ("--backend", backend(), "--size", "512x512")
        with (
            viewed(f"{path}:{program}", *options, environment={**os.environ, **caches}) as view,
            browsed(view.url) as page,
        ):
            view.path = path
            page.wait(f"document.body?.dataset.form === '{backend()}'")
            with _paused(page):
                _settle(view)
            yield view, page


@contextmanager
def _paused(page: Browsed) -> Iterator[None]:
    """Hold the picture still: frames that keep every core busy would leave none for the trials of widths."""
    page.evaluate(_PLAY)
    yield
    page.evaluate(_PLAY)


def _settle(view: View) -> None:
    """Wait until the widths of the kernel have been tried: meanwhile a process of the worker's compiles at times."""
    last = time.monotonic()
    while time.monotonic() - last < _PAUSE:
        if any(map(_children, _children(view.process.pid))):
            last = time.monotonic()
        time.sleep(0.1)


def _children(process: int) -> list[int]:
    tasks = Path(f"/proc/{process}/task").glob("*/children")
    return [int(pid) for task in tasks for pid in task.read_text().split()]


def saves(example: Example, count: int) -> NDArray[np.float64]:
    """Return milliseconds from a save to the first picture and to the full one, (count, 2)."""
    delays = []
    with shown(example, example.saved(1), example.program) as (view, page):
        page.evaluate(_WATCH.replace("ATTRIBUTES", '["data-first", "data-full"]'))
        for _ in range(count):
            time.sleep(_PAUSE)
            text = example.saved(random.randrange(10**6, 10**7))
            page.evaluate("window.seen = []")
            begun = 1000 * time.time()
            view.save(text)
            page.wait("window.seen.some(([name, , value]) => name === 'data-full' && value)")
            times = {name: at for name, at, value in page.evaluate("window.seen") if value}
            delays.append([times["data-first"] - begun, times["data-full"] - begun])
    return np.array(delays)


def frames(example: Example, seconds: float) -> tuple[float, float, float]:
    """Return frames a second while the picture moves and while a slider is dragged too, and the lag in ms."""
    with shown(example, example.moving(), "moving") as (_, page):
        running = _rate(page, lambda: time.sleep(seconds))
        dragged = _rate(page, lambda: page.evaluate(_DRAG.replace("SECONDS", str(seconds))))
        page.evaluate(_PLAY)
        page.evaluate(_WATCH.replace("ATTRIBUTES", '["data-frames"]'))
        ended = page.evaluate(_DRAG.replace("SECONDS", str(seconds)))
        time.sleep(_PAUSE)
        last = page.evaluate("window.seen.at(-1)[1]")
        return running, dragged, last - ended


def _rate(page: Any, work: Callable[[], Any]) -> float:
    """Return the frames that the page draws in a second meanwhile."""
    count = "[Number(document.body.dataset.frames), performance.now()]"
    before, begun = page.evaluate(count)
    work()
    after, ended = page.evaluate(count)
    return float(1000 * (after - before) / (ended - begun))


def memory(example: Example, count: int) -> Iterator[tuple[int, list[float]]]:
    """Yield MB of the server, its two workers and the page's objects, after a tenth, a half and all of the frames."""
    with shown(example, example.moving(), "moving") as (view, page):
        page.send("Performance.enable")
        for number in (count // 10, count // 2, count):
            while page.evaluate("Number(document.body.dataset.frames)") < number:
                time.sleep(0.2)
            page.send("HeapProfiler.collectGarbage")
            metrics = {one["name"]: one["value"] for one in page.send("Performance.getMetrics")["metrics"]}
            server = view.process.pid
            workers = sum(map(_resident, _children(server)))
            yield number, [_resident(server), workers, metrics["JSHeapUsedSize"] / 1e6]


def _resident(process: int) -> float:
    """Return the MB of memory that a process holds."""
    (line,) = (x for x in Path(f"/proc/{process}/status").read_text().splitlines() if x.startswith("VmRSS"))
    return int(line.split()[1]) * 1024 / 1e6


def live(names: Sequence[str], count: int, seconds: float) -> tuple[Table, list[str]]:
    """Measure saves and frames of examples; return the table, and the limits that are missed."""
    rows, missed = [], []
    for name in names:
        example = EXAMPLES[name]
        times = saves(example, count)
        running, dragged, lag = frames(example, seconds)
        rows.append([name, *(spread(t, 0) for t in times.T), f"{running:.1f}", f"{dragged:.1f}", f"{lag:.0f}"])
        first, full = np.median(times, axis=0)
        missed += [f"{name}: the first picture after {first:.0f} ms"] * bool(first >= ALLOWED_FIRST)
        missed += [f"{name}: the full picture after {full:.0f} ms"] * bool(full >= ALLOWED_FULL)
        slow = example.fast and min(running, dragged) < LEAST_FRAMES
        missed += [f"{name}: {min(running, dragged):.1f} frames a second"] * slow
    note = (
        f"Milliseconds from a save to the first picture and to the full one on {backend()}, the median of {count} "
        "saves with the quartiles; frames a second at 512 x 512 while the picture moves, and while a slider is dragged "
        "too; milliseconds by which the last picture comes after the last change of the slider."
    )
    return Table("view", note, ["example", "first", "full", "moving", "dragged", "lag"], rows), missed


def growth(names: Sequence[str], count: int) -> Table:
    """Measure the memory that frames take."""
    rows = [
        [name, f"{number:,}", *(f"{size:.1f}" for size in sizes)]
        for name in names
        for number, sizes in memory(EXAMPLES[name], count)
    ]
    note = (
        f"MB that the server and both of its workers hold (one draws, one is warm), and the objects of the page, while "
        f"{count:,} frames of 512 x 512 are drawn."
    )
    return Table("view-memory", note, ["example", "frames", "server", "workers", "page"], rows)


def main(names: Sequence[str], *, count: int, drawn: int | None, quick: bool) -> int:
    """Print what is measured, memory over `drawn` frames or else times; return 1 where a limit is missed."""
    end_by_signal()
    if drawn is not None:
        print(growth(names, drawn).markdown())
        return 0
    table, missed = live(names, count, 0.5 if quick else _SECONDS)
    print(table.markdown())
    for text in missed:
        print(f"missed: {text}")
    return 1 if missed else 0
