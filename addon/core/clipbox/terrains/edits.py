"""Solids that the user adds to a terrain and subtracts from it: ellipsoids, chains of capsules, and meshes.

A solid is a density like the terrain itself: about the distance to its surface, positive inside. It is evaluated only near itself.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Protocol

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, distance_transform_edt

from ...arrays import concatenate_ranges
from ...geometry.distance import TriangleTree
from .grids import Grid, smooth_minimum
from .pyramids import interpolate_axis, locate_samples

MESH_SAMPLES = 64  # Along the longest side of a mesh.
BAND = 3  # Samples along the axes from the surface of a mesh to which distances are exact; farther ones are about right.
MIN_WIDTH = 1.0  # Voxels along the shortest side of a solid; coarser boxes leave it out.
JITTER = 1.37e-4, 2.91e-4  # Samples by which the columns are moved that count crossings, so that none meets an edge.


class Solid(Protocol):
    """A solid in terrain space."""

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The lowest and the highest corner (3,) of its bounding box."""

    def densities(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return about the distances to its surface, positive inside, at coordinates (X,), (Y,), (Z,) along the axes."""


@dataclass(frozen=True)
class Ellipsoid:
    """A sphere that may be scaled and rotated. matrix: the rows of the (3, 4) matrix from the unit sphere to terrain space."""

    matrix: tuple[tuple[float, float, float, float], ...]

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Solid`."""
        matrix = np.array(self.matrix)
        reach = np.linalg.norm(matrix[:, :3], axis=1)
        return matrix[:, 3] - reach, matrix[:, 3] + reach

    def densities(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """See `Solid`. The first-order distance of Taubin: |p| (1 - |p|) by the length of its gradient, with p on the unit sphere."""
        matrix = np.array(self.matrix)
        inverse = np.linalg.inv(matrix[:, :3])
        columns = [axis - center for axis, center in zip((x, y, z), matrix[:, 3], strict=True)]
        unit = [row[0] * columns[0][:, None, None] + row[1] * columns[1][:, None] + row[2] * columns[2] for row in inverse]
        length = np.sqrt(sum(component**2 for component in unit))
        gradient = np.sqrt(sum(sum(inverse[row, axis] * unit[row] for row in range(3)) ** 2 for axis in range(3)))
        return length * (1.0 - length) / np.maximum(gradient, 1e-9)


@dataclass(frozen=True)
class Capsules:
    """A chain of capsules along a polyline. points: ((x, y, z, radius), ...), at least one."""

    points: tuple[tuple[float, float, float, float], ...]

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Solid`."""
        points = np.array(self.points)
        return (points[:, :3] - points[:, 3:]).min(axis=0), (points[:, :3] + points[:, 3:]).max(axis=0)

    def densities(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """See `Solid`."""
        points = np.array(self.points)
        result = np.full((len(x), len(y), len(z)), -np.inf)
        for start, end in pairwise(points) if len(points) > 1 else [(points[0], points[0])]:
            offsets = x[:, None, None] - start[0], y[:, None] - start[1], z - start[2]
            axis = end[:3] - start[:3]
            along = sum(offset * component for offset, component in zip(offsets, axis, strict=True)) / max(axis @ axis, 1e-12)
            along = np.clip(along, 0.0, 1.0)
            squares = sum((offset - along * component) ** 2 for offset, component in zip(offsets, axis, strict=True))
            np.maximum(result, start[3] + along * (end[3] - start[3]) - np.sqrt(squares), out=result)
        return result


@dataclass(frozen=True)
class MeshSolid:
    """A closed mesh.

    fingerprint: identifies its shape. corners: (T, 3, 3) float64 of its triangles, counter-clockwise as seen from outside.
    """

    fingerprint: str
    corners: np.ndarray = field(compare=False, repr=False)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Solid`."""
        return self.corners.min(axis=(0, 1)), self.corners.max(axis=(0, 1))

    def densities(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """See `Solid`."""
        samples = _sample_mesh(self)
        low, step, values = samples.low, samples.step, samples.values
        along = [
            locate_samples((positions - start) / step, 0, count - 1)
            for positions, start, count in zip((x, y, z), low, values.shape, strict=True)
        ]
        result = values[tuple(slice(axis.start, axis.stop) for axis in along)]
        for axis in (2, 1, 0):
            result = interpolate_axis(result, along[axis], axis)
        beyond = [
            np.maximum(start - positions, positions - start - step * count)
            for positions, start, count in zip((x, y, z), low, values.shape, strict=True)
        ]
        x, y, z = (np.maximum(distances, 0.0) for distances in beyond)
        return result - np.sqrt(x[:, None, None] ** 2 + y[:, None] ** 2 + z**2)


@dataclass(frozen=True)
class Edits:
    """Solids that are added to a terrain, and subtracted afterwards. blend: distance within which they blend with the ground."""

    added: tuple[Solid, ...] = ()
    subtracted: tuple[Solid, ...] = ()
    blend: float = 0.0

    def apply(self, grid: Grid, densities: np.ndarray) -> np.ndarray:
        """Return the densities (X, Y, Z) float32 of a grid with the solids."""
        if not self.added and not self.subtracted:
            return densities
        edited = np.array(densities, np.float32)
        axes = [grid.coordinates_along(axis) for axis in range(3)]
        margin, width = self.blend + 2.0 * grid.voxel_size, np.float32(max(self.blend, 1e-6 * grid.voxel_size))
        for solid, sign in [(solid, np.float32(-1.0)) for solid in self.added] + [(solid, np.float32(1.0)) for solid in self.subtracted]:
            low, high = solid.bounds
            if (high - low).min() < MIN_WIDTH * grid.voxel_size:
                continue
            spans = [slice(*np.searchsorted(axis, (a - margin, b + margin)).tolist()) for axis, a, b in zip(axes, low, high, strict=True)]
            if any(span.start >= span.stop for span in spans):
                continue
            values = solid.densities(*(axis[span] for axis, span in zip(axes, spans, strict=True))).astype(np.float32)
            window = edited[tuple(spans)]
            window[...] = sign * smooth_minimum(sign * window, -values, width)
        return edited


NO_EDITS = Edits()


@dataclass(frozen=True)
class _MeshSamples:
    """Distances at regularly spaced points: values (X, Y, Z) float32, positive inside. Sample i is at low + (i + 0.5) * step."""

    low: np.ndarray
    step: float
    values: np.ndarray


@lru_cache(maxsize=32)
def _sample_mesh(mesh: MeshSolid) -> _MeshSamples:
    """Sample the distance to a mesh."""
    low, high = mesh.bounds
    step = float((high - low).max()) / MESH_SAMPLES
    low = low - (BAND + 1) * step
    shape = np.ceil((high - low) / step).astype(np.int64) + BAND + 1
    corners = (mesh.corners - low) / step
    inside = _is_inside(corners, shape)
    near = binary_dilation(inside, iterations=BAND) & ~binary_erosion(inside, iterations=BAND)
    values = (distance_transform_edt(~near) + 0.7 * BAND).astype(np.float32)
    values[near] = TriangleTree(corners).find_closest(np.argwhere(near) + 0.5)[0]
    return _MeshSamples(low, step, np.where(inside, values, -values) * np.float32(step))


def _is_inside(corners: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Return which samples of a grid are inside triangles `corners` (T, 3, 3), in samples: the sum of crossings below is positive."""
    a, b, c = (corners[:, index] for index in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    first, last = (
        np.clip(np.ceil(extreme - 0.5).astype(np.int64), 0, shape[:2])
        for extreme in (corners[:, :, :2].min(axis=1) - JITTER, corners[:, :, :2].max(axis=1) - JITTER)
    )
    counts = np.where((area != 0.0)[:, None], last - first, 0)
    triangles = np.repeat(np.arange(len(corners)), counts.prod(axis=1))
    number = concatenate_ranges(0, counts.prod(axis=1))
    column = first[triangles] + np.stack(
        [number // np.maximum(counts[triangles, 1], 1), number % np.maximum(counts[triangles, 1], 1)], axis=1
    )
    x, y = (column + 0.5 + JITTER).T
    a, b, c, area = a[triangles], b[triangles], c[triangles], area[triangles]
    weights = np.stack([
        (b[:, 0] - x) * (c[:, 1] - y) - (b[:, 1] - y) * (c[:, 0] - x),
        (c[:, 0] - x) * (a[:, 1] - y) - (c[:, 1] - y) * (a[:, 0] - x),
        (a[:, 0] - x) * (b[:, 1] - y) - (a[:, 1] - y) * (b[:, 0] - x),
    ]) / area  # fmt: skip
    hits = (weights >= 0.0).all(axis=0)
    height = (weights[0] * a[:, 2] + weights[1] * b[:, 2] + weights[2] * c[:, 2])[hits]
    above = np.clip(np.ceil(height - 0.5).astype(np.int64), 0, shape[2])
    crossings = np.zeros((*shape[:2], shape[2] + 1), np.int32)
    np.add.at(crossings, (*column[hits].T, above), np.where(area[hits] > 0.0, -1, 1))
    return np.cumsum(crossings[:, :, :-1], axis=2) > 0
