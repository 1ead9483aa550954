"""A broadleaf tree grown from a seed: trunk and branches by space colonisation, thousands of leaf cards on the twigs.

The skeleton follows Runions, Lane and Prusinkiewicz 2007: points spread in the crown pull the nearest branch ends towards them until they
are reached. Branches are as thick as the twigs they carry (da Vinci's rule), and every leaf card shows a sprig with real alpha.
Lengths are metres, up is +Z, the trunk stands on the origin.
"""

from dataclasses import dataclass

import bpy
import numpy as np
from scipy.spatial import cKDTree

from demo_materials import SPRIGS_A_SIDE, bark_material, leaf_material

TRUNK_HEIGHT = 1.9
CROWN_CENTER = np.array([0.0, 0.0, 4.7])
CROWN_RADII = np.array([2.5, 2.5, 2.75])
CROWN_POINTS = 900
STEP = 0.17
REACH = 1.5
REACHED = 0.36
MAX_ROUNDS = 120
TWIG_RADIUS = 0.0075
THICKNESS_EXPONENT = 2.1  # children's radii to this power add up to their parent's; da Vinci's own 2 gives clumsy limbs
SIDES_BY_RADIUS = ((0.045, 12), (0.016, 6), (0.0, 3))


@dataclass(frozen=True)
class Skeleton:
    """N nodes from the ground to the twigs: positions (N, 3), radii (N,), parents (N,) int: -1 at the root, else smaller than the child."""

    positions: np.ndarray
    parents: np.ndarray
    radii: np.ndarray


def grow(seed: int = 0, leaves: int = 6000) -> list[bpy.types.Object]:
    """Grow a tree into the current scene: the object of its trunk and branches, and the object of its `leaves` leaf cards.

    Equal seeds give equal trees; the branches do not depend on the number of leaves.
    """
    skeleton = grow_skeleton(seed)
    vertices, polygons, uvs = tubes(skeleton)
    trunk = _add_object("Tree", vertices, polygons, uvs, bark_material())
    trunk.data.shade_smooth()
    vertices, polygons, uvs, tints = leaf_cards(skeleton, leaves, seed)
    foliage = _add_object("Tree Leaves", vertices, polygons, uvs, leaf_material(seed))
    attribute = foliage.data.color_attributes.new("Tint", "FLOAT_COLOR", "POINT")
    attribute.data.foreach_set("color", tints.astype(np.float32).ravel())
    return [trunk, foliage]


def grow_skeleton(seed: int) -> Skeleton:
    """The branches of the tree of this seed."""
    random = np.random.default_rng([seed, 1])
    attractors = _crown_points(random)
    heights = np.arange(0.0, TRUNK_HEIGHT, STEP)
    sway = 0.07 * np.sin(heights[:, None] * random.uniform(1.0, 1.8, 2) + random.uniform(0.0, 6.0, 2))
    positions = np.column_stack([sway - sway[0], heights])
    parents = np.arange(len(positions)) - 1
    for _ in range(MAX_ROUNDS):
        tree = cKDTree(positions)
        distances, nearest = tree.query(attractors)
        attractors, nearest = attractors[distances > REACHED], nearest[distances > REACHED]
        pulled = np.linalg.norm(attractors - positions[nearest], axis=1) < REACH
        if not pulled.any():
            if positions[-1, 2] > CROWN_CENTER[2]:
                break
            pulled = np.ones(len(attractors), bool)  # the trunk has not come within reach of the crown yet
        ends, new = _pulled_ends(positions, attractors[pulled], nearest[pulled], random)
        free = tree.query(new)[0] > 0.4 * STEP
        if not free.any():
            break
        positions = np.concatenate([positions, new[free]])
        parents = np.concatenate([parents, ends[free]])
    return Skeleton(_relaxed(positions, parents), parents, _thicknesses(positions, parents))


def tubes(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tapering tubes around the branches: vertices (V, 3), quadrilaterals (F, 4) and their corner UVs (F, 4, 2) in metres."""
    chain_of = _chains(skeleton)
    rings = _rings(skeleton, chain_of)
    parts, offset = [], 0
    thickest = np.zeros(chain_of.max() + 1)
    np.maximum.at(thickest, chain_of, skeleton.radii)
    sides_of = np.select([thickest >= radius for radius, _ in SIDES_BY_RADIUS], [sides for _, sides in SIDES_BY_RADIUS])
    for _, sides in SIDES_BY_RADIUS:
        chosen = sides_of[rings.chains] == sides
        part = _skin(rings, chosen, sides, offset)
        offset += len(part[0])
        parts.append(part)
    return tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def leaf_cards(skeleton: Skeleton, leaves: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Cards on the twigs: vertices (4 * leaves, 3), quadrilaterals (leaves, 4), corner UVs (leaves, 4, 2), colours (4 * leaves, 4)."""
    random = np.random.default_rng([seed, 2])
    feet, outward, twig = _leaf_places(skeleton, leaves, random)
    spread = random.normal(size=(leaves, 3))
    normals = _normalized(0.55 * outward + [0.0, 0.0, 0.75] + 0.42 * spread)
    growth = 0.7 * twig + 0.6 * outward + 0.55 * random.normal(size=(leaves, 3)) - [0.0, 0.0, 0.25]
    along = _normalized(growth - (growth * normals).sum(axis=1, keepdims=True) * normals)
    across = np.cross(along, normals)
    lengths = 0.40 * (6000.0 / leaves) ** 0.4 * random.uniform(0.75, 1.2, leaves)
    widths = 0.5 * lengths
    near, far = feet - 0.04 * lengths[:, None] * along, feet + 0.96 * lengths[:, None] * along
    side = widths[:, None] * across
    vertices = np.stack([near - side, near + side, far + side, far - side], axis=1).reshape(-1, 3)
    cells = random.integers(0, SPRIGS_A_SIDE, size=(leaves, 1, 2))
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    uvs = (cells + square) / SPRIGS_A_SIDE
    return vertices, np.arange(4 * leaves).reshape(-1, 4), uvs, np.repeat(_tints(feet, random), 4, axis=0)


def _crown_points(random: np.random.Generator) -> np.ndarray:
    """Points (CROWN_POINTS, 3) in an uneven crown: an ellipsoid, wider below, whose surface is bulged by a few broad lobes."""
    directions = _normalized(random.normal(size=(CROWN_POINTS, 3)))
    lobes = _normalized(random.normal(size=(9, 3)) * [1.0, 1.0, 0.7])
    bulge = 0.80 + 0.34 * np.exp(-6.0 * (1.0 - directions @ lobes.T)).max(axis=1)
    depth = random.uniform(0.12, 1.0, CROWN_POINTS) ** (1.0 / 2.6)
    points = directions * (bulge * depth)[:, None] * CROWN_RADII
    points[:, :2] *= 1.08 - 0.16 * points[:, 2:] / CROWN_RADII[2]
    return points + CROWN_CENTER


def _pulled_ends(
    positions: np.ndarray, attractors: np.ndarray, nearest: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The nodes that grow in this round, and where their new children stand."""
    pulls = _normalized(attractors - positions[nearest])
    sums = np.stack([np.bincount(nearest, pulls[:, axis], len(positions)) for axis in range(3)], axis=1)
    ends = np.unique(nearest)
    directions = _normalized(_normalized(sums[ends]) + 0.13 * random.normal(size=(len(ends), 3)) + [0.0, 0.0, 0.10])
    return ends, positions[ends] + STEP * directions


def _relaxed(positions: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Positions drawn twice towards the middle of parent and children, so that branches bend instead of kink; ends and root stay."""
    children = np.bincount(parents[1:], minlength=len(positions))
    inner = (children > 0) & (parents >= 0)
    for _ in range(2):
        sums = np.stack([np.bincount(parents[1:], positions[1:, axis], len(positions)) for axis in range(3)], axis=1)
        middles = 0.5 * (positions[parents] + sums / np.maximum(children, 1)[:, None])
        positions = np.where(inner[:, None], 0.6 * positions + 0.4 * middles, positions)
    return positions


def _thicknesses(positions: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Radii (N,) by da Vinci's rule from the twigs down, with a flare where the trunk meets the ground."""
    carried = np.zeros(len(parents))
    for node in range(len(parents) - 1, -1, -1):
        carried[node] = max(carried[node], TWIG_RADIUS**THICKNESS_EXPONENT)
        if parents[node] >= 0:
            carried[parents[node]] += carried[node]
    return carried ** (1.0 / THICKNESS_EXPONENT) * (1.0 + 0.75 * np.exp(-positions[:, 2] / 0.28))


def _chains(skeleton: Skeleton) -> np.ndarray:
    """The chain (N,) that each node belongs to, when every branch goes on in its thickest child."""
    parents, radii = skeleton.parents, skeleton.radii
    order = np.lexsort((-np.arange(len(parents)), radii))
    next_of = np.full(len(parents), -1)
    order = order[parents[order] >= 0]
    next_of[parents[order]] = order  # the thickest child is written last
    starts = parents < 0
    starts[1:] |= next_of[parents[1:]] != np.arange(1, len(parents))
    chain_of = np.cumsum(starts) - 1
    for node in range(1, len(parents)):
        if not starts[node]:
            chain_of[node] = chain_of[parents[node]]
    return chain_of


@dataclass(frozen=True)
class _Rings:
    """R cross-sections, chain after chain from foot to tip: positions, two unit axes across, radii, chains, lengths along the chain."""

    positions: np.ndarray
    axes: np.ndarray
    radii: np.ndarray
    chains: np.ndarray
    lengths: np.ndarray


def _rings(skeleton: Skeleton, chain_of: np.ndarray) -> _Rings:
    """Cross-sections of all branches. A branch starts inside the one that carries it, so that no gap shows."""
    starts = np.unique(chain_of, return_index=True)[1]
    sprouts = starts[skeleton.parents[starts] >= 0]
    nodes = np.concatenate([skeleton.parents[sprouts], np.arange(len(chain_of))])
    chains = np.concatenate([chain_of[sprouts], chain_of])
    radii = np.concatenate([skeleton.radii[sprouts], skeleton.radii])
    order = np.argsort(chains, kind="stable")
    positions, chains, radii = skeleton.positions[nodes[order]], chains[order], radii[order]
    joined = chains[1:] == chains[:-1]
    steps = np.diff(positions, axis=0) * joined[:, None]
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    firsts = np.concatenate([[True], ~joined])
    lengths = travelled - travelled[np.flatnonzero(firsts)][np.cumsum(firsts) - 1]
    tips = np.concatenate([~joined, [True]])
    tangents = np.zeros_like(positions)
    tangents[:-1] += steps
    tangents[1:] += steps
    return _Rings(positions, _axes_across(_normalized(tangents), chains), np.where(tips, 0.35 * radii, radii), chains, lengths)


def _axes_across(tangents: np.ndarray, chains: np.ndarray) -> np.ndarray:
    """(R, 2, 3) axes across each tangent. A chain shares one reference across its mean direction, so that its tube does not twist."""
    means = np.stack([np.bincount(chains, tangents[:, axis]) for axis in range(3)], axis=1)
    reference = np.eye(3)[np.abs(means).argmin(axis=1)][chains]
    first = _normalized(np.cross(tangents, reference))
    return np.stack([first, np.cross(tangents, first)], axis=1)


def _skin(rings: _Rings, chosen: np.ndarray, sides: int, offset: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, quadrilaterals and UVs of the chosen rings with this many sides; vertex numbers start at `offset`."""
    rows = np.flatnonzero(chosen)
    turns = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    around = np.einsum("sa,rac->rsc", circle, rings.axes[rows]) * rings.radii[rows, None, None]
    vertices = (rings.positions[rows, None] + around).reshape(-1, 3)
    lower = np.flatnonzero(rings.chains[rows[:-1]] == rings.chains[rows[1:]])
    side = np.arange(sides)
    corners = np.stack([side, (side + 1) % sides, (side + 1) % sides + sides, side + sides], axis=1)
    polygons = offset + (lower[:, None, None] * sides + corners).reshape(-1, 4)
    girth = 2.0 * np.pi * rings.radii[rows[lower], None, None]
    across = np.stack([side, side + 1, side + 1, side], axis=1) / sides * girth
    heights = rings.lengths[rows]
    up = np.stack([heights[lower], heights[lower], heights[lower + 1], heights[lower + 1]], axis=1)[:, None]
    uvs = np.stack([across, np.broadcast_to(up, across.shape)], axis=-1).reshape(-1, 4, 2)
    return vertices, polygons, uvs


def _leaf_places(skeleton: Skeleton, leaves: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where leaves sit: feet (leaves, 3) on thin twigs, unit directions out of the crown, unit directions of the twigs."""
    twigs = np.flatnonzero((skeleton.radii < 3.0 * TWIG_RADIUS) & (skeleton.positions[:, 2] > TRUNK_HEIGHT))
    weight = 1.0 / skeleton.radii[twigs]
    chosen = random.choice(twigs, size=leaves, p=weight / weight.sum())
    foot, tip = skeleton.positions[skeleton.parents[chosen]], skeleton.positions[chosen]
    feet = foot + random.random((leaves, 1)) * (tip - foot) + 0.05 * random.normal(size=(leaves, 3))
    return feet, _normalized((feet - CROWN_CENTER) / CROWN_RADII), _normalized(tip - foot)


def _tints(feet: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Scene-linear colours (L, 4) that leaves are multiplied by: lighter and yellower high and outside, older and darker inside."""
    openness = np.clip(np.linalg.norm((feet - CROWN_CENTER) / CROWN_RADII, axis=1), 0.0, 1.2)
    brightness = (0.62 + 0.42 * openness) * random.uniform(0.8, 1.2, len(feet))
    yellow = random.normal(0.0, 0.09, len(feet)) + 0.08 * openness
    colors = np.stack([1.0 + yellow, np.ones(len(feet)), 1.0 - 1.2 * yellow], axis=1) * brightness[:, None]
    return np.column_stack([np.clip(colors, 0.0, 1.6), np.ones(len(feet))])


def _add_object(name: str, vertices: np.ndarray, polygons: np.ndarray, uvs: np.ndarray, material: bpy.types.Material) -> bpy.types.Object:
    """An object of quadrilaterals with one UV map and one material, linked to the current scene."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    mesh.loops.add(polygons.size)
    mesh.loops.foreach_set("vertex_index", polygons.astype(np.int32).ravel())
    mesh.polygons.add(len(polygons))
    mesh.polygons.foreach_set("loop_start", np.arange(0, polygons.size, 4, dtype=np.int32))
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", uvs.astype(np.float32).ravel())
    mesh.materials.append(material)
    mesh.update(calc_edges=True)
    mesh.validate()
    made = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def _normalized(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
