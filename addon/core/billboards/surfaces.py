"""What the primitives are part of: solids, sheets, loose leaves."""

from dataclasses import dataclass

import numpy as np

from ..mesh import connected_parts, loose_parts, solid_parts
from .primitives import Primitives


@dataclass(frozen=True)
class Surfaces:
    """parts (P,) int32: the connected part of each primitive. solid (P,) bool: it bounds a solid. loose (P,) bool: it is a leaf or card."""

    parts: np.ndarray
    solid: np.ndarray
    loose: np.ndarray

    def subset(self, index: np.ndarray) -> "Surfaces":
        """What the primitives `index` (K,) are part of; parts keep their numbers."""
        return Surfaces(self.parts[index], self.solid[index], self.loose[index])


def surfaces_of(primitives: Primitives) -> Surfaces:
    """The connected parts of `primitives`; the points of a cloud count as one part, neither solid nor loose."""
    count = len(primitives)
    if primitives.corners.shape[1] != 3:
        return Surfaces(np.zeros(count, np.int32), np.zeros(count, bool), np.zeros(count, bool))
    mesh = (primitives.points, primitives.corners)
    parts = connected_parts(*mesh)
    return Surfaces(parts, solid_parts(*mesh, parts), loose_parts(*mesh, parts))


def shared_surfaces(surfaces: Surfaces, owner: np.ndarray) -> np.ndarray:
    """Whether each primitive belongs to a connected surface of which several quads own a piece: (P,) bool. `owner` (P,) int32."""
    parts = surfaces.parts
    lowest = np.full(int(parts.max()) + 1, np.iinfo(np.int32).max)
    highest = np.full(len(lowest), -1)
    np.minimum.at(lowest, parts, owner)
    np.maximum.at(highest, parts, owner)
    return (lowest < highest)[parts] & ~surfaces.loose
