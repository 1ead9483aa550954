"""A broadleaf tree grown from a seed: trunk and branches by space colonization, thousands of leaf cards on the twigs.

The skeleton follows Runions, Lane and Prusinkiewicz 2007: attraction points in the crown pull the nearest nodes towards them until a node
is within the kill distance. Branch radii follow da Vinci's rule. Every leaf card shows a sprig with an alpha channel.
Lengths are meters, up is +Z, the base of the trunk is at the origin.
"""

from dataclasses import dataclass

import bpy
import numpy as np
from scipy.spatial import cKDTree

from lib import environment
from lib.demo_materials import SPRIGS_PER_SIDE, create_bark_material, create_leaf_material

environment.import_farfield()

from farfield.addon.bridge.geometry.mesh_arrays import write_attribute, write_geometry, write_uvs

TRUNK_HEIGHT = 1.9
CROWN_CENTER = np.array([0.0, 0.0, 4.7])
CROWN_RADII = np.array([2.5, 2.5, 2.75])
CROWN_POINTS = 900
STEP_LENGTH = 0.17
INFLUENCE_DISTANCE = 1.5
KILL_DISTANCE = 0.36
MAX_ROUNDS = 120
TWIG_RADIUS = 0.0075
THICKNESS_EXPONENT = 2.1  # children's radii to this power add up to their parent's; da Vinci's own 2 gives clumsy limbs
SIDES_BY_RADIUS = ((0.045, 12), (0.016, 6), (0.0, 3))


@dataclass(frozen=True)
class Skeleton:
    """N nodes from the root to the twigs: positions (N, 3), radii (N,), parents (N,) int, -1 at the root, else smaller than the child."""

    positions: np.ndarray
    parents: np.ndarray
    radii: np.ndarray


def grow_tree(seed: int = 0, leaves: int = 6000) -> list[bpy.types.Object]:
    """Grow a tree in the current scene. Returns the object of trunk and branches and the object of the `leaves` leaf cards.

    Equal seeds give equal trees; the branches do not depend on the number of leaves.
    """
    skeleton = grow_skeleton(seed)
    vertices, polygons, uvs = build_tubes(skeleton)
    trunk = _add_object("Tree", vertices, polygons, uvs, create_bark_material())
    trunk.data.shade_smooth()
    vertices, polygons, uvs, colors = build_leaf_cards(skeleton, leaves, seed)
    foliage = _add_object("Tree Leaves", vertices, polygons, uvs, create_leaf_material(seed))
    write_attribute(foliage.data, "Leaf Color", "POINT", colors)
    return [trunk, foliage]


def grow_skeleton(seed: int) -> Skeleton:
    """Grow the branches of the tree with this seed."""
    random = np.random.default_rng([seed, 1])
    attractors = _crown_points(random)
    heights = np.arange(0.0, TRUNK_HEIGHT, STEP_LENGTH)
    sway = 0.07 * np.sin(heights[:, None] * random.uniform(1.0, 1.8, 2) + random.uniform(0.0, 6.0, 2))
    positions = np.column_stack([sway - sway[0], heights])
    parents = np.arange(len(positions)) - 1
    for _ in range(MAX_ROUNDS):
        tree = cKDTree(positions)
        distances, nearest = tree.query(attractors)
        attractors, nearest = attractors[distances > KILL_DISTANCE], nearest[distances > KILL_DISTANCE]
        in_range = np.linalg.norm(attractors - positions[nearest], axis=1) < INFLUENCE_DISTANCE
        if not in_range.any():
            if positions[-1, 2] > CROWN_CENTER[2]:
                break
            in_range = np.ones(len(attractors), bool)  # the trunk has not reached the crown yet
        growing, new = _grow_nodes(positions, attractors[in_range], nearest[in_range], random)
        free = tree.query(new)[0] > 0.4 * STEP_LENGTH
        if not free.any():
            break
        positions = np.concatenate([positions, new[free]])
        parents = np.concatenate([parents, growing[free]])
    return Skeleton(_smooth(positions, parents), parents, _branch_radii(positions, parents))


def build_tubes(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Build tapering tubes around the branches: vertices (V, 3), quadrilaterals (F, 4) and their corner UVs (F, 4, 2) in meters."""
    chain_indices = _find_chains(skeleton)
    rings = _build_rings(skeleton, chain_indices)
    parts, offset = [], 0
    thickest = np.zeros(chain_indices.max() + 1)
    np.maximum.at(thickest, chain_indices, skeleton.radii)
    side_counts = np.select([thickest >= radius for radius, _ in SIDES_BY_RADIUS], [sides for _, sides in SIDES_BY_RADIUS])
    for _, sides in SIDES_BY_RADIUS:
        selected = side_counts[rings.chains] == sides
        part = _build_tube(rings, selected, sides, offset)
        offset += len(part[0])
        parts.append(part)
    return tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def build_leaf_cards(skeleton: Skeleton, leaves: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Build cards on the twigs: vertices (4 * leaves, 3), quadrilaterals (leaves, 4), corner UVs (leaves, 4, 2), colors (4 * leaves, 4)."""
    random = np.random.default_rng([seed, 2])
    bases, outward, twig = _sample_leaf_bases(skeleton, leaves, random)
    spread = random.normal(size=(leaves, 3))
    normals = _normalize(0.55 * outward + [0.0, 0.0, 0.75] + 0.42 * spread)
    growth = 0.7 * twig + 0.6 * outward + 0.55 * random.normal(size=(leaves, 3)) - [0.0, 0.0, 0.25]
    along = _normalize(growth - (growth * normals).sum(axis=1, keepdims=True) * normals)
    across = np.cross(along, normals)
    lengths = 0.40 * (6000.0 / leaves) ** 0.4 * random.uniform(0.75, 1.2, leaves)
    widths = 0.5 * lengths
    near, far = bases - 0.04 * lengths[:, None] * along, bases + 0.96 * lengths[:, None] * along
    side = widths[:, None] * across
    vertices = np.stack([near - side, near + side, far + side, far - side], axis=1).reshape(-1, 3)
    cells = random.integers(0, SPRIGS_PER_SIDE, size=(leaves, 1, 2))
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    uvs = (cells + square) / SPRIGS_PER_SIDE
    return vertices, np.arange(4 * leaves).reshape(-1, 4), uvs, np.repeat(_leaf_colors(bases, random), 4, axis=0)


def _crown_points(random: np.random.Generator) -> np.ndarray:
    """Return attraction points (CROWN_POINTS, 3) in an uneven crown: an ellipsoid, wider below, with a few broad bulges."""
    directions = _normalize(random.normal(size=(CROWN_POINTS, 3)))
    lobes = _normalize(random.normal(size=(9, 3)) * [1.0, 1.0, 0.7])
    bulge = 0.80 + 0.34 * np.exp(-6.0 * (1.0 - directions @ lobes.T)).max(axis=1)
    depth = random.uniform(0.12, 1.0, CROWN_POINTS) ** (1.0 / 2.6)
    points = directions * (bulge * depth)[:, None] * CROWN_RADII
    points[:, :2] *= 1.08 - 0.16 * points[:, 2:] / CROWN_RADII[2]
    return points + CROWN_CENTER


def _grow_nodes(
    positions: np.ndarray, attractors: np.ndarray, nearest: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of the nodes that grow in this round and the positions of their new children."""
    pulls = _normalize(attractors - positions[nearest])
    sums = np.stack([np.bincount(nearest, pulls[:, axis], len(positions)) for axis in range(3)], axis=1)
    growing = np.unique(nearest)
    directions = _normalize(_normalize(sums[growing]) + 0.13 * random.normal(size=(len(growing), 3)) + [0.0, 0.0, 0.10])
    return growing, positions[growing] + STEP_LENGTH * directions


def _smooth(positions: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Smooth the branches: move inner nodes twice towards the mean of parent and children. Tips and root stay."""
    children = np.bincount(parents[1:], minlength=len(positions))
    inner = (children > 0) & (parents >= 0)
    for _ in range(2):
        sums = np.stack([np.bincount(parents[1:], positions[1:, axis], len(positions)) for axis in range(3)], axis=1)
        means = 0.5 * (positions[parents] + sums / np.maximum(children, 1)[:, None])
        positions = np.where(inner[:, None], 0.6 * positions + 0.4 * means, positions)
    return positions


def _branch_radii(positions: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Return radii (N,) by da Vinci's rule from the twigs down, with a flare at the base of the trunk."""
    carried = np.zeros(len(parents))
    for node in range(len(parents) - 1, -1, -1):
        carried[node] = max(carried[node], TWIG_RADIUS**THICKNESS_EXPONENT)
        if parents[node] >= 0:
            carried[parents[node]] += carried[node]
    return carried ** (1.0 / THICKNESS_EXPONENT) * (1.0 + 0.75 * np.exp(-positions[:, 2] / 0.28))


def _find_chains(skeleton: Skeleton) -> np.ndarray:
    """Return the chain index (N,) of each node. A chain continues in the thickest child of each node."""
    parents, radii = skeleton.parents, skeleton.radii
    order = np.lexsort((-np.arange(len(parents)), radii))
    next_node = np.full(len(parents), -1)
    order = order[parents[order] >= 0]
    next_node[parents[order]] = order  # the thickest child is written last
    starts = parents < 0
    starts[1:] |= next_node[parents[1:]] != np.arange(1, len(parents))
    chain_indices = np.cumsum(starts) - 1
    for node in range(1, len(parents)):
        if not starts[node]:
            chain_indices[node] = chain_indices[parents[node]]
    return chain_indices


@dataclass(frozen=True)
class _Rings:
    """R cross-sections, chain by chain from base to tip: positions (R, 3), two unit axes (R, 2, 3) perpendicular to the branch, radii (R,),
    chain indices (R,), and lengths (R,) along the chain."""

    positions: np.ndarray
    axes: np.ndarray
    radii: np.ndarray
    chains: np.ndarray
    lengths: np.ndarray


def _build_rings(skeleton: Skeleton, chain_indices: np.ndarray) -> _Rings:
    """Build the cross-sections of all branches. A branch starts inside its parent branch, so that there is no gap."""
    starts = np.unique(chain_indices, return_index=True)[1]
    branch_starts = starts[skeleton.parents[starts] >= 0]
    nodes = np.concatenate([skeleton.parents[branch_starts], np.arange(len(chain_indices))])
    chains = np.concatenate([chain_indices[branch_starts], chain_indices])
    radii = np.concatenate([skeleton.radii[branch_starts], skeleton.radii])
    order = np.argsort(chains, kind="stable")
    positions, chains, radii = skeleton.positions[nodes[order]], chains[order], radii[order]
    is_same_chain = chains[1:] == chains[:-1]
    steps = np.diff(positions, axis=0) * is_same_chain[:, None]
    total_lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    is_first = np.concatenate([[True], ~is_same_chain])
    lengths = total_lengths - total_lengths[np.flatnonzero(is_first)][np.cumsum(is_first) - 1]
    is_tip = np.concatenate([~is_same_chain, [True]])
    tangents = np.zeros_like(positions)
    tangents[:-1] += steps
    tangents[1:] += steps
    return _Rings(positions, _perpendicular_axes(_normalize(tangents), chains), np.where(is_tip, 0.35 * radii, radii), chains, lengths)


def _perpendicular_axes(tangents: np.ndarray, chains: np.ndarray) -> np.ndarray:
    """Return two axes (R, 2, 3) perpendicular to each tangent. Rings of a chain share a reference axis, so that the tube is not twisted."""
    means = np.stack([np.bincount(chains, tangents[:, axis]) for axis in range(3)], axis=1)
    reference = np.eye(3)[np.abs(means).argmin(axis=1)][chains]
    first = _normalize(np.cross(tangents, reference))
    return np.stack([first, np.cross(tangents, first)], axis=1)


def _build_tube(rings: _Rings, selected: np.ndarray, sides: int, offset: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices, quadrilaterals and UVs of the `selected` rings with `sides` vertices each; vertex indices start at `offset`."""
    rows = np.flatnonzero(selected)
    angles = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    offsets = np.einsum("sa,rac->rsc", circle, rings.axes[rows]) * rings.radii[rows, None, None]
    vertices = (rings.positions[rows, None] + offsets).reshape(-1, 3)
    lower = np.flatnonzero(rings.chains[rows[:-1]] == rings.chains[rows[1:]])
    side = np.arange(sides)
    corners = np.stack([side, (side + 1) % sides, (side + 1) % sides + sides, side + sides], axis=1)
    polygons = offset + (lower[:, None, None] * sides + corners).reshape(-1, 4)
    circumference = 2.0 * np.pi * rings.radii[rows[lower], None, None]
    u = np.stack([side, side + 1, side + 1, side], axis=1) / sides * circumference
    lengths = rings.lengths[rows]
    v = np.stack([lengths[lower], lengths[lower], lengths[lower + 1], lengths[lower + 1]], axis=1)[:, None]
    uvs = np.stack([u, np.broadcast_to(v, u.shape)], axis=-1).reshape(-1, 4, 2)
    return vertices, polygons, uvs


def _sample_leaf_bases(skeleton: Skeleton, leaves: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample leaf bases (leaves, 3) on thin twigs; also return the unit directions out of the crown and along the twigs."""
    twigs = np.flatnonzero((skeleton.radii < 3.0 * TWIG_RADIUS) & (skeleton.positions[:, 2] > TRUNK_HEIGHT))
    weight = 1.0 / skeleton.radii[twigs]
    nodes = random.choice(twigs, size=leaves, p=weight / weight.sum())
    start, end = skeleton.positions[skeleton.parents[nodes]], skeleton.positions[nodes]
    bases = start + random.random((leaves, 1)) * (end - start) + 0.05 * random.normal(size=(leaves, 3))
    return bases, _normalize((bases - CROWN_CENTER) / CROWN_RADII), _normalize(end - start)


def _leaf_colors(bases: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return scene-linear colors (L, 4) to multiply leaves by: lighter and yellower high and outside, darker inside the crown."""
    relative_radius = np.clip(np.linalg.norm((bases - CROWN_CENTER) / CROWN_RADII, axis=1), 0.0, 1.2)
    brightness = (0.62 + 0.42 * relative_radius) * random.uniform(0.8, 1.2, len(bases))
    yellow = random.normal(0.0, 0.09, len(bases)) + 0.08 * relative_radius
    colors = np.stack([1.0 + yellow, np.ones(len(bases)), 1.0 - 1.2 * yellow], axis=1) * brightness[:, None]
    return np.column_stack([np.clip(colors, 0.0, 1.6), np.ones(len(bases))])


def _add_object(name: str, vertices: np.ndarray, polygons: np.ndarray, uvs: np.ndarray, material: bpy.types.Material) -> bpy.types.Object:
    """Create an object of quadrilaterals with one UV map and one material, linked to the current scene."""
    mesh = bpy.data.meshes.new(name)
    write_geometry(mesh, vertices, polygons, np.arange(0, polygons.size, 4))
    write_uvs(mesh.uv_layers.new(name="UVMap"), uvs)
    mesh.materials.append(material)
    mesh.validate()
    mesh_object = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(mesh_object)
    return mesh_object


def _normalize(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
