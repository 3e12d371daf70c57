"""Files with chains for the live page: any number of buffers, in any order of writing and reading."""

HEAD = """
import numpy as np
import shpy as sh


def board(height, width, seed=1):
    return np.random.default_rng(seed).random((height, width)).astype(np.float32)


@sh.program
def near(u: sh.Table[sh.Attrib1f, 2]):
    here = sh.grid_index(2)
    return {"w": 0.5 * u[here] + 0.5 * u[(here + (0, 1)) % sh.grid_shape(2)]}


@sh.program
def back(w: sh.Table[sh.Attrib1f, 2]):
    here = sh.grid_index(2)
    return {"u": 0.25 * w[here] + 0.75 * w[(here + (1, 0)) % sh.grid_shape(2)]}

"""

CHAINS = {
    "two_buffers": """
chain = sh.sequence(near, back)


def start(height, width):
    return {"u": board(height, width), "w": np.zeros((height, width))}
""",
    "written_before_read": """
chain = sh.sequence(near, back)


def start(height, width):
    return {"u": board(height, width)}


@sh.program
def show(w: sh.Attrib1f, u: sh.Attrib1f) -> sh.Color3f:
    return sh.Color3f(w, u, 0.5)
""",
    "three_buffers": """
@sh.program
def third(u: sh.Attrib1f, w: sh.Attrib1f):
    return {"v": 0.5 * (u + w)}


@sh.program
def first(v: sh.Attrib1f, w: sh.Attrib1f):
    return {"u": v, "w": 0.9 * w}


chain = sh.sequence(near, third, first)


def start(height, width):
    return {"u": board(height, width), "v": board(height, width, 2)}


@sh.program
def show(u: sh.Attrib1f, v: sh.Attrib1f, w: sh.Attrib1f) -> sh.Color3f:
    return sh.Color3f(u, v, w)
""",
    "shared_stream": """
@sh.program
def push(u: sh.Attrib1f, wind: sh.Attrib1f):
    return {"u": sh.mod(u + 0.1 * wind, 1)}


@sh.program
def turn(v: sh.Attrib1f, wind: sh.Attrib1f):
    return {"v": sh.mod(v - 0.2 * wind, 1)}


chain = sh.sequence(push, turn)


def start(height, width):
    return {"u": board(height, width), "v": board(height, width, 2), "wind": board(height, width, 3)}


@sh.program
def show(u: sh.Attrib1f, wind: sh.Attrib1f, v: sh.Attrib1f) -> sh.Color3f:
    return sh.Color3f(u, wind, v)
""",
    "reduction": """
@sh.program
def total(u: sh.Table[sh.Attrib1f, 2]):
    found = sh.Attrib1f(0)
    with sh.SH_FOR(0, 8) as k:
        found += u[sh.Attrib2i(k, k)]
    return {"sum": found}


@sh.program
def level(u: sh.Attrib1f, sum: sh.Table[sh.Attrib1f]):
    return {"u": sh.mod(u + 0.01 * sum[0] + 0.01, 1)}


chain = sh.sequence(total, level)


def start(height, width):
    return {"u": board(height, width), "sum": np.zeros(1)}
""",
    "while_": """
@sh.program
def collatz(n: sh.Attrib1i):
    steps, value = sh.Attrib1i(0), sh.Attrib1i(n)
    with sh.SH_WHILE(lambda: value > 1):
        value[:] = sh.cond(value % 2 == 0, value // 2, 3 * value + 1)
        steps += 1
    return {"steps": steps, "n": n % 1000 + 1}


def start(height, width):
    return {"n": np.arange(1, height * width + 1).reshape(height, width)}


@sh.program
def show(steps: sh.Attrib1i) -> sh.Attrib1f:
    return sh.Attrib1f(steps) / 100
""",
    "time_and_mouse": """
@sh.program
def paint(u: sh.Attrib1f, pixel: sh.Attrib2i, time: sh.Attrib1f, mouse: sh.Attrib4f, frame: sh.Attrib1i = 7):
    away = sh.length(sh.Attrib2f(pixel) - mouse.xy)
    return {"u": 0.9 * u + 0.1 * sh.abs(sh.sin(time + away + sh.Attrib1f(frame)))}


def start(height, width):
    return {"u": np.zeros((height, width))}
""",
    "repeated_and_nested": """
chain = sh.repeat(sh.sequence(sh.repeat(sh.sequence(near, back), 2), near), 3)


def start(height, width):
    return {"u": board(height, width)}


@sh.program
def show(u: sh.Attrib1f, w: sh.Attrib1f) -> sh.Color3f:
    return sh.Color3f(u, w, 0)
""",
    "a_loop_that_ends": """
@sh.program
def settle(u: sh.Attrib1f):
    sh.SH_DISCARD(u < 0.01)
    return {"u": 0.5 * u}


@sh.program
def lift(u: sh.Attrib1f, uv: sh.TexCoord2f):
    return {"u": u + uv.x}


chain = sh.sequence(lift, sh.loop(settle))


def start(height, width):
    return {"u": board(height, width)}


@sh.program
def show(u: sh.Attrib1f) -> sh.Attrib1f:
    return 60 * u
""",
    "a_board_of_its_own_size": """
chain = sh.sequence(near, back)


def start(height, width):
    return {"u": board(20, 36)}


@sh.program
def show(u: sh.Table[sh.Attrib1f, 2], uv: sh.TexCoord2f) -> sh.Color3f:
    return sh.Color3f(u[sh.grid_index(2)], uv)
""",
    "a_struct": """
@sh.struct
class Cell:
    heat: sh.Attrib1f
    tint: sh.Color3f


@sh.program
def cool(cell: Cell) -> Cell:
    return Cell(0.99 * cell.heat, sh.Color3f(cell.tint.yzx))


def start(height, width):
    heat = board(height, width)
    return {"cell": {"heat": heat, "tint": np.stack([heat, heat * 0, 1 - heat], -1)}}


@sh.program
def show(cell: Cell) -> sh.Color3f:
    return cell.heat * cell.tint
""",
    "numbers_and_a_param": """
gain = sh.Param(sh.Attrib1f, 0.5, range=(0, 1))


@sh.program
def count(n: sh.Attrib1i):
    return {"n": n + 1}


@sh.program
def shade(n: sh.Attrib1i, u: sh.Attrib1f, by: sh.Attrib1f = 0.01):
    return {"u": sh.fract(u + by * gain * sh.Attrib1f(n))}


chain = sh.sequence(count, shade)


def start(height, width):
    return {"n": 0, "u": board(height, width), "by": 0.125}
""",
    "counted_passes": """
@sh.program
def lift(u: sh.Attrib1f, k: sh.Attrib1i, pass_: sh.Attrib1i):
    return {"u": sh.fract(u + 0.125 * sh.Attrib1f(k + 3 * pass_))}


@sh.program
def turn(u: sh.Attrib1f, k: sh.Attrib1i) -> sh.Attrib1f:
    return sh.fract(u * sh.Attrib1f(k + 2))


chain = sh.repeat(sh.sequence(sh.repeat(sh.sequence(lift, turn), 3, index="k"), near, turn), 2, index="pass_")


def start(height, width):
    return {"u": board(height, width), "k": 5}
""",
    "its_last_stream_comes_first": """
@sh.program
def half(w: sh.Attrib1f):
    return {"u": 0.5 * w}


chain = sh.sequence(back, near, half)


def start(height, width):
    return {"w": board(height, width)}
""",
}
"""The text of each file, after HEAD, by a name."""
