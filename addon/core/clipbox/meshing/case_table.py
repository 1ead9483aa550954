"""The 256 cases of solid and empty voxels around a lattice corner, and the cycles of faces in each.

Eight voxels meet at a corner, its octants. Octant x + 2 y + 4 z lies on the high side of the axes whose bit is 1. Twelve pairs of octants
share a face: pair 4 a + r joins octant `LOW[4 a + r]` with the next one along axis a. Where one of them is solid and the other empty, their
common face belongs to the surface. Around the corner such faces form cycles, and each cycle gets its own vertex. The surface is therefore a
manifold where voxels touch only along an edge or at a corner.

Four octants surround each of the six lattice edges that leave the corner. If they alternate between solid and empty, four faces meet at the
edge and have to be joined in two pairs. They are joined around the solid octants, which separates these. Where this would bring all four
faces into one cycle at both ends of the edge, the edge would be non-manifold, and they are joined around the empty octants instead
(Wenger, Isosurfaces, 2013, section 3.3.3, manifold dual marching cubes).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

AXES = 3
OCTANTS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])  # (8, 3)
LOW = np.array([octant for axis in range(AXES) for octant in range(8) if not octant >> axis & 1])  # (12,) lower octant of each pair
PAIR_AXIS = np.repeat(np.arange(AXES), 4)  # (12,)
HIGH = LOW + (1 << PAIR_AXIS)  # (12,)
DIRECTIONS = np.array([[sign if axis == along else 0 for axis in range(AXES)] for along in range(AXES) for sign in (-1, 1)])  # (6, 3)


@cache
def pair_index(axis: int, low: int) -> int:
    """Return the index of the pair along `axis` with the lower octant `low`."""
    return int(np.flatnonzero((axis == PAIR_AXIS) & (low == LOW))[0])


@cache
def edge_octants(direction: int) -> tuple[int, ...]:
    """Return the four octants around the lattice edge in one of the six directions, in cyclic order."""
    axis, high = divmod(direction, 2)
    first, second = (1 << other for other in range(AXES) if other != axis)
    return tuple((high << axis) + offset for offset in (0, first, first + second, second))


def _pair_between(octant: int, other: int) -> int:
    return pair_index(int(abs(octant - other)).bit_length() - 1, min(octant, other))


def _find_cycles(case: int, flipped: int = -1) -> tuple[np.ndarray, int]:
    """Find the cycles of faces of a case. Around the lattice edge in the direction `flipped`, faces are joined around empty octants.

    Returns the cycle of each pair, (12,) with -1 where its octants are alike, and the direction of an ambiguous edge whose four faces are
    all in one cycle, -1 if there is none.
    """
    solid = [bool(case >> octant & 1) for octant in range(8)]
    labels = [pair if solid[low] != solid[high] else -1 for pair, (low, high) in enumerate(zip(LOW.tolist(), HIGH.tolist(), strict=True))]
    ambiguous = []
    for direction in range(6):
        octants = edge_octants(direction)
        pairs = [_pair_between(octants[side], octants[(side + 1) % 4]) for side in range(4)]
        if sum(labels[pair] >= 0 for pair in pairs) == 4:
            ambiguous.append((direction, pairs))
            joined = [(pairs[side - 1], pairs[side]) for side in range(4) if solid[octants[side]] != (direction == flipped)]
        else:
            joined = [tuple(pair for pair in pairs if labels[pair] >= 0)]
        for group in joined:
            if group:
                old, new = labels[group[1]], labels[group[0]]
                labels = [new if label == old else label for label in labels]
    non_manifold = [direction for direction, pairs in ambiguous if len({labels[pair] for pair in pairs}) == 1]
    cycles = {label: cycle for cycle, label in enumerate(dict.fromkeys(label for label in labels if label >= 0))}
    return np.array([cycles.get(label, -1) for label in labels], np.int8), non_manifold[0] if non_manifold else -1


@dataclass(frozen=True)
class CaseTable:
    """Properties of the cases.

    cycles (512, 12) int8: cycle of each pair, -1 for none. Entries 256 + case are those of a case with its non-manifold edge flipped.
    cycle_counts (512,) int64. non_manifold (256,) int8: direction of the edge whose four faces are all in one cycle, -1 for none.
    """

    cycles: np.ndarray
    cycle_counts: np.ndarray
    non_manifold: np.ndarray


@cache
def case_table() -> CaseTable:
    """Return the table, which is computed once."""
    cycles, non_manifold = np.empty((512, 12), np.int8), np.empty(256, np.int8)
    for case in range(256):
        cycles[case], non_manifold[case] = _find_cycles(case)
        cycles[256 + case] = _find_cycles(case, non_manifold[case])[0]
    return CaseTable(cycles, cycles.max(axis=1).astype(np.int64) + 1, non_manifold)
