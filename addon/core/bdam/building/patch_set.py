"""Patches of one level, in ragged arrays or encoded, and their files between the levels of a build.

A file has one section for every shard of the next coarser level that needs some of its patches, so that every patch is read once only. It
is sealed, and so is each section, because readers see one section only. Its content: the number of sections and, for each, its shard and
its end, counted from the end of this table, as little-endian int64; then the sections.
"""

import io
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Self

import numpy as np

from ...arrays import concatenate_ranges, to_starts
from ...errors import FileError
from ...files.file_access import error_reason
from ...files.sealed_files import DIGEST_BYTES, seal, unseal, write_sealed
from .work_folder import ADVICE

INTEGER = np.dtype("<i8")


class Arrays:
    """Base of dataclasses whose fields are arrays."""

    def to_bytes(self) -> bytes:
        """Return the arrays one after the other in the format of NumPy."""
        stream = io.BytesIO()
        for field in fields(self):
            np.save(stream, getattr(self, field.name), allow_pickle=False)
        return stream.getvalue()

    @classmethod
    def from_bytes(cls, content: bytes) -> Self:
        """Return what `to_bytes` has written."""
        stream = io.BytesIO(content)
        return cls(*(np.load(stream, allow_pickle=False) for _ in fields(cls)))


@dataclass(frozen=True)
class PatchSet(Arrays):
    """Patches of one level, in ascending order of their triangles in the bintree.

    Attributes:
        indices: (P,) int64, triangles of the bintree.
        errors: (P,) float32, largest vertical distance to the field in steps.
        vertex_starts, triangle_starts: (P + 1,) int64.
        x, y, z: (V,) int32, grid coordinates and heights in steps; the vertices of a patch are sorted by x, then y.
        gradients: (V, 2) float32, derivatives of the height along x and y in steps per cell at vertices on the boundary of their patch, NaN
            elsewhere.
        triangles: (T, 3) int32, vertices counted from the first of the patch, counterclockwise.
        is_hole: (T,) bool, triangles without any known sample.
        sample_starts: (P + 1,) int64.
        samples: (S, 3) int32, some of the samples (x, y, z) that were removed at this level and at finer ones.
        sample_triangles: (S,) int32, triangles that contain the samples, counted from the first of the patch.
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


def join(parts: list[PatchSet]) -> PatchSet:
    """Return the patches of several sets, one after the other."""
    arrays = {field.name: [getattr(part, field.name) for part in parts] for field in fields(PatchSet)}
    for name in ("vertex_starts", "triangle_starts", "sample_starts"):
        arrays[name] = [to_starts(np.concatenate([np.diff(starts) for starts in arrays[name]]))]
    return PatchSet(**{name: np.concatenate(values) for name, values in arrays.items()})


@dataclass(frozen=True)
class EncodedPatches(Arrays):
    """Encoded patches of a shard in ascending order of their triangles, with what the structure of a store says about them.

    Attributes:
        indices: (P,) int64, triangles of the bintree.
        errors: (P,) float32, steps.
        heights: (P, 2) int32, the lowest and highest vertex in steps.
        counts: (P, 3) int32, vertices, triangles, and triangles of the outline.
        sizes: (P,) int64, bytes of each block.
        blocks: (sum of sizes,) uint8.
    """

    indices: np.ndarray
    errors: np.ndarray
    heights: np.ndarray
    counts: np.ndarray
    sizes: np.ndarray
    blocks: np.ndarray

    def without_blocks(self) -> "EncodedPatches":
        """Return the same patches without their contents."""
        return replace(self, blocks=np.zeros(0, np.uint8))


def write_patches(path: Path, patches: PatchSet, shards: np.ndarray) -> None:
    """Write patches for the `shards` (P,) int64 of the next coarser level that need them.

    The system may still hold the file in its cache: if the power fails, its seal shows whether it is complete.

    Raises:
        FileError: the file cannot be written.
    """
    sections = []
    numbers = np.unique(shards)
    for shard in numbers:
        sections.append(seal(patches.select(np.flatnonzero(shards == shard)).to_bytes()))
    ends = np.cumsum([len(section) for section in sections])
    table = np.concatenate([[len(sections)], np.stack([numbers, ends], axis=1).reshape(-1)]).astype(INTEGER)
    write_sealed(path, b"".join([table.tobytes(), *sections]), is_durable=False)


def read_patches(path: Path, shard: int) -> PatchSet:
    """Read the patches that a shard of the next coarser level needs.

    Raises:
        FileError: the file cannot be read, is damaged, or has no such patches.
    """
    content = None
    try:
        with path.open("rb") as file:
            file.seek(DIGEST_BYTES)
            size = path.stat().st_size - DIGEST_BYTES
            count = int.from_bytes(file.read(INTEGER.itemsize), "little", signed=True)
            if 0 < count <= size // (2 * INTEGER.itemsize):
                table = np.frombuffer(file.read(2 * INTEGER.itemsize * count), INTEGER).reshape(-1, 2)
                found = np.flatnonzero(table[:, 0] == shard)
                if len(found):
                    start, end = 0 if found[0] == 0 else int(table[found[0] - 1, 1]), int(table[found[0], 1])
                    if 0 <= start <= end <= size:
                        file.seek(start, io.SEEK_CUR)
                        content = unseal(file.read(end - start))
    except OSError as error:
        raise FileError(f'"{path}" cannot be read: {error_reason(error)}; {ADVICE}.') from error
    if content is None:
        raise FileError(f'"{path}" is damaged; {ADVICE}.')
    return PatchSet.from_bytes(content)
