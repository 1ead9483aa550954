"""Shapes with known answers, as the tests of the core need them: triangle meshes about the origin, normals outwards."""

import numpy as np

from farfield.addon.core.mesh import TriangleMesh, merge


def sphere(rings: int = 12) -> TriangleMesh:
    """A closed unit sphere of 4 rings (rings - 1) triangles."""
    polar, sides = np.linspace(0.0, np.pi, rings + 1)[1:-1], 2 * rings
    turn = 2.0 * np.pi * np.arange(sides) / sides
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    belts = [np.column_stack([np.sin(angle) * around, np.full(sides, np.cos(angle))]) for angle in polar]
    vertices = np.concatenate([*belts, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    top, bottom, last = len(vertices) - 2, len(vertices) - 1, (rings - 2) * sides
    here = np.arange(sides)
    ahead = (here + 1) % sides
    lower = np.arange(1, rings - 1)[:, None] * sides
    strips = strip(lower + here, lower + ahead, lower - sides + ahead, lower - sides + here).reshape(-1, 3)
    caps = [np.stack([np.full(sides, top), here, ahead], axis=1), np.stack([np.full(sides, bottom), last + ahead, last + here], axis=1)]
    return TriangleMesh(vertices, np.concatenate([strips, *caps]).astype(np.int32))


def strip(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Two triangles (..., 2, 3) for each quadrilateral a, b, c, d."""
    return np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=-2)


def sheet(side: int = 6, height=lambda x, y: 0.0 * (x + y)) -> TriangleMesh:
    """The graph of `height` over the unit square 0..1, 2 side^2 triangles that look up."""
    x, y = np.meshgrid(np.linspace(0.0, 1.0, side + 1), np.linspace(0.0, 1.0, side + 1), indexing="ij")
    index = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    triangles = strip(index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    return TriangleMesh(np.stack([x, y, height(x, y)], axis=2).reshape(-1, 3), triangles.reshape(-1, 3).astype(np.int32))


def box(sides: tuple[float, float, float] = (1.0, 1.0, 1.0), cuts: int = 3) -> TriangleMesh:
    """A closed box of 12 cuts^2 triangles."""
    flat = sheet(cuts)
    faces = []
    for axis in range(3):
        upper = np.roll(flat.vertices + [0.0, 0.0, 1.0], axis, axis=1)
        faces += [TriangleMesh(upper, flat.triangles), TriangleMesh(np.roll(flat.vertices, axis, axis=1), flat.triangles[:, ::-1])]
    soup = merge(faces)
    return TriangleMesh((soup.vertices - 0.5) * np.array(sides), soup.triangles)


def cylinder(radius: float = 1.0, length: float = 2.0, sides: int = 48, cuts: int = 6) -> TriangleMesh:
    """The open side of a cylinder around the Z axis."""
    turn, along = 2.0 * np.pi * np.arange(sides) / sides, np.linspace(-0.5, 0.5, cuts + 1) * length
    vertices = np.stack([np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(sides, z)]) for z in along]).reshape(-1, 3)
    here = np.arange(sides)
    ahead, low = (here + 1) % sides, np.arange(cuts)[:, None] * sides
    triangles = strip(low + here, low + ahead, low + sides + ahead, low + sides + here)
    return TriangleMesh(vertices, triangles.reshape(-1, 3).astype(np.int32))


def soup(count: int, size: float = 0.1, seed: int = 0) -> TriangleMesh:
    """Triangles that do not touch, at random in a ball of standard deviation 1."""
    random = np.random.default_rng(seed)
    corners = random.normal(size=(count, 1, 3)) + size * random.normal(size=(count, 3, 3))
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3))


def cards(count: int = 100, size: float = 0.03, spread: float = 0.4, seed: int = 0) -> TriangleMesh:
    """Loose rhombi of two triangles each, such as leaves, at random in a ball of standard deviation `spread`."""
    random = np.random.default_rng(seed)
    centers = spread * random.normal(size=(count, 3))
    across, along = size * random.normal(size=(2, count, 3))
    vertices = np.stack([centers - across, centers + along, centers + across, centers - along], axis=1).reshape(-1, 3)
    first = 4 * np.arange(count)
    return TriangleMesh(vertices, strip(first, first + 1, first + 2, first + 3).reshape(-1, 3).astype(np.int32))


def bumpy_sphere(rings: int = 10, height: float = 0.1, seed: int = 0) -> TriangleMesh:
    """A sphere with vertices at random radii 1 to 1 + height, at coordinates that are whole multiples of 2^-20: no two distances are equal,
    and moving it by whole numbers or scaling it by powers of two rounds nothing."""
    smooth = sphere(rings)
    radii = 1.0 + height * np.random.default_rng(seed).random((len(smooth.vertices), 1))
    return TriangleMesh(np.round(smooth.vertices * radii * 2.0**20) / 2.0**20, smooth.triangles)


def rotation(seed: int) -> np.ndarray:
    """A random rotation matrix (3, 3)."""
    turned = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return turned * np.sign(np.linalg.det(turned))
