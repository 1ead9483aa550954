"""Simple triangle meshes for the tests of the core, around the origin with normals pointing outwards."""

import numpy as np

from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate


def sphere(rings: int = 12) -> TriangleMesh:
    """Return a closed unit sphere of 4 rings (rings - 1) triangles."""
    polar, sides = np.linspace(0.0, np.pi, rings + 1)[1:-1], 2 * rings
    azimuth = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    parallels = [np.column_stack([np.sin(angle) * circle, np.full(sides, np.cos(angle))]) for angle in polar]
    vertices = np.concatenate([*parallels, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    top, bottom, last = len(vertices) - 2, len(vertices) - 1, (rings - 2) * sides
    here = np.arange(sides)
    following = (here + 1) % sides
    lower = np.arange(1, rings - 1)[:, None] * sides
    bands = split_quads(lower + here, lower + following, lower - sides + following, lower - sides + here).reshape(-1, 3)
    caps = [
        np.stack([np.full(sides, top), here, following], axis=1),
        np.stack([np.full(sides, bottom), last + following, last + here], axis=1),
    ]
    return TriangleMesh(vertices, np.concatenate([bands, *caps]).astype(np.int32))


def split_quads(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return two triangles (..., 2, 3) for each quadrilateral a, b, c, d."""
    return np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=-2)


def sheet(side: int = 6, height=lambda x, y: 0.0 * (x + y)) -> TriangleMesh:
    """Return the graph of `height` over the unit square 0..1: 2 side^2 triangles facing up."""
    x, y = np.meshgrid(np.linspace(0.0, 1.0, side + 1), np.linspace(0.0, 1.0, side + 1), indexing="ij")
    index = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    triangles = split_quads(index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    return TriangleMesh(np.stack([x, y, height(x, y)], axis=2).reshape(-1, 3), triangles.reshape(-1, 3).astype(np.int32))


def box(sides: tuple[float, float, float] = (1.0, 1.0, 1.0), cuts: int = 3) -> TriangleMesh:
    """Return a closed box of 12 cuts^2 triangles."""
    flat = sheet(cuts)
    faces = []
    for axis in range(3):
        upper = np.roll(flat.vertices + [0.0, 0.0, 1.0], axis, axis=1)
        faces += [TriangleMesh(upper, flat.triangles), TriangleMesh(np.roll(flat.vertices, axis, axis=1), flat.triangles[:, ::-1])]
    soup = concatenate(faces)
    return TriangleMesh((soup.vertices - 0.5) * np.array(sides), soup.triangles)


def cylinder(radius: float = 1.0, length: float = 2.0, sides: int = 48, cuts: int = 6) -> TriangleMesh:
    """Return the side of a cylinder around the Z axis, without caps."""
    azimuth, heights = 2.0 * np.pi * np.arange(sides) / sides, np.linspace(-0.5, 0.5, cuts + 1) * length
    vertices = np.stack(
        [np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.full(sides, z)]) for z in heights]
    ).reshape(-1, 3)
    here = np.arange(sides)
    following, low = (here + 1) % sides, np.arange(cuts)[:, None] * sides
    triangles = split_quads(low + here, low + following, low + sides + following, low + sides + here)
    return TriangleMesh(vertices, triangles.reshape(-1, 3).astype(np.int32))


def soup(count: int, size: float = 0.1, seed: int = 0) -> TriangleMesh:
    """Return unconnected random triangles, normally distributed with standard deviation 1."""
    random = np.random.default_rng(seed)
    corners = random.normal(size=(count, 1, 3)) + size * random.normal(size=(count, 3, 3))
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3))


def leaf_cards(count: int = 100, size: float = 0.03, spread: float = 0.4, seed: int = 0) -> TriangleMesh:
    """Return unconnected rhombi of two triangles each, such as leaves, normally distributed with standard deviation `spread`."""
    random = np.random.default_rng(seed)
    centers = spread * random.normal(size=(count, 3))
    u, v = size * random.normal(size=(2, count, 3))
    vertices = np.stack([centers - u, centers + v, centers + u, centers - v], axis=1).reshape(-1, 3)
    first = 4 * np.arange(count)
    return TriangleMesh(vertices, split_quads(first, first + 1, first + 2, first + 3).reshape(-1, 3).astype(np.int32))


def bumpy_sphere(rings: int = 10, height: float = 0.1, seed: int = 0) -> TriangleMesh:
    """Return a sphere with random radii 1 to 1 + height and coordinates that are multiples of 2^-20: no two distances are equal, and
    translating it by integers or scaling it by powers of two causes no rounding."""
    smooth = sphere(rings)
    radii = 1.0 + height * np.random.default_rng(seed).random((len(smooth.vertices), 1))
    return TriangleMesh(np.round(smooth.vertices * radii * 2.0**20) / 2.0**20, smooth.triangles)


def random_rotation(seed: int) -> np.ndarray:
    """Return a random rotation matrix (3, 3)."""
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return rotation * np.sign(np.linalg.det(rotation))
