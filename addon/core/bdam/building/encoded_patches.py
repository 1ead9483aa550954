"""Encoded patches of a shard, with what the structure of a store says about them."""

import io
from dataclasses import dataclass, fields, replace

import numpy as np


@dataclass(frozen=True)
class EncodedPatches:
    """Encoded patches in ascending order of their triangles.

    indices: (P,) int64. errors: (P,) float32, in steps. heights: (P, 2) int32, the lowest and highest vertex in steps. counts: (P, 3)
    int32, of vertices, triangles, and triangles of the outline. sizes: (P,) int64, bytes of each block. blocks: (sum of sizes,) uint8.
    """

    indices: np.ndarray
    errors: np.ndarray
    heights: np.ndarray
    counts: np.ndarray
    sizes: np.ndarray
    blocks: np.ndarray

    def to_bytes(self) -> bytes:
        """Return the arrays as a NumPy archive."""
        buffer = io.BytesIO()
        np.savez(buffer, **{field.name: getattr(self, field.name) for field in fields(self)})
        return buffer.getvalue()

    @staticmethod
    def from_bytes(content: bytes) -> "EncodedPatches":
        """Return what `to_bytes` has written."""
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            return EncodedPatches(**{field.name: archive[field.name] for field in fields(EncodedPatches)})

    def without_blocks(self) -> "EncodedPatches":
        """Return the same patches without their contents."""
        return replace(self, blocks=np.zeros(0, np.uint8))
