"""Conway's game of life: a chain of two kernels that stays on the device for 400 generations.

python examples/life.py [numpy|opencl|glsl]
shpy view examples/life.py
"""

import sys

import numpy as np
from pictures import save

import shpy as sh

rules = sh.Table(
    [
        [0, 0, 0, 1, 0, 0, 0, 0, 0],  # an empty cell, by the number of its neighbours
        [0, 0, 1, 1, 0, 0, 0, 0, 0],  # a living one
    ],
    sh.Attrib1i,
    name="rules",
)


@sh.program
def generation(cells: sh.Table[sh.Attrib1i, 2]) -> sh.Attrib1i:
    """Return the next state of a cell of zeros and ones, on a board that wraps around."""
    here = sh.grid_index(2)
    neighbours = sh.Attrib1i(0)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            if down or right:
                neighbours += cells[(here + (down, right)) % sh.grid_shape(2)]
    return rules[cells[here], neighbours]


@sh.program
def fade(age: sh.Attrib1f, cells: sh.Attrib1i):
    """Age each cell: 1 for a living cell, then 0.97 times as much in each generation."""
    return {"age": sh.cond(cells == 1, 1, 0.97 * age)}


life = sh.sequence(generation, fade)


def game(board, generations, backend=None):
    """Return the streams `cells` and `age` after some generations of a board (H, W) of zeros and ones."""
    chain = sh.repeat(life, generations)
    return chain.run(cells=board, age=np.zeros(board.shape), backend=backend).streams


def r_pentomino(size):
    """Five cells that keep a board busy for a thousand generations."""
    board = np.zeros((size, size), np.int32)
    middle = size // 2
    for row, column in ((-1, 0), (-1, 1), (0, -1), (0, 0), (1, 0)):
        board[middle + row, middle + column] = 1
    return board


def start(height, width):
    """Return the streams that `shpy view` begins with: a square board, which it shows whole."""
    board = r_pentomino(min(height, width))
    return {"cells": board, "age": np.zeros(board.shape)}


@sh.program
def show(age: sh.Attrib1f, cells: sh.Attrib1i) -> sh.Color3f:
    """Return the colour in which `shpy view` shows a cell."""
    trail = sh.Color3f(0.97, 0.95, 0.9) - age * sh.Color3f(0.1, 0.5, 0.75)
    return sh.cond(cells == 1, sh.Color3f(0.1, 0.15, 0.4), trail)


if __name__ == "__main__":
    streams = game(r_pentomino(160), 400, *sys.argv[1:])
    board, age = streams["cells"].numpy(), streams["age"].numpy()
    print(f"{board.sum()} cells live after 400 generations")
    trail = np.subtract((0.97, 0.95, 0.9), age[..., None] * (0.1, 0.5, 0.75))
    colors = np.where(board[..., None] == 1, (0.1, 0.15, 0.4), trail)
    save("life", colors.repeat(4, axis=0).repeat(4, axis=1))
