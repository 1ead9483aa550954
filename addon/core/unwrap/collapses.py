"""A mesh thinned out in rounds of independent half-edge collapses, so that layouts can be made on few triangles and carried back to all.

A collapse takes a vertex into one of its neighbours; vertices never move, so every coarser mesh has vertices of the finest one. Collapses
of a round touch no triangle twice, and are undone together: a vertex comes back inside the polygon that its triangles had left
(Hormann, Greiner, Campagna: Hierarchical parametrization of triangulated surfaces, 1999).
"""

from dataclasses import dataclass

import numpy as np

from ..edges import Edges, edges_of
from ..parallel import in_chunks
from ..progress import Progress, Steps, scaled
from ..spatial import keys_of

LARGEST_STAR = 10  # triangles around a vertex that is taken out
SLIVER = 0.05  # of the shape of an equilateral triangle: what a collapse may leave
FOLDED = 0.2  # cosine between a triangle and what a collapse makes of it
SHORTEST = 0.7  # of all collapses are looked at in a round
JITTER = 3.0  # times its squared length may count, by chance
SWEEPS = 3  # in which independent ones are picked
CHUNK = 1 << 14


@dataclass(frozen=True)
class Round:
    """N collapses that were made together.

    triangles (T, 3) int32: the mesh before them. removed (N,), kept (N,) int32: the vertices that went, and those that they went into.
    stars (N, S, 2) int32: the edges opposite to the removed vertices in their triangles, counter-clockwise, -1 where there are fewer.
    """

    triangles: np.ndarray
    removed: np.ndarray
    kept: np.ndarray
    stars: np.ndarray

    def some(self, rows: slice) -> "Round":
        """The same with some of the collapses alone; they do not depend on each other."""
        return Round(self.triangles, self.removed[rows], self.kept[rows], self.stars[rows])


def thinned(vertices: np.ndarray, triangles: np.ndarray, target: int, stays: np.ndarray) -> Steps[tuple[np.ndarray, list[Round]]]:
    """The triangles of a mesh with about `target` vertices, and the rounds that led there, the first one first.

    vertices: (V, 3) float64. triangles: (T, 3) int32, a manifold. stays: (V,) bool, whom no round takes. Ends early where no collapse is
    left that keeps shape and topology.
    """
    rounds: list[Round] = []
    count = int(np.count_nonzero(np.bincount(triangles.ravel())))
    begun = count
    while count > target:
        share = (begun - count) / (begun - target)
        made = yield from scaled(_round(vertices, triangles, stays, count - target, len(rounds)), share, share)
        if len(made.removed) == 0:
            break
        rounds.append(made)
        triangles = _after(made)
        count -= len(made.removed)
    return triangles, rounds


def stars_of(triangles: np.ndarray, chosen: np.ndarray, count: int) -> np.ndarray:
    """The edges (N, S, 2) opposite to the vertices `chosen` (N,) of `count` in their triangles, -1 where there are fewer than S."""
    place = np.full(count, -1)
    place[chosen] = np.arange(len(chosen))
    corners = np.flatnonzero(place[triangles.ravel()] >= 0)
    owner = place[triangles.ravel()[corners]]
    order = np.argsort(owner, kind="stable")
    corners, owner = corners[order], owner[order]
    slot = np.arange(len(owner)) - np.searchsorted(owner, owner)
    stars = np.full((len(chosen), int(slot.max(initial=0)) + 1, 2), -1, np.int32)
    triangle, corner = corners // 3, corners % 3
    stars[owner, slot, 0] = triangles[triangle, (corner + 1) % 3]
    stars[owner, slot, 1] = triangles[triangle, (corner + 2) % 3]
    return stars


def _round(vertices: np.ndarray, triangles: np.ndarray, stays: np.ndarray, most: int, number: int) -> Steps[Round]:
    """The next round, of at most `most` collapses. Chance, drawn by the round's `number`, keeps rows of like vertices from waiting for
    each other."""
    thinning = Progress(0.0, "Thinning")
    yield thinning
    edges = edges_of(triangles, len(vertices))
    yield thinning
    removed, kept, squared = _ways(vertices, triangles, stays, edges)
    yield thinning
    priority = squared * np.random.default_rng(number).uniform(1.0, JITTER, len(squared))
    order = np.argsort(priority, kind="stable")
    order = order[: max(int(SHORTEST * len(order)), min(len(order), 64))]
    removed, kept = removed[order], kept[order]
    chosen = independent(removed, edges)
    removed, kept = removed[chosen], kept[chosen]
    yield thinning
    stars = stars_of(triangles, removed, len(vertices))
    yield thinning
    allowed = in_chunks(lambda rows: _allowed(vertices, edges, stars[rows], removed[rows], kept[rows]), np.arange(len(removed)), CHUNK)
    yield thinning
    chosen = np.flatnonzero(allowed)[:most]
    chosen = chosen[_share_no_edge(stars[chosen], kept[chosen], edges)]
    return Round(triangles, removed[chosen].astype(np.int32), kept[chosen].astype(np.int32), stars[chosen])


def _after(made: Round) -> np.ndarray:
    """The triangles (T', 3) when the collapses of a round are done."""
    goes_to = np.arange(int(made.triangles.max()) + 1, dtype=np.int32)
    goes_to[made.removed] = made.kept
    triangles = goes_to[made.triangles]
    return triangles[(triangles != np.roll(triangles, -1, axis=1)).all(axis=1)]


def _ways(vertices: np.ndarray, triangles: np.ndarray, stays: np.ndarray, edges: Edges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The shortest half-edge of every vertex that may go: the vertex (C,), the one it goes into (C,), the length squared (C,).

    A vertex of a border stays on it.
    """
    sizes = np.bincount(triangles.ravel(), minlength=edges.count)
    removed, kept = np.concatenate([edges.ends, edges.ends[:, ::-1]]).T
    open_to = (sizes[removed] <= LARGEST_STAR) & ~stays[removed] & (np.tile(edges.uses == 1, 2) | ~edges.on_border[removed])
    removed, kept = removed[open_to], kept[open_to]
    squared = ((vertices[removed] - vertices[kept]) ** 2).sum(axis=1)
    order = np.argsort(squared, kind="stable")
    _, first = np.unique(removed[order], return_index=True)
    return removed[order[first]], kept[order[first]], squared[order[first]]


def _allowed(vertices: np.ndarray, edges: Edges, stars: np.ndarray, removed: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Which collapses (C,) bool keep the topology, fold no triangle over and leave no sliver that was not there."""
    there = stars[:, :, 0] >= 0
    left = there & (stars != kept[:, None, None]).all(axis=2)
    old, new = (_fan(vertices, stars, at) for at in (removed, kept))
    old_shape, new_shape = _shapes(*old), _shapes(*new)
    cosine = np.einsum("csk,csk->cs", old[1], new[1])
    sizes = np.sqrt(np.einsum("csk,csk->cs", old[1], old[1]) * np.einsum("csk,csk->cs", new[1], new[1]))
    least = np.minimum(SLIVER, np.where(there, old_shape, 1.0).min(axis=1))
    fits = ~left | ((cosine >= FOLDED * sizes) & (new_shape >= least[:, None]))
    return fits.all(axis=1) & left.any(axis=1) & ~_joined_twice(edges, stars, kept)


def _fan(vertices: np.ndarray, stars: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the triangles from `at` (C,) to `stars` (C, S, 2): the sums of their squared sides (C, S), and normals (C, S, 3), twice as long as
    the areas."""
    middle = vertices[at][:, None]
    first, second = vertices[stars[:, :, 0]] - middle, vertices[stars[:, :, 1]] - middle
    across = second - first
    return sum(np.einsum("csk,csk->cs", each, each) for each in (first, second, across)), np.cross(first, second)


def _shapes(squares: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """1 for equilateral triangles, 0 for those without area, from what `_fan` gives."""
    return 2.0 * np.sqrt(3.0 * np.einsum("csk,csk->cs", normals, normals)) / np.where(squares > 0.0, squares, 1.0)


def _new_neighbours(stars: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Which entries of `stars` (C, S, 2) the kept vertex gets as neighbours, that it had not within the star: (C, S, 2) bool."""
    beside = (stars == kept[:, None, None]).any(axis=2)
    own = np.where(beside[:, :, None], stars, -1).reshape(len(stars), 2 * stars.shape[1])
    known = np.sort(own, axis=1)[:, -4:]  # the kept one twice at most, and those beside it
    return (stars >= 0) & (stars[..., None] != known[:, None, None, :]).all(axis=3)


def _joined_twice(edges: Edges, stars: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Whether a collapse would make an edge that is there already (C,) bool: then the mesh would touch itself there (link condition)."""
    new = _new_neighbours(stars, kept)
    return (new & (edges.between(kept[:, None, None], np.maximum(stars, 0)) >= 0)).any(axis=(1, 2))


def independent(removed: np.ndarray, edges: Edges) -> np.ndarray:
    """Places of some of `removed` (C,), of which no two are neighbours; those that come first go before others."""
    rank = np.full(edges.count, len(removed))
    rank[removed] = np.arange(len(removed))
    open_to = np.zeros(edges.count, bool)
    open_to[removed] = True
    chosen = np.zeros(edges.count, bool)
    for _ in range(SWEEPS):
        first, second = edges.ends[open_to[edges.ends].all(axis=1)].T
        won = open_to.copy()
        won[np.where(rank[first] < rank[second], second, first)] = False
        chosen |= won
        open_to &= ~won
        open_to[edges.ends[chosen[edges.ends].any(axis=1)]] = False
    return np.flatnonzero(chosen[removed])


def _share_no_edge(stars: np.ndarray, kept: np.ndarray, edges: Edges) -> np.ndarray:
    """Which collapses (C,) bool make no edge that an earlier one makes too."""
    item, slot, end = np.nonzero(_new_neighbours(stars, kept))
    other = stars[item, slot, end]
    keys = keys_of(kept[item], other, edges.count)
    order = np.lexsort((item, keys))
    same = (keys[order][1:] == keys[order][:-1]) & (item[order][1:] != item[order][:-1])
    alone = np.ones(len(kept), bool)
    alone[item[order][1:][same]] = False
    return alone
