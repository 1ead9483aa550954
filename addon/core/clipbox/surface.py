"""The surface between set and unset voxels: a quad for each face between the two, vertices shared by the number of their corner.

What a corner's vertex is depends on the eight voxels about it alone (see `patterns`), in a fixed order of sums, so any part of a volume
gives the very same vertices as the whole. Corners of an array of voxels are numbered like its voxels: corner (i, j, k) is the low one of
voxel (i, j, k). After section 3.4 of the paper; surface nets after Gibson, Constrained Elastic Surface Nets, 1998.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .patterns import AXES, DIRECTIONS, HIGH, LOW, OCTANTS, PAIR_AXIS, pair_of, patterns

CENTRES = (OCTANTS - 0.5).astype(np.float32)  # (8, 3) the voxels' centres about their corner

TURNS = np.array([(0, 2, 3, 1), (0, 1, 3, 2)])  # corners of a face, 1 high on the next axis, 2 on the third; normal down the axis, and up
_PAIRS_OF_FACES = [  # the pair of octants that a face lies between, for its corners
    np.array(
        [[pair_of(axis, ((turn & 1 ^ 1) << (axis + 1) % 3) + ((turn >> 1 ^ 1) << (axis + 2) % 3)) for turn in order] for order in TURNS],
        np.int8,
    )
    for axis in range(AXES)
]
_SIDES = np.array([np.where(axis == PAIR_AXIS, 0.0, CENTRES[LOW, axis]) for axis in range(AXES)], np.float32)  # (3, 12) of each pair


@dataclass(frozen=True)
class Faces:
    """Faces between set and unset voxels.

    corners (F, 4) int64, numbers of corners, counter-clockwise seen from the unset voxel. pairs (F, 4) int8: which pair of each corner's
    octants the face lies between. voxels (F,) int64: the own voxel beside the face, the lower one where both are.
    """

    corners: np.ndarray
    pairs: np.ndarray
    voxels: np.ndarray


@dataclass(frozen=True)
class Rings:
    """The vertices of corners, one a ring.

    corners (V,) int64: which of the corners asked for each vertex belongs to. rings (V,) int8. The first vertex of corner i is vertex i;
    `further` (K,) plus a ring, less 1, is the number of any other one, 0 where there is none.
    """

    corners: np.ndarray
    rings: np.ndarray
    further: np.ndarray


@dataclass(frozen=True)
class Surface:
    """The surface of a volume.

    corners (V, 3) int32: the corner that each vertex belongs to. vertices (V, 3) float64, in voxels. normals (V, 3) float32, or None
    where surfaces are blocky. quads (F, 4) int32, counter-clockwise seen from outside.
    """

    corners: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray | None
    quads: np.ndarray


def surface_of(densities: np.ndarray, blocky: bool = False) -> Surface:
    """The surface of `densities` (X, Y, Z), above 0 where set, open where it leaves the volume; voxel (0, 0, 0) fills the unit cube.

    With `blocky`, vertices are the corners themselves, else the means of the points where the densities between two voxels of their ring
    are 0.
    """
    padded = np.pad(densities > 0 if blocky else densities, 1, mode="edge")
    is_set = bits_of(padded)
    faces = faces_of(is_set, inner_voxels(padded.shape))
    used, numbers = numbered(faces.corners, padded.size)
    strides = np.array(strides_of(padded.shape))
    codes = with_flips(patterns_at(is_set, used), lambda rows, along: patterns_at(is_set, used[rows] + DIRECTIONS[along] @ strides))
    made = rings_of(codes)
    quads = vertex_numbers(made, codes, numbers.take(faces.corners), faces.pairs)
    corners = (indices_of(used, padded.shape) - 1).take(made.corners, axis=0)
    if blocky:
        return Surface(corners, corners.astype(np.float64), None, quads)
    values = octants_at(padded, used)
    return Surface(corners, corners + offsets_of(made, codes, values), normals_of(values)[made.corners], quads)


@lru_cache(maxsize=8)
def inner_voxels(shape: tuple[int, int, int]) -> np.ndarray:
    """All voxels of an array but its outermost layer, as a flat mask."""
    inner = np.zeros(shape, bool)
    inner[1:-1, 1:-1, 1:-1] = True
    inner.flags.writeable = False
    return inner.ravel()


def bits_of(values: np.ndarray) -> np.ndarray:
    """Which voxels are set: those above 0."""
    return values.view(np.int16) > 0 if values.dtype == np.float16 else values > 0  # far faster than comparing halves


def indices_of(numbers: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """Indices (K, 3) int32 of the voxels or corners with these `numbers` (K,) in an array."""
    rest, indices = numbers.astype(np.int32), np.empty((len(numbers), AXES), np.int32)
    for axis in (2, 1):
        whole = rest // np.int32(shape[axis])
        indices[:, axis] = rest - whole * np.int32(shape[axis])
        rest = whole
    indices[:, 0] = rest
    return indices


def strides_of(shape: tuple[int, int, int]) -> tuple[int, int, int]:
    """Steps along each axis in the numbers of voxels."""
    return shape[1] * shape[2], shape[2], 1


def faces_of(is_set: np.ndarray, own: np.ndarray, above: np.ndarray | None = None, below: np.ndarray | None = None) -> Faces:
    """The faces between the voxels `own` and those above them along each axis.

    Args:
        is_set: (X, Y, Z) bool. own: (X * Y * Z,) bool, none of them in the outermost layer. above, below: (X * Y * Z,) bool, the voxels
            that count where they lie above own ones, and where they lie below; all of the former and none of the latter if not given.
    """
    flat, strides = is_set.ravel(), strides_of(is_set.shape)
    corners, pairs, voxels = [], [], []
    for axis in range(AXES):
        along, second, third = (strides[(axis + turn) % AXES] for turn in range(AXES))
        crossed = flat[:-along] != flat[along:]
        crossed &= own[:-along] if above is None else (own[:-along] & above[along:]) | (below[:-along] & own[along:])
        low = places_of(crossed)
        outward = flat[low].astype(np.int64)
        steps = along + (TURNS & 1) * second + (TURNS >> 1) * third
        of_face = steps.take(outward, axis=0)  # far faster than steps[outward]
        of_face += low[:, None]
        corners.append(of_face)
        pairs.append(_PAIRS_OF_FACES[axis].take(outward, axis=0))
        voxels.append(low if above is None else np.where(own[low], low, low + along))
    return Faces(np.concatenate(corners), np.concatenate(pairs), np.concatenate(voxels))


def places_of(mask: np.ndarray) -> np.ndarray:
    """As `np.flatnonzero` of a flat mask, faster where few are set: words of eight are looked at first."""
    whole = len(mask) // 8 * 8
    eights = mask[:whole].view(np.uint64)
    words = np.flatnonzero(eights != 0)
    bits = np.flatnonzero(eights[words].view(bool))
    found = words[bits >> 3] * 8 + (bits & 7)
    return np.concatenate([found, whole + np.flatnonzero(mask[whole:])]) if whole < len(mask) else found


def numbered(corners: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The different ones (K,) among `corners`, rising, and for each of `size` corners its place among them, undefined elsewhere."""
    used = np.zeros(size, bool)
    used[corners.ravel()] = True
    different = places_of(used)
    numbers = np.empty(size, np.int32)
    numbers[different] = np.arange(len(different), dtype=np.int32)
    return different, numbers


def octants_at(voxels: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """What `voxels` (X, Y, Z) hold about each of `corners` (K,), none of which lies on a low side of the array: (8, K)."""
    flat = voxels.ravel()
    steps = (OCTANTS - 1) @ np.array(strides_of(voxels.shape))
    found = np.empty((8, len(corners)), voxels.dtype)
    for octant, step in enumerate(steps):
        np.take(flat, corners + step, out=found[octant], mode="clip")
    return found


def patterns_at(is_set: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """The patterns (K,) int64 about `corners` (K,) of an array of bits (X, Y, Z)."""
    return patterns_of(octants_at(is_set, corners))


def patterns_of(is_set: np.ndarray) -> np.ndarray:
    """The patterns (K,) int64 of octants (8, K) bool."""
    codes = is_set[0].astype(np.uint8)
    for octant in range(1, 8):
        codes |= is_set[octant].view(np.uint8) << np.uint8(octant)
    return codes.astype(np.int64)


def with_flips(codes: np.ndarray, neighbours: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
    """The patterns `codes` (K,) with 256 added where two corners would pinch the edge between them.

    neighbours: gives the patterns of the corners at the other ends of the edges that leave the corners `rows` (R,) in `directions` (R,).
    """
    pinched = patterns().pinched
    rows = np.flatnonzero(pinched[codes] >= 0)
    if len(rows) == 0:
        return codes
    direction = pinched[codes[rows]]
    codes = codes.copy()
    codes[rows] += 256 * (pinched[neighbours(rows, direction)] == direction ^ 1)
    return codes


def rings_of(codes: np.ndarray) -> Rings:
    """The vertices of corners with the patterns `codes` (K,)."""
    rings = patterns().counts[codes]
    several = np.flatnonzero(rings > 1)
    more = rings[several] - 1
    further = np.zeros(len(codes), np.int64)
    further[several] = len(codes) + np.cumsum(more) - more
    extra = np.repeat(several, more)
    numbers = np.arange(len(codes), len(codes) + len(extra)) - further[extra] + 1
    return Rings(
        np.concatenate([np.arange(len(codes)), extra]), np.concatenate([np.zeros(len(codes), np.int8), numbers.astype(np.int8)]), further
    )


def vertex_numbers(made: Rings, codes: np.ndarray, places: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """The vertices (F, 4) int32 of faces, written over the places (F, 4) of their corners among those asked for, by their `pairs`."""
    found = places.ravel()
    several = np.flatnonzero((made.further > 0).take(found))
    place = found[several]
    ring = patterns().rings[codes[place], pairs.ravel()[several]].astype(np.int64)
    found[several] = np.where(ring > 0, made.further[place] + ring - 1, place)
    return found.reshape(places.shape)


def offsets_of(made: Rings, codes: np.ndarray, values: np.ndarray, centres: np.ndarray = CENTRES) -> np.ndarray:
    """Where vertices lie from their corners, (V, 3) float32 in voxels: the means of the points of their rings where densities are 0.

    Args:
        codes: (K,) patterns. values: (8, K) densities of the octants. centres: where these belong, from the corner, in voxels: (8, 3),
            or (8, 3, K) where they differ.
    """
    values = values.astype(np.float32)
    offsets = np.empty((AXES, len(made.corners)), np.float32)
    offsets[:, : len(codes)] = _crossings(values, centres, None)
    rows = np.concatenate([np.flatnonzero(made.further), np.arange(len(codes), len(made.corners))])
    if len(rows):
        places = made.corners[rows]
        members = (patterns().rings[codes[places]] == made.rings[rows][:, None]).T
        offsets[:, rows] = _crossings(values[:, places], centres if centres.ndim == 2 else centres[:, :, places], members)
    return offsets.T


def _crossings(values: np.ndarray, centres: np.ndarray, members: np.ndarray | None) -> np.ndarray:
    """The mean (3, K) of the points where densities are 0 between two octants, over all pairs, or those of `members` (12, K)."""
    low, high = values[LOW], values[HIGH]
    crossed = (low > 0) != (high > 0) if members is None else members
    share = low / np.where(crossed, low - high, np.float32(1.0))  # divisions that skip some take five times as long
    share *= crossed
    if centres.ndim == 3:
        points = centres[LOW] + share[:, None] * (centres[HIGH] - centres[LOW])
        total = np.where(crossed[:, None], points, np.float32(0.0)).sum(axis=0)
    else:
        weights = crossed.astype(np.float32)
        share -= np.float32(0.5) * weights
        total = share.reshape(AXES, 4, -1).sum(axis=1) + _SIDES @ weights  # halves add up exactly in any order
    return total / crossed.sum(axis=0, dtype=np.float32)


def normals_of(values: np.ndarray, centres: np.ndarray = CENTRES) -> np.ndarray:
    """Unit vectors (K, 3) float32 down the slope of the densities (8, K) of octants with `centres` as in `offsets_of`."""
    values = values.astype(np.float32)
    slopes = (values[LOW] - values[HIGH]).reshape(AXES, 4, -1).sum(axis=1) if centres.ndim == 2 else -_fitted_slopes(values, centres)
    lengths = np.sqrt((slopes**2).sum(axis=0))
    level = lengths == 0
    slopes[2, level] = lengths[level] = 1.0
    return (slopes / lengths).T


def _fitted_slopes(values: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """The slopes (3, K) that fit densities (8, K) at `centres` (8, 3, K) best."""
    away, rise = centres - centres.mean(axis=0), values - values.mean(axis=0)
    spread = np.stack([[(away[:, row] * away[:, column]).sum(axis=0) for column in range(AXES)] for row in range(AXES)])
    along = np.stack([(away[:, row] * rise).sum(axis=0) for row in range(AXES)])
    return np.linalg.solve(spread.transpose(2, 0, 1), along.T[:, :, None])[:, :, 0].T
