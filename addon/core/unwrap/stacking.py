"""Finds groups of triangles, such as parts or UV islands, that are equal up to a rigid motion, so that they can share a place in a UV map.

A triangle of one group and one of the other determine the motion that is tried; mirror images are not equal.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import TINY
from ..geometry.mesh import scaled_normals
from ..jobs.progress import Progress, Steps

MAX_DIFFERENCE = 1e-3  # Between corners of equal groups, relative to the size of the group.
MAX_SEED_DIFFERENCE = 20.0  # The same before the motion is fitted to all triangles, relative to `MAX_DIFFERENCE`.
MAX_DENSITY_RATIO = 1.02  # Of the texel densities that equal groups are to have.
MIN_SEED_AREA = 0.1  # Of the triangle that determines the motion, relative to the largest one.
MAX_MOTIONS = 48  # That are tried per pair of groups.
GROUPS_PER_YIELD = 64


@dataclass(frozen=True)
class Copies:
    """Which triangles have the UVs of others.

    sources: (T,) the triangle whose UVs each triangle gets, itself where it is no copy. turns: (T,) 0 to 2, by how many corners the source
    starts later.
    """

    sources: np.ndarray
    turns: np.ndarray

    @classmethod
    def none(cls, count: int) -> "Copies":
        """Return that none of `count` triangles is a copy."""
        return cls(np.arange(count), np.zeros(count, np.int64))

    @property
    def is_copy(self) -> np.ndarray:
        """Triangles (T,) bool that are copies."""
        return self.sources != np.arange(len(self.sources))

    def fill(self, corner_uvs: np.ndarray) -> np.ndarray:
        """Return `corner_uvs` (T, 3, 2) with the UVs of copies, which need not be set before."""
        return corner_uvs[self.sources[:, None], (np.arange(3) + self.turns[:, None]) % 3]


class _Group:
    """Triangles that are compared with other groups.

    Attributes:
        triangles: (N,) their indices.
        corners: (N, 3, 3), relative to their center.
        size: largest distance of a corner from the center.
        figures: that do not depend on the position of the group.
    """

    def __init__(self, corners: np.ndarray, triangles: np.ndarray) -> None:
        """Describe `triangles` (N,) of `corners` (T, 3, 3)."""
        own = corners[triangles]
        self.triangles, self.corners = triangles, own - own.mean(axis=(0, 1))
        self.size = float(np.linalg.norm(self.corners, axis=2).max())
        self.areas = np.linalg.norm(scaled_normals(self.corners), axis=1)
        lengths = [np.sqrt(self.areas.sum()), np.sqrt((self.corners**2).sum()), _edge_lengths(self.corners).sum()]
        self.figures = np.array([*lengths, self.size])

    @cached_property
    def tree(self) -> cKDTree:
        """The search tree of the triangles."""
        return cKDTree(_features(self.corners, self.size))

    @cached_property
    def seed(self) -> int:
        """A large triangle with edge lengths that few others have, which determines motions."""
        step = MAX_SEED_DIFFERENCE * MAX_DIFFERENCE * self.size
        keys = np.round(np.sort(_edge_lengths(self.corners), axis=1) / step).astype(np.int64)
        _, kinds, frequencies = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        is_large = self.areas >= MIN_SEED_AREA * self.areas.max()
        return int(np.lexsort((-self.areas, np.where(is_large, frequencies[kinds.reshape(-1)], len(keys) + 1)))[0])


def find_copies(corners: np.ndarray, labels: np.ndarray, density: np.ndarray, polygon_ids: np.ndarray) -> Steps[Copies]:
    """Return which groups of triangles are copies of an earlier one.

    Args:
        corners: (T, 3, 3) positions.
        labels: (T,) the group of each triangle, from 0.
        density: (T,) texel density that each triangle is to have.
        polygon_ids: (T,) the polygon of each triangle; those of a copy must not be cut.
    """
    copies = Copies.none(len(corners))
    models: dict[int, list[_Group]] = {}
    order, counts = np.argsort(labels, kind="stable"), np.bincount(labels)
    for index, members in enumerate(np.split(order, np.cumsum(counts)[:-1])):
        if index % GROUPS_PER_YIELD == 0:
            yield Progress(index / len(counts), "Finding equal parts")
        group = _Group(corners, members)
        if group.areas.max() <= TINY:
            continue
        same = models.setdefault(len(members), [])
        for model in same:
            match = _match(model, group) if np.allclose(model.figures, group.figures, rtol=10.0 * MAX_DIFFERENCE) else None
            if match is None:
                continue
            sources = model.triangles[match[0]]
            ratios = density[members] / density[sources]
            polygons = np.stack([polygon_ids[members], polygon_ids[sources]], axis=1)
            has_same_polygons = len(np.unique(polygons, axis=0)) == len(np.unique(polygons[:, 0]))
            if has_same_polygons and max(ratios.max(), 1.0 / ratios.min()) <= MAX_DENSITY_RATIO:
                copies.sources[members], copies.turns[members] = sources, match[1]
                break
        else:
            same.append(group)
    return copies


def _edge_lengths(corners: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)


def _features(corners: np.ndarray, size: float) -> np.ndarray:
    """Return points (N, 6) that distinguish triangles (N, 3, 3), also the two sides of a card."""
    return np.concatenate([corners.mean(axis=1), scaled_normals(corners) / size], axis=1)


def _match(model: _Group, group: _Group) -> tuple[np.ndarray, np.ndarray] | None:
    """Return for each triangle of `group` that of `model` in its place (N,), and by how many corners it starts later; None where the groups
    are not equal."""
    tolerance = MAX_DIFFERENCE * model.size
    wanted, lengths = _edge_lengths(model.corners[model.seed][None])[0], _edge_lengths(group.corners)
    motions = []
    for turn in range(3):
        is_like_seed = (np.abs(np.roll(lengths, -turn, axis=1) - wanted) <= 2.0 * tolerance).all(axis=1)
        for triangle in np.flatnonzero(is_like_seed)[:MAX_MOTIONS].tolist():
            motions.append(_fit_motion(np.roll(group.corners[triangle], -turn, axis=0), model.corners[model.seed]))
    motions.sort(key=lambda motion: -np.trace(motion[0]))  # The smallest rotation first, so that symmetric copies stay upright.
    for rotation, translation in motions[:MAX_MOTIONS]:
        found = _find_places(model, group.corners @ rotation.T + translation, MAX_SEED_DIFFERENCE * tolerance)
        if found is None:
            continue
        places, turns = found
        targets = model.corners[places[:, None], (np.arange(3) + turns[:, None]) % 3]
        rotation, translation = _fit_motion(group.corners.reshape(-1, 3), targets.reshape(-1, 3))
        if np.abs(group.corners @ rotation.T + translation - targets).max() <= tolerance:
            return found
    return None


def _find_places(model: _Group, corners: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the triangle of `model` at each of `corners` (N, 3, 3), and by how many corners it starts later; None where one has none."""
    _, places = model.tree.query(_features(corners, model.size))
    if len(np.unique(places)) < len(places):
        return None
    differences = np.stack([np.abs(np.roll(model.corners[places], -turn, axis=1) - corners).max(axis=(1, 2)) for turn in range(3)])
    return (places, differences.argmin(axis=0)) if differences.min(axis=0).max() <= tolerance else None


def _fit_motion(points: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation (3, 3) and translation (3,) that move `points` (N, 3) closest to `targets` (N, 3), by least squares (Kabsch)."""
    center, target_center = points.mean(axis=0), targets.mean(axis=0)
    u, _, vt = np.linalg.svd((targets - target_center).T @ (points - center))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return rotation, target_center - rotation @ center
