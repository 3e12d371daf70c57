"""The command `raytracer`: render a scene to a file, trade time for error, list scenes, say what is installed.

raytracer render bunny.obj -o bunny.png
raytracer render mixed --size 1024x768 --backend opencl --bounces 3 --samples 4
raytracer render chair.glb --camera 2,1,3 --target 0,0.5,0 --no-floor
raytracer render cornell --integrator path --samples 1024 -o cornell.exr --resume
raytracer tradeoff mixed --error 0.5 -o tradeoff.png
"""

from __future__ import annotations

import argparse
import re
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

import shpy as sh
from raytracer import viewing
from raytracer.animation import ANIMATIONS, Make, animate, made_by, mistakes_in, spread
from raytracer.backends import open_device
from raytracer.denoising import check_denoising, denoised
from raytracer.errors import ClusterError, SceneError
from raytracer.gallery import SIZE, gallery
from raytracer.image import READING, SAVING, Image, writer
from raytracer.integrators import integrator
from raytracer.integrators.renderer import Renderer
from raytracer.listing import doctor, scenes
from raytracer.memory import PIXEL, check_fits
from raytracer.progress import announced, progress_bar
from raytracer.rendering import render
from raytracer.scene.animated_file import AnimatedFile
from raytracer.scene.loading import FORMATS
from raytracer.scene.scene import Scene
from raytracer.scenes import SCENES
from raytracer.studies.tradeoff import tradeoff
from raytracer.view import command as view
from raytracer.view.opening import scene_at

_SAVING = 10.0
"""Seconds after which a picture that takes long is written, though it is not finished."""
_SHARE = 20
"""It is not written before computing has taken this many times as long as writing did."""
_KEYWORD = re.compile(r"\b(integrator|tracer|accel|grid|math)=[\"']?([\w:]+)[\"']?")
"""The options of the command as messages spell them, which are keywords of Python."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return the exit status: 0 done, 1 an error that is printed, 130 after Ctrl-C."""
    return int(sh.command.run("raytracer", lambda: _run(arguments), stopped="stopped; nothing was written"))


def _run(arguments: Sequence[str] | None) -> int:
    options = _parser().parse_args(viewing.joined(sys.argv[1:] if arguments is None else arguments))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", sh.ShpyWarning)
            warnings.showwarning = _show
            with ThreadPoolExecutor(1, "raytracer-device") as meanwhile:
                meanwhile.submit(_open_backend, options)
                with mistakes_in(Path(getattr(options, "scene", None) or "")):
                    return int(options.run(options))
    except BrokenPipeError:
        raise
    except (SceneError, ClusterError, sh.ShpyError, OSError) as error:
        print("raytracer:", _KEYWORD.sub(r"--\1 \2", str(error)), file=sys.stderr)
        return 1


def _open_backend(options: argparse.Namespace) -> None:
    """Open the device; say why numpy computes, where the user has chosen no backend and OpenCL cannot.

    A thread does so while the scene is read. The command itself meets the errors. A cluster's workers open their own.
    """
    if options.run not in (_render, _animate, _gallery, _tradeoff):
        return
    if options.backend is None:
        chosen = sh.default_backend(long=True)
        if chosen == "numpy" and not chosen.pinned:
            print(f"raytracer: numpy computes: {chosen.why}", file=sys.stderr)
    elif getattr(options, "cluster", None) is None:
        open_device(options.backend)


def _show(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning in one line: the place that it names is ours, and no matter of who gives a command."""
    print(f"raytracer: warning: {message}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="raytracer", description="A ray tracer written once in shpy.")
    version = sh.packages.installed(sh.packages.DISTRIBUTION) or "not installed"
    parser.add_argument("--version", action="version", version=f"raytracer of shpy {version}")
    sh.command.add_completion(parser)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    command = commands.add_parser(
        "render",
        help="render a built-in scene or a mesh file",
        epilog=viewing.EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_render_arguments(command)
    command = commands.add_parser("tradeoff", help="time and error of every variant of a scene, and the one to take")
    command.add_argument("scene", help="a built-in scene, or an OBJ, GLB, glTF, PLY, STL or OFF file")
    command.add_argument("--error", type=_error, default=1.0, help="root mean square error allowed, in 255ths (1)")
    command.add_argument("-o", "--output", type=Path, help="draw time against error there; JSON goes beside it")
    _add_backend(command, math=False)
    command.add_argument(
        "--bounces", type=sh.command.whole(0), default=3, help="how often the reference's rays may be mirrored (3)"
    )
    command.set_defaults(run=_tradeoff)
    _add_study_arguments(
        commands.add_parser("study", help="repeat the measurements of a paper, as tables of Markdown and plots")
    )
    command = commands.add_parser("gallery", help="render every built-in scene into a folder")
    command.add_argument("folder", help="where the PNG files go")
    command.add_argument("--size", type=_size, default=SIZE, help="WIDTHxHEIGHT in pixels (640x480)")
    command.add_argument("--samples", type=_positive, help="rays for each pixel: 1, 4, 9, 16, ... (9)")
    _add_backend(command)
    command.set_defaults(run=_gallery)
    command = commands.add_parser("animate", help="render the frames of a moving scene to a GIF, WebP or MP4 file")
    _add_animate_arguments(command)
    command = commands.add_parser("view", help="a live page in the browser: turn, pick, change lights")
    view.add_arguments(command, _positive, _whole)
    command = commands.add_parser("scenes", help="list the built-in scenes, or the meshes of a scene or file")
    command.add_argument("scene", nargs="?", help="a built-in scene or a file")
    command.set_defaults(run=scenes)
    command = commands.add_parser("doctor", help="what is installed, what is missing, and the cure")
    command.set_defaults(run=doctor)
    return parser


def _add_study_arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "paper",
        choices=["christen", "layered"],
        help="christen: Ray Tracing on GPU, 2005, the staged tracer; layered: layered depth cubes, 2007",
    )
    command.add_argument("-o", "--output", type=Path, help="draw the plots there; JSON and CSV go beside it")
    command.add_argument(
        "--backend", action="append", help="a backend to measure, several times for several (all; layered: opencl)"
    )
    command.add_argument("--minutes", type=_error, default=9.0, help="after how long no measurement begins (9)")
    command.add_argument("--cpu", action="store_true", help="count CPU time, where the machine does other things too")
    command.add_argument("--mesh", action="append", default=[], help="layered: a mesh file to measure too")
    command.add_argument("--size", type=_size, help="layered: WIDTHxHEIGHT of the pictures in pixels (1280x1024)")
    command.add_argument("--quick", action="store_true", help="layered: small models and pictures; does it work?")
    command.set_defaults(run=_study)


def _add_animate_arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "scene",
        help="a Python file that defines scene(time) -> Scene, a GLB or glTF file with animations, or `animated`",
    )
    command.add_argument("--clip", metavar="NAME", help="which animation of a GLB or glTF file (the first one)")
    command.add_argument("-o", "--output", type=Path, help="a .gif, .webp or .mp4 file, or a folder (SCENE.gif)")
    command.add_argument("--frames", type=_positive, help="how many (48; of a GLB or glTF file, its whole animation)")
    command.add_argument(
        "--fps",
        type=_error,
        help="frames of a second; frame k is at k / fps (24, or as --frames spread over the file's)",
    )
    command.add_argument("--size", type=_size, default=(320, 240), help="WIDTHxHEIGHT in pixels (320x240)")
    _add_backend(command)
    command.add_argument("--integrator", choices=integrator.INTEGRATORS, default="whitted", help="as of render")
    command.add_argument("--bounces", type=_whole, help="as of render")
    command.add_argument("--samples", type=_positive, help="as of render")
    viewing.add_tracing(command)
    _add_cluster(command)
    command.add_argument("--resume", action="store_true", help="keep the frames of this size that the folder has")
    viewing.add_arguments(command)
    command.set_defaults(run=_animate)


def _add_sampling(command: argparse.ArgumentParser) -> None:
    """Add the options of path tracing's samples."""
    command.add_argument("--seed", type=_whole, default=0, help="path: another seed, other noise (0)")
    command.add_argument(
        "--clamp",
        type=_error,
        metavar="LIGHT",
        help="path: bound indirect light in each sample; fewer bright dots, but too dark",
    )
    command.add_argument(
        "--resume", action="store_true", help="path: add samples to the .exr or .npy file of the output, if it is there"
    )
    command.add_argument(
        "--denoise", action="store_true", help="path: estimate the picture without its noise, by Open Image Denoise"
    )


def _add_render_arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument("scene", help="a built-in scene, or an OBJ, GLB, glTF, PLY, STL or OFF file")
    command.add_argument(
        "--time",
        type=float,
        metavar="SECONDS",
        help="the moment of a moving scene: a GLB, glTF or Python file, `animated`",
    )
    command.add_argument("--clip", metavar="NAME", help="with --time: which animation of the file (the first one)")
    command.add_argument("-o", "--output", type=Path, help="a .png, .jpg, .webp, .exr or .npy file (SCENE.png)")
    command.add_argument("--size", type=_size, default=(512, 512), help="WIDTHxHEIGHT in pixels (512x512)")
    _add_backend(command)
    command.add_argument(
        "--integrator",
        choices=integrator.INTEGRATORS,
        default="whitted",
        help="direct light and mirrors, or all light (whitted)",
    )
    command.add_argument(
        "--bounces", type=_whole, help="how often a ray may be mirrored (3), or light be scattered (path: 8)"
    )
    command.add_argument(
        "--samples", type=_positive, help="rays for each pixel: 1, 4, 9, 16, ... (1), or any number (path: 64)"
    )
    _add_sampling(command)
    viewing.add_tracing(command)
    command.add_argument(
        "--threshold",
        type=_share,
        default=integrator.THRESHOLD,
        help="staged: share of rays that wait to be intersected (0.2)",
    )
    command.add_argument(
        "--grid", type=_positive, help="cells of a grid along each axis (as many as suit the triangles)"
    )
    command.add_argument("--error", type=_error, help="render the fastest variant within this error, in 255ths")
    _add_cluster(command)
    command.add_argument(
        "--partitions", type=_positive, help="cluster: cut the scene into so many parts, each held by one worker"
    )
    command.add_argument(
        "--transparent", action="store_true", help="alpha in place of the background: .png, .webp, .exr"
    )
    viewing.add_arguments(command)
    command.set_defaults(run=_render)


def _add_backend(command: argparse.ArgumentParser, *, math: bool = True) -> None:
    command.add_argument("--backend", help="numpy, opencl or glsl (opencl where its device has numpy's bits)")
    if math:
        command.add_argument(
            "--math", help="strict, portable, relaxed or fast; devices without binary64 need portable (strict)"
        )
        command.add_argument(
            "--fuse", action="store_const", const=True, help="round a * b + c once, with the same bits everywhere"
        )


def _add_cluster(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--cluster",
        metavar="WHERE",
        help="render by a Dask cluster: tcp://host:8786, or local:4 for four processes of this machine",
    )


_whole, _positive, _error, _share = sh.command.whole(0), sh.command.whole(1), sh.command.real(0), sh.command.real(0)


def _size(text: str) -> tuple[int, int]:
    width, times, height = text.lower().partition("x")
    if not (times and text.isascii() and width.isdigit() and height.isdigit() and len(text) < 30):
        raise argparse.ArgumentTypeError(f"a size is WIDTHxHEIGHT, such as 1024x768, not {text!r}")
    return int(width), int(height)


def _still(options: argparse.Namespace) -> Scene:
    """Return the scene of the options without a time; SceneError for one that has none of its own."""
    path = Path(options.scene)
    if options.scene in ANIMATIONS or (path.suffix.lower() == ".py" and path.is_file()):
        raise SceneError(f"{options.scene} is a function of the time: --time 0, say, chooses a moment of it")
    return viewing.scene_of(options)


def _render(options: argparse.Namespace) -> int:
    first_rows = announced(options.scene)
    try:
        return _render_picture(options, first_rows)
    finally:
        first_rows()


def _render_picture(options: argparse.Namespace, first_rows: Callable[[], None]) -> int:
    output = options.output or Path(f"{Path(options.scene).stem}.png")
    writer(output, options.size, options.transparent)  # complains now about a path that cannot be written later
    width, height = options.size
    check_fits(width, height, SAVING[output.suffix.lower()], PIXEL if options.cluster is None else 0)
    arguments = {k: v for k, v in vars(options).items() if k in integrator.Options.__annotations__}
    chosen_integrator = integrator.chosen(options.integrator, arguments)
    viewing.check(options, output, framed=options.scene not in SCENES)
    if options.denoise:
        check_denoising(chosen_integrator)
        if options.resume:
            raise SceneError("--resume adds samples to the output, and --denoise changes its pixels: leave one out")
    scene = _still(options) if options.time is None else scene_at(options, options.time)
    title, resume_path = f"{scene.name}, {scene.triangles:,} triangles", None
    if isinstance(chosen_integrator, integrator.Path):
        title, resume_path = f"{title}, {chosen_integrator.samples:,} samples", _begun(options, output)
        if options.cluster is None:
            renderer = Renderer(scene, integrator=chosen_integrator, backend=options.backend)
            return _render_passes(options, renderer, output, resume_path, title, first_rows)
    elif options.resume:
        raise SceneError("--resume is for --integrator path: other pictures have no samples to add to")
    elif options.error is not None and (options.math is not None or options.fuse):
        raise SceneError("--error chooses the arithmetic itself: leave out --math and --fuse")
    with progress_bar(title, first_rows) as progress:
        image = render(
            scene,
            options.size,
            integrator=chosen_integrator,
            backend=options.backend,
            resume=resume_path,
            max_error=options.error,
            progress=progress,
            cluster=options.cluster,
            partitions=options.partitions,
            transparent=options.transparent,
            denoise=options.denoise,
        )
    if image.stats.picked:
        print(f"within {options.error:g}/255: {image.stats.picked}")
    print(f"{_saved(image, options, output)}: {_summary(image)}")
    return 0


def _saved(image: Image, options: argparse.Namespace, output: Path) -> Path:
    """Write a picture with the exposure and the curve of the options; return its path."""
    return image.save(output, options.exposure or 0.0, options.tonemap)


def _begun(options: argparse.Namespace, output: Path) -> Path | None:
    """Return the path traced picture to which samples are added, if there is one."""
    if options.error is not None:
        raise SceneError("--error is for --integrator whitted")
    if options.resume and output.suffix.lower() not in READING:
        raise SceneError(f"{output}: samples are added to files that hold all numbers: {' or '.join(READING)}")
    return output if options.resume and output.exists() else None


def _render_passes(
    options: argparse.Namespace,
    renderer: Renderer,
    output: Path,
    resume_path: Path | None,
    title: str,
    first_rows: Callable[[], None],
) -> int:
    """Render in passes, and write what there is every few minutes, after Ctrl-C, and at the end."""
    samples = renderer.integrator.samples
    stop: KeyboardInterrupt | None = None
    image, kept, due = None, 0, time.monotonic() + _SAVING
    with progress_bar(title, first_rows) as progress:
        try:
            for image in renderer.passes(
                options.size, progress=progress, resume=resume_path, transparent=options.transparent
            ):
                started = time.monotonic()
                if started >= due and image.samples < samples:
                    _saved(image, options, output)
                    kept, ended = image.samples, time.monotonic()
                    due = ended + max(_SAVING, _SHARE * (ended - started))
        except KeyboardInterrupt as error:
            if image is None:
                raise
            stop = error
    assert image is not None  # there is at least one pass
    if options.denoise and stop is None:
        image = denoised(image, renderer.scene, renderer.backend)
    try:
        print(f"{_saved(image, options, output)}: {_summary(image)}")
    except KeyboardInterrupt as error:
        raise type(error)(f"stopped; {output} holds {kept:,} samples" if kept else "") from None
    if stop is None:
        return 0
    cure = "" if output.suffix.lower() in READING else f"; --resume goes on from {' or '.join(READING)} alone"
    print(
        f"raytracer: stopped after {image.samples:,} of {samples:,} samples, which were written{cure}", file=sys.stderr
    )
    return int(sh.command.status_of(stop))


def _tradeoff(options: argparse.Namespace) -> int:
    scene = viewing.find_scene(options.scene)
    if options.output is not None:
        sh.outputs.check_output(options.output)
    with progress_bar(f"{scene.name}: variants") as progress:
        comparison = tradeoff(
            scene, max_error=options.error, backend=options.backend, bounces=options.bounces, progress=progress
        )
    print(comparison.table())
    if options.output is not None:
        comparison.plot(options.output)
    print(f"within {options.error:g}/255: {comparison.pick.variant}")
    return 0


def _study(options: argparse.Namespace) -> int:
    if options.output is not None:
        sh.outputs.check_output(options.output)
    arguments: dict[str, Any] = {"minutes": options.minutes, "cpu": options.cpu}
    layered = {"files": options.mesh, "size": options.size, "quick": options.quick}
    if options.paper == "layered":
        arguments |= layered
    elif any(layered.values()):
        raise SceneError("--mesh, --size and --quick are for `raytracer study layered`")
    study = import_module(f"raytracer.studies.{options.paper}").study  # imported here since few commands need it
    with progress_bar(f"{options.paper}: measurements") as progress:
        measured = study(options.backend, progress=progress, **arguments)
    print(measured.markdown())
    if options.output is not None:
        measured.plot(options.output)
    return 0


def _gallery(options: argparse.Namespace) -> int:
    arguments: dict[str, Any] = {
        "backend": options.backend,
        "samples": options.samples,
        "math": options.math or "strict",
        "fuse": bool(options.fuse),
    }
    written = 0
    try:
        for path, image in gallery(options.folder, options.size, **arguments):
            print(f"{path}: {_summary(image)}", flush=True)
            written += 1
    except KeyboardInterrupt as error:
        raise type(error)(f"stopped; pictures written to {options.folder}: {written}" if written else "") from None
    return 0


def _animate(options: argparse.Namespace) -> int:
    output = options.output or Path(f"{Path(options.scene).stem}.gif")
    arguments = {
        name: value
        for name in ("bounces", "samples", "math", "fuse", "accel", "tracer")
        if (value := getattr(options, name)) is not None
    }
    named = ("size", "integrator", "backend", "resume", "cluster", "exposure", "tonemap")
    asked = {name: getattr(options, name) for name in named}
    framed = Path(options.scene).suffix.lower() in FORMATS
    viewing.check(options, output, framed=framed)
    make, frames, fps = _moving(options)
    steps = animate(make, output, frames, fps=fps, **asked, **arguments)
    with progress_bar(f"{options.scene}, {frames:,} frames") as progress:
        done = 0
        try:
            for done in steps:
                progress(done, frames)
        except KeyboardInterrupt as error:
            kept = f"stopped; {output} holds the first {done:,} of {frames:,} frames: --resume draws the others"
            raise type(error)(kept if done and output.is_dir() else "") from None
    width, height = options.size
    print(f"{output}: {frames:,} frames, {width} x {height}, {fps:g} a second")
    return 0


def _moving(options: argparse.Namespace) -> tuple[Make, int, float]:
    """Return the scenes that are animated, the number of frames, and how many of them a second has."""
    path = Path(options.scene)
    if path.suffix.lower() in FORMATS:
        file = AnimatedFile(path, options.clip, **viewing.choices(options))
        frames, fps = spread(file.seconds, options.frames, options.fps)
        return viewing.scenes_of_file(options, file, frames, fps), frames, fps
    if options.scene in SCENES and not path.exists():
        raise SceneError(
            f"the scene {options.scene} stands still: `raytracer render {options.scene}` draws it; `raytracer animate` "
            "takes `animated`, a GLB or glTF file with animations, or a Python file that defines scene(time)"
        )
    if options.clip is not None:
        raise SceneError("--clip is for GLB and glTF files, whose animations have names: leave it out")
    fps = sh.videos.FPS if options.fps is None else options.fps
    make = ANIMATIONS.get(options.scene) or made_by(path)
    return viewing.scenes_of(options, make), options.frames or 48, fps


def _summary(image: Image) -> str:
    height, width = image.depth.shape
    stats = image.stats
    no_numbers = int(np.isnan(image.pixels).any(axis=-1).sum())
    return (
        f"{width} x {height}, {stats.triangles:,} triangles, {stats.rays:,} rays on {stats.backend} "
        f"in {stats.seconds:.2f} s, after {stats.build_seconds + stats.record_seconds + stats.compile_seconds:.2f} s "
        f"of preparation{f'; {no_numbers:,} pixels are NaN' if no_numbers else ''}"
    )
