"""What keeps a layout's border from touching itself: a layout that flips no triangle and whose border is simple overlaps nowhere.

Every vertex of the border keeps away from every edge of it that it does not belong to, by an energy that begins at a small distance and
is infinite at none (Smith, Schaefer: Bijective parameterization with free boundaries, 2015). A layout whose border crosses itself is no
layout: its energy is infinite, so that no step ends there.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..spatial import sorted_unique
from .plane import cross
from .stretch_energy import first_root

PUSH = 0.1  # of the reach squared, which is about what the stretch of a triangle counts
FEW = 100  # edges at most, of which all pairs are looked at
MOST_SAMPLES = 16  # times as many as edges, to look for what is near long ones


class BorderBarrier:
    """The energy of layouts (V, 2) by a border of B edges (B, 2) int, each of whose vertices begins one of them.

    reach: distance in the layout at which the energy begins.
    """

    def __init__(self, border: np.ndarray, reach: float) -> None:
        self._border, self._reach = border, reach
        self._last: tuple[np.ndarray, np.ndarray, _Contacts] | None = None  # one layout is asked about several times in a row

    def value(self, layout: np.ndarray) -> float:
        """The energy; infinite where the border crosses itself."""
        pairs, contacts = self._near(layout)
        if _crossed(layout[self._border[pairs]]):
            return np.inf
        ratio = self._reach / contacts.distances
        return float(PUSH * self._reach**2 * ((ratio - 1.0) ** 2).sum())

    def slopes(self, layout: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What pushes: vertices (P, 3), and slopes (P, 6) by their x and y in turn."""
        _, contacts = self._near(layout)
        ratio = self._reach / contacts.distances
        slope = -2.0 * PUSH * self._reach * (ratio - 1.0) * ratio**2
        return contacts.vertices, slope[:, None] * contacts.ways

    def bends(self, layout: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same vertices (P, 3), and bends (P, 6, 6), positive."""
        _, contacts = self._near(layout)
        ratio, ways = self._reach / contacts.distances, contacts.ways
        bend = 2.0 * PUSH * (3.0 * ratio - 2.0) * ratio**3
        return contacts.vertices, bend[:, None, None] * ways[:, :, None] * ways[:, None, :]

    def longest_step(self, layout: np.ndarray, move: np.ndarray) -> float:
        """The multiple of `move` (V, 2) at which the first vertex that is near to an edge comes upon its line; infinite where none does."""
        _, contacts = self._near(layout)
        beside = (contacts.shares > 0.0) & (contacts.shares < 1.0)
        there, change = layout[contacts.vertices[beside]], move[contacts.vertices[beside]]
        (first, second), (by_first, by_second) = ((each[:, 1] - each[:, 0], each[:, 2] - each[:, 0]) for each in (there, change))
        area = cross(first, second)
        side = np.sign(area)
        return first_root(side * cross(by_first, by_second), side * (cross(first, by_second) + cross(by_first, second)), np.abs(area))

    def _near(self, layout: np.ndarray) -> tuple[np.ndarray, "_Contacts"]:
        """Pairs (Q, 2) of edges that may be in contact, and the contacts that there are."""
        if self._last is None or self._last[0] is not layout:
            pairs = _near_edges(layout, self._border, self._reach)
            self._last = layout, pairs, self._contacts(layout, pairs)
        return self._last[1:]

    def _contacts(self, layout: np.ndarray, pairs: np.ndarray) -> "_Contacts":
        """The contacts within reach, from `pairs` (Q, 2) of edges that may have some."""
        first, second = self._border[pairs].transpose(1, 0, 2)
        vertices = np.concatenate([np.column_stack([first[:, 0], second]), np.column_stack([second[:, 0], first])])
        point, start, end = layout[vertices].transpose(1, 0, 2)
        along = end - start
        shares = np.einsum("pi,pi->p", point - start, along) / np.maximum(np.einsum("pi,pi->p", along, along), 1e-300)
        shares = np.clip(shares, 0.0, 1.0)
        towards = point - start - shares[:, None] * along
        distances = np.maximum(np.hypot(*towards.T), 1e-12 * self._reach)
        within = distances < self._reach
        return _Contacts(vertices[within], shares[within], towards[within], distances[within])


@dataclass(frozen=True)
class _Contacts:
    """P vertices near to edges: vertices (P, 3), the one and the ends of the edge; shares (P,), where along the edge the nearest point is;
    towards (P, 2), from there to the vertex; distances (P,)."""

    vertices: np.ndarray
    shares: np.ndarray
    towards: np.ndarray
    distances: np.ndarray

    @property
    def ways(self) -> np.ndarray:
        """How the distances grow (P, 6) by the x and y of the three vertices in turn."""
        away, share = self.towards / self.distances[:, None], self.shares[:, None]
        return np.concatenate([away, (share - 1.0) * away, -share * away], axis=1)


def crosses_itself(layout: np.ndarray, border: np.ndarray) -> bool:
    """Whether two edges of a `border` (B, 2) that share no vertex meet in a layout (V, 2)."""
    return _crossed(layout[border[_near_edges(layout, border, 0.0)]])


def _near_edges(layout: np.ndarray, border: np.ndarray, reach: float) -> np.ndarray:
    """Pairs (Q, 2) of edges that share no vertex, all of those among them that come within `reach` of each other."""
    starts, ends = layout[border[:, 0]], layout[border[:, 1]]
    pairs = _by_boxes(starts, ends, reach) if len(border) <= FEW else _by_samples(starts, ends, reach)
    ones, others = border[pairs].transpose(1, 0, 2)
    return pairs[(ones[:, :, None] != others[:, None, :]).all(axis=(1, 2))]


def _by_boxes(starts: np.ndarray, ends: np.ndarray, reach: float) -> np.ndarray:
    """Pairs (Q, 2) of segments, from `starts` (B, 2) to `ends`, whose boxes come within `reach` of each other."""
    low, high = np.minimum(starts, ends) - reach, np.maximum(starts, ends)
    meet = (low[:, None] <= high).all(axis=2)
    return np.stack(np.nonzero(np.triu(meet & meet.T, 1)), axis=1)


def _by_samples(starts: np.ndarray, ends: np.ndarray, reach: float) -> np.ndarray:
    """Pairs (Q, 2) of segments, from `starts` (B, 2) to `ends`, all of those among them that come within `reach` of each other."""
    lengths = np.hypot(*(ends - starts).T)
    spacing = max(float(np.median(lengths)), float(lengths.sum()) / (MOST_SAMPLES * len(starts)), reach, 1e-300)
    counts = np.maximum(np.ceil(lengths / spacing).astype(int), 1)
    owner = np.repeat(np.arange(len(starts)), counts)
    place = (np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / counts[owner]
    samples = starts[owner] + place[:, None] * (ends - starts)[owner]
    found = np.sort(owner[cKDTree(samples).query_pairs(spacing + reach, output_type="ndarray")], axis=1)
    keys, _ = sorted_unique(found[:, 0].astype(np.int64) * len(starts) + found[:, 1])
    return np.stack(np.divmod(keys, len(starts)), axis=1)


def _crossed(ends: np.ndarray) -> bool:
    """Whether any two segments meet, of pairs `ends` (Q, 2, 2, 2): pair, segment, end, axis."""
    (a, b), (c, d) = (ends[:, segment].transpose(1, 0, 2) for segment in (0, 1))
    apart = (_side(a, b, c) * _side(a, b, d) > 0.0) | (_side(c, d, a) * _side(c, d, b) > 0.0)
    return bool((~apart & _boxes_meet(a, b, c, d)).any())


def _side(start: np.ndarray, end: np.ndarray, point: np.ndarray) -> np.ndarray:
    return cross(end - start, point - start)


def _boxes_meet(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    return ((np.minimum(a, b) <= np.maximum(c, d)) & (np.minimum(c, d) <= np.maximum(a, b))).all(axis=1)
