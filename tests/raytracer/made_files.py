"""OBJ, PLY, STL and OFF files whose right reading is known by construction, drawn by a seed.

Each face has corners of its own, so a corner's place tells what is at it: `Made.at` has its colour, normal and uv
coordinates. Files differ in all that writers may choose: line ends, spaces, comments, order, types, forms of indices.
Some have bad entries, whose sentences are known as well.
"""

import struct
from dataclasses import dataclass, field

import numpy as np

ELL = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
OUTLINES = {
    "dart": ([(0, 0), (1, 0.5), (2, 0), (1, 2)], 1.5),
    "ell": (ELL, 3),
    "frame": ([(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)], 12),
    "comb": ([(0, 0), (5, 0), (5, 2), (4, 2), (4, 1), (3, 1), (3, 2), (2, 2), (2, 1), (1, 1), (1, 2), (0, 2)], 8),
}
CODES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}
WHITES = {"uchar": 255, "ushort": 65535, "short": 32767, "uint": 2**32 - 1, "float": 1.0, "double": 255.0}


@dataclass
class Face:
    """A face: the places of its corners (N, 3), the area that it covers, and the properties of its corners."""

    places: np.ndarray
    area: float
    normal: np.ndarray
    colors: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    convex: bool
    part: str = ""


@dataclass
class Made:
    """A file: its contents, its faces, what it has for each corner, and the sentences on its bad entries."""

    ending: str
    data: bytes
    faces: list[Face]
    has: set[str]
    said: list[str] = field(default_factory=list)
    flat: set[tuple] = field(default_factory=set)
    """The places of corners whose normal is left out: they have that of the face."""

    @property
    def area(self):
        return sum(face.area for face in self.faces)

    def at(self):
        """Give the face and the corner at each place."""
        return {tuple(place): (face, k) for face in self.faces for k, place in enumerate(face.places.tolist())}


def drawn_face(rng, only_triangles):
    kind = rng.choice([*OUTLINES, "regular", "regular", "star"])
    if only_triangles or kind == "regular":
        count = 3 if only_triangles else int(rng.integers(3, 9))
        angle = 2 * np.pi * np.arange(count) / count
        outline, area = np.stack([np.cos(angle), np.sin(angle)], axis=1), count / 2 * np.sin(2 * np.pi / count)
    elif kind == "star":
        count = 2 * int(rng.integers(3, 7))
        radius = np.where(np.arange(count) % 2, 0.4, 1.0)
        angle = 2 * np.pi * np.arange(count) / count
        outline = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        area = count * 0.4 * np.sin(2 * np.pi / count) / 2
    else:
        outline, area = OUTLINES[kind]
        outline = np.array(outline, float)
        count = len(outline)
    outline = np.roll(outline, int(rng.integers(count)), axis=0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    scale = float(rng.uniform(0.5, 3))
    flat = np.column_stack([outline, np.zeros(count)]) * scale
    places = (flat @ turn.T + rng.normal(size=3) * 10).astype(np.float32).astype(float)
    normals = rng.normal(size=(count, 3)) * 0.2 + turn[:, 2]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    colors, uv = rng.integers(0, 256, (count, 3)), rng.random((count, 2))
    same = {}
    for k, place in enumerate(map(tuple, places.tolist())):  # the two ends of a bridge are one corner each
        k = same.setdefault(place, k)
        colors[-1 if k < 0 else k] = colors[k]
    ends = [same[tuple(place)] for place in places.tolist()]
    rounded = np.float32(normals[ends]).astype(float), np.float32(uv[ends]).astype(float)
    convex = only_triangles or kind == "regular"
    return Face(places, area * scale**2, turn[:, 2], colors[ends], rounded[0], rounded[1], convex)


def drawn_faces(rng, *, only_triangles=False):
    return [drawn_face(rng, only_triangles) for _ in range(int(rng.integers(1, 7)))]


def drawn_bad(rng, *names):
    """Draw the number of bad entries of each kind."""
    return {name: int(rng.integers(1, 4)) if rng.random() < 0.15 else 0 for name in names}


def number(x):
    """The shortest text of a number that is read as it."""
    return repr(float(x))


def made_obj(rng):
    """An OBJ file; `has` says which properties its faces name."""
    faces = drawn_faces(rng)
    has = {name for name in ("colors", "normals", "uv") if rng.random() < 0.5}
    made = Made("obj", b"", faces, has)
    lines, counts = ["# made"], [0, 0, 0]
    bad = {
        name: int(rng.integers(1, 4)) if rng.random() < 0.15 else 0 for name in ("lacking", "small", "normal", "nan")
    }
    with_parts = rng.random() < 0.5
    for number_of, face in enumerate(faces):
        if with_parts and (number_of == 0 or rng.random() < 0.5):
            lines.append(f"{rng.choice(['o', 'g'])} part{number_of}")
        begin = list(counts)
        for k in range(len(face.places)):
            color = [number(c / 255) for c in face.colors[k]] if "colors" in has else []
            rows = [("v", [*map(number, face.places[k]), *color])]
            rows += [("vt", map(number, face.uv[k]))] if "uv" in has else []
            rows += [("vn", map(number, face.normals[k]))] if "normals" in has else []
            for key, words in rows:
                lines.append(f"{key} {' '.join(words)}")
                counts[("v", "vt", "vn").index(key)] += 1
        lines.append(obj_face(rng, begin, counts, len(face.places), has, bad, made, face))
    for name, entry in (("small", "f 1 2"), ("lacking", f"f 1 2 {counts[0] + 1000}"), ("nan", "v 0 nan 0")):
        lines += [entry] * bad[name]
    made.said += sentences(bad)
    made.data = joined(rng, lines, comments=True)
    return made


def obj_face(rng, begin, counts, count, has, bad, made, face):
    """The line of a face: indices from the start or counted back, of which one normal may be lacking."""
    back = rng.random() < 0.4
    wrong = int(rng.integers(count)) if bad["normal"] and "normals" in has else -1
    if wrong >= 0:
        bad["normals named"] = bad.get("normals named", 0) + 1
        place = tuple(face.places[wrong].tolist())
        made.flat.add(place)
    words = []
    for k in range(count):
        index = [begin[c] - counts[c] + k if back else begin[c] + k + 1 for c in range(3)]
        if k == wrong or (wrong >= 0 and tuple(face.places[k].tolist()) == tuple(face.places[wrong].tolist())):
            index[2] = 10**6
        parts = [index[0], index[1] if "uv" in has else "", index[2] if "normals" in has else ""]
        words.append("/".join(map(str, parts)).rstrip("/"))
    return "f " + " ".join(words)


def sentences(bad):
    """The sentences on bad entries, without the place of the first."""
    texts = {
        "nan": ("vertex is not three finite numbers", "vertices are not three finite numbers"),
        "small": ("face has fewer than three corners", "faces have fewer than three corners"),
        "lacking": ("face names a vertex that the file lacks", "faces name a vertex that the file lacks"),
        "normals named": ("face names a normal that the file lacks", "faces name a normal that the file lacks"),
    }
    return [f"{bad[name]} {one if bad[name] == 1 else many}" for name, (one, many) in texts.items() if bad.get(name)]


def joined(rng, lines, *, comments=False):
    """Lines as a text, with line ends, spaces and comments by chance."""
    end = str(rng.choice(["\n", "\r\n", "\r"]))
    spaces, gaps = rng.random() < 0.3, rng.random() < 0.3
    found = []
    for line in lines:
        if spaces:
            line = " " * int(rng.integers(3)) + line.replace(" ", str(rng.choice([" ", "  ", "\t"])))
        if comments and line.lstrip()[:1] in "vf" and rng.random() < 0.05:
            line += " # 1 2 3 \\" if rng.random() < 0.5 else " #"
        if comments and line.lstrip().startswith("f") and "#" not in line and rng.random() < 0.1:
            head, _, tail = line.rpartition(" ")
            line = f"{head} \\{end}{tail}"
        found += [line, ""] if gaps and rng.random() < 0.3 else [line]
    text = end.join(found) + (end if rng.random() < 0.8 else "")
    return text.encode("utf-8-sig" if rng.random() < 0.2 else "utf-8")


def made_ply(rng):
    """A PLY file in one of three forms, with colours of vertices of any type."""
    form = str(rng.choice(["ascii", "binary_little_endian", "binary_big_endian"]))
    faces = drawn_faces(rng)
    has = {name for name in ("colors", "normals", "uv") if rng.random() < 0.5}
    made = Made("ply", b"", faces, has)
    kind = str(rng.choice(list(WHITES)))
    white = WHITES[kind]
    vertex = [("float", "x"), ("float", "y"), ("float", "z")]
    vertex += [("float", f"n{axis}") for axis in "xyz"] if "normals" in has else []
    vertex += [(kind, name) for name in ("red", "green", "blue")] if "colors" in has else []
    on_corners = "uv" in has and rng.random() < 0.5
    vertex += [("float", "s"), ("float", "t")] if "uv" in has and not on_corners else []
    extra = rng.random() < 0.3
    vertex += [("list uchar short", "bones")] if extra else []
    rows, lists = [], []
    for face in faces:
        first = len(rows)
        for k in range(len(face.places)):
            color = face.colors[k] / 255 * white
            color = color if isinstance(white, float) else np.rint(color).astype(int)
            face.colors[k] = np.rint(np.asarray(color, float) / white * 255)
            row = [*face.places[k], *(face.normals[k] if "normals" in has else [])]
            row += list(color) if "colors" in has else []
            row += list(face.uv[k]) if "uv" in has and not on_corners else []
            rows.append([*row, (1, 2, 3)[: int(rng.integers(4))]] if extra else row)
        lists.append((tuple(range(first, len(rows))), tuple(face.uv.reshape(-1)) if on_corners else ()))
    bad = drawn_bad(rng, "lacking", "small", "nan")
    if bad["nan"]:
        none = [np.nan] * 3 + [0] * (len(vertex) - 3 - extra) + ([()] if extra else [])
        rows += [none] * bad["nan"]
    lists += [((0, 1), ())] * bad["small"] + [((0, 1, len(rows) + 5), ())] * bad["lacking"]
    made.said += sentences(bad)
    before = [("strand", [("list uint double", "weights"), ("uchar", "n")], [[(0.5,) * 2, 1], [(), 2]])]
    elements = [("vertex", vertex, rows), *(before if rng.random() < 0.3 else [])]
    count, corner = str(rng.choice(["uchar", "int", "ushort"])), str(rng.choice(["int", "uint", "ushort"]))
    properties = [(f"list {count} {corner}", str(rng.choice(["vertex_indices", "vertex_index"])))]
    properties += [("list uchar float", "texcoord")] if on_corners else []
    elements.append(("face", properties, [[part[0], part[1]][: len(properties)] for part in lists]))
    made.data = ply_data(rng, form, elements)
    return made


def ply_data(rng, form, elements):
    end = str(rng.choice(["\n", "\r\n", "\r"]))
    head = ["ply", f"format {form} 1.0", "comment made"]
    body, lines = b"", []
    for name, properties, rows in elements:
        head += [f"element {name} {len(rows)}", *(f"property {kind} {own}" for kind, own in properties)]
        for row in rows:
            words = []
            for (kind, _), value in zip(properties, row, strict=True):
                kinds = kind.split()
                pairs = [(kinds[0], value)]
                if kinds[0] == "list":
                    pairs = [(kinds[1], len(value)), *((kinds[2], one) for one in value)]
                order = ">" if "big" in form else "<"
                words += [number(one) if k in ("float", "double") else str(int(one)) for k, one in pairs]
                if form != "ascii":
                    body += b"".join(struct.pack(order + CODES[k], one) for k, one in pairs)
            lines.append(" ".join(words))
    start = (end.join(head) + end + "end_header" + end).encode()
    return start + (end.join([*lines, ""]).encode() if form == "ascii" else body)


def made_stl(rng):
    faces = drawn_faces(rng, only_triangles=True)
    made = Made("stl", b"", faces, set())
    bad = int(rng.integers(1, 4)) if rng.random() < 0.2 else 0
    if bad:
        made.said.append(f"{bad} triangle{'s have' if bad > 1 else ' has'} a corner that is not finite")
    corners = [face.places for face in faces] + [np.full((3, 3), np.nan)] * bad
    if rng.random() < 0.5:
        count = int(rng.choice([len(corners), 0, 0xFFFFFFFF]))
        rows = (struct.pack("<12fH", 0, 0, 1, *map(float, each.reshape(-1)), 0) for each in corners)
        made.data = bytes(80) + struct.pack("<I", count) + b"".join(rows)
        return made
    lines = ["solid part 1"]
    for each in corners:
        lines += ["facet normal 0 0 1", "outer loop", *("vertex " + " ".join(map(number, place)) for place in each)]
        lines += ["endloop", "endfacet"]
    made.data = joined(rng, [*lines, "endsolid part 1"])
    return made


def made_off(rng):
    faces = drawn_faces(rng)
    made = Made("off", b"", faces, set())
    bad = drawn_bad(rng, "lacking", "small", "nan")
    rows, lists = [], []
    for face in faces:
        lists.append(range(len(rows), len(rows) + len(face.places)))
        rows += face.places.tolist()
    rows += [[np.nan] * 3] * bad["nan"]
    lists += [(0, 1)] * bad["small"] + [(0, 1, len(rows) + 5)] * bad["lacking"]
    made.said += sentences(bad)
    counts = f"{len(rows)} {len(lists)} 0"
    head = [f"OFF {counts}"] if rng.random() < 0.3 else ["OFF", counts]
    lines = [
        *head,
        *(" ".join(map(number, row)) for row in rows),
        *(f"{len(f)} {' '.join(map(str, f))}" for f in lists),
    ]
    made.data = joined(rng, lines)
    return made


MAKERS = {"obj": made_obj, "ply": made_ply, "stl": made_stl, "off": made_off}


def made_file(seed):
    """The file of a seed."""
    rng = np.random.default_rng(seed)
    return list(MAKERS.values())[seed % len(MAKERS)](rng)
