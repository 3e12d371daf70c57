"""Saves what the examples draw: as PNG if Pillow is installed, else as a numpy array."""

from pathlib import Path

import numpy as np

import shpy as sh


def save(name, pixels):
    """Write pixels (H, W) or (H, W, 3) in [0, 1] into the current folder and say where."""
    shades = np.rint(255 * np.clip(pixels, 0, 1)).astype(np.uint8)
    try:
        from PIL import Image
    except ImportError:
        path = Path(f"{name}.npy")
        np.save(path, shades)
    else:
        path = Path(f"{name}.png")
        Image.fromarray(shades).save(path, optimize=True)
    print(f"wrote {path}: {shades.shape[1]} x {shades.shape[0]}")


def save_program(program, size, backend=None):
    """Draw a program of pixels over (width, height) at the time 0, its inputs filled by their names."""
    save(program.name, sh.screen.drawn(program, sh.screen.Moment(size), backend=backend))
