"""The first points of a terrain on rays.

Rays descend both bintrees through the bounding boxes of patches, all rays of a chunk level by level; then each ray visits its patches from
front to back until none can be nearer than what it has hit. Rays through edges or corners of triangles and of patches hit, see
`ray_triangles`. The space is the local frame of the store, with its heights exaggerated.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..errors import FileError, SettingsError
from ..files.segment_cache import DEFAULT_CACHE_BYTES, SegmentCache
from .extraction import Cut, extract_uniform_cut
from .ray_triangles import NO_TRIANGLE, Rays, TriangleBlocks
from .store.patch_links import NO_PATCH
from .store.terrain_store import TerrainStore

MAX_RAYS = 1 << 16  # that are cast at once
MAX_VISITS = 1 << 18  # of rays and patches that are kept at once, about 60 MB; chunks of rays with more are divided
BOUNDS_MARGIN = 0.01  # cells; the borders of patches in geographic frames are curved a little more than their bounds allow


@dataclass(frozen=True)
class RayHits:
    """Where rays hit a terrain.

    distances: (N,) float64 meters from the origins, infinite where nothing is hit. positions: (N, 3) float64, NaN there. normals: (N, 3)
    float64, unit normals of the triangles, upwards also if a ray comes from below; NaN there. levels, rows: (N,) int64, the patches, see
    `TerrainStore.levels`; -1 there.
    """

    distances: np.ndarray
    positions: np.ndarray
    normals: np.ndarray
    levels: np.ndarray
    rows: np.ndarray


def cast_rays(
    store: TerrainStore,
    origins: np.ndarray,
    directions: np.ndarray,
    max_distance: float | np.ndarray = np.inf,
    *,
    max_error: float = 0.0,
    exaggeration: float = 1.0,
) -> RayHits:
    """Return the first triangles on rays from `origins` (N, 3) along `directions` (N, 3) of any length, local meters with exaggeration.

    Holes are not hit, nor is a triangle by a ray within its plane. Rays hit from above and from below. Those that are not finite, or have
    no direction, hit nothing. Use a `RayCaster` for several calls.

    Args:
        max_distance: meters, one number or (N,).
        max_error: meters without exaggeration; the triangles are those of the coarsest cut within this error. 0 for the finest ones, which
            `height_at` takes, too.
        exaggeration: factor of the heights of the terrain.

    Raises:
        FileError: a patch that is needed is damaged.
        SettingsError: the exaggeration is not positive, or the error negative.
    """
    if not max_error >= 0.0:
        raise SettingsError(f"The largest error of rays is {max_error:g} m; it must not be negative.")
    caster = RayCaster(store, extract_uniform_cut(store, max_error) if max_error else None, exaggeration)
    hits = caster.cast(origins, directions, max_distance)
    if caster.damages:
        raise FileError(caster.damages[0])
    return hits


class RayCaster:
    """Casts rays against one store, and keeps the patches used last. One thread at a time may use it.

    damages: sentences about patches that cannot be read. Rays pass through them.
    """

    def __init__(
        self, store: TerrainStore, cut: Cut | None = None, exaggeration: float = 1.0, max_bytes: int = DEFAULT_CACHE_BYTES
    ) -> None:
        """cut: the finest patches by default. max_bytes: of patches that are kept in memory.

        Raises:
            SettingsError: the exaggeration is not positive.
        """
        if not 0.0 < exaggeration < np.inf:
            raise SettingsError(f"The exaggeration of heights is {exaggeration:g}; it must be positive and finite.")
        self._store, self._cache = store, SegmentCache(max_bytes)
        self._scale = np.array([1.0, 1.0, exaggeration])
        self._is_in_cut = np.zeros(len(store.bounds), bool)
        if cut is None:
            self._is_in_cut[store.links.starts[-2] :] = True
        else:
            self._is_in_cut[store.links.starts[cut.levels] + cut.rows] = True
        self.damages: list[str] = []

    def cast(self, origins: np.ndarray, directions: np.ndarray, max_distance: float | np.ndarray = np.inf) -> RayHits:
        """Return the first triangles on rays; see `cast_rays`."""
        origins, directions = (np.asarray(array, np.float64).reshape(-1, 3) for array in (origins, directions))
        limits = np.broadcast_to(np.asarray(max_distance, np.float64), len(origins))
        is_valid = np.isfinite(origins).all(axis=1) & np.isfinite(directions).all(axis=1) & directions.any(axis=1) & (limits >= 0.0)
        valid = np.flatnonzero(is_valid)
        units = directions[valid] / np.abs(directions[valid]).max(axis=1, keepdims=True)
        units /= np.linalg.norm(units, axis=1, keepdims=True)
        rays, found = Rays.create(origins[valid] / self._scale, units / self._scale), _Nearest.create(limits[valid])
        for start in range(0, len(valid), MAX_RAYS):
            self._cast_part(rays, np.arange(start, min(start + MAX_RAYS, len(valid))), found)
        return self._collect(len(origins), valid, origins[valid], units, found)

    def _cast_part(self, rays: Rays, rows: np.ndarray, found: "_Nearest") -> None:
        """Cast the rays `rows` (R,), in halves if they visit too many patches."""
        visits = self._descend(rays, rows, found.limits)
        if visits is None:
            self._cast_part(rays, rows[: len(rows) // 2], found)
            self._cast_part(rays, rows[len(rows) // 2 :], found)
            return
        for visitors, patch in self._order_visits(*visits, found):
            blocks = self._read(patch)
            if blocks is None:
                continue
            distances, triangles = blocks.intersect(rays.take(visitors), found.limits[visitors])
            is_nearer = triangles != NO_TRIANGLE
            nearer = visitors[is_nearer]
            found.limits[nearer], found.patches[nearer] = distances[is_nearer], patch
            found.normals[nearer] = blocks.normals(triangles[is_nearer])

    def _descend(self, rays: Rays, rows: np.ndarray, limits: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Return the rays (P,), the patches of the cut (P,), and the distances (P,) where the rays enter their boxes, unsorted. None if
        there are too many of several rays."""
        links, bounds, margin = self._store.links, self._store.bounds, BOUNDS_MARGIN * self._store.header.cell_size
        roots = np.arange(links.starts[1])
        visitors, patches = np.repeat(rows, len(roots)), np.tile(roots, len(rows))
        kept: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        count = 0
        while len(visitors):
            if len(rows) > 1 and count + len(visitors) > MAX_VISITS:
                return None
            boxes = bounds[patches].astype(np.float64)
            near, far = rays.take(visitors).enter_boxes(boxes[:, :3], boxes[:, 3:6], margin)
            enters = (near <= far) & (far >= 0.0) & (near <= limits[visitors])
            visitors, patches, near = visitors[enters], patches[enters], near[enters]
            is_final = self._is_in_cut[patches]
            kept.append((visitors[is_final], patches[is_final], near[is_final]))
            count += len(kept[-1][0])
            children = links.children[patches[~is_final]]
            visitors, patches = np.repeat(visitors[~is_final], 2), children.ravel()
            exists = patches != NO_PATCH
            visitors, patches = visitors[exists], patches[exists]
        return tuple(np.concatenate(parts) for parts in zip(*kept, strict=True))

    @staticmethod
    def _order_visits(
        visitors: np.ndarray, patches: np.ndarray, distances: np.ndarray, found: "_Nearest"
    ) -> Iterator[tuple[np.ndarray, int]]:
        """Yield rays (R,) and the patch that they visit next, until no patch is nearer than what the rays have hit by then."""
        order = np.lexsort((distances, visitors))
        visitors, patches, distances = visitors[order], patches[order], distances[order]
        current = np.flatnonzero(np.diff(visitors, prepend=-1))  # the next visit of each ray
        while len(current):
            current = current[distances[current] <= found.limits[visitors[current]]]
            by_patch = current[np.argsort(patches[current], kind="stable")]
            starts = np.flatnonzero(np.diff(patches[by_patch], prepend=-1))
            for start, stop in pairwise([*starts.tolist(), len(by_patch)]):
                yield visitors[by_patch[start:stop]], int(patches[by_patch[start]])
            current = current[current + 1 < len(visitors)]
            current = current[visitors[current + 1] == visitors[current]] + 1

    def _read(self, patch: int) -> TriangleBlocks | None:
        """Return the triangles of a patch, None if it has none or is damaged."""
        try:
            blocks = self._cache.get(patch, lambda: self._prepare(patch))
        except FileError as error:
            if str(error) not in self.damages:
                self.damages.append(str(error))
            return None
        return blocks if len(blocks) else None

    def _prepare(self, patch: int) -> TriangleBlocks:
        content = self._store.read(*(int(number) for number in self._store.links.locate(patch)))
        return TriangleBlocks(self._store.to_local(content.x, content.y, content.z), content.triangles[~content.is_hole])

    def _collect(self, count: int, valid: np.ndarray, origins: np.ndarray, units: np.ndarray, found: "_Nearest") -> RayHits:
        """Return the hits of `count` rays, of which those of the rows `valid` (M,) with `origins` and `units` (M, 3) were cast."""
        distances, levels, rows = np.full(count, np.inf), np.full(count, -1), np.full(count, -1)
        positions, normals = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
        is_hit = found.patches != NO_PATCH
        hit = valid[is_hit]
        distances[hit] = found.limits[is_hit]
        positions[hit] = origins[is_hit] + units[is_hit] * distances[hit, None]
        directions = found.normals[is_hit] / self._scale
        normals[hit] = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        levels[hit], rows[hit] = self._store.links.locate(found.patches[is_hit])
        return RayHits(distances, positions, normals, levels, rows)


@dataclass(frozen=True)
class _Nearest:
    """The nearest hits so far. limits: (N,) float64, their distances, or the largest ones allowed. patches: (N,) int64, NO_PATCH without a
    hit. normals: (N, 3) float64, of any length, without exaggeration."""

    limits: np.ndarray
    patches: np.ndarray
    normals: np.ndarray

    @classmethod
    def create(cls, limits: np.ndarray) -> "_Nearest":
        return cls(limits.copy(), np.full(len(limits), NO_PATCH, np.int64), np.zeros((len(limits), 3)))
