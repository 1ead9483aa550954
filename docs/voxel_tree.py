"""A tree as a block of voxels, for pictures of the terrain `forest`: branches that fork, with clumps of leaves at their ends."""

from pathlib import Path

import numpy as np

from farfield.addon.core.clipbox.grids import Grid
from farfield.addon.core.clipbox.spheres import Spheres, carved

HEIGHT = 44.0  # voxels, of the trunk
WIDTH = 5.0  # radius of the trunk at the ground
FORKS = (3, 4, 4)  # branches at the end of twigs, of boughs, of the trunk
STEP = 1.2  # voxels between two spheres of a branch
LEAVES = 26  # balls in a clump
MARGIN = 5  # voxels around
GREYS = 32.0  # a voxel of distance


def write_tree(path: Path, seed: int) -> None:
    """Write a tree as a .npy file of bytes (X, Y, Z), 128 on its surface."""
    random = np.random.default_rng(seed)
    centres, radii = (
        np.concatenate(part) for part in zip(*_grown(random, np.zeros(3), _unit([0.05, 0.02, 1.0]), HEIGHT, WIDTH), strict=True)
    )
    low, high = np.floor(centres.min(axis=0) - MARGIN).astype(int), np.ceil(centres.max(axis=0) + MARGIN).astype(int)
    low[2] = 0
    grid = Grid(tuple(low.tolist()), tuple((high - low).tolist()), 1.0)
    distances = carved(grid, Spheres(centres, radii, np.zeros(len(radii), bool)))
    np.save(path, np.clip(128.0 + GREYS * distances, 0.0, 255.0).astype(np.uint8))


def _grown(random: np.random.Generator, start: np.ndarray, along: np.ndarray, length: float, width: float, depth: int = len(FORKS)) -> list:
    """Centres (S, 3) and radii (S,) of the spheres of a branch and of all that grows on it."""
    end = start + along * length
    shares = np.linspace(0.0, 1.0, int(length / STEP) + 2)
    spheres = [(start + shares[:, None] * (end - start), width * (1.0 - 0.3 * shares))]
    if depth == 0:
        return [*spheres, (end + random.normal(size=(LEAVES, 3)) * [5.5, 5.5, 4.0], random.uniform(1.5, 3.6, LEAVES))]
    for _ in range(FORKS[depth - 1]):
        turned = along + random.normal(0.0, 0.75, 3)
        turned[2] = 0.6 * abs(turned[2]) + 0.15
        spheres += _grown(random, end, _unit(turned), 0.62 * length, 0.6 * width, depth - 1)
    return spheres


def _unit(vector: np.ndarray | list[float]) -> np.ndarray:
    return np.asarray(vector) / np.linalg.norm(vector)
