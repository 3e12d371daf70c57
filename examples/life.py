"""Conway's game of life: a table of cells, another of rules, and a kernel that looks things up in both.

python examples/life.py [numpy|opencl|glsl]
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


def game(board, backend=None):
    """A function that gives the next generation of a board (H, W) of zeros and ones, which wraps around."""
    height, width = board.shape
    cells = sh.Table(board, sh.Attrib1i, name="cells")

    @sh.program
    def generation() -> sh.Attrib1i:
        here = sh.grid_index(2)
        neighbours = sh.Attrib1i(0)
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                if down or right:
                    neighbours += cells[(here + (down, right)) % (height, width)]
        return rules[cells[here], neighbours]

    kernel = generation.compile(backend)

    def advance():
        board = kernel(shape=(height, width))
        cells.update(board)
        return board

    return advance


def r_pentomino(size):
    """Five cells that keep a board busy for a thousand generations."""
    board = np.zeros((size, size), np.int32)
    middle = size // 2
    for row, column in ((-1, 0), (-1, 1), (0, -1), (0, 0), (1, 0)):
        board[middle + row, middle + column] = 1
    return board


if __name__ == "__main__":
    advance = game(r_pentomino(160), *sys.argv[1:])
    age = np.zeros((160, 160))
    for _ in range(400):
        board = advance()
        age = np.where(board == 1, 1, 0.97 * age)
    print(f"{board.sum()} cells live after 400 generations")
    colors = np.stack([np.where(board == 1, 1, 0.7 * age**3), np.where(board == 1, 1, 0.4 * age), 0.05 + 0.6 * age], -1)
    save("life", colors.repeat(4, axis=0).repeat(4, axis=1))
