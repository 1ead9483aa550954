"""Grass, bushes, trees and rocks as meshes.

Lengths are meters, up is +Z, the ground is at z = 0. The index of the material is 0 for bark and stone, and 1 for leaves.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull

BLADE_RINGS = np.array([0.0, 0.4, 0.75, 1.0])  # Of a blade of grass, along its length; the last one is its tip.
CONIFER_HEIGHT, TRUNK_RADIUS, TRUNK_SIDES = 11.0, 0.16, 7
FAN_SEGMENTS = 4  # Of a branch, along its length.
BUSH_FORMS = ((1.0, 1.0), (1.5, 0.8), (0.65, 1.0), (1.25, 0.3))  # How wide bushes are, and the part of their leaves that they have.
TREE_CROWN, TREE_REACH = (0.0, 0.0, 3.6), (2.4, 2.4, 2.4)  # Center and half axes of the crown of a broadleaf tree.
STONES_BESIDE, STONE_SIZES = 16, (0.1, 0.65)  # Of rubble: small rocks around one of 1 m, and their sizes.
LEAF = np.array(
    [(0.0, 0.0, 0.0), (0.36, 0.5, 0.08), (0.0, 1.0, -0.05), (-0.36, 0.5, 0.08)]
)  # Across, along, above; relative to its length.


@dataclass(frozen=True)
class Model:
    """A mesh.

    Attributes:
        vertices: (V, 3) float64, meters.
        triangles: (T, 3) int64, counterclockwise seen from outside.
        materials: (T,) int64, 0 for bark and stone, 1 for leaves.
        shades: (V,) float64, factors of the color.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    materials: np.ndarray
    shades: np.ndarray


@dataclass(frozen=True)
class RockForm:
    """A kind of shape of rocks.

    Attributes:
        points: number of random points, of which the rock is the hull.
        roundness: from 0, points of a normal distribution, to 1, on an ellipsoid.
        axes: (3,) half axes of the ellipsoid.
        roughness: how far faces are broken up, relative to their edges.
    """

    points: int
    roundness: float
    axes: tuple[float, float, float]
    roughness: float


ROCK_FORMS = {
    "boulder": RockForm(24, 0.0, (0.42, 0.34, 0.26), 0.13),
    "slab": RockForm(14, 0.6, (0.5, 0.36, 0.11), 0.07),
    "block": RockForm(10, 0.7, (0.42, 0.36, 0.34), 0.09),
    "cobble": RockForm(28, 1.0, (0.45, 0.38, 0.3), 0.08),
    "shard": RockForm(9, 0.4, (0.55, 0.2, 0.24), 0.09),
}


def grass(seed: int, blades: int, radius: float, height: float, taper: float = 0.0) -> Model:
    """Return a tuft of `blades` in a circle with a radius, which droop outwards and are darker at the ground.

    taper: by how much blades are shorter at the border of the circle than at its center, where they are denser then; large tufts next to
    each other grow together so.
    """
    random = np.random.default_rng([seed, 1])
    angle, fraction = random.uniform(0.0, 2.0 * np.pi, blades), random.random(blades) ** (0.5 + 0.3 * taper)
    place = radius * fraction
    roots = np.column_stack([place * np.cos(angle), place * np.sin(angle), np.full(blades, -0.02)])
    lengths = height * random.uniform(0.45, 1.1, blades) * (1.0 - taper * fraction**2)
    lean = angle + random.normal(0.0, 0.9, blades)
    outward = np.column_stack([np.cos(lean), np.sin(lean), np.zeros(blades)])
    droop = random.uniform(0.15, 0.75, blades)
    along = BLADE_RINGS[None] * lengths[:, None]
    points = roots[:, None] + outward[:, None] * (droop[:, None] * along * BLADE_RINGS)[..., None]
    points[..., 2] += along * (1.0 - 0.35 * droop[:, None] * BLADE_RINGS)
    across = np.column_stack([-np.sin(lean), np.cos(lean), np.zeros(blades)]) * (0.018 * lengths + 0.0012)[:, None]
    wide = across[:, None] * np.array([1.0, 0.9, 0.55])[None, :, None]
    sides = np.stack([points[:, :3] - wide, points[:, :3] + wide], axis=2).reshape(blades, 6, 3)
    vertices = np.concatenate([sides, points[:, 3:]], axis=1)
    triangles = np.array([(0, 1, 3), (0, 3, 2), (2, 3, 5), (2, 5, 4), (4, 5, 6)])
    shades = np.array([0.45, 0.45, 0.8, 0.8, 1.0, 1.0, 1.1]) * random.uniform(0.75, 1.25, (blades, 1))
    return _repeat(vertices, triangles, shades)


def bush(seed: int, leaves: int, height: float, form: int = 0) -> Model:
    """Return a bush: twigs from the ground, and leaves around their ends.

    form: index of one of `BUSH_FORMS`; some are low and wide, others slender or nearly bare.
    """
    random = np.random.default_rng([seed, 2])
    twigs, (spread, leafy) = 24, BUSH_FORMS[form]
    leaves = round(leafy * leaves)
    angle = random.uniform(0.0, 2.0 * np.pi, twigs)
    reach = spread * height * random.uniform(0.1, 0.75, twigs)
    tops = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), height * random.uniform(0.4, 0.95, twigs) / spread**0.5])
    wood = _tubes(np.stack([0.05 * tops * [1.0, 1.0, 0.0], 0.5 * tops + [0.0, 0.0, 0.1 * height], tops], axis=1), 0.018 * height, 4)
    owners = random.integers(0, twigs, leaves)
    centers = tops[owners] * random.uniform(0.35, 1.0, (leaves, 1)) + random.normal(0.0, 0.07, (leaves, 3)) * height
    centers[:, 2] = np.maximum(centers[:, 2], 0.05 * height)
    inside = np.clip(np.linalg.norm(centers - [0.0, 0.0, 0.4 * height], axis=1) / (0.7 * height), 0.0, 1.0)
    length = 2.6 * height / np.sqrt(leaves / leafy) * random.uniform(0.6, 1.4, leaves)
    shades = (0.35 + 0.75 * inside) * random.uniform(0.8, 1.2, leaves)
    return join([wood, _leaves(centers, random.normal(size=(leaves, 3)) + [0.0, 0.0, 0.8], length, shades, random)])


def conifer(seed: int, detail: float) -> Model:
    """Return a spruce whose branches are fans of needles. detail: 1 for trees nearby, less for fewer and wider needles."""
    random = np.random.default_rng([seed, 3])
    trunk_points = np.linspace([0.0, 0.0, -0.3], [0.0, 0.0, CONIFER_HEIGHT], 7)[None]
    trunk = _tubes(trunk_points, TRUNK_RADIUS, TRUNK_SIDES, 0.04)
    whorls, per_whorl = round(34 * max(detail, 0.35) ** 0.5), 7
    heights = np.repeat(np.linspace(0.06, 0.985, whorls) ** 1.1, per_whorl) * CONIFER_HEIGHT
    heights = np.clip(heights + random.normal(0.0, 0.26, len(heights)) * (1.0 - heights / CONIFER_HEIGHT) ** 0.4, 0.4, CONIFER_HEIGHT)
    reach = 0.23 * (CONIFER_HEIGHT - heights) * random.uniform(0.7, 1.12, len(heights)) + np.clip(
        0.09 * (CONIFER_HEIGHT - heights), 0.03, 0.18
    )
    angles = np.tile(np.arange(per_whorl), whorls) * (2.0 * np.pi / per_whorl) + np.repeat(random.uniform(0.0, 6.3, whorls), per_whorl)
    outward = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
    rise = random.uniform(0.02, 0.22, len(heights)) - 0.35 * (1.0 - heights / CONIFER_HEIGHT)
    starts = np.column_stack([np.zeros((len(heights), 2)), heights])

    def at(fractions: np.ndarray) -> np.ndarray:
        """Return positions on all branches (B, F, 3), which hang, with tips that rise."""
        points = starts[:, None] + (fractions * reach[:, None])[..., None] * outward[:, None]
        points[..., 2] += reach[:, None] * (rise[:, None] * fractions - 0.30 * fractions**2 + 0.22 * fractions**4)
        return points

    branches = _tubes(at(np.linspace(0.0, 0.9, FAN_SEGMENTS)), 0.02, 3)
    twigs = round(30 * detail**0.5)
    fractions = np.sqrt(np.linspace(0.03, 1.0, twigs))
    bases = at(fractions)
    sides = np.cross([0.0, 0.0, 1.0], outward)
    sign = np.where(np.arange(twigs) % 2, 1.0, -1.0)[:, None]
    direction = 0.55 * outward[:, None] + 0.85 * sign * sides[:, None] + random.normal(0.0, 0.16, bases.shape)
    direction[..., 2] -= random.uniform(0.0, 0.9, bases.shape[:2])
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    lengths = (0.42 * reach[:, None] * (1.08 - fractions) + np.minimum(0.16, 0.5 * reach[:, None])) * random.uniform(
        0.8, 1.2, bases.shape[:2]
    )
    bases, direction, lengths = bases.reshape(-1, 3), direction.reshape(-1, 3), lengths.reshape(-1)
    per_twig = max(round(16 * detail), 2)
    count = len(bases) * per_twig
    along = np.tile((np.arange(per_twig) + 0.5) / per_twig, len(bases))
    roots = np.repeat(bases, per_twig, axis=0) + (along * np.repeat(lengths, per_twig))[:, None] * np.repeat(direction, per_twig, axis=0)
    turn = random.normal(size=(count, 3))
    ahead = 0.75 * np.repeat(direction, per_twig, axis=0) + 0.65 * turn / np.linalg.norm(turn, axis=1, keepdims=True)
    slender = np.clip(np.repeat(reach, twigs * per_twig), 0.15, 1.0)
    length = 0.16 * (16.0 / per_twig) ** 0.5 * slender * random.uniform(0.7, 1.2, count)
    from_trunk = np.hypot(roots[:, 0], roots[:, 1]) / (0.23 * CONIFER_HEIGHT + 0.3)
    shades = (0.4 + 0.75 * np.sqrt(np.clip(from_trunk, 0.0, 1.0))) * random.uniform(0.8, 1.2, count)
    width = 0.34 * (16.0 / per_twig) ** 0.1
    return join([trunk, branches, _leaves(roots, random.normal(size=(count, 3)), length, shades, random, ahead, width)])


def broadleaf(seed: int, leaves: int) -> Model:
    """Return a broadleaf tree about 6 m high: a trunk, limbs, and clusters of leaves around the ends of the limbs."""
    random = np.random.default_rng([seed, 5])
    limbs, reach = 26, TREE_REACH * random.uniform(0.8, 1.15, 3)
    direction = random.normal(size=(limbs, 3)) + [0.0, 0.0, 0.3]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    ends = TREE_CROWN + direction * reach * random.uniform(0.45, 0.8, (limbs, 1))
    stem = np.column_stack([random.normal(0.0, 0.12, (2, 2)), [1.0, 2.6]])
    trunk = _tubes(np.stack([[0.0, 0.0, -0.3], *stem])[None], 0.17, TRUNK_SIDES, 0.55)
    forks = stem[0] + (stem[1] - stem[0]) * random.uniform(0.0, 1.0, (limbs, 1))
    wood = _tubes(np.stack([forks, 0.5 * (forks + ends) + [0.0, 0.0, 0.2], ends], axis=1), 0.055, 4)
    owners = random.integers(0, limbs, leaves)
    around = random.normal(size=(leaves, 3))
    around *= random.random((leaves, 1)) ** 0.5 / np.linalg.norm(around, axis=1, keepdims=True)
    centers = ends[owners] + around * random.uniform(0.55, 1.0, (limbs, 1))[owners] * [1.0, 1.0, 0.75]
    inside = np.clip(np.linalg.norm((centers - TREE_CROWN) / (reach + 0.3), axis=1), 0.0, 1.0)
    shades = (0.45 + 0.5 * inside + 0.2 * around[:, 2]) * random.uniform(0.8, 1.2, leaves)
    length = 11.0 / np.sqrt(leaves) * random.uniform(0.7, 1.3, leaves)
    return join([trunk, wood, _leaves(centers, random.normal(size=(leaves, 3)) + around + [0.0, 0.0, 0.6], length, shades, random)])


def rubble(seed: int, detail: int) -> Model:
    """Return a rock about 1 m wide with small ones around it, most of them close to it. detail: as of `rock`."""
    random = np.random.default_rng([seed, 6])
    forms = list(ROCK_FORMS)
    rocks = [rock(seed, detail, forms[random.integers(len(forms))])]
    smallest, largest = STONE_SIZES
    for index in range(STONES_BESIDE):
        stone = rock(seed + index + 1, max(detail - 1, 1), forms[random.integers(len(forms))])
        size = sample_sizes(random.random(), smallest / largest) * largest
        angle, spin = random.uniform(0.0, 2.0 * np.pi, 2)
        distance = 0.3 + 0.5 * size + random.exponential(0.4)
        turn = np.array([[np.cos(spin), -np.sin(spin), 0.0], [np.sin(spin), np.cos(spin), 0.0], [0.0, 0.0, 1.0]])
        place = distance * np.array([np.cos(angle), np.sin(angle), 0.0])
        rocks.append(replace(stone, vertices=size * stone.vertices @ turn.T + place))
    return join(rocks)


def sample_sizes(random: np.ndarray | float, smallest: float) -> np.ndarray | float:
    """Return sizes from `smallest` to 1 for uniform random numbers from 0 to 1: the number of those above a size falls with its square."""
    return (smallest**-2.0 + random * (1.0 - smallest**-2.0)) ** -0.5


def rock(seed: int, detail: int, form: str = "boulder") -> Model:
    """Return a rock about 1 m wide, a third of it in the ground: a hull of random points, whose faces are broken up.

    detail: how often edges are halved. form: one of `ROCK_FORMS`.
    """
    random, shape = np.random.default_rng([seed, 4]), ROCK_FORMS[form]
    points = random.normal(size=(shape.points, 3))
    points *= shape.axes / np.linalg.norm(points, axis=1, keepdims=True) ** shape.roundness
    hull = ConvexHull(points)
    used, triangles = np.unique(hull.simplices, return_inverse=True)
    vertices, triangles = points[used], triangles.reshape(-1, 3)
    center = vertices.mean(axis=0)
    normals = np.cross(vertices[triangles[:, 1]] - vertices[triangles[:, 0]], vertices[triangles[:, 2]] - vertices[triangles[:, 0]])
    is_inward = (normals * (vertices[triangles[:, 0]] - center)).sum(axis=1) < 0.0
    triangles[is_inward] = triangles[is_inward][:, ::-1]
    roughness = shape.roughness
    for _ in range(detail):
        vertices, triangles = _split(vertices, triangles, roughness, random)
        roughness *= 0.8
    vertices -= [*vertices[:, :2].mean(axis=0), vertices[:, 2].min() + np.ptp(vertices[:, 2]) / 3.0]
    vertices /= np.ptp(vertices[:, :2], axis=0).max()
    shades = random.uniform(0.8, 1.15) * np.clip(0.75 + 0.5 * vertices[:, 2], 0.6, 1.1)
    return Model(vertices, triangles, np.zeros(len(triangles), np.int64), shades)


def join(models: list[Model]) -> Model:
    """Return one mesh of several."""
    offsets = np.cumsum([0, *(len(model.vertices) for model in models[:-1])])
    triangles = np.concatenate([model.triangles + offset for model, offset in zip(models, offsets, strict=True)])
    return Model(
        np.concatenate([model.vertices for model in models]),
        triangles,
        np.concatenate([model.materials for model in models]),
        np.concatenate([model.shades for model in models]),
    )


def _repeat(positions: np.ndarray, triangles: np.ndarray, shades: np.ndarray) -> Model:
    """Return N leaves with the positions (N, K, 3) and shades (N, K), each with `triangles`."""
    count, size = positions.shape[:2]
    repeated = (size * np.arange(count)[:, None, None] + triangles).reshape(-1, 3)
    shades = np.broadcast_to(shades, (count, size)).reshape(-1)
    return Model(positions.reshape(-1, 3), repeated, np.ones(len(repeated), np.int64), shades)


def _leaves(
    roots: np.ndarray,
    normals: np.ndarray,
    lengths: np.ndarray,
    shades: np.ndarray,
    random: np.random.Generator,
    along: np.ndarray | None = None,
    width: float = 1.0,
) -> Model:
    """Return leaves with `roots` (N, 3), `normals` (N, 3) of any length, `lengths` and `shades` (N,).

    along: (N, 3) directions, random ones without. width: relative to `LEAF`.
    """
    along = random.normal(size=roots.shape) if along is None else along
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, normals)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    frames = np.stack([width * across, along, np.cross(across, along)], axis=1) * lengths[:, None, None]
    positions = roots[:, None] + np.einsum("lk,nki->nli", LEAF, frames)
    return _repeat(positions, np.array([(0, 1, 2), (0, 2, 3)]), shades[:, None])


def _tubes(points: np.ndarray, radius: float, sides: int, taper: float = 0.25) -> Model:
    """Return tubes around polylines (N, P, 3), which taper from a radius to a fraction of it."""
    count, rings = points.shape[:2]
    axes = points[:, -1] - points[:, 0]
    first = np.cross(axes, np.eye(3)[np.abs(axes).argmin(axis=1)])
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-9)
    second = np.cross(axes, first)
    second /= np.maximum(np.linalg.norm(second, axis=1, keepdims=True), 1e-9)
    angles = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.cos(angles)[:, None] * first[:, None] + np.sin(angles)[:, None] * second[:, None]
    radii = radius * np.linspace(1.0, taper, rings)
    vertices = points[:, :, None] + radii[:, None, None] * circle[:, None]
    side = np.arange(sides)
    ring = np.stack([side, (side + 1) % sides, (side + 1) % sides + sides, side + sides], axis=1)
    starts = sides * (rings * np.arange(count)[:, None] + np.arange(rings - 1)).reshape(-1)
    quads = (starts[:, None, None] + ring).reshape(-1, 4)
    triangles = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    vertices = vertices.reshape(-1, 3)
    return Model(vertices, triangles, np.zeros(len(triangles), np.int64), np.ones(len(vertices)))


def _split(vertices: np.ndarray, triangles: np.ndarray, roughness: float, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return a mesh with all triangles split into four, and vertices on edges moved by up to `roughness` times the length of the edge."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, numbers = np.unique(edges, axis=0, return_inverse=True)
    ends = vertices[unique]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1, keepdims=True)
    midpoints = ends.mean(axis=1) + random.normal(size=(len(unique), 3)) * roughness * lengths
    a, b, c = (len(vertices) + numbers.reshape(-1, 3)).T
    corners = triangles.T
    parts = [(corners[0], a, c), (a, corners[1], b), (c, b, corners[2]), (a, b, c)]
    return np.concatenate([vertices, midpoints]), np.concatenate([np.stack(part, axis=1) for part in parts])
