"""Programs that are right: the source check must not blame them."""

from __future__ import annotations

import types

import pytest
from source_text import check

from shpy.errors import RecordError

INNOCENT = {
    "the first program of the language": """
        def mandelbrot(c: sh.Point2f) -> sh.Attrib1f:
            z = sh.Attrib2f(0, 0)
            n = sh.Attrib1f(0)
            with SH_DO():
                z[:] = sh.Attrib2f(z.x * z.x - z.y * z.y, 2 * z.x * z.y) + c
                n += 1
                SH_UNTIL((sh.dot(z, z) > 4) | (n >= 256))
            return n
        """,
    "stores in place": """
        def f(x: sh.Point3f, d: sh.Vector3f, a):
            with SH_IF(x.x > 0):
                x[:] = x + d
                x.xy = d.xy
                x[0] = 1
                x += d
                a += 1
                a[0] = 3
                a.x = 4
                a.x += 1
            return x + a
        """,
    "data whose fields are values, or numbers that a block sets for itself": """
        def f(x: sh.Attrib1f):
            state = types.SimpleNamespace(total=sh.Attrib1f(0), count=0, name="n")
            with SH_FOR(3) as i:
                state.total += x
                state.total[:] = state.total * 2
                state.count = 2
                x += state.count * i
            state.name = "m"
            state.count = 0
            return state.total + state.count
        """,
    "temporaries that several blocks reuse": """
        def f(x: sh.Attrib1f):
            t = x * 2
            x += t
            with SH_IF(x > 0):
                t = x * 3
                x[:] = t
            with SH_ELIF(x > -1):
                t = x * 4
                x[:] = t
            with SH_ELSE():
                t, u = x, x * 2
                x[:] = t + u
            t = x + 1
            return t
        """,
    "temporaries in nested loops": """
        def f(x: sh.Attrib1f):
            with SH_FOR(8) as i:
                a = x + i
                with SH_FOR(8) as j:
                    b = a * j
                    c = b if WIDE else a
                    x += c
                a = x * 2
                x += a
            with SH_FOR(3) as i:
                x += i
            return x
        """,
    "loops of Python around blocks": """
        def f(x: sh.Attrib1f):
            for k in range(3):
                with SH_IF(x > k):
                    t = x * k
                    x[:] = t
            for k, w in enumerate(DATA):
                with SH_DO():
                    for j in range(2):
                        t = w * j
                        x += t
                    for j in range(2):
                        x += t
                    SH_UNTIL(x > 3)
            return x
        """,
    "choices of Python inside blocks": """
        def f(x: sh.Attrib1f):
            y = x * 2
            with SH_DO():
                if WIDE:
                    t = x * 2
                else:
                    t = x * 3
                if WIDE:
                    u = t
                if WIDE:
                    x += u
                x[:] = t + y
                SH_UNTIL(x > 8)
            if WIDE:
                t = x * 5
            if WIDE:
                x += t
            return x
        """,
    "a sum that starts with nothing": """
        def f(x: sh.Attrib1f):
            total = None
            with SH_DO():
                for w in DATA:
                    total = x * w if total is None else total + x * w
                x[:] = total
                SH_UNTIL(x > 8)
            return x
        """,
    "a host sum inside one block": """
        def f(x: sh.Attrib1f):
            with SH_IF(x > 0):
                total = 0
                for w in DATA:
                    total += w
                x[:] = total
            with SH_IF(x > 1):
                total = 1
                for w in DATA:
                    total *= w
                x[:] = total
            return x
        """,
    "a host sum outside blocks": """
        def f(x: sh.Attrib1f):
            total = 0
            for w in DATA:
                total += x * w
                with SH_IF(x > w):
                    x += 1
            total += 1
            return total
        """,
    "lists and dicts of values": """
        def f(x: sh.Attrib1f):
            parts, named = [], {}
            for k in range(3):
                parts.append(x * k)
                named[k] = x + k
                named["last"] = parts[k]
            with SH_IF(x > 0):
                for k, p in enumerate(parts):
                    p += named[k]
                    parts[k] += 1
                    named["last"][:] = p
            return sum(parts) + named["last"]
        """,
    "a list that a block fills and uses": """
        def f(x: sh.Attrib1f):
            with SH_IF(x > 0):
                terms = []
                for k in range(3):
                    terms.append(x * k)
                    terms[k] = terms[k] + 1
                names = [str(k) for k in range(3)]
                x[:] = sum(terms)
            label = "".join(names)
            return x
        """,
    "host strings and constants in blocks": """
        def f(x: sh.Attrib1f):
            label = "a"
            with SH_IF(x > 0):
                label = "b"
                eps = 1e-4
                axes = (0, 1, 2)
                x += eps
            print(label, axes)
            return x + eps
        """,
    "comprehensions have their own names": """
        def f(x: sh.Attrib1f):
            k = x * 2
            with SH_IF(x > 0):
                ts = [k * 2 for k in DATA]
                x[:] = sum(t for t in ts)
                pairs = {t: k for k, t in enumerate(ts)}
            return x + k
        """,
    "functions inside functions": """
        def f(x: sh.Attrib1f):
            def step(a):
                t = a * 2
                return t
            t = x * 3
            with SH_IF(x > 0):
                def inner(a):
                    return a + 1
                half = lambda a: a / 2
                x[:] = inner(step(half(x)))
            return x + t + half(x) + inner(x)
        """,
    "a return in a function that a block defines": """
        def f(x: sh.Attrib1f):
            with SH_DO():
                def stop(a):
                    for k in range(3):
                        if k == 2:
                            break
                    return a > k
                SH_UNTIL(stop(x))
            return x
        """,
    "break and continue of a loop inside the block": """
        def f(x: sh.Attrib1f):
            with SH_DO():
                for k in DATA:
                    if k == 2:
                        continue
                    if k > 5:
                        break
                    x += k
                while True:
                    break
                SH_BREAK(x > 3)
            return x
        """,
    "helpers that make a block": """
        @contextlib.contextmanager
        def positive(a):
            with SH_IF(a > 0):
                yield a

        def each(values):
            for v in values:
                with SH_IF(v > 0):
                    yield v

        def f(x: sh.Attrib1f):
            with positive(x) as p:
                x[:] = p + 1
            for v in each([x]):
                x[:] = v * 2
            return x
        """,
    "two names, and no store": """
        def f(x: sh.Point3f, d: sh.Vector3f):
            p = x
            q = p + d
            p = q
            return p + x
        """,
    "two names, and the other is not read again": """
        def f(x: sh.Point3f, d: sh.Vector3f):
            p = x
            with SH_DO():
                p += d
                SH_UNTIL(p.x > 3)
            return p
        """,
    "two names, after the store": """
        def f(x: sh.Point3f, d: sh.Vector3f):
            x += d
            p = x
            q = x + p
            p = p + d
            x[:] = q
            return x
        """,
    "two names, one bound anew": """
        def f(x: sh.Point3f, d: sh.Vector3f):
            p = x
            x = x + d
            x += d
            return p + x
        """,
    "copies": """
        def f(x: sh.Point3f, d: sh.Vector3f):
            p = x.copy()
            q = sh.Point3f(x)
            r = x[:]
            s = x.xyz
            x += d
            return p + q + r + s + x
        """,
    "a variable that Python chooses": """
        def f(x: sh.Attrib1f, y: sh.Attrib1f):
            target = x if WIDE else y
            target[:] = 3
            if WIDE:
                other = x
            else:
                other = y
            other += 1
            for v in (x, y):
                w = v
                w += 1
            return x + y
        """,
    "helper's parameters may be anything": """
        def accumulate(into, value):
            out = into
            out += value
            return into

        def f(x: sh.Attrib1f):
            return accumulate(x, 1)
        """,
    "swaps that copy": """
        def f(x: sh.Point3f, y: sh.Point3f):
            x, y = y, x
            x.xy, y.xy = y.xy, x.xy
            x[:], y[:] = y + 0, x + 0
            sh.swap(x, y)
            x[:], y[:] = x, y
            return x + y
        """,
    "the state of a Python object": """
        def f(x: sh.Attrib1f):
            counter.made = counter.made + 1
            with SH_IF(x > 0):
                counter.label = "inside"
                counter.latest = x
                x[:] = counter.latest
            counter.made += 1
            return x
        """,
    "a struct's fields": """
        @sh.struct
        class Ray:
            o: sh.Point3f
            d: sh.Vector3f

        def f(ray: Ray, t: sh.Attrib1f):
            here = Ray(ray.o, ray.d)
            with SH_DO():
                ray.o = ray.o + t * ray.d
                here.o = ray.o
                here.d += ray.d
                SH_UNTIL(ray.o.x > 3)
            return here.o + ray.d
        """,
    "the test of a loop": """
        def f(x: sh.Attrib1f):
            t = sh.Attrib1f(0)
            with SH_WHILE(lambda: (t < 8) & all(x > t for t in [1])):
                t += 1
            with SH_DO():
                d = x - t
                SH_CONTINUE(d > 3)
                x += d
                SH_UNTIL(lambda: x > t)
            return x
        """,
    "other context managers": """
        def f(x: sh.Attrib1f):
            with open(os.devnull) as file:
                text = file.read()
                y = x * 2
                if WIDE:
                    return y
            with contextlib.ExitStack() as stack:
                stack.enter_context(SH_IF(x > 0))
                x += len(text)
            return y
        """,
    "the last statement but for a comment": '''
        def f(x: sh.Attrib1f):
            with SH_DO():
                x += 1
                if WIDE:
                    SH_UNTIL(x > 3)
                else:
                    SH_UNTIL(x > 4)
            with SH_DO():
                x += 1
                SH_UNTIL(x > 3)
                """Done."""
                pass
            return x
        ''',
    "numpy on numbers": """
        def f(x: sh.Attrib1f):
            n = np.sin(0.5) + math.sin(len(DATA))
            weights = np.linspace(0, 1, 3)
            with SH_IF(x is None):
                pass
            return x * n * np.sqrt(weights[0])
        """,
    "lists whose items are replaced, read, or one alone": """
        def f(x: sh.Attrib1f):
            def put(held):
                for k in range(len(held)):
                    held[k] = sh.Attrib1f(k)
            sums = [sh.Attrib1f(0)] * 3
            for k in range(3):
                sums[k] = sums[k] + k * x
            sums[0] += x
            given = [sh.Attrib1f(0)] * 3
            put(given)
            given[1] += x
            one = [sh.Attrib1f(0)] * 1
            one[0] += x
            numbers = [0] * 3
            numbers[1] += 1
            rows = [[None] * 2 for _ in range(2)]
            rows[0][1] = sh.Attrib1f(x)
            rows[0][1] += 1
            read = [x] * 3
            return sums[0] + given[1] + one[0] + numbers[1] + rows[0][1] + sum(read)
        """,
    "try and match": """
        def f(x: sh.Attrib1f):
            with SH_IF(x > 0):
                try:
                    t = x * 2
                except TypeError as error:
                    t = x * 3
                finally:
                    x += 1
                match len(DATA):
                    case 3:
                        u = t
                    case n:
                        u = t * n
                x[:] = u
            t = x
            return t
        """,
    "tuples of values of each block": """
        def f(x: sh.Attrib1f):
            total, pair = sh.Attrib1f(0), (x, 2)
            total += pair[0]
            with SH_IF(x > 0):
                pair = (x, 1)
                total += pair[0]
            with SH_FOR(2):
                pair = [x, total]
                total += pair[1]
            pair = (total, 0)
            for k in range(3):
                with SH_IF(x > k):
                    total += pair[0]
                pair = (x * k, k)
            return total + pair[0]
        """,
}


@pytest.mark.parametrize("case", INNOCENT)
def test_programs_that_are_right(case: str) -> None:
    import contextlib
    import os

    counter = types.SimpleNamespace(made=0, label="")
    if case == "the test of a loop":  # its names are right, and Python's `all` is not
        with pytest.raises(RecordError, match="Python's `all` asks while recording"):
            check(INNOCENT[case])
        return
    check(INNOCENT[case], DATA=[1, 2, 3], WIDE=True, contextlib=contextlib, os=os, counter=counter)
