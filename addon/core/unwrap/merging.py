"""Merges flat pieces of a surface to larger UV islands across their longest common borders, without changing their shapes.

A box becomes a strip or a cross, and the faces of a bracket stay next to each other. Pieces are only turned and moved, and an island is
never allowed to overlap itself, or to become so long or so ragged that it wastes the texture.
"""

import heapq
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import TINY
from ..geometry.convex_hulls import convex_hull
from ..geometry.mesh import TriangleMesh, face_areas_and_normals
from ..geometry.transforms import cross
from ..jobs.progress import Progress, Steps, run_to_end
from .cutting.creases import fold_angles
from .dividing import MAX_LENGTH, MAX_THINNESS, square_side
from .overlaps import any_overlap, count_overlaps

MAX_MISMATCH = 0.02  # Distance of two ends that are sewn together, relative to their edge.
MAX_PLACEMENTS = 3  # Placements that are tried per pair of islands, those with the longest common border first.
MIN_SEWN = 0.12  # Common border relative to the square root of the smaller island's area; a piece that hangs on less is kept apart.
GAP = 2e-3  # Distance of parts of an island that are not sewn, relative to the side of a square with the area of the surface.
JOINT_RADIUS = 0.003  # Around ends of sewn borders, relative to the same side, parts may be closer, such as both sides of a rounded corner.
SNAP_TOLERANCE = 1e-7  # Distance of corners at the same position, relative to the same side.
FOLD_PREFERENCE, CONCAVE_PREFERENCE = 0.3, 0.05  # How much longer a border counts that is flat, and one that is convex.
MAX_SMALL_BOX_GROWTH, SMALL_SIDE = 1.7, 0.4  # Islands that stay shorter may grow so much, see `MergeLimits`.
PAIRS_PER_YIELD = 32


@dataclass(frozen=True)
class MergeLimits:
    """Limits of the bounding boxes of merged islands.

    Attributes:
        max_side: Relative to the side of a square with the area of the bounding boxes of all pieces.
        max_growth: Area, relative to that of the boxes of the two islands that are merged.
        max_addition: Area that the box of the larger of both gains, relative to the box of the smaller one. A low limit forbids arms that
            are small but stick out of a large island.
    """

    max_side: float
    max_growth: float = 1.25
    max_addition: float = np.inf


@dataclass
class _Island:
    """Triangles that are sewn together; `borders`: indices of the links to each other island; `hull`: (H, 2) positions around it."""

    triangles: np.ndarray
    area: float
    hull: np.ndarray
    borders: dict[int, list[int]] = field(default_factory=dict)


def merge_islands(
    mesh: TriangleMesh, corner_uvs: np.ndarray, labels: np.ndarray, halfedges: np.ndarray, scales: np.ndarray, limits: MergeLimits
) -> Steps[tuple[np.ndarray, np.ndarray]]:
    """Return the corner UVs (T, 3, 2) of pieces that are moved next to each other, and the pairs of halfedges that are sewn, (I,) bool.

    Args:
        mesh: T triangles.
        corner_uvs: (T, 3, 2).
        labels: (T,) the piece of each triangle.
        halfedges: (I, 2), 3 t + c, pairs across which triangles may be connected.
        scales: (T,) lengths in the map over lengths on the surface, about the same on both sides of each pair.
        limits: of merged islands.
    """
    merging = _Merging(mesh, corner_uvs.copy(), labels, halfedges, scales, limits)
    yield from merging.run()
    return merging.corner_uvs, merging.sewn()


class _Merging:
    """The state of a merge: corner UVs, islands, and a heap of pairs of islands by the length of their common border."""

    def __init__(
        self,
        mesh: TriangleMesh,
        corner_uvs: np.ndarray,
        labels: np.ndarray,
        halfedges: np.ndarray,
        scales: np.ndarray,
        limits: MergeLimits,
    ) -> None:
        self.corner_uvs, self._labels = corner_uvs, labels.astype(np.int64)
        faces, corners = halfedges // 3, halfedges % 3
        # The first halfedge runs from start to end, the second one from end to start.
        self._starts = faces, np.stack([(corners[:, 0] + 1) % 3, (corners[:, 1] + 2) % 3], axis=1)
        self._ends = faces, np.stack([(corners[:, 0] + 2) % 3, (corners[:, 1] + 1) % 3], axis=1)
        first, second = mesh.vertices[mesh.triangles[self._starts]], mesh.vertices[mesh.triangles[self._ends]]
        self._lengths = np.linalg.norm(second[:, 0] - first[:, 0], axis=1) * scales[faces[:, 0]]
        self._weights = self._lengths * _preferences(mesh, halfedges)
        areas = face_areas_and_normals(mesh.corners)[0] * scales**2
        self._side = square_side(corner_uvs, labels)
        self._limits, self._max_side = limits, limits.max_side * self._side
        self._is_blocked = np.zeros(len(halfedges), bool)
        self._islands: dict[int, _Island] = {}
        order = np.argsort(self._labels, kind="stable")
        for members in np.split(order, np.cumsum(np.bincount(self._labels))[:-1]):
            island = _Island(members, float(areas[members].sum()), convex_hull(corner_uvs[members].reshape(-1, 2)))
            self._islands[int(self._labels[members[0]])] = island
        for link, (a, b) in enumerate(self._labels[faces].tolist()):
            if a != b:
                self._islands[a].borders.setdefault(b, []).append(link)
                self._islands[b].borders.setdefault(a, []).append(link)
        self._heap: list[tuple[float, float, int, int, int, int]] = []
        for a, island in self._islands.items():
            for b in island.borders:
                if a < b:
                    self._push(a, b)

    def run(self) -> Steps[None]:
        """Merge islands until none fits to another one."""
        count, total = 0, len(self._islands)
        while self._heap:
            _, _, a, b, first_size, second_size = heapq.heappop(self._heap)
            if count % PAIRS_PER_YIELD == 0:
                yield Progress(1.0 - len(self._islands) / total, "Merging UV islands")
            count += 1
            first, second = self._islands.get(a), self._islands.get(b)
            is_current = first is not None and second is not None
            if is_current and (len(first.triangles), len(second.triangles)) == (first_size, second_size):
                self._try_to_merge(a, b)

    def sewn(self) -> np.ndarray:
        """Return at which links both sides meet in the map, (I,) bool."""
        starts, ends = self.corner_uvs[self._starts], self.corner_uvs[self._ends]
        distances = np.maximum(np.linalg.norm(starts[:, 0] - starts[:, 1], axis=1), np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))
        labels = self._labels[self._starts[0]]
        return (labels[:, 0] == labels[:, 1]) & (distances <= MAX_MISMATCH * self._lengths)

    def _push(self, a: int, b: int) -> None:
        """Add the pair of islands to the heap, with the length of their border as far as it can be sewn."""
        links = self._islands[a].borders[b]
        first, second = self._islands[a], self._islands[b]
        length = float(self._weights[links].sum())
        if length >= MIN_SEWN * np.sqrt(min(first.area, second.area)):
            area = first.area + second.area  # Of equal borders, the one of the larger island comes first: it grows to a strip.
            heapq.heappush(self._heap, (-round(length / self._side, 6), -area, a, b, len(first.triangles), len(second.triangles)))

    def _try_to_merge(self, a: int, b: int) -> None:
        """Place the smaller of two islands next to the other one if it fits there."""
        if len(self._islands[a].triangles) < len(self._islands[b].triangles):
            a, b = b, a
        fixed, moved = self._islands[a], self._islands[b]
        links = np.array(fixed.borders[b])
        for rotation, translation, length, placing_links in self._placements(a, links[~self._is_blocked[links]]):
            if length < MIN_SEWN * np.sqrt(min(fixed.area, moved.area)):
                break
            hull = moved.hull @ rotation.T + translation
            if not self._is_compact(fixed, moved, hull):
                continue
            ends = self._corners_at(a, placing_links)
            joints = ends[1] @ rotation.T + translation
            joined, tolerance = 0.5 * (ends[0] + joints), SNAP_TOLERANCE * self._side
            fixed_uvs = _snap(self.corner_uvs[fixed.triangles], ends[0], joined, tolerance)
            placed = self.corner_uvs[moved.triangles] @ rotation.T + translation
            uvs = _snap(placed, joints, joined, tolerance)
            if (
                any_overlap(fixed_uvs, uvs, GAP * self._side, joined, JOINT_RADIUS * self._side)
                or _overlaps_by_snapping(self.corner_uvs[fixed.triangles], fixed_uvs)
                or _overlaps_by_snapping(placed, uvs)
            ):
                self._is_blocked[placing_links] = True  # Islands only grow, so they will never fit there.
                continue
            self.corner_uvs[fixed.triangles], self.corner_uvs[moved.triangles] = fixed_uvs, uvs
            self._join(a, b, hull)
            return

    def _placements(self, a: int, links: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, float, np.ndarray]]:
        """Return rotation (2, 2), translation (2,), length of the sewn border and sewn links of the best placements at island `a`."""
        starts, ends = self._corners_at(a, links).reshape(2, 2, -1, 2).transpose(1, 2, 0, 3)
        vectors, lengths = ends - starts, self._lengths[links]
        angles = np.arctan2(cross(vectors[:, 1], vectors[:, 0]), np.einsum("li,li->l", vectors[:, 1], vectors[:, 0]))
        placements, is_left = [], np.ones(len(links), bool)
        while is_left.any() and len(placements) < MAX_PLACEMENTS:
            longest = int(np.argmax(np.where(is_left, lengths, -1.0)))
            cosine, sine = np.cos(angles[longest]), np.sin(angles[longest])
            rotation = np.array([[cosine, -sine], [sine, cosine]])
            translation = 0.5 * (starts[longest, 0] + ends[longest, 0] - (starts[longest, 1] + ends[longest, 1]) @ rotation.T)
            distances = np.maximum(*(np.linalg.norm(at[:, 1] @ rotation.T + translation - at[:, 0], axis=1) for at in (starts, ends)))
            is_sewn = distances <= MAX_MISMATCH * lengths
            is_sewn[longest] = True
            placements.append((rotation, translation, float(lengths[is_sewn].sum()), links[is_sewn]))
            is_left &= ~is_sewn
        return sorted(placements, key=lambda placement: -placement[2])

    def _corners_at(self, a: int, links: np.ndarray) -> np.ndarray:
        """Return the starts and then the ends of links in the map, (2, 2 L, 2): at the island `a`, and at the other one."""
        sides = np.where(self._labels[self._starts[0][links, 0]] == a, 0, 1)
        rows = links, np.stack([sides, 1 - sides])
        return np.concatenate([self.corner_uvs[faces[rows], corners[rows]] for faces, corners in (self._starts, self._ends)], axis=1)

    def _is_compact(self, fixed: _Island, moved: _Island, hull: np.ndarray) -> bool:
        """Return whether two islands, the second one moved to `hull` (H, 2), together waste little of the texture."""
        sides = _box_sides(convex_hull(np.concatenate([fixed.hull, hull])))
        parts = np.stack([_box_sides(island.hull) for island in (fixed, moved)])
        is_thin = fixed.area + moved.area < MAX_THINNESS * sides.max() ** 2
        max_side = min(MAX_LENGTH * self._side, self._max_side) if is_thin else self._max_side
        if sides.max() > max(max_side, parts.max()):
            return False
        boxes = parts.prod(axis=1)
        if sides.max() <= SMALL_SIDE * self._side:
            return bool(sides.prod() <= MAX_SMALL_BOX_GROWTH * boxes.sum())
        is_filled = sides.prod() <= self._limits.max_growth * boxes.sum()
        return bool(is_filled and sides.prod() <= boxes.max() + self._limits.max_addition * boxes.min())

    def _join(self, a: int, b: int, hull: np.ndarray) -> None:
        """Add the island `b`, which has been moved to `hull` (H, 2), to the island `a`."""
        fixed, moved = self._islands[a], self._islands.pop(b)
        self._labels[moved.triangles] = a
        fixed.triangles = np.concatenate([fixed.triangles, moved.triangles])
        fixed.area += moved.area
        fixed.hull = convex_hull(np.concatenate([fixed.hull, hull]))
        del fixed.borders[b]
        for other, links in moved.borders.items():
            if other != a:
                self._islands[other].borders.pop(b)
                fixed.borders.setdefault(other, []).extend(links)
                self._islands[other].borders[a] = fixed.borders[other]
        for other in fixed.borders:
            self._push(min(a, other), max(a, other))


def _overlaps_by_snapping(before: np.ndarray, corner_uvs: np.ndarray) -> bool:
    """Return whether triangles (N, 3, 2) overlap near those that differ from what they were `before` (N, 3, 2)."""
    snapped = corner_uvs[(before != corner_uvs).any(axis=(1, 2))]
    if not len(snapped):
        return False
    low, high = corner_uvs.min(axis=1), corner_uvs.max(axis=1)
    is_near = ((low <= snapped.max(axis=(0, 1))) & (high >= snapped.min(axis=(0, 1)))).all(axis=1)
    return run_to_end(count_overlaps(corner_uvs[is_near])) > 0


def _snap(corner_uvs: np.ndarray, positions: np.ndarray, targets: np.ndarray, tolerance: float) -> np.ndarray:
    """Return `corner_uvs` (T, 3, 2), those at `positions` (P, 2) moved to `targets` (P, 2)."""
    distances, nearest = cKDTree(positions).query(corner_uvs.reshape(-1, 2), distance_upper_bound=tolerance)
    is_near = np.isfinite(distances)
    snapped = corner_uvs.reshape(-1, 2).copy()
    snapped[is_near] = targets[nearest[is_near]]
    return snapped.reshape(corner_uvs.shape)


def _preferences(mesh: TriangleMesh, halfedges: np.ndarray) -> np.ndarray:
    """Return factors (I,) of the lengths of borders: larger where the surface is flat, smaller where it is concave."""
    folds = fold_angles(mesh.vertices, mesh.triangles, halfedges)
    _, normals = face_areas_and_normals(mesh.corners)
    faces = halfedges // 3
    apexes = mesh.vertices[mesh.triangles[faces[:, 1], halfedges[:, 1] % 3]]
    origins = mesh.vertices[mesh.triangles[faces[:, 0], (halfedges[:, 0] + 1) % 3]]
    is_concave = np.einsum("li,li->l", apexes - origins, normals[faces[:, 0]]) > 0.0
    return 1.0 + FOLD_PREFERENCE * np.cos(folds) - CONCAVE_PREFERENCE * is_concave


def _box_sides(hull: np.ndarray) -> np.ndarray:
    """Return the sides (2,) of the bounding box of minimum area around `hull` (H, 2)."""
    edges = np.roll(hull, -1, axis=0) - hull
    edges = edges / np.maximum(np.linalg.norm(edges, axis=1, keepdims=True), TINY)
    extents = np.stack([np.ptp(hull @ edges.T, axis=0), np.ptp(hull @ (edges[:, ::-1] * [-1.0, 1.0]).T, axis=0)], axis=1)
    return extents[int(extents.prod(axis=1).argmin())]
