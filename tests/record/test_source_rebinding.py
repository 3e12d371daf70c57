"""Names that blocks rebind, or make, and that are used where the block's run cannot reach them."""

from __future__ import annotations

import pytest
from source_text import blame

AFTER = "Python rebinds the name once, while recording, whatever happens at run time\n  write instead: "

REBOUND = {
    "a parameter": (
        """
        def f(x: sh.Attrib1f):
            with SH_IF(x > 1):
                x = x - 1
            return x
        """,
        f"3: `x` is rebound inside `with SH_IF(…)` and used after it (line 4): {AFTER}x[:] = x - 1",
    ),
    "a name, in one of the branches": (
        """
        def f(x: sh.Attrib1f):
            y = sh.abs(x)
            with SH_IF(x > 1):
                x[:] = 2
            with SH_ELIF(x > 0):
                y = x - 1
            return y
        """,
        f"6: `y` is rebound inside `with SH_ELIF(…)` and used after it (line 7): {AFTER}y[:] = x - 1",
    ),
    "a name that the next branch reads": (
        """
        def f(x: sh.Attrib1f):
            y = sh.abs(x)
            with SH_IF(x > 1):
                y = x * 3
            with SH_ELSE():
                x[:] = y
            return x
        """,
        f"4: `y` is rebound inside `with SH_IF(…)` and used after it (line 6): {AFTER}y[:] = x * 3",
    ),
    "in the next iteration": (
        """
        def f(x: sh.Attrib1f):
            y = x * 2
            with SH_DO():
                y = y * 2
                x += 1
                SH_UNTIL(x > 100)
            return x
        """,
        f"4: `y` is rebound inside `with SH_DO()` and used in its next iteration (line 4): {AFTER}y[:] = y * 2",
    ),
    "read by the loop's test": (
        """
        def f(x: sh.Attrib1f):
            t = x * 1
            with SH_WHILE(lambda: t < 8):
                t = t + 1
            return x
        """,
        f"4: `t` is rebound inside `with SH_WHILE(…)` and used in its next iteration (line 3): {AFTER}t[:] = t + 1",
    ),
    "in the next iteration of an outer loop": (
        """
        def f(x: sh.Attrib1f):
            y = x * 2
            with SH_FOR(4):
                x += y
                with SH_FOR(3):
                    y = x + 1
            return x
        """,
        f"6: `y` is rebound inside `with SH_FOR(…)` and used in its next iteration (line 4): {AFTER}y[:] = x + 1",
    ),
    "in a tuple": (
        """
        def f(x: sh.Attrib1f, y: sh.Attrib1f):
            with SH_IF(x > y):
                x, y = y, x
            return x - y
        """,
        f"3: `x` is rebound inside `with SH_IF(…)` and used after it (line 4): {AFTER}x[:] = y",
    ),
    "by walrus": (
        """
        def f(x: sh.Attrib1f):
            y = x + 1
            with SH_IF(x > 1):
                x[:] = (y := x * 3) + 1
            return x + y
        """,
        f"4: `y` is rebound inside `with SH_IF(…)` and used after it (line 5): {AFTER}y[:] = x * 3",
    ),
    "across Python's loop": (
        """
        def f(x: sh.Attrib1f):
            best = x * 1
            for k in range(3):
                with SH_IF(best > k):
                    best = best - k
            return x
        """,
        f"5: `best` is rebound inside `with SH_IF(…)` and used after it (line 4): {AFTER}best[:] = best - k",
    ),
    "a helper's parameter": (
        """
        def absolute(a):
            with SH_IF(a < 0):
                a = -a
            return a

        def f(x: sh.Attrib1f):
            return absolute(x)
        """,
        f"3: `a` is rebound inside `with SH_IF(…)` and used after it (line 4): {AFTER}a[:] = -a",
    ),
    "in a function inside": (
        """
        def f(x: sh.Attrib1f):
            def absolute(a):
                with SH_IF(a < 0):
                    a = -a
                return a
            return absolute(x)
        """,
        f"4: `a` is rebound inside `with SH_IF(…)` and used after it (line 5): {AFTER}a[:] = -a",
    ),
    "a host number": (
        """
        def f(x: sh.Attrib1f):
            count = 0
            with SH_IF(x > 1):
                count += 1
            return x * count
        """,
        f"4: `count` is rebound inside `with SH_IF(…)` and used after it (line 5): {AFTER}"
        "`count = sh.Attrib1i(0)` before the block, `count += 1` inside it",
    ),
    "a host number that counts iterations": (
        """
        def f(x: sh.Attrib1f):
            count = 0
            with SH_WHILE(lambda: x < 10):
                count += 1
                x += 1
            return x
        """,
        f"4: `count` is rebound inside `with SH_WHILE(…)` and used in its next iteration (line 4): {AFTER}"
        "`count = sh.Attrib1i(0)` before the block, `count += 1` inside it",
    ),
    "a host bool": (
        """
        def f(x: sh.Attrib1f):
            found = False
            with SH_IF(x > 0):
                found = True
            return found
        """,
        f"4: `found` is rebound inside `with SH_IF(…)` and used after it (line 5): {AFTER}"
        "`found = sh.Attrib1b(False)` before the block, `found[:] = True` inside it",
    ),
    "a host float, by a value": (
        """
        def f(x: sh.Attrib1f):
            total = 0
            with SH_FOR(8) as i:
                total += x
            return total
        """,
        f"4: `total` is rebound inside `with SH_FOR(…)` and used in its next iteration (line 4): {AFTER}"
        "`total = sh.Attrib1f(0)` before the block, `total += x` inside it",
    ),
    "the length of a list": (
        """
        def f(x: sh.Attrib1f):
            n = len(DATA) - 1
            with SH_IF(x > 0):
                n = n - 1
            return x * n
        """,
        f"4: `n` is rebound inside `with SH_IF(…)` and used after it (line 5): {AFTER}"
        "`n = sh.Attrib1i(len(DATA) - 1)` before the block, `n[:] = n - 1` inside it",
    ),
    "nothing yet": (
        """
        def f(x: sh.Attrib3f):
            best = None
            with SH_IF(x.x > 0):
                best = x * 2
            return best
        """,
        f"4: `best` is rebound inside `with SH_IF(…)` and used after it (line 5): {AFTER}"
        "make `best` a value before the block, `best[:] = x * 2` inside it",
    ),
    "an item": (
        """
        def f(x: sh.Attrib1f):
            d = {"t": x + 1}
            with SH_IF(x > 0):
                d["t"] = x * 2
            return d["t"]
        """,
        f'4: `d["t"]` is rebound inside `with SH_IF(…)` and used after it (line 5): {AFTER}d["t"][:] = x * 2',
    ),
    "an item that is a number": (
        """
        def f(x: sh.Attrib1f):
            d = {"n": 0}
            with SH_DO():
                d["n"] += 1
                SH_UNTIL(x > 0)
            return x
        """,
        f'4: `d["n"]` is rebound inside `with SH_DO()` and used in its next iteration (line 4): {AFTER}'
        '`d["n"] = sh.Attrib1i(0)` before the block, `d["n"] += 1` inside it',
    ),
    "an item of a list that Python's loop goes through": (
        """
        def f(a: sh.Attrib1f, b: sh.Attrib1f, c: sh.Attrib1f):
            v = [x for x in (a, b, c)]
            for i, j in ((0, 1), (1, 2), (0, 1)):
                with SH_IF(v[i] > v[j]):
                    v[i], v[j] = v[j], v[i]
            return v[0]
        """,
        f"5: `v[i]` is rebound inside `with SH_IF(…)` and used after it (line 4): {AFTER}v[i][:] = v[j]",
    ),
    "an item of a list": (
        """
        def f(x: sh.Attrib1f):
            slots = [x + 1, x + 2]
            with SH_IF(x > 0):
                slots[0] = x
            return slots[0] + slots[1]
        """,
        f"4: `slots[0]` is rebound inside `with SH_IF(…)` and used after it (line 5): {AFTER}slots[0][:] = x",
    ),
    "a number of numpy": (
        """
        def f(x: sh.Attrib1f):
            gain = np.float32(1)
            with SH_IF(x > 1):
                gain = np.float32(2)
            return x * gain
        """,
        f"4: `gain` is rebound inside `with SH_IF(…)` and used after it (line 5): {AFTER}"
        "`gain = sh.Attrib1f(np.float32(1))` before the block, `gain[:] = np.float32(2)` inside it",
    ),
    "the items of a list, by a slice": (
        """
        def f(x: sh.Attrib1f, y: sh.Attrib1f):
            ends = [x, y]
            with SH_IF(x > y):
                ends[:] = [y, x]
            return ends[0]
        """,
        f"4: `ends` is rebound inside `with SH_IF(…)` and used after it (line 5): {AFTER}"
        "a name before the block for each value that `ends` holds, and `x[:] = …` inside it",
    ),
    "a tuple of values in the next iteration": (
        """
        def f(x: sh.Attrib1f):
            pair = (x, x)
            with SH_FOR(3):
                pair = (pair[1], pair[0] + 1)
            return pair[0]
        """,
        f"4: `pair` is rebound inside `with SH_FOR(…)` and used in its next iteration (line 4): {AFTER}"
        "a name before the block for each value that `pair` holds, and `x[:] = …` inside it",
    ),
    "a tuple of a helper, whose parameters may be values": (
        """
        def ordered(a, b):
            pair = (a + 0, b)
            with SH_IF(a > b):
                pair = (pair[1], pair[0])
            return pair[0]
        """,
        f"4: `pair` is rebound inside `with SH_IF(…)` and used after it (line 5): {AFTER}"
        "a name before the block for each value that `pair` holds, and `x[:] = …` inside it",
    ),
    "a dict that gets values": (
        """
        def f(x: sh.Attrib1f):
            found = {"a": 1}
            with SH_IF(x > 0):
                found = {"a": [x * 2, 1]}
            return x * found["a"][0]
        """,
        f"4: `found` is rebound inside `with SH_IF(…)` and used after it (line 5): {AFTER}"
        "a name before the block for each value that `found` holds, and `x[:] = …` inside it",
    ),
}


@pytest.mark.parametrize("case", REBOUND)
def test_a_name_that_a_block_rebinds(case: str) -> None:
    text, error = REBOUND[case]
    assert blame(text, DATA=[1, 2, 3]) == error


ENDS = "what a block makes ends with it\n  write instead: "

MADE_INSIDE = {
    "in one block": (
        """
        def f(x: sh.Attrib1f):
            with SH_DO():
                t = x + 1
                x[:] = t
                SH_UNTIL(x > 100)
            return t
        """,
        f"3: `t` is made inside `with SH_DO()` and used after it (line 6): {ENDS}"
        "make `t` a value before the block, `t[:] = x + 1` inside it",
    ),
    "in both branches": (
        """
        def f(x: sh.Attrib1f):
            with SH_IF(x > 0):
                t = sh.Color3f(1, 0, 0)
            with SH_ELSE():
                t = sh.Color3f(0, 0, 0)
            return t
        """,
        f"5: `t` is made inside `with SH_ELSE()` and used after it (line 6): {ENDS}"
        "`t = sh.Color3f()` before the SH_IF, `t[:] = sh.Color3f(0, 0, 0)` inside the block",
    ),
    "and used in the next branch": (
        """
        def f(x: sh.Attrib1f):
            with SH_IF(x > 0):
                t = sh.sqrt(x)
            with SH_ELSE():
                x[:] = t
            return x
        """,
        f"3: `t` is made inside `with SH_IF(…)` and used after it (line 5): {ENDS}"
        "make `t` a value before the block, `t[:] = sh.sqrt(x)` inside it",
    ),
    "the index of a loop": (
        """
        def f(x: sh.Attrib1f):
            with SH_FOR(8) as i:
                x += i
            return x + i
        """,
        "2: `i` counts the iterations of `with SH_FOR(…)`, and is used after it (line 4)\n"
        "  write instead: `last = sh.Attrib1i()` before the loop, `last[:] = i` inside, `last` after it",
    ),
}


@pytest.mark.parametrize("case", MADE_INSIDE)
def test_a_name_that_is_made_inside_a_block_and_used_after_it(case: str) -> None:
    text, error = MADE_INSIDE[case]
    assert blame(text) == error
