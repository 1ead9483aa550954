"""Random inputs for property tests and for the campaigns: names, meshes, damaged files, formulas, values of settings.

All functions draw from a `random.Random`. A campaign seeds it, so that a case can be repeated; `strategies.py` lets Hypothesis control it,
so that a failing example is simplified.
"""

import math
from dataclasses import dataclass
from random import Random

from farfield.addon.core.settings import Description, Unit

PLAIN_NAMES = ("Cube", "Tree", "Rock.001", "House", "Ball")
ABSOLUTE_NAME = "/farfield-campaign/x"  # no data-block may choose where files go
ODD_NAMES = (
    " ", ".", "..", ".hidden", "A/B", "../../escaped", ABSOLUTE_NAME, "a\\b", "line\nbreak", "tab\tname", "\x7f", "x" * 63, "é",
    "e\u0301",
    "立方体", "名" * 21, "🌲", "\u202egnp.exe", "CON", "nul.txt", "a:b*?", 'a"b', "-flag", "%s{0}", "$HOME", "Cube ", "cube", "CUBE",
    "0", "nan",
)  # fmt: skip
NUMBERS = (0.0, -0.0, 1.0, -1.0, 0.5, 1e-30, 1e-9, 1e7, 1e30, 3e38, -3e38, 1e300, math.inf, -math.inf, math.nan)
BAD_TEXTS = (
    "", " ", "abc", "nan", "inf", "-inf", "1e400", "-1", "1e9", "0x10", "1.5.2", "%", "5 %", "1,2", "1,2,3,4", "nan,0,0", "0,0,0",
    "1e400,0,0", "True", "9" * 400, "\u0661", "--", "{}", "None", "1;2;3", "serial,serial", "dask:", "processes:0", "processes:x",
    "dask:nonsense",
)  # fmt: skip
NUMBER_TOKENS = (b"nan", b"inf", b"-inf", b"1e39", b"-1", b"0", b"1e-45", b"99999999999", b"2147483648", b"4294967295", b"", b"x", b"1e999")
FORMULA_PARTS = (
    "x", "y", "z", "0", "1e308", "-1", "pi", "{0}+{1}", "{0}-{1}", "{0}*{1}", "{0}/{1}", "{0}//{1}", "{0}%{1}", "{0}^{1}", "-{0}", "({0})",
    "sin({0})", "log({0})", "sqrt({0})", "exp({0})", "arctan2({0},{1})", "min({0},{1})", "where({0}>{1},{0},{2})", "clip({0},{1},{2})",
    "xor({0},{1})", "{0}<{1}", "hypot({0},{1})",
)  # fmt: skip
BAD_FORMULAS = (
    "", "x+", "((z", "a", "x.y", "f(x)", "sin()", "sin(x,y)", "sin(*x)", "lambda: x", "[x]", "x if y else z", "'x'", "__import__('os')",
    "x;y", "x\ny", "1" * 2500, "(" * 900, "x" + "**2" * 300, "\x00", "\uff58", "nan", "1j", "x:=1", "not x", "x and y", "9**9**9**9",
)  # fmt: skip


@dataclass(frozen=True)
class PolygonMesh:
    """A mesh as its files describe it: positions of vertices, and faces of three or more indices."""

    vertices: tuple[tuple[float, float, float], ...]
    faces: tuple[tuple[int, ...], ...]

    def to_obj(self, name: str = "Mesh") -> bytes:
        """Return the mesh as an .obj file."""
        lines = [f"o {name}", *(f"v {x!r} {y!r} {z!r}" for x, y, z in self.vertices)]
        lines += ["f " + " ".join(str(index + 1) for index in face) for face in self.faces]
        return ("\n".join(lines) + "\n").encode("utf-8")

    def to_ply(self) -> bytes:
        """Return the mesh as an ASCII .ply file."""
        header = ["ply", "format ascii 1.0", f"element vertex {len(self.vertices)}", *(f"property float {axis}" for axis in "xyz")]
        header += [f"element face {len(self.faces)}", "property list uchar int vertex_indices", "end_header"]
        vertices = [f"{x!r} {y!r} {z!r}" for x, y, z in self.vertices]
        faces = [" ".join(str(number) for number in (len(face), *face)) for face in self.faces]
        return ("\n".join([*header, *vertices, *faces]) + "\n").encode("ascii")


def random_name(random: Random) -> str:
    """Return the name of a data-block: an ordinary one, or one that is special for files, shells or people."""
    return random.choice(PLAIN_NAMES if random.random() < 0.5 else ODD_NAMES)


def random_mesh(random: Random) -> PolygonMesh:
    """Return a small mesh, often with defects: without area, not finite, huge, tiny, far apart, not manifold, with n-gons."""
    mesh = random.choice((_box, _grid, _fan, _soup, _polygon, _point_cloud))(random)
    for change in random.sample(
        (_scale, _separate, _collapse, _corrupt_position, _repeat_faces, _flip, _add_page), random.choice((0, 0, 1, 1, 2))
    ):
        mesh = change(random, mesh)
    return mesh


def damage(random: Random, content: bytes) -> bytes:
    """Return `content` with one to four random changes: truncated, overwritten, repeated or removed parts, other numbers in text."""
    for _ in range(random.randint(1, 4)):
        content = random.choice((_truncate, _overwrite, _overwrite, _remove, _repeat, _replace_number, _replace_number, _replace_all))(
            random, content
        )
    return content


def random_formula(random: Random, depth: int = 3) -> str:
    """Return a formula of x, y and z that is often valid, not always defined, and sometimes no formula at all."""
    if random.random() < 0.15:
        return random.choice(BAD_FORMULAS)
    return _expression(random, depth)


def valid_value(random: Random, description: Description, limits: tuple[float, float] | None = None) -> str | bool:
    """Return a valid value of a setting, as text of a flag or as a Boolean. `limits` replaces its range, in internal units."""
    if description.type is bool:
        return random.random() < 0.5
    if description.choices:
        return random.choice(list(description.choices))
    if description.type is tuple:
        return ",".join(f"{random.uniform(-1.0, 1.0):.3g}" for _ in description.default)
    if description.type is str:
        return random_name(random)
    minimum, maximum = limits or (description.minimum or 0.0, description.maximum or 1e6)
    if description.type is int:
        return str(random.randint(int(minimum), int(maximum)))
    value = random.choice((minimum, maximum, random.uniform(minimum, maximum)))
    return (
        f"{value * 100:.6g}%"
        if description.unit is Unit.FRACTION
        else f"{math.degrees(value) if description.unit is Unit.ANGLE else value:.6g}"
    )


def bad_value(random: Random) -> str:
    """Return text that few settings accept as their value."""
    return random.choice(BAD_TEXTS)


def _box(random: Random) -> PolygonMesh:
    corners = tuple((x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0))
    return PolygonMesh(corners, ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)))


def _grid(random: Random) -> PolygonMesh:
    side = random.randint(1, 6)
    vertices = tuple((float(x), float(y), random.uniform(-0.3, 0.3)) for x in range(side + 1) for y in range(side + 1))
    corners = [(x * (side + 1) + y, (x + 1) * (side + 1) + y) for x in range(side) for y in range(side)]
    return PolygonMesh(vertices, tuple((low, high, high + 1, low + 1) for low, high in corners))


def _fan(random: Random) -> PolygonMesh:
    """Triangles that all share one edge."""
    count = random.randint(1, 8)
    vertices = ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), *((math.cos(index), math.sin(index), 0.0) for index in range(count)))
    return PolygonMesh(vertices, tuple((0, 1, 2 + index) for index in range(count)))


def _soup(random: Random) -> PolygonMesh:
    count = random.randint(3, 20)
    vertices = tuple((random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0)) for _ in range(count))
    return PolygonMesh(vertices, tuple(tuple(random.sample(range(count), 3)) for _ in range(random.randint(1, 20))))


def _polygon(random: Random) -> PolygonMesh:
    count = random.randint(3, 60)
    corners = [(math.cos(math.tau * index / count), math.sin(math.tau * index / count)) for index in range(count)]
    if random.random() < 0.3:
        random.shuffle(corners)
    return PolygonMesh(tuple((x, y, 0.0) for x, y in corners), (tuple(range(count)),))


def _point_cloud(random: Random) -> PolygonMesh:
    count = random.randint(0, 30)
    return PolygonMesh(tuple((random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0)) for _ in range(count)), ())


def _scale(random: Random, mesh: PolygonMesh) -> PolygonMesh:
    factors = [random.choice((0.0, 1.0, 1.0, -1.0, 1e-30, 1e-6, 1e6, 1e18, 1e30)) for _ in range(3)]
    if random.random() < 0.6:
        factors = [factors[0]] * 3
    return _moved(mesh, lambda position: tuple(value * factor for value, factor in zip(position, factors, strict=True)))


def _separate(random: Random, mesh: PolygonMesh) -> PolygonMesh:
    """Add a copy far away."""
    distance = random.choice((1e3, 1e7, 1e15, 1e30))
    count = len(mesh.vertices)
    copy = _moved(mesh, lambda position: (position[0] + distance, *position[1:]))
    return PolygonMesh(mesh.vertices + copy.vertices, mesh.faces + tuple(tuple(index + count for index in face) for face in mesh.faces))


def _collapse(random: Random, mesh: PolygonMesh) -> PolygonMesh:
    """Flatten the mesh to a plane, a line or a point."""
    axes = random.choice(((2,), (1, 2), (0, 1, 2)))
    return _moved(mesh, lambda position: tuple(0.0 if axis in axes else value for axis, value in enumerate(position)))


def _corrupt_position(random: Random, mesh: PolygonMesh) -> PolygonMesh:
    if not mesh.vertices:
        return mesh
    vertices = [list(position) for position in mesh.vertices]
    vertices[random.randrange(len(vertices))][random.randrange(3)] = random.choice(NUMBERS)
    return PolygonMesh(tuple(tuple(position) for position in vertices), mesh.faces)


def _repeat_faces(random: Random, mesh: PolygonMesh) -> PolygonMesh:
    return PolygonMesh(mesh.vertices, mesh.faces + mesh.faces[: random.randint(0, len(mesh.faces))])


def _flip(random: Random, mesh: PolygonMesh) -> PolygonMesh:
    return PolygonMesh(mesh.vertices, tuple(face[::-1] if random.random() < 0.5 else face for face in mesh.faces))


def _add_page(random: Random, mesh: PolygonMesh) -> PolygonMesh:
    """Add a face to the first edge, which then has at least two."""
    if not mesh.faces:
        return mesh
    apex = (random.uniform(-2.0, 2.0), random.uniform(-2.0, 2.0), random.uniform(-2.0, 2.0))
    return PolygonMesh((*mesh.vertices, apex), (*mesh.faces, (*mesh.faces[0][:2], len(mesh.vertices))))


def _moved(mesh: PolygonMesh, move) -> PolygonMesh:
    return PolygonMesh(tuple(move(position) for position in mesh.vertices), mesh.faces)


def _position(random: Random, content: bytes) -> int:
    """Return a position in `content`, in the first 200 bytes half of the time: there are the headers."""
    return random.randrange(min(len(content), 200) if random.random() < 0.5 else len(content))


def _truncate(random: Random, content: bytes) -> bytes:
    return content[: random.randint(0, len(content))]


def _overwrite(random: Random, content: bytes) -> bytes:
    if not content:
        return content
    start = _position(random, content)
    patch = random.choice(
        (b"\0", b"\xff", b"\xff\xff\xff\xff", b"\0\0\0\x80", b"\x7f\xff\xff\xff", b"\0" * 64, bytes([random.randrange(256)]))
    )
    return content[:start] + patch + content[start + len(patch) :]


def _remove(random: Random, content: bytes) -> bytes:
    start = random.randint(0, len(content))
    return content[:start] + content[start + random.randint(1, 64) :]


def _repeat(random: Random, content: bytes) -> bytes:
    start = random.randint(0, len(content))
    return content[:start] + content[start : start + random.randint(1, 256)] * 2 + content[start:]


def _replace_number(random: Random, content: bytes) -> bytes:
    """Replace one run of digits near a random position."""
    if not content:
        return content
    start = _position(random, content)
    while start < len(content) and not content[start : start + 1].isdigit():
        start += 1
    end = start
    while end < len(content) and content[end : end + 1].isdigit():
        end += 1
    return content[:start] + random.choice(NUMBER_TOKENS) + content[end:] if end > start else content


def _replace_all(random: Random, content: bytes) -> bytes:
    if random.random() < 0.7:
        return content
    return random.choice((b"", b"\0" * 1000, b"BLENDER", b"PK\x03\x04", b"<html></html>", bytes(random.randrange(256) for _ in range(200))))


def _expression(random: Random, depth: int) -> str:
    part = random.choice(FORMULA_PARTS if depth else FORMULA_PARTS[:7])
    return part.format(*(_expression(random, depth - 1) for _ in range(3))) if "{" in part else part
