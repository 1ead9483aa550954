"""Connected components of the primitives, classified as solid, open surface or loose part (leaf, card)."""

from dataclasses import dataclass

import numpy as np

from ..geometry.mesh import connected_components, loose_components, solid_components
from .primitives import Primitives


@dataclass(frozen=True)
class Components:
    """The connected component of each of P primitives.

    labels (P,) int32: component. solid (P,) bool: the component bounds a solid. loose (P,) bool: the component is a leaf or a card.
    """

    labels: np.ndarray
    solid: np.ndarray
    loose: np.ndarray

    def subset(self, indices: np.ndarray) -> "Components":
        """Return the entries of the primitives `indices` (K,). Labels do not change."""
        return Components(self.labels[indices], self.solid[indices], self.loose[indices])


def find_components(primitives: Primitives) -> Components:
    """Find the connected components of `primitives`. A point cloud is a single component, neither solid nor loose."""
    count = len(primitives)
    if primitives.corners.shape[1] != 3:
        return Components(np.zeros(count, np.int32), np.zeros(count, bool), np.zeros(count, bool))
    mesh = (primitives.points, primitives.corners)
    labels = connected_components(*mesh)
    return Components(labels, solid_components(*mesh, labels), loose_components(*mesh, labels))


def find_shared_surfaces(components: Components, owner: np.ndarray) -> np.ndarray:
    """Find the connected surfaces that several quads divide between them.

    Args:
        owner: (P,) int32 quad that owns each primitive.

    Returns:
        (P,) bool: the primitive belongs to such a surface. False for loose parts.
    """
    labels = components.labels
    min_owner = np.full(int(labels.max()) + 1, np.iinfo(np.int32).max)
    max_owner = np.full(len(min_owner), -1)
    np.minimum.at(min_owner, labels, owner)
    np.maximum.at(max_owner, labels, owner)
    return (min_owner < max_owner)[labels] & ~components.loose
