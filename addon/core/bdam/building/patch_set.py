"""Patches of one level in ragged arrays, and their files between the levels of a build."""

from dataclasses import dataclass, fields
from typing import BinaryIO

import numpy as np

from ...arrays import concatenate_ranges


@dataclass(frozen=True)
class PatchSet:
    """Patches of one level, in ascending order of their triangles in the bintree.

    indices: (P,) int64, triangles of the bintree. errors: (P,) float32, largest vertical distance to the field in steps.
    vertex_starts, triangle_starts: (P + 1,) int64. x, y, z: (V,) int32, grid coordinates and heights in steps; the vertices of a patch are
    sorted by x, then y. gradients: (V, 2) float32, derivatives of the height along x and y in steps per cell at vertices on the boundary of
    their patch, NaN elsewhere. triangles: (T, 3) int32, vertices counted from the first of the patch, counterclockwise.
    is_hole: (T,) bool, triangles without any known sample.
    sample_starts: (P + 1,) int64. samples: (S, 3) int32, some of the samples (x, y, z) that were removed at this level and at finer ones.
    sample_triangles: (S,) int32, triangles that contain them, counted from the first of the patch.
    """

    indices: np.ndarray
    errors: np.ndarray
    vertex_starts: np.ndarray
    triangle_starts: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    gradients: np.ndarray
    triangles: np.ndarray
    is_hole: np.ndarray
    sample_starts: np.ndarray
    samples: np.ndarray
    sample_triangles: np.ndarray

    def __len__(self) -> int:
        return len(self.indices)

    def select(self, positions: np.ndarray) -> "PatchSet":
        """Return the patches at `positions` (N,)."""
        if np.array_equal(positions, np.arange(len(self))):
            return self
        vertex_counts, triangle_counts = np.diff(self.vertex_starts)[positions], np.diff(self.triangle_starts)[positions]
        vertices = concatenate_ranges(self.vertex_starts[positions], vertex_counts)
        triangles = concatenate_ranges(self.triangle_starts[positions], triangle_counts)
        sample_counts = np.diff(self.sample_starts)[positions]
        samples = concatenate_ranges(self.sample_starts[positions], sample_counts)
        return PatchSet(
            self.indices[positions],
            self.errors[positions],
            to_starts(vertex_counts),
            to_starts(triangle_counts),
            *(array.take(vertices, axis=0) for array in (self.x, self.y, self.z, self.gradients)),
            *(array.take(triangles, axis=0) for array in (self.triangles, self.is_hole)),
            to_starts(sample_counts),
            *(array.take(samples, axis=0) for array in (self.samples, self.sample_triangles)),
        )

    def save(self, stream: BinaryIO) -> None:
        """Write the arrays to a stream, one after the other in the format of NumPy."""
        for field in fields(self):
            np.save(stream, getattr(self, field.name), allow_pickle=False)

    @staticmethod
    def load(stream: BinaryIO) -> "PatchSet":
        """Read patches that `save` has written."""
        return PatchSet(*(np.load(stream, allow_pickle=False) for _ in fields(PatchSet)))


def join(parts: list[PatchSet]) -> PatchSet:
    """Return the patches of several sets, one after the other."""
    arrays = {field.name: [getattr(part, field.name) for part in parts] for field in fields(PatchSet)}
    for name in ("vertex_starts", "triangle_starts", "sample_starts"):
        arrays[name] = [to_starts(np.concatenate([np.diff(starts) for starts in arrays[name]]))]
    return PatchSet(**{name: np.concatenate(values) for name, values in arrays.items()})


def to_starts(counts: np.ndarray) -> np.ndarray:
    """Return (N + 1,) int64: 0 and the cumulative sums of `counts` (N,)."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
