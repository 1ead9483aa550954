"""What is worked on at once: all of a level's vertices, or where these are many, patches of them one after the other while the rest stands
still. A factor of all would take memory and time out of proportion; coarser levels have brought far ends together by then."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .assembly import Assembly
from .border_barrier import BorderBarrier
from .layout_energy import LayoutEnergy
from .relaxation import mended
from .rest_shapes import RestShapes
from .shape_barrier import ShapeBarrier, least_ratios
from .stretch_energy import StretchEnergy

DIRECT = 20_000  # vertices that are worked on at once
PATCH = 8_000  # vertices of a patch at most, where there are more
UNEVEN = 0.36  # of the vertices: where every other sweep is cut first, so that its patches meet elsewhere
RINGS = 8  # of triangles around those that have changed, that are worked on with them
NEARLY = 0.95  # of the ratio that a triangle has: where it is below the bound on its shape, it is not let fall farther than that


@dataclass(frozen=True)
class Level:
    """A level of a chart.

    vertices (V, 3): of the whole chart. triangles (T, 3), with their rest shapes, weights (T,) and `border` edges (B, 2).
    vertex_weights (V,). moved (V,) bool: who may move. reach: how near the border may come to itself freely.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    shapes: RestShapes
    weights: np.ndarray
    vertex_weights: np.ndarray
    border: np.ndarray
    moved: np.ndarray
    reach: float

    def parts(self, layout: np.ndarray, sweep: int, changed: np.ndarray) -> Iterator[tuple[float, "Part | None"]]:
        """What is around the triangles that are `changed` (T,) bool, or the patches of a large level with any of them, each with the share
        of the level that went before; None on the way to the first of many. Patches meet in other places `sweep` after sweep."""
        moved = np.flatnonzero(self.moved)
        if len(moved) <= DIRECT:
            near = self.moved & self._around(changed)
            if near.any():
                yield 0.0, self._part(near, np.flatnonzero(near[self.triangles].any(axis=1)))
            return
        patches = []
        for patch in _patches(layout[moved], UNEVEN if sweep % 2 else 0.5):
            patches.append(patch)
            yield 0.0, None
        owner = np.full(len(self.moved), -1)
        for number, patch in enumerate(patches):
            owner[moved[patch]] = number
        owners = owner[self.triangles].ravel()
        corners = np.argsort(owners, kind="stable")
        starts = np.searchsorted(owners[corners], np.arange(len(patches) + 1))
        yield 0.0, None
        for number in range(len(patches)):
            which = np.unique(corners[starts[number] : starts[number + 1]] // 3)
            if changed[which].any():
                yield number / len(patches), self._part(owner == number, which)

    def _around(self, changed: np.ndarray) -> np.ndarray:
        """Vertices (V,) bool within some rings of triangles around those that are `changed` (T,) bool."""
        near = np.zeros(len(self.moved), bool)
        near[self.triangles[changed]] = True
        for _ in range(RINGS if not changed.all() else 0):
            near[self.triangles[near[self.triangles].any(axis=1)]] = True
        return near

    def _part(self, moved: np.ndarray, which: np.ndarray) -> "Part":
        """The triangles `which` (K,), those of the vertices `moved` (V,) bool."""
        border = self.border if moved[self.border].any() else self.border[:0]
        used = np.zeros(len(moved), bool)
        used[self.triangles[which]] = True
        used[border] = True
        numbers = np.flatnonzero(used)
        place = np.cumsum(used) - 1
        stays = ~moved
        stays[self.border] = True
        return Part(
            numbers=numbers,
            which=which,
            vertices=self.vertices[numbers],
            triangles=place[self.triangles[which]].astype(np.int32),
            shapes=RestShapes(self.shapes.areas[which], np.ascontiguousarray(self.shapes.gradients[:, :, which])),
            weights=self.weights[which],
            vertex_weights=self.vertex_weights[numbers],
            border=place[border],
            moved=moved[numbers],
            stays=stays[numbers],
            reach=self.reach,
        )


@dataclass(frozen=True)
class Part:
    """Some triangles of a level and the vertices that they and the border have, numbered anew.

    numbers (N,): of the vertices in the chart. which (K,): of the triangles in the level. stays (N,) bool: who is not mended alone.
    The rest as in `Level`.
    """

    numbers: np.ndarray
    which: np.ndarray
    vertices: np.ndarray
    triangles: np.ndarray
    shapes: RestShapes
    weights: np.ndarray
    vertex_weights: np.ndarray
    border: np.ndarray
    moved: np.ndarray
    stays: np.ndarray
    reach: float

    def energy(self, layout: np.ndarray, least_ratio: float, pull: np.ndarray) -> LayoutEnergy:
        """What is lowered, from a layout (N, 2). No triangle above the bound on its shape goes below it, and no other one much lower than
        it is; those are pulled up, as strongly as `pull` (K,) says."""
        barriers = []
        if least_ratio > 0.0:
            counts = self.shapes.areas * np.sqrt(self.weights)  # half of what stretch comes to where there is none
            ratios = least_ratios(layout[self.triangles])
            floors = np.where(ratios > least_ratio, least_ratio, NEARLY * ratios)
            barriers.append(ShapeBarrier(self.triangles, np.arange(len(self.which)), counts, floors, False))
            low = np.flatnonzero((ratios < least_ratio) & (pull > 0.0))
            if len(low):
                barriers.append(ShapeBarrier(self.triangles[low], low, (counts * pull)[low], np.full(len(low), least_ratio), True))
        return LayoutEnergy(
            Assembly(self.triangles, self.moved),
            StretchEnergy(self.triangles, self.shapes, self.weights),
            barriers,
            BorderBarrier(self.border, self.reach) if len(self.border) else None,
            self.mended,
        )

    def mended(self, layout: np.ndarray) -> np.ndarray:
        """The layout (N, 2) with fewer squeezed triangles."""
        return mended(layout, self.triangles, self.vertices, self.shapes, self.vertex_weights, self.stays)


def _patches(places: np.ndarray, first: float) -> Iterator[np.ndarray]:
    """`places` (N, 2) in patches by cuts across the longer side of their box, the first at the share `first`, all others in the middle."""
    waiting = [(np.arange(len(places)), first)]
    while waiting:
        members, share = waiting.pop()
        if len(members) <= PATCH:
            yield members
            continue
        axis = int(np.ptp(places[members], axis=0).argmax())
        order = members[np.argsort(places[members, axis], kind="stable")]
        cut = int(share * len(order))
        waiting += [(order[cut:], 0.5), (order[:cut], 0.5)]
