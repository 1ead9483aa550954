"""Leaves that are cut out of larger faces by an opacity map, as opaque pieces.

Transparent faces cost a renderer one step more for each of them that a ray passes, up to a limit; a wood of such trees took three times
as long as one of opaque ones. From some distance on, pieces of a pixel or two with the color of one point of the map look the same.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import TINY
from ..geometry.distance import plane_barycentric
from ..geometry.mesh import face_areas_and_normals
from ..geometry.transforms import normalize

SIDE = 2.0  # Of a square with the area of a piece, in pixels.
CANDIDATES = 256  # Points of a face, of which those in leaves become pieces.
MAX_PIECES = 64  # Of a face; nearer, it stays as it is.
MIN_OPACITY = 0.5  # Of a point that becomes a piece.
MAX_COVERAGE = 0.9  # Of an element that is cut out; others are nearly opaque.
GENERATORS = 1.2207440846057596 ** -np.arange(1.0, 4.0)  # Of the low-discrepancy sequence R3; the root of x^4 = x + 1.
CORNER_ANGLES = np.arange(3) * (2.0 * np.pi / 3.0)
THICKNESS = 0.1  # Of the pieces of an element together, in pixels: pieces in one plane would shadow each other.
UV_LENGTH = 1e-3  # Of a piece in the map, so that it has one color and a direction for normal maps.

ReadOpacity = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Returns opacities (N,) in 0..1 at points: triangles (N,) and barycentric coordinates (N, 3)."""


@dataclass(frozen=True)
class Cutouts:
    """The points of elements of a mesh at which opaque pieces may stand. Elements that are not cut out have an area of 0.

    Attributes:
        areas: (E,) of the pieces together, which cover as much as the leaves.
        starts: (E + 1,) int64, the first point of each element.
        triangles: (P,) int64, that each point is in.
        weights: (P, 3), its barycentric coordinates. The first points of an element are evenly distributed.
        angles: (P,) by which a piece is turned.
        is_double: (E,) bool, which elements are fronts with backs at the same place. These shadow each other in some renderers, so that
            their pieces have backs as well.
    """

    areas: np.ndarray
    starts: np.ndarray
    triangles: np.ndarray
    weights: np.ndarray
    angles: np.ndarray
    is_double: np.ndarray

    @property
    def is_cut(self) -> np.ndarray:
        """Which elements (E,) are cut out."""
        return self.areas > 0.0

    def is_replaced(self, pixel_size: float) -> np.ndarray:
        """Return which elements (E,) pieces replace where a pixel has this size."""
        return self.is_cut & (self.areas <= np.minimum(np.diff(self.starts), MAX_PIECES) * (SIDE * pixel_size) ** 2)

    def count_triangles(self, pixel_size: float, ranks: np.ndarray) -> int:
        """Return the number of triangles of the pieces of `choose`."""
        return int((self._count(pixel_size, ranks) * np.where(self.is_double, 2, 1)).sum())

    def choose(self, pixel_size: float, ranks: np.ndarray) -> np.ndarray:
        """Return the points (N,) that have pieces where a pixel has this size. Elements with less than the area of one piece have one if
        their rank in `ranks` (E,), 0..1, is low enough."""
        counts = self._count(pixel_size, ranks)
        ends = np.cumsum(counts)
        return np.repeat(self.starts[:-1] - ends + counts, counts) + np.arange(ends[-1] if len(ends) else 0)

    def _count(self, pixel_size: float, ranks: np.ndarray) -> np.ndarray:
        numbers = np.where(self.is_replaced(pixel_size), self.areas / (SIDE * pixel_size) ** 2, 0.0)
        counts = np.floor(numbers).astype(np.int64)
        return counts + (ranks < numbers - counts)


@dataclass(frozen=True)
class Pieces:
    """Opaque triangles that stand for leaves.

    Attributes:
        positions: (N, 3, 3), their corners.
        sources: (N,) int64, the triangle of the mesh that each is in.
        weights: (N, 3, 3), barycentric coordinates in that triangle of a tiny triangle with the same direction, which has one color.
        is_back: (N,) bool, whether its normals are the opposite ones of that triangle.
    """

    positions: np.ndarray
    sources: np.ndarray
    weights: np.ndarray
    is_back: np.ndarray


def find_cutouts(
    vertices: np.ndarray, triangles: np.ndarray, of_triangles: np.ndarray, is_cut: np.ndarray, read_opacity: ReadOpacity
) -> Cutouts:
    """Return where leaves are in the elements of a mesh with `vertices` (V, 3) and `triangles` (T, 3).

    Args:
        of_triangles: (T,) the element of each triangle, -1 for the rest of the mesh.
        is_cut: (E,) bool, the elements that may be cut out.
        read_opacity: of the map.
    """
    count = len(is_cut)
    rows = np.flatnonzero((of_triangles >= 0) & is_cut[of_triangles])
    rows = rows[np.argsort(of_triangles[rows], kind="stable")]
    areas, normals = face_areas_and_normals(vertices[triangles[rows]])
    ends = np.cumsum(areas)
    chosen = np.flatnonzero(is_cut)
    totals = np.bincount(of_triangles[rows], areas, minlength=count)[chosen]
    begins = np.cumsum(totals) - totals
    sequence = (0.5 + np.arange(CANDIDATES)[:, None] * GENERATORS) % 1.0
    shifts = (0.5 + np.arange(len(chosen))[:, None] * GENERATORS) % 1.0  # Otherwise all elements would have the same pattern.
    points = (sequence + shifts[:, None]) % 1.0
    places = begins[:, None] + points[..., 0] * totals[:, None]
    found = np.minimum(np.searchsorted(ends, places.ravel(), side="right"), max(len(rows) - 1, 0))
    root, fraction = np.sqrt(points[..., 1].ravel()), points[..., 2].ravel()
    weights = np.column_stack([1.0 - root, root * (1.0 - fraction), root * fraction])
    opacities = read_opacity(rows[found], weights)
    coverage = opacities.reshape(-1, CANDIDATES).mean(axis=1) if len(chosen) else np.zeros(0)
    vector_areas = np.stack([np.bincount(of_triangles[rows], areas * axis, minlength=count) for axis in normals.T], axis=1)[chosen]
    is_double = np.zeros(count, bool)
    is_double[chosen] = np.linalg.norm(vector_areas, axis=1) < 0.5 * totals
    covered = np.zeros(count)
    # Pieces cover each other as discs at random do: to cover a fraction c, they have -log(1 - c) times the area.
    fractions = -np.log1p(-np.minimum(coverage, MAX_COVERAGE)) * np.where(is_double[chosen], 0.5, 1.0)
    covered[chosen] = np.where(coverage <= MAX_COVERAGE, fractions * totals, 0.0)
    owners = np.repeat(chosen, CANDIDATES)
    is_leaf = (opacities >= MIN_OPACITY) & (covered[owners] > 0.0)
    starts = np.concatenate([[0], np.cumsum(np.bincount(owners[is_leaf], minlength=count))])
    angles = (points[..., 0].ravel() * CANDIDATES % 1.0) * (2.0 * np.pi)
    return Cutouts(covered, starts, rows[found][is_leaf], weights[is_leaf], angles[is_leaf], is_double)


def place_pieces(
    vertices: np.ndarray, triangles: np.ndarray, uvs: np.ndarray, cutouts: Cutouts, points: np.ndarray, pixel_size: float
) -> Pieces:
    """Return the pieces at some `points` (N,) of cutouts. uvs: (N, 3, 2), of the opacity map at the corners of their triangles."""
    sources, weights, angles = cutouts.triangles[points], cutouts.weights[points], cutouts.angles[points]
    corners = np.asarray(vertices, np.float64)[triangles[sources]]
    _, normals = face_areas_and_normals(corners)
    heights = THICKNESS * pixel_size * ((points * GENERATORS[0]) % 1.0 - 0.5)
    centers = np.einsum("nk,nki->ni", weights, corners) + heights[:, None] * normals
    along = normalize(corners[:, 1] - corners[:, 0])
    across = np.cross(normals, along)
    turned = angles[:, None] + CORNER_ANGLES
    radius = SIDE * pixel_size * np.sqrt(4.0 / (3.0 * np.sqrt(3.0)))  # Of an equilateral triangle with that area.
    offsets = radius * (np.cos(turned)[..., None] * along[:, None] + np.sin(turned)[..., None] * across[:, None])
    positions = centers[:, None] + offsets
    moved = np.stack([plane_barycentric(positions[:, corner], corners) for corner in range(3)], axis=1) - weights[:, None]
    lengths = np.linalg.norm(np.einsum("nck,nki->nci", moved, uvs), axis=2).max(axis=1)
    scale = np.minimum(UV_LENGTH / np.maximum(lengths, TINY), 1.0)
    in_map = weights[:, None] + scale[:, None, None] * moved
    owners = np.searchsorted(cutouts.starts, points, side="right") - 1
    backs = np.flatnonzero(cutouts.is_double[owners])
    return Pieces(
        np.concatenate([positions, positions[backs, ::-1]]),
        np.concatenate([sources, sources[backs]]),
        np.concatenate([in_map, in_map[backs, ::-1]]),
        np.arange(len(points) + len(backs)) >= len(points),
    )
