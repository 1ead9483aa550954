"""The 256 patterns of set and unset voxels around a corner, and how the surface passes the corner in each.

Eight voxels meet at a corner, its octants; octant x + 2 y + 4 z lies on the high side of the axes whose bit is 1. Twelve pairs of them
share a face; pair 4 a + r joins along axis a the octant `LOW[4 a + r]` with the one above it. Where the two differ, the face between them
belongs to the surface. Around the corner such faces form rings, and each ring gets a vertex of its own: so the surface is a manifold
where voxels touch along an edge or in a corner only.

About the half edge from the corner in one of six directions lie four octants. If they alternate, four faces meet there, and have to be
joined in two twos: about the set octants, so that these part. Where that would bring all four into one ring at both ends of the edge, they
are joined about the unset octants instead (after Wenger, Isosurfaces, 2013, section 3.3.3, manifold dual marching cubes).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

AXES = 3
OCTANTS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])  # (8, 3)
LOW = np.array([octant for axis in range(AXES) for octant in range(8) if not octant >> axis & 1])  # (12,) the lower octant of each pair
PAIR_AXIS = np.repeat(np.arange(AXES), 4)  # (12,)
HIGH = LOW + (1 << PAIR_AXIS)  # (12,)
DIRECTIONS = np.array([[sign if axis == along else 0 for axis in range(AXES)] for along in range(AXES) for sign in (-1, 1)])  # (6, 3)


def pair_of(axis: int, low: int) -> int:
    """The number of the pair along `axis` whose lower octant is `low`."""
    return int(np.flatnonzero((axis == PAIR_AXIS) & (low == LOW))[0])


def octants_about(direction: int) -> list[int]:
    """The four octants about the half edge in one of the six directions, in a round."""
    axis, high = divmod(direction, 2)
    first, second = (1 << other for other in range(AXES) if other != axis)
    return [(high << axis) + side for side in (0, first, first + second, second)]


def _pair_between(one: int, other: int) -> int:
    return pair_of(int(abs(one - other)).bit_length() - 1, min(one, other))


def _rings(pattern: int, flipped: int = -1) -> tuple[np.ndarray, int]:
    """The ring of each pair in a pattern, (12,) with -1 where the two octants are alike, and whether an ambiguous direction has all four
    of its faces in one ring: that direction, else -1. About the direction `flipped`, faces are joined about unset octants."""
    is_set = [bool(pattern >> octant & 1) for octant in range(8)]
    ring = [pair if is_set[LOW[pair]] != is_set[HIGH[pair]] else -1 for pair in range(12)]
    ambiguous = []
    for direction in range(6):
        around = octants_about(direction)
        crossed = [_pair_between(around[side], around[(side + 1) % 4]) for side in range(4)]
        if sum(ring[pair] >= 0 for pair in crossed) == 4:
            ambiguous.append((direction, crossed))
            joined = [(crossed[side - 1], crossed[side]) for side in range(4) if is_set[around[side]] != (direction == flipped)]
        else:
            joined = [tuple(pair for pair in crossed if ring[pair] >= 0)]
        for pairs in joined:
            if pairs:
                old, new = ring[pairs[1]], ring[pairs[0]]
                ring = [new if each == old else each for each in ring]
    pinched = [direction for direction, crossed in ambiguous if len({ring[pair] for pair in crossed}) == 1]
    numbers = {name: number for number, name in enumerate(dict.fromkeys(each for each in ring if each >= 0))}
    return np.array([numbers.get(each, -1) for each in ring], np.int8), pinched[0] if pinched else -1


@dataclass(frozen=True)
class Patterns:
    """What is known of each pattern.

    rings (512, 12) int8: the ring of each pair, -1 for none; 256 is added to a pattern whose pinched direction is flipped.
    counts (512,) int64: how many rings. pinched (256,) int8: the direction in which all four faces come into one ring, -1 for none.
    """

    rings: np.ndarray
    counts: np.ndarray
    pinched: np.ndarray


@cache
def patterns() -> Patterns:
    """The tables, worked out once."""
    rings, pinched = np.empty((512, 12), np.int8), np.empty(256, np.int8)
    for pattern in range(256):
        rings[pattern], pinched[pattern] = _rings(pattern)
        rings[256 + pattern] = _rings(pattern, pinched[pattern])[0]
    return Patterns(rings, rings.max(axis=1).astype(np.int64) + 1, pinched)
