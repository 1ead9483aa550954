"""Drastic simplification (section I.B of the paper): what goes on where constraints stop the collapses.

The steps are taken one after the other, as far as needed, and again for each target. Where seams have costs instead of being locked, small
openings are closed before: narrow tunnels would become slits. The size of small parts follows from the mean edge length of a mesh with as
many triangles as the target.
"""

from dataclasses import replace

import numpy as np

from ...geometry.mesh import face_areas_and_normals
from ..settings import TexmeshSettings
from ..textured_mesh import group_by_texture
from .collapse_fans import measure_uv_quality
from .engine import CollapseEngine, RemovalOrder
from .openings import choose_tunnels, find_holes, find_loops, find_side, list_sides
from .topology import label_connected

MAX_LOCKED_FRACTION = 0.25  # If more of the vertices of a level are locked, what can be unlocked is unlocked before all others are gone.
SMALLEST_FRACTION = 0.5  # Components below this fraction of the size of small ones are dropped before triangles fold.
LARGER_FACTOR = 2.0  # Triangles up to this multiple of the size of small ones fold before larger components are dropped.
MIN_FILL_QUALITY = 1e-3  # in texture space, of triangles that close holes
SIMPLEST_COUNT = 4  # Components of at most so many triangles, such as tetrahedra, are dropped at last whatever their size.
TRIANGLES_PER_HOLE, TRIANGLES_PER_TUNNEL = 4, 12  # About so many triangles are no longer needed when one is closed.
OPENING_WEIGHT = 0.02  # Closing an opening costs this multiple of the fourth power of its size: its area times a squared distance.


class DrasticSteps:
    """The steps for one engine, and sentences about what they did."""

    def __init__(self, engine: CollapseEngine, order: RemovalOrder, settings: TexmeshSettings) -> None:
        self._engine, self._order, self._settings = engine, order, settings
        self._area = float(face_areas_and_normals(engine.mesh.vertices[engine.mesh.triangles])[0].sum())
        self._target, self._taken = 0, 0
        self._closed_holes = self._closed_tunnels = self._dropped_components = self._dropped_triangles = 0
        self._unlocked_vertices = self._freed_ends = self._separated_vertices = 0

    def prepare(self, target: int) -> None:
        """Unlock vertices before there are `target` triangles if locked ones would be a large part of what remains."""
        for step in (self._unlock_attributes, self._free_seam_ends, self._unlock_touching_surfaces):
            topology = self._engine.topology
            locked_count = np.count_nonzero(topology.is_used & ~topology.is_removable)
            has_many = locked_count > MAX_LOCKED_FRACTION * target / 2.0  # A surface has half as many vertices as triangles.
            if self._settings.drastic_simplification and has_many:
                step(0.0)

    def close_cheap_openings(self, cost: float, target: int) -> None:
        """Close openings that cost less than a collapse, which costs at least `cost`, on the way to `target` triangles."""
        if self._settings.drastic_simplification and self._engine.crosses_seams:
            self._aim_at(target)
            while self._close_some(size=(max(cost, 0.0) / OPENING_WEIGHT) ** 0.25):
                pass

    def take_next(self, target: int) -> bool:
        """Take the next step that changes anything on the way to `target` triangles. Return whether there was one."""
        if not self._settings.drastic_simplification:
            return False
        self._aim_at(target)
        steps = (
            self._unlock_attributes,
            self._free_seam_ends,
            self._unlock_touching_surfaces,
            self._close_small_openings,
            self._drop_smallest_components,
            self._fold_small_triangles,
            self._close_larger_openings,
            self._fold_larger_triangles,
            self._close_all_openings,
            self._fold_all_triangles,
            self._drop_components,
            self._drop_islands,
            self._drop_simplest_components,
        )
        size = self._settings.drastic_size * np.sqrt(4.0 / np.sqrt(3.0) * self._area / target)  # edge length of equilateral triangles
        while self._taken < len(steps):
            self._taken += 1
            if steps[self._taken - 1](float(size)):
                return True
        return False

    def _aim_at(self, target: int) -> None:
        """Begin with the first step if the target is another one."""
        if target != self._target:
            self._target, self._taken = target, 0

    @property
    def sentences(self) -> list[str]:
        """What was done so far, one sentence for each kind of step."""
        dropped = f"{{}} dropped, {self._dropped_triangles} triangles."
        counts = (
            ("Seams of normals, colors or other attributes were unlocked at {}.", self._unlocked_vertices, "vertex", "vertices"),
            ("{} of seams could collapse.", self._freed_ends, "end", "ends"),
            ("Surfaces that touch at edges were simplified separately at {}.", self._separated_vertices, "vertex", "vertices"),
            ("{} closed.", self._closed_holes, "hole was", "holes were"),
            ("{} closed.", self._closed_tunnels, "tunnel was", "tunnels were"),
            ("The last triangles of islands vanished at {}.", self._engine.dropped_island_count, "vertex", "vertices"),
            (dropped, self._dropped_components, "small component was", "small components were"),
            ("Small triangles folded over at {}.", self._engine.folded_count, "vertex", "vertices"),
        )
        return [text.format(f"{n} {one if n == 1 else many}") for text, n, one, many in counts if n]

    def _fold_small_triangles(self, size: float) -> bool:
        self._engine.relaxation = replace(self._engine.relaxation, small_size=size)
        return self._engine.retry(is_forced=True)

    def _fold_larger_triangles(self, size: float) -> bool:
        return self._fold_small_triangles(LARGER_FACTOR * size)

    def _fold_all_triangles(self, size: float) -> bool:
        return self._fold_small_triangles(np.inf)

    def _unlock_attributes(self, size: float) -> bool:
        """Keep only seams of texture coordinates and materials."""
        engine = self._engine
        if engine.crosses_seams or self._closed_tunnels:
            return False
        before = engine.topology.is_removable
        groups = group_by_texture(engine.mesh)
        if np.array_equal(engine.groups, groups) or len(np.unique(groups)) == len(groups):
            return False
        engine.groups = groups
        engine.rebuild()
        self._unlocked_vertices += np.count_nonzero(engine.topology.is_removable & ~before)
        return True

    def _free_seam_ends(self, size: float) -> bool:
        engine = self._engine
        if engine.frees_ends or engine.crosses_seams:
            return False
        before = engine.topology.is_removable
        engine.frees_ends = True
        engine.rebuild()
        self._freed_ends = np.count_nonzero(engine.topology.is_removable & ~before)
        return engine.retry(is_forced=True) or self._freed_ends > 0

    def _unlock_touching_surfaces(self, size: float) -> bool:
        engine = self._engine
        before = engine.topology.is_removable
        engine.is_locked = np.zeros_like(engine.is_locked)
        engine.rebuild()
        count = np.count_nonzero(engine.topology.is_removable & ~before)
        self._separated_vertices += count
        return count > 0

    def _drop_islands(self, size: float) -> bool:
        if self._engine.relaxation.drops_islands or self._engine.crosses_seams:
            return False
        self._engine.relaxation = replace(self._engine.relaxation, drops_islands=True)
        return self._engine.retry(is_forced=True)

    def _close_small_openings(self, size: float) -> bool:
        """Close openings, and forbid folds again: fewer triangles have to fold without openings."""
        self._engine.relaxation = replace(self._engine.relaxation, small_size=0.0)
        return self._close_openings(size)

    def _close_larger_openings(self, size: float) -> bool:
        return self._close_openings(LARGER_FACTOR * size)

    def _close_all_openings(self, size: float) -> bool:
        return self._close_openings(np.inf)

    def _close_openings(self, size: float) -> bool:
        """Close holes, or else tunnels, from the smallest on, about as many as there are too many triangles. As long as there are any, the
        step is taken again. Where seams set no limits, a triangle may have the texture of a neighbor."""
        is_changed = self._close_some(size)
        self._taken -= is_changed
        return is_changed

    def _close_some(self, size: float) -> bool:
        return self._close_holes(size) or self._close_tunnels(size)

    def _close_holes(self, size: float) -> bool:
        holes = find_holes(self._engine.topology)
        sizes = self._measure(holes)
        is_allowed = (sizes <= size) & (self._can_fill(holes) | self._engine.crosses_seams)
        by_size = np.argsort(sizes, kind="stable")
        by_size = by_size[is_allowed[by_size]][: self._count_excess(TRIANGLES_PER_HOLE)]
        if len(by_size):
            self._closed_holes += len(by_size)
            self._fill(holes[:, by_size])
        return len(by_size) > 0

    def _close_tunnels(self, size: float) -> bool:
        topology = self._engine.topology
        loops = find_loops(topology)
        sizes = self._measure(loops)
        can_fill = self._can_fill(list_sides(topology, loops)).reshape(2, -1).all(axis=0)
        is_allowed = (sizes <= size) & (can_fill | self._engine.crosses_seams)
        tunnels = choose_tunnels(topology, loops[:, is_allowed], sizes[is_allowed], self._count_excess(TRIANGLES_PER_TUNNEL))
        count = tunnels.shape[1]
        if count:
            self._closed_tunnels += count
            self._engine.divide(find_side(topology, tunnels), self._order)
            self._fill(list_sides(topology, tunnels))
        return count > 0

    def _measure(self, openings: np.ndarray) -> np.ndarray:
        """Return the lengths (N,) of the longest edges of `openings` (3, N)."""
        corners = self._engine.surface.positions.T[self._engine.topology.starts[openings]]
        return np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=2).max(axis=0, initial=0.0)

    def _count_excess(self, triangles_per_opening: int) -> int:
        return -(-(self._engine.triangle_count - self._target) // triangles_per_opening)

    def _can_fill(self, holes: np.ndarray) -> np.ndarray:
        """Return which `holes` (3, N), (N,) bool, are within one island and have an area of its sign in texture space, or no texture."""
        engine, topology = self._engine, self._engine.topology
        wedges = topology.wedges[holes]
        signs = engine.orientations[holes[0] % topology.triangle_count]
        is_in_island = (wedges == topology.wedges[topology.next(holes[[1, 2, 0]])]).all(axis=0)
        return is_in_island & ((signs == 0) | (measure_uv_quality(engine.mesh.uvs[wedges]) * signs >= MIN_FILL_QUALITY))

    def _fill(self, holes: np.ndarray) -> None:
        """Close `holes` (3, N) by triangles that begin at these halfedges. Where the wedges there give no triangle of one island, it gets
        the texture of a neighbor."""
        engine, topology = self._engine, self._engine.topology
        rows = np.flatnonzero(~self._can_fill(holes))
        if len(rows):
            quality = measure_uv_quality(engine.mesh.uvs[engine.wedges]) * engine.orientations
            best = quality[holes[:, rows] % topology.triangle_count].argmax(axis=0)
            holes[:, rows] = np.take_along_axis(holes[:, rows], (best + np.arange(3)[:, None]) % 3, axis=0)
        vertices, wedges, edges = topology.starts[holes], topology.wedges[holes], holes[0]
        if len(rows):
            sources = np.stack([topology.next(edges[rows]), topology.previous(edges[rows]), edges[rows]])
            wedges[:, rows] = engine.add_wedges(topology.wedges[sources], vertices[:, rows], self._order)
        engine.add_triangles(vertices, wedges, edges % topology.triangle_count)

    def _drop_smallest_components(self, size: float) -> bool:
        return self._drop_components(SMALLEST_FRACTION * size)

    def _drop_simplest_components(self, size: float) -> bool:
        return self._drop_components(np.inf, SIMPLEST_COUNT)

    def _drop_components(self, size: float, max_count: float = np.inf) -> bool:
        """Drop small components, from the smallest on, as long as there are too many triangles. The largest one stays, and those with more
        than `max_count` triangles."""
        engine = self._engine
        labels = label_connected(engine.triangles.T, len(engine.mesh.vertices))
        counts = np.bincount(labels)
        corners = engine.surface.positions.T[engine.triangles.T]
        areas = np.bincount(labels, face_areas_and_normals(corners)[0])
        low, high = np.full((len(counts), 3), np.inf), np.full((len(counts), 3), -np.inf)
        np.minimum.at(low, labels, corners.min(axis=1))
        np.maximum.at(high, labels, corners.max(axis=1))
        is_small = (np.linalg.norm(high - low, axis=1) <= size) & (counts <= max_count)
        small = np.flatnonzero(is_small & (np.arange(len(counts)) != areas.argmax()))
        small = small[np.argsort(areas[small], kind="stable")]
        excess = engine.triangle_count - self._target
        dropped = small[: int(np.searchsorted(np.cumsum(counts[small]), excess)) + 1]
        if not len(dropped):
            return False
        is_kept = ~np.isin(labels, dropped)
        self._dropped_components += len(dropped)
        self._dropped_triangles += np.count_nonzero(~is_kept)
        engine.keep_triangles(is_kept)
        return True
