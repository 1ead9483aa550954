"""The surface of one block of voxels of a level, joined to its neighbours in the same level and in the next finer and coarser ones.

Levels are joined without cracks (section 3.5 of the paper): a face between a voxel and a coarser one belongs to the finer level; a coarser
face that has an edge in common with finer voxels gets the finer corner in the middle of that edge as a vertex of its own. Vertices on the
border of two levels follow from the voxels of both about them, and both levels work them out alike.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from . import surface
from .layout import Cuboid
from .nested import NestedBoxes, slices_of
from .polygons import fans, polygon_normals, smoothed, split_quads
from .subdivision import Patch, subdivided
from .surface import Rings

Place = tuple[int, int, int]


@dataclass(frozen=True)
class BlockMesh:
    """The surface of a block.

    corners (V, 3) int64 and rings (V,) int8: which corner of level 0's lattice a vertex belongs to, and which of its rings; the same pair
    is the same vertex in every block. vertices (V, 3) float64, scene units. normals (V, 3) float32, out of the ground, unit. triangles
    (T, 3) int32, counter-clockwise seen from outside.
    """

    corners: np.ndarray
    rings: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray


@dataclass(frozen=True)
class _Corners:
    """Corners about which vertices lie. places (K, 3) int64 in lattice `units` (K,) int64 of level 0. border (K,): on that of two levels.
    values (8, K), centres (8, 3, K) in those units, of border corners (8, 3, B). codes (K,)."""

    places: np.ndarray
    units: np.ndarray
    border: np.ndarray
    values: np.ndarray
    centres: np.ndarray
    codes: np.ndarray


def signatures(boxes: NestedBoxes, level: int, blocks: list[Place], side: int) -> dict[Place, tuple[int, ...]]:
    """What the surfaces of blocks depend on besides the terrain: how what is shown, and what finer levels show, cut what is about them."""
    reach = _reach(boxes, level) + 1  # patterns ask for the next corner
    low = np.array(blocks, np.int64).reshape(-1, 3) * side - reach
    high = low + side + 2 * reach
    cuts = [_cut(boxes.layout.shown[level], low, high)]
    if (hole := boxes.hole(level)) is not None:
        cuts.append(_cut(hole, low, high))
    if level == boxes.finest:
        for number in range(boxes.finest):
            scale, finer = 1 << (level - number), boxes.layout.shown[number]
            touched = (_cut(Cuboid(finer.low // scale, -(-finer.high // scale)), low, high) != 0).any(axis=1)
            cuts.append(np.where(touched[:, None], finer.key, 0))
    return dict(zip(blocks, map(tuple, np.concatenate(cuts, axis=1).tolist()), strict=True))


def _cut(box: Cuboid, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Bounds (B, 6) of what `box` has in common with cuboids `low` to `high` (B, 3); 0 where that is nothing."""
    first, last = np.maximum(low, box.low), np.minimum(high, box.high)
    return np.where((first < last).all(axis=1)[:, None], np.concatenate([first, last + 1], axis=1), 0)


def _reach(boxes: NestedBoxes, level: int) -> int:
    """How many voxels beyond a block its surface depends on."""
    smoothing = boxes.settings.smoothing
    return smoothing + 2 if smoothing or (boxes.finest and level == boxes.finest) else 1


def block_meshes(boxes: NestedBoxes, level: int, blocks: list[Place], side: int) -> dict[Place, BlockMesh]:
    """The surfaces of blocks of `level`: of the voxels from each place times `side` on, `side` each way, as far as they are shown.

    A face belongs to the block of the lower of its voxels, of the finer where they are of two levels. Blocks without any are left out.
    All blocks are worked on at once, their windows stacked along the first axis: one by one they cost mostly beginnings.
    """
    stack = _stacked(boxes, level, blocks, side)
    if stack is None:
        return {}
    settings, pad = boxes.settings, stack.pad
    faces = surface.faces_of(stack.is_set, *_masks(boxes, level, stack))
    if len(faces.voxels) == 0:
        return {}
    of_face = faces.voxels // stack.size
    kept = Cuboid(np.full(3, pad), np.full(3, pad + side)).contains(stack.local(faces.voxels, of_face)) if pad > 1 else None
    used, numbers = surface.numbered(faces.corners, stack.values.size)
    of_corner = used // stack.size
    places, quads = stack.local(used, of_corner) + stack.lows[of_corner], numbers.take(faces.corners)
    split, middles = _split_edges(boxes.hole(level), places, quads)
    corners = _corners(boxes, level, stack.values, used, places, middles)
    made = surface.rings_of(corners.codes)
    vertices, normals = _placed(boxes, corners, made)
    polygons = np.full((len(quads), 8), -1, np.int64)
    polygons[:, 1::2][split] = surface.vertex_numbers(made, corners.codes, len(used) + np.arange(len(middles)), faces.pairs[split])
    polygons[:, 0::2] = quads = surface.vertex_numbers(made, corners.codes, quads, faces.pairs)
    if settings.smoothing:
        fixed = corners.border[made.corners] | _on_rim(boxes.layout.shown[level], corners.places, corners.units >> level)[made.corners]
        vertices = smoothed(vertices, quads, fixed, settings.smoothing)
        if settings.surface == "blocky":
            normals = np.where(fixed[:, None], normals, polygon_normals(vertices, quads))
    patch = Patch(corners.places.take(made.corners, axis=0) * corners.units[made.corners, None], made.rings, vertices, normals)
    if level == boxes.finest and boxes.finest:
        patch, polygons, source = subdivided(patch, quads, boxes.layout.shown[boxes.finest - 1 :: -1], settings.roughness, settings.seed)
        of_face, kept = of_face[source], kept[source]
    if kept is not None:
        polygons, of_face = polygons[kept], of_face[kept]
    parts = zip(stack.blocks, _parts(patch, polygons, of_face, len(stack.blocks), settings.voxel), strict=True)
    return {block: mesh for block, mesh in parts if len(mesh.triangles)}


@dataclass(frozen=True)
class _Stack:
    """The windows of blocks, stacked along x: values and is_set (B * N, N, N). lows (B, 3) int64: the first voxel of each. pad: how many
    voxels they reach beyond their blocks. size: voxels of one."""

    blocks: list[Place]
    lows: np.ndarray
    pad: int
    values: np.ndarray
    is_set: np.ndarray

    @property
    def side(self) -> int:
        """Voxels along each side of a window."""
        return self.values.shape[1]

    @property
    def size(self) -> int:
        """Voxels in a window."""
        return self.side**3

    def local(self, numbers: np.ndarray, windows: np.ndarray) -> np.ndarray:
        """Indices (K, 3) int64 within their windows of voxels or corners with these `numbers`, which lie in these `windows`."""
        indices = surface.indices_of(numbers, self.values.shape).astype(np.int64)
        indices[:, 0] -= windows * self.side
        return indices


def _stacked(boxes: NestedBoxes, level: int, blocks: list[Place], side: int) -> _Stack | None:
    """The windows of those blocks that hold set voxels and unset ones, None where there are none."""
    pad, found = _reach(boxes, level), []
    for block in blocks:
        low = np.array(block, np.int64) * side - pad
        values = boxes.window(level, low, low + side + 2 * pad)
        is_set = surface.bits_of(values)
        if is_set.any() and not is_set.all():
            found.append((block, low, values, is_set))
    if not found:
        return None
    kept, lows, values, is_set = zip(*found, strict=True)
    return _Stack(list(kept), np.stack(lows), pad, np.concatenate(values), np.concatenate(is_set))


def _masks(boxes: NestedBoxes, level: int, stack: _Stack) -> tuple[np.ndarray | None, ...]:
    """For `faces_of`: which voxels of the windows are the level's own, which count above own ones, which below."""
    shown, hole, side = boxes.layout.shown[level], boxes.hole(level), stack.side
    inner = surface.inner_voxels((side,) * 3)
    highs = stack.lows + side
    whole = ((stack.lows >= shown.low) & (highs <= shown.high)).all(axis=1)
    if hole is not None:
        whole &= ~((highs > hole.low) & (stack.lows < hole.high)).all(axis=1)
    own = np.tile(inner, len(whole)).reshape(len(whole), -1)
    if whole.all():
        return own.ravel(), None, None
    above, below = np.ones_like(own), np.zeros_like(own)
    for row in np.flatnonzero(~whole).tolist():
        window = Cuboid(stack.lows[row], highs[row])
        shell = _box_mask(side, window, shown)
        beyond = ~shell if level < boxes.coarsest or boxes.closed else np.zeros_like(shell)
        if hole is not None:
            shell &= ~_box_mask(side, window, hole)
        own[row] &= shell.ravel()
        above[row], below[row] = (shell | beyond).ravel(), beyond.ravel()
    return own.ravel(), above.ravel(), below.ravel()


def _box_mask(side: int, window: Cuboid, box: Cuboid) -> np.ndarray:
    mask, common = np.zeros((side,) * 3, bool), box.clipped(window)
    if not common.empty:
        mask[slices_of(common.low - window.low, common.high - window.low)] = True
    return mask


def _split_edges(hole: Cuboid | None, places: np.ndarray, quads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which edges (F, 4) of `quads` lie on the border of finer voxels, and their middles (M, 3) in the next finer lattice."""
    if hole is None:
        return np.zeros(quads.shape, bool), np.empty((0, 3), np.int64)
    on_hole = hole.touches(places)[quads]
    split = on_hole & np.roll(on_hole, -1, axis=1)
    return split, places[quads[split]] + places[np.roll(quads, -1, axis=1)[split]]


def _corners(boxes: NestedBoxes, level: int, values: np.ndarray, used: np.ndarray, places: np.ndarray, middles: np.ndarray) -> _Corners:
    """What stands about the corners at `places` (K, 3) of a level, numbers `used` (K,) of its window, and about `middles` (M, 3)."""
    hole, shown = boxes.hole(level), boxes.layout.shown[level]
    on_hole = np.zeros(len(places), bool) if hole is None else hole.touches(places)
    on_rim = np.zeros(len(places), bool) if level == boxes.coarsest else _on_rim(shown, places, 1)
    finer = np.concatenate([on_hole, np.ones(len(middles), bool)])
    places = np.concatenate([np.where(on_hole[:, None], 2 * places, places), middles])
    border = finer | np.concatenate([on_rim, np.zeros(len(middles), bool)])
    octants = np.empty((8, len(places)), values.dtype)
    octants[:, ~border] = surface.octants_at(values, used[~border[: len(used)]])
    centres = np.empty((8, 3, len(places)), np.float32) if border.any() else np.empty((8, 3, 0), np.float32)
    for those, of_level in ((border & ~finer, level), (finer, level - 1)):
        if those.any():
            about = boxes.about(of_level, places[those])
            octants[:, those], centres[:, :, those] = about.values, about.centres
    codes = surface.patterns_of(surface.bits_of(octants))
    for those, of_level in ((~finer, level), (finer, level - 1)):
        rows = np.flatnonzero(those)
        codes[rows] = surface.with_flips(codes[rows], lambda some, along: boxes.patterns_beyond(of_level, places[rows[some]], along))  # noqa: B023
    units = np.where(finer, 1 << max(level - 1, 0), 1 << level)
    return _Corners(places, units, border, octants, centres[:, :, border] if border.any() else centres, codes)


def _on_rim(shown: Cuboid, places: np.ndarray, scale: np.ndarray | int) -> np.ndarray:
    """Which of `places` (K, 3), in lattice units of `scale`, lie on the border of what a level shows."""
    there = places * np.reshape(scale, (-1, 1))
    return ((there == shown.low) | (there == shown.high)).any(axis=1)


def _placed(boxes: NestedBoxes, corners: _Corners, made: Rings) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 in voxels of level 0, and their normals (V, 3) float32."""
    blocky, border = boxes.settings.surface == "blocky", corners.border
    normals = surface.normals_of(corners.values)
    offsets = np.zeros((len(made.corners), 3), np.float32) if blocky else surface.offsets_of(made, corners.codes, corners.values)
    if border.any():
        values, codes = corners.values[:, border], corners.codes[border]
        normals[border] = surface.normals_of(values, corners.centres)
        if not blocky or boxes.settings.smoothing:
            offsets[border[made.corners]] = surface.offsets_of(surface.rings_of(codes), codes, values, corners.centres)
    units = corners.units[made.corners, None]
    return corners.places.take(made.corners, axis=0) * units + offsets.astype(np.float64) * units, normals.take(made.corners, axis=0)


def _parts(patch: Patch, polygons: np.ndarray, of_polygon: np.ndarray, count: int, voxel: float) -> Iterator[BlockMesh]:
    """The meshes of `count` blocks out of `polygons` (F, 8), each in the block `of_polygon` (F,), with the vertices that they use."""
    split = (polygons[:, 1::2] >= 0).any(axis=1)
    fanned, sources = fans(polygons[split])
    triangles = np.concatenate([split_quads(patch.vertices, polygons[~split, 0::2]), fanned])
    of_triangle = np.concatenate([np.repeat(of_polygon[~split], 2), of_polygon[split][sources]])
    order = np.argsort(of_triangle.astype(np.int16), kind="stable")
    triangles, of_triangle = triangles.take(order, axis=0), of_triangle[order]
    of_vertex = np.full(len(patch.vertices), -1, np.int16)
    of_vertex[triangles] = of_triangle[:, None]
    vertices = np.argsort(of_vertex, kind="stable")
    numbers = np.empty(len(vertices), np.int32)
    numbers[vertices] = np.arange(len(vertices), dtype=np.int32)
    triangles = numbers.take(triangles)
    starts, ends = np.searchsorted(of_vertex[vertices], np.arange(count + 1)), np.searchsorted(of_triangle, np.arange(count + 1))
    corners, rings, normals, points = (each.take(vertices, axis=0) for each in (patch.corners, patch.rings, patch.normals, patch.vertices))
    points *= voxel
    for block in range(count):
        rows = slice(starts[block], starts[block + 1])
        part = triangles[ends[block] : ends[block + 1]] - np.int32(starts[block])
        yield BlockMesh(corners[rows], rings[rows], points[rows], normals[rows], part)
