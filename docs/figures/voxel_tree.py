"""A tree as a voxel model, for renders of the terrain `forest`: forking branches with clumps of leaves at their ends."""

from pathlib import Path

import numpy as np

from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.clipbox.terrains.spheres import Spheres, csg_density

TRUNK_HEIGHT = 44.0  # voxels
TRUNK_RADIUS = 5.0  # voxels, at the ground
FORKS = (3, 4, 4)  # branches at the ends of small branches, large branches and the trunk
SPHERE_SPACING = 1.2  # voxels between the spheres of a branch
LEAVES = 26  # spheres per clump
MARGIN = 5  # voxels around the tree
VALUE_PER_VOXEL = 32.0  # change of the values per voxel of distance


def write_tree(path: Path, seed: int) -> None:
    """Write a tree as a .npy file of bytes (X, Y, Z), 128 at its surface."""
    random = np.random.default_rng(seed)
    branches = _grow_branch(random, np.zeros(3), _normalize([0.05, 0.02, 1.0]), TRUNK_HEIGHT, TRUNK_RADIUS)
    centers, radii = (np.concatenate(arrays) for arrays in zip(*branches, strict=True))
    low, high = np.floor(centers.min(axis=0) - MARGIN).astype(int), np.ceil(centers.max(axis=0) + MARGIN).astype(int)
    low[2] = 0
    grid = Grid(tuple(low.tolist()), tuple((high - low).tolist()), 1.0)
    distances = csg_density(grid, Spheres(centers, radii, np.zeros(len(radii), bool)))
    np.save(path, np.clip(128.0 + VALUE_PER_VOXEL * distances, 0.0, 255.0).astype(np.uint8))


def _grow_branch(
    random: np.random.Generator, start: np.ndarray, direction: np.ndarray, length: float, radius: float, depth: int = len(FORKS)
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the centers (S, 3) and radii (S,) of the spheres of a branch and of all its sub-branches."""
    end = start + direction * length
    t = np.linspace(0.0, 1.0, int(length / SPHERE_SPACING) + 2)
    spheres = [(start + t[:, None] * (end - start), radius * (1.0 - 0.3 * t))]
    if depth == 0:
        return [*spheres, (end + random.normal(size=(LEAVES, 3)) * [5.5, 5.5, 4.0], random.uniform(1.5, 3.6, LEAVES))]
    for _ in range(FORKS[depth - 1]):
        fork = direction + random.normal(0.0, 0.75, 3)
        fork[2] = 0.6 * abs(fork[2]) + 0.15
        spheres += _grow_branch(random, end, _normalize(fork), 0.62 * length, 0.6 * radius, depth - 1)
    return spheres


def _normalize(vector: np.ndarray | list[float]) -> np.ndarray:
    return np.asarray(vector) / np.linalg.norm(vector)
