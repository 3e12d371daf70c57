"""One value under two names, and jumps and calls that stand where they cannot: each error word for word."""

from __future__ import annotations

import re

import pytest
from source_text import blame, check

ALIASES = {
    "a list of one value": (
        """
        def f(x: sh.Attrib1f):
            sums = [sh.Attrib1f(0)] * 3
            for k in range(len(sums)):
                sums[k] += x * k
            return sums[0]
        """,
        "2: `sums = [sh.Attrib1f(0)] * 3` holds one value several times: `sums[k] += x * k` (line 4) changes all of "
        "them\n  write instead: sums = [sh.Attrib1f(0) for _ in range(3)]",
    ),
    "a list of one name": (
        """
        def f(x: sh.Attrib3f, n: int = 2):
            y = x + 1
            both = n * [y]
            both[0].xy = 0, 0
            return both[0] + both[1]
        """,
        "3: `both = n * [y]` holds one value several times: `both[0].xy = 0, 0` (line 4) changes all of them\n"
        "  write instead: both = [y.copy() for _ in range(n)]",
    ),
    "a list of lists": (
        """
        def f(x: sh.Attrib1f):
            grid = [[sh.Attrib1f(x)] * 2 for _ in range(3)]
            with SH_IF(x > 0):
                grid[1][0][:] = 1
            return grid[1][1]
        """,
        "2: `grid = [[sh.Attrib1f(x)] * 2 for _ in range(3)]` holds one value several times: `grid[1][0][:] = 1` "
        "(line 4) changes all of them\n"
        "  write instead: grid = [[sh.Attrib1f(x) for _ in range(2)] for _ in range(3)]",
    ),
    "a dict of one value": (
        """
        def f(x: sh.Attrib1f):
            by_name = dict.fromkeys("ab", sh.Attrib1f(0))
            by_name["a"] += x
            return by_name["b"]
        """,
        '2: `by_name = dict.fromkeys("ab", sh.Attrib1f(0))` holds one value several times: `by_name["a"] += x` '
        "(line 3) changes all of them\n  write instead: by_name = {key: sh.Attrib1f(0) for key in 'ab'}",
    ),
    "the copy is read": (
        """
        def f(x: sh.Point3f, d: sh.Vector3f):
            old = x
            x += d
            return x - old
        """,
        "2: `old = x` gives one value two names: `x += d` (line 3) changes both, and `old` is read after it (line 4)\n"
        "  write instead: old = x.copy()",
    ),
    "the original is read": (
        """
        def f(x: sh.Point3f, d: sh.Vector3f):
            q = x + d
            p = q
            p.xy = d.xy
            return q
        """,
        "3: `p = q` gives one value two names: `p.xy = d.xy` (line 4) changes both, and `q` is read after it (line 5)\n"
        "  write instead: p = q.copy()",
    ),
    "stored whole": (
        """
        def f(x: sh.Attrib1f):
            y = x
            with SH_IF(x > 0):
                y[:] = 3
            return x + y
        """,
        "2: `y = x` gives one value two names: `y[:] = 3` (line 4) changes both, and `x` is read after it (line 5)\n"
        "  write instead: y = x.copy()",
    ),
    "a chain": (
        """
        def f(x: sh.Attrib3f):
            a = b = sh.Attrib3f(0)
            a[0] = x[0]
            return a + b
        """,
        "2: `a = b = sh.Attrib3f(0)` gives one value two names: `a[0] = x[0]` (line 3) changes both, and `b` is read "
        "after it (line 4)\n  write instead: b = sh.Attrib3f(0); a = b.copy()",
    ),
    "a tuple": (
        """
        def f(x: sh.Attrib3f, y: sh.Attrib1f):
            a, b, c = x, y, x * y
            a += c
            return x + a
        """,
        "2: `a, b, c = x, y, x * y` gives one value two names: `a += c` (line 3) changes both, and `x` is read after "
        "it (line 4)\n  write instead: a, b, c = x.copy(), y, x * y",
    ),
    "a tuple of one value": (
        """
        def f(x: sh.Attrib3f):
            p = x * 2
            low, high = p, p
            low[:] = sh.min(low, 1)
            return high - low
        """,
        "3: `low, high = p, p` gives one value two names: `low[:] = sh.min(low, 1)` (line 4) changes both, and `high` "
        "is read after it (line 5)\n  write instead: low, high = p, p.copy()",
    ),
    "an assignment expression": (
        """
        def f(x: sh.Attrib1f):
            y = sh.sqrt(old := x)
            x += y
            return x - old
        """,
        "2: `old := x` gives one value two names: `x += y` (line 3) changes both, and `old` is read after it (line 4)\n"
        "  write instead: (old := x.copy())",
    ),
    "in the next iteration": (
        """
        def f(x: sh.Attrib3f):
            p = x * 2
            q = p
            with SH_DO():
                x += p
                q.x = 3
                SH_UNTIL(x.x > 0)
            return x
        """,
        "3: `q = p` gives one value two names: `q.x = 3` (line 6) changes both, and `p` is read in the next iteration "
        "(line 5)\n  write instead: q = p.copy()",
    ),
    "a struct": (
        """
        @sh.struct
        class Ray:
            o: sh.Point3f
            d: sh.Vector3f

        def f(ray: Ray):
            first = ray
            ray.o = ray.o + ray.d
            return first.o
        """,
        "7: `first = ray` gives one value two names: `ray.o = ray.o + ray.d` (line 8) changes both, and `first` is "
        "read after it (line 9)\n  write instead: first = ray.copy()",
    ),
    "a field that is changed while its old value is kept": (
        """
        @sh.struct
        class Ray:
            o: sh.Point3f
            d: sh.Vector3f

        def f(ray: Ray):
            old = ray.o
            ray.o = ray.o + ray.d
            return old
        """,
        "7: `old = ray.o` gives one value two names: `ray.o = ray.o + ray.d` (line 8) changes both, and `old` is read "
        "after it (line 9)\n  write instead: old = ray.o.copy()",
    ),
    "a field whose other name is changed": (
        """
        @sh.struct
        class Ray:
            o: sh.Point3f
            d: sh.Vector3f

        def f(ray: Ray):
            o, d = ray.o, ray.d
            o += d
            return ray.d + ray.o
        """,
        "7: `o, d = ray.o, ray.d` gives one value two names: `o += d` (line 8) changes both, and `ray.o` is read after "
        "it (line 9)\n  write instead: o, d = ray.o.copy(), ray.d",
    ),
    "a field that a loop changes through its other name": (
        """
        @sh.struct
        class Ray:
            o: sh.Point3f
            d: sh.Vector3f

        def f(ray: Ray):
            o = ray.o
            with SH_FOR(0, 3):
                o += ray.o
            return o
        """,
        "7: `o = ray.o` gives one value two names: `o += ray.o` (line 9) changes both, and `ray.o` is read in the next "
        "iteration (line 9)\n  write instead: o = ray.o.copy()",
    ),
    "a field that each iteration names and changes": (
        """
        @sh.struct
        class Ray:
            o: sh.Point3f
            d: sh.Vector3f

        def f(ray: Ray):
            with SH_FOR(0, 3):
                o = ray.o
                o += ray.d
            return ray.d
        """,
        "8: `o = ray.o` gives one value two names: `o += ray.d` (line 9) changes both, and `ray.o` is read in the next "
        "iteration (line 8)\n  write instead: o = ray.o.copy()",
    ),
    "a field whose struct is read whole": (
        """
        @sh.struct
        class Ray:
            o: sh.Point3f
            d: sh.Vector3f

        def f(ray: Ray):
            o = ray.o
            o += ray.d
            return ray
        """,
        "7: `o = ray.o` gives one value two names: `o += ray.d` (line 8) changes both, and `ray` is read after it "
        "(line 9)\n  write instead: o = ray.o.copy()",
    ),
    "a field of a struct that is stored whole": (
        """
        @sh.struct
        class Ray:
            o: sh.Point3f

        @sh.struct
        class Hit:
            ray: Ray

        def f(hit: Hit):
            old = hit.ray.o
            hit.ray = Ray(old + 1)
            return old
        """,
        "10: `old = hit.ray.o` gives one value two names: `hit.ray = Ray(old + 1)` (line 11) changes both, and `old` "
        "is read after it (line 12)\n  write instead: old = hit.ray.o.copy()",
    ),
    "a struct of the function that makes the program": (
        """
        def make():
            @sh.struct
            class Ray:
                o: sh.Point3f

            def f(ray: Ray):
                first = ray
                ray.o += 1
                return first.o

            return f

        f = make()
        """,
        "7: `first = ray` gives one value two names: `ray.o += 1` (line 8) changes both, and `first` is read after it "
        "(line 9)\n  write instead: first = ray.copy()",
    ),
    "an array": (
        """
        def f(x: sh.Attrib1f):
            a = sh.Array(sh.Attrib1f, 4)
            before = a
            a[1] = x
            return before[1]
        """,
        "3: `before = a` gives one value two names: `a[1] = x` (line 4) changes both, and `before` is read after it "
        "(line 5)\n  write instead: before = a.copy()",
    ),
    "a swap": (
        """
        def f(x: sh.Attrib3f, y: sh.Attrib3f):
            x[:], y[:] = y, x
            return x
        """,
        "2: `x[:], y[:] = y, x` stores into `x` before `y[:]` is stored from it\n"
        "  write instead: copy first, or `sh.swap(x, y)`",
    ),
    "more than a swap": (
        """
        def step(a, b):
            a[:], b[:] = a + b, a

        def f(x: sh.Attrib1f, y: sh.Attrib1f):
            step(x, y)
            return x
        """,
        "2: `a[:], b[:] = a + b, a` stores into `a` before `b[:]` is stored from it\n"
        "  write instead: copy first: `old = a.copy()`, and `old` for `a` on the right",
    ),
}


def test_names_that_change_places_are_no_aliases() -> None:
    """`a, b = b, a + b` gives each value the name of another: a store into either changes one name alone."""
    text = """
        def f(x: sh.Attrib1f, y: sh.Attrib1f):
            a, b = x * 1, y * 1
            for _ in range(3):
                a, b = b, a + b
            a, b = b, a
            a += 1
            return a * b
        """
    check(text)  # no error


def test_a_store_in_one_branch_is_not_read_in_another() -> None:
    text = """
        def f(x: sh.Attrib1f):
            y, r = sh.Attrib1f(x), sh.Attrib1f(0)
            z = y
            with SH_IF(x > 0):
                z += 1
                r[:] = z
            with SH_ELIF(y < -3):
                r[:] = y
            with SH_ELSE():
                r[:] = y
            return r
        """
    check(text)  # no error
    assert str(blame(text.replace("return r", "return r + y"))).startswith("3: `z = y` gives one value two names")
    after = text.replace("ELIF", "IF")
    assert str(blame(after)).startswith("3: `z = y` gives one value two names: `z += 1` (line 5) changes both")


def test_components_and_copies_of_fields_are_no_aliases() -> None:
    text = """
        @sh.struct
        class Ray:
            o: sh.Point3f
            d: sh.Vector3f

        def f(ray: Ray):
            height, o, kept = ray.o.y, ray.o.copy(), ray.d
            height += 1
            o += height
            ray.o = o
            return ray.o + kept + ray.d + o
        """
    check(text)  # no error


@pytest.mark.parametrize("case", ALIASES)
def test_one_value_with_two_names(case: str) -> None:
    text, error = ALIASES[case]
    assert blame(text) == error


def jumps(word: str, block: str) -> str:
    return (
        f"Python's `{word}` inside `with {block}` happens while recording, whatever the block's condition is\n"
        "  write instead: "
    )


MISPLACED = {
    "return": (
        """
        def f(x: sh.Attrib1f):
            with SH_IF(x > 0):
                return x + 1
            return -x
        """,
        f"3: {jumps('return', 'SH_IF(…)')}SH_RETURN(x + 1)",
    ),
    "return under Python's if": (
        """
        def f(x: sh.Attrib1f):
            with SH_DO():
                if DEBUG:
                    return
                SH_BREAK(x > 3)
            return -x
        """,
        f"4: {jumps('return', 'SH_DO()')}SH_RETURN()",
    ),
    "break out of a block": (
        """
        def f(x: sh.Attrib1f):
            for k in range(3):
                with SH_IF(x > k):
                    break
            return x
        """,
        f"4: {jumps('break', 'SH_IF(…)')}make the loop a `with SH_FOR(…) as i:`, and write `SH_BREAK()`",
    ),
    "continue in a loop of both kinds": (
        """
        def f(x: sh.Attrib1f):
            for k in range(3):
                with SH_WHILE(lambda: x < k):
                    with SH_IF(x > 0):
                        continue
            return x
        """,
        f"5: {jumps('continue', 'SH_IF(…)')}SH_CONTINUE()",
    ),
    "a block without with": (
        """
        def f(x: sh.Attrib1f):
            SH_IF(x > 0)
            x += 1
            return x
        """,
        "2: `SH_IF(x > 0)` alone does nothing: SH_IF opens a block\n  write instead: with SH_IF(x > 0):",
    ),
    "a block without a call": (
        """
        def f(x: sh.Attrib1f):
            with SH_DO:
                SH_BREAK(x > 1)
            return x
        """,
        "2: `SH_DO` is not called\n  write instead: with SH_DO():",
    ),
    "an exit without a call": (
        """
        def f(x: sh.Attrib1f):
            with SH_DO():
                sh.SH_BREAK
            return x
        """,
        "3: `sh.SH_BREAK` is not called\n  write instead: sh.SH_BREAK()",
    ),
    "a test that is not last": (
        """
        def f(x: sh.Attrib1f):
            with SH_DO():
                SH_UNTIL(x > 1)
                x += 1
            return x
        """,
        "4: this follows the SH_UNTIL at line 3, which is the last statement of its SH_DO\n"
        "  write instead: put it before the SH_UNTIL; `SH_BREAK(c)` leaves a loop in the middle",
    ),
    "None": (
        """
        def f(x: sh.Attrib1f):
            return 1 if x == None else x
        """,
        "2: `x == None` compares a value with None, component by component\n  write instead: x is None",
    ),
    "None != x": (
        """
        def f(x: sh.Attrib1f):
            if None != x:
                x += 1
            return x
        """,
        "2: `None != x` compares a value with None, component by component\n  write instead: x is not None",
    ),
    "numpy's functions": (
        """
        def f(x: sh.Attrib1f):
            return np.arcsin(x * 2)
        """,
        "2: `np.arcsin(x * 2)` is computed while recording, and its argument is known only when the program runs\n"
        "  write instead: sh.asin(x * 2)",
    ),
}


@pytest.mark.parametrize("case", MISPLACED)
def test_what_stands_where_it_cannot(case: str) -> None:
    text, error = MISPLACED[case]
    assert re.sub(r"<program \d+>:", "line ", blame(text, DEBUG=False)) == error
