"""The surface of blocks of voxels of a level, joined to their neighbors in the same level and in the next finer and coarser ones.

Levels are joined without cracks (section 3.5 of the paper). A face between voxels of two levels belongs to the finer level. A coarser face
with an edge along finer voxels gets the finer corner at the midpoint of that edge as an additional vertex. Vertices on the boundary of two
levels depend on the voxels of both around them, and both levels compute them identically.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .layout import IntBox, box_slices
from .meshing import surface_nets
from .meshing.subdivision import PatchVertices, subdivide
from .meshing.surface_nets import CornerVertices
from .meshing.triangulation import polygon_normals, smooth, split_quads, triangulate_fans
from .morphing import morph_vertices
from .nested import NestedBoxes
from .transitions import ViewerTransition

BlockIndex = tuple[int, int, int]  # position of a block among the blocks of its level


@dataclass(frozen=True)
class BlockMesh:
    """The surface of a block.

    Attributes:
        corners: (V, 3) int64, lattice corner of level 0 that a vertex belongs to.
        cycles: (V,) int8, cycle at this corner. The same corner and cycle are the same vertex in every block.
        vertices: (V, 3) float64, scene units.
        normals: (V, 3) float32, outward unit vectors.
        triangles: (T, 3) int32, counter-clockwise as seen from outside.
    """

    corners: np.ndarray
    cycles: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray


@dataclass(frozen=True)
class _Corners:
    """Lattice corners that have vertices.

    Attributes:
        positions: (K, 3) int64, in units.
        units: (K,) int64, voxels of level 0.
        on_boundary: (K,) bool, whether a corner is on the boundary of two levels.
        values: (8, K), densities of the octants.
        centers: (8, 3, B) float32, centers of the octants of boundary corners, in units.
        cases: (K,) int64, see `case_table`.
    """

    positions: np.ndarray
    units: np.ndarray
    on_boundary: np.ndarray
    values: np.ndarray
    centers: np.ndarray
    cases: np.ndarray


def compute_signatures(boxes: NestedBoxes, level: int, blocks: list[BlockIndex], side: int) -> dict[BlockIndex, tuple[int, ...]]:
    """Return everything that the surfaces of blocks depend on in addition to the terrain.

    These are the bounds to which the visible part of the level, and those of finer levels, clip a block and its neighborhood, and those
    between which densities are blended.
    """
    margin = _margin(boxes, level) + 1  # cases depend on the next corner
    low = np.array(blocks, np.int64).reshape(-1, 3) * side - margin
    high = low + side + 2 * margin
    bounds = [_clip_bounds(boxes.layout.visible[level], low, high)]
    if (hole := boxes.hole(level)) is not None:
        bounds.append(_clip_bounds(hole, low, high))
    for outer_level in range(level, min(level + 2, boxes.coarsest_level)):
        if (transition := boxes.transition(outer_level)) is not None:
            scale = 1 << (outer_level - level)
            bounds.append(transition.bounds(low // scale, -(-high // scale)))
    if level == boxes.finest_level:  # Its surface is subdivided in finer boxes, if there are some.
        for finer_level in range(boxes.finest_level):
            scale, finer = 1 << (level - finer_level), boxes.layout.visible[finer_level]
            overlaps = (_clip_bounds(IntBox(finer.low // scale, -(-finer.high // scale)), low, high) != 0).any(axis=1)
            bounds.append(np.where(overlaps[:, None], finer.bounds, 0))
    return dict(zip(blocks, map(tuple, np.concatenate(bounds, axis=1).tolist()), strict=True))


def _clip_bounds(box: IntBox, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the bounds (B, 6) of the intersections of `box` with boxes `low` to `high` (B, 3), 0 where they are empty."""
    first, last = np.maximum(low, box.low), np.minimum(high, box.high)
    return np.where((first < last).all(axis=1)[:, None], np.concatenate([first, last + 1], axis=1), 0)


def _margin(boxes: NestedBoxes, level: int) -> int:
    """Return the width in voxels of the neighborhood that the surface of a block depends on."""
    smoothing = boxes.settings.smoothing
    return smoothing + 2 if smoothing or (boxes.finest_level and level == boxes.finest_level) else 1


def extract_blocks(boxes: NestedBoxes, level: int, blocks: list[BlockIndex], side: int) -> dict[BlockIndex, BlockMesh]:
    """Extract the visible surfaces of blocks of `level`, which have `side` voxels per side. Blocks without a surface are left out.

    A face belongs to the block of the lower of its two voxels, or of the finer one where they are of two levels. All blocks are processed
    at once, with their windows stacked along the first axis: one by one they cost mostly call overhead.
    """
    stack = _stack_windows(boxes, level, blocks, side)
    if stack is None:
        return {}
    settings, margin = boxes.settings, stack.margin
    faces = surface_nets.find_faces(stack.solid, *_voxel_masks(boxes, level, stack))
    if len(faces.voxels) == 0:
        return {}
    face_windows = faces.voxels // stack.size
    block_box = IntBox(np.full(3, margin), np.full(3, margin + side))
    in_block = block_box.contains(stack.local_indices(faces.voxels, face_windows)) if margin > 1 else None
    used, rows = surface_nets.compact_indices(faces.corners, stack.values.size)
    corner_windows = used // stack.size
    positions, quads = stack.local_indices(used, corner_windows) + stack.lows[corner_windows], rows.take(faces.corners)
    split, midpoints = _find_split_edges(boxes.hole(level), positions, quads)
    corners = _gather_corners(boxes, level, stack.values, used, positions, midpoints)
    corner_vertices = surface_nets.find_corner_vertices(corners.cases)
    vertices, normals = _compute_vertices(boxes, level, corners, corner_vertices)
    polygons = np.full((len(quads), 8), -1, np.int64)
    midpoint_rows = len(used) + np.arange(len(midpoints))
    polygons[:, 1::2][split] = surface_nets.face_vertices(corner_vertices, corners.cases, midpoint_rows, faces.pairs[split])
    polygons[:, 0::2] = quads = surface_nets.face_vertices(corner_vertices, corners.cases, quads, faces.pairs)
    if settings.smoothing:
        fixed = corners.on_boundary | _is_on_boundary(boxes.layout.visible[level], corners.positions, corners.units >> level)
        fixed = fixed[corner_vertices.corners]
        vertices = smooth(vertices, quads, fixed, settings.smoothing)
        if settings.surface == "blocky":
            normals = np.where(fixed[:, None], normals, polygon_normals(vertices, quads))
    lattice_corners = corners.positions.take(corner_vertices.corners, axis=0) * corners.units[corner_vertices.corners, None]
    patch = PatchVertices(lattice_corners, corner_vertices.cycles, vertices, normals)
    if level == boxes.finest_level and boxes.finest_level:
        finer_boxes = boxes.layout.visible[boxes.finest_level - 1 :: -1]
        patch, polygons, sources = subdivide(patch, quads, finer_boxes, settings.roughness, settings.seed)
        face_windows, in_block = face_windows[sources], in_block[sources]
    if in_block is not None:
        polygons, face_windows = polygons[in_block], face_windows[in_block]
    meshes = zip(stack.blocks, _split_into_blocks(patch, polygons, face_windows, len(stack.blocks), settings.voxel_size), strict=True)
    return {block: mesh for block, mesh in meshes if len(mesh.triangles)}


@dataclass(frozen=True)
class _WindowStack:
    """The windows of blocks, stacked along x.

    Attributes:
        blocks: the blocks.
        lows: (B, 3) int64, first voxel of each window.
        margin: voxels that windows extend beyond their blocks.
        values: (B * N, N, N), densities.
        solid: (B * N, N, N) bool.
    """

    blocks: list[BlockIndex]
    lows: np.ndarray
    margin: int
    values: np.ndarray
    solid: np.ndarray

    @property
    def side(self) -> int:
        """Voxels along each side of a window."""
        return self.values.shape[1]

    @property
    def size(self) -> int:
        """Voxels in a window."""
        return self.side**3

    def local_indices(self, indices: np.ndarray, windows: np.ndarray) -> np.ndarray:
        """Return the indices (K, 3) int64 within their `windows` (K,) of voxels or corners with flat `indices` (K,) in the stack."""
        local = surface_nets.unravel_indices(indices, self.values.shape).astype(np.int64)
        local[:, 0] -= windows * self.side
        return local


def _stack_windows(boxes: NestedBoxes, level: int, blocks: list[BlockIndex], side: int) -> _WindowStack | None:
    """Stack the windows of the blocks that contain both solid and empty voxels; None if there are none."""
    margin, windows = _margin(boxes, level), []
    for block in blocks:
        low = np.array(block, np.int64) * side - margin
        if boxes.has_one_sign(level, low, low + side + 2 * margin):
            continue
        values = boxes.window(level, low, low + side + 2 * margin)
        solid = surface_nets.is_solid(values)
        if solid.any() and not solid.all():
            windows.append((block, low, values, solid))
    if not windows:
        return None
    kept, lows, values, solid = zip(*windows, strict=True)
    return _WindowStack(list(kept), np.stack(lows), margin, np.concatenate(values), np.concatenate(solid))


def _voxel_masks(boxes: NestedBoxes, level: int, stack: _WindowStack) -> tuple[np.ndarray | None, ...]:
    """Return the masks `owned`, `above` and `below` of `surface_nets.find_faces` for the windows of a level."""
    visible, hole, side = boxes.layout.visible[level], boxes.hole(level), stack.side
    interior = surface_nets.interior_mask((side,) * 3)
    highs = stack.lows + side
    is_complete = ((stack.lows >= visible.low) & (highs <= visible.high)).all(axis=1)
    if hole is not None:
        is_complete &= ~((highs > hole.low) & (stack.lows < hole.high)).all(axis=1)
    owned = np.tile(interior, len(is_complete)).reshape(len(is_complete), -1)
    if is_complete.all():
        return owned.ravel(), None, None
    above, below = np.ones_like(owned), np.zeros_like(owned)
    for row in np.flatnonzero(~is_complete).tolist():
        window = IntBox(stack.lows[row], highs[row])
        in_level = _box_mask(side, window, visible)
        outside = ~in_level if level < boxes.coarsest_level or boxes.closed else np.zeros_like(in_level)
        if hole is not None:
            in_level &= ~_box_mask(side, window, hole)
        owned[row] &= in_level.ravel()
        above[row], below[row] = (in_level | outside).ravel(), outside.ravel()
    return owned.ravel(), above.ravel(), below.ravel()


def _box_mask(side: int, window: IntBox, box: IntBox) -> np.ndarray:
    mask, common = np.zeros((side,) * 3, bool), box.intersection(window)
    if not common.is_empty:
        mask[box_slices(common.low - window.low, common.high - window.low)] = True
    return mask


def _find_split_edges(hole: IntBox | None, positions: np.ndarray, quads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which edges (F, 4) of `quads` lie on the boundary of finer voxels, and their midpoints (M, 3) in the next finer lattice."""
    if hole is None:
        return np.zeros(quads.shape, bool), np.empty((0, 3), np.int64)
    on_hole = hole.contains_corners(positions)[quads]
    split = on_hole & np.roll(on_hole, -1, axis=1)
    return split, positions[quads[split]] + positions[np.roll(quads, -1, axis=1)[split]]


def _gather_corners(
    boxes: NestedBoxes, level: int, values: np.ndarray, used: np.ndarray, positions: np.ndarray, midpoints: np.ndarray
) -> _Corners:
    """Gather the octants of the corners at `positions` (K, 3) of a level, with flat indices `used` (K,), and at `midpoints` (M, 3)."""
    hole, visible = boxes.hole(level), boxes.layout.visible[level]
    on_hole = np.zeros(len(positions), bool) if hole is None else hole.contains_corners(positions)
    on_outside = np.zeros(len(positions), bool) if level == boxes.coarsest_level else _is_on_boundary(visible, positions, 1)
    is_finer = np.concatenate([on_hole, np.ones(len(midpoints), bool)])
    positions = np.concatenate([np.where(on_hole[:, None], 2 * positions, positions), midpoints])
    on_boundary = is_finer | np.concatenate([on_outside, np.zeros(len(midpoints), bool)])
    octants = np.empty((8, len(positions)), values.dtype)
    octants[:, ~on_boundary] = surface_nets.gather_octants(values, used[~on_boundary[: len(used)]])
    centers = np.empty((8, 3, len(positions)), np.float32) if on_boundary.any() else np.empty((8, 3, 0), np.float32)
    for mask, corner_level in ((on_boundary & ~is_finer, level), (is_finer, level - 1)):
        if mask.any():
            neighborhood = boxes.gather_octants(corner_level, positions[mask])
            octants[:, mask], centers[:, :, mask] = neighborhood.values, neighborhood.centers
    cases = surface_nets.case_indices(surface_nets.is_solid(octants))
    for mask, corner_level in ((~is_finer, level), (is_finer, level - 1)):
        rows = np.flatnonzero(mask)
        cases[rows] = surface_nets.resolve_non_manifold_edges(
            cases[rows],
            lambda subset, directions: boxes.cases_at_edge_ends(corner_level, positions[rows[subset]], directions),  # noqa: B023
        )
    units = np.where(is_finer, 1 << max(level - 1, 0), 1 << level)
    return _Corners(positions, units, on_boundary, octants, centers[:, :, on_boundary] if on_boundary.any() else centers, cases)


def _is_on_boundary(visible: IntBox, positions: np.ndarray, scale: np.ndarray | int) -> np.ndarray:
    """Return which `positions` (K, 3), in units of `scale` voxels, lie on the boundary of the visible part of a level."""
    corners = positions * np.reshape(scale, (-1, 1))
    return ((corners == visible.low) | (corners == visible.high)).any(axis=1)


def _compute_vertices(boxes: NestedBoxes, level: int, corners: _Corners, corner_vertices: CornerVertices) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3) float64 in voxels of level 0, and their normals (V, 3) float32."""
    blocky, on_boundary = boxes.settings.surface == "blocky", corners.on_boundary
    normals = surface_nets.corner_normals(corners.values)
    if blocky:
        offsets = np.zeros((len(corner_vertices.corners), 3), np.float32)
    else:
        offsets = surface_nets.vertex_offsets(corner_vertices, corners.cases, corners.values)
    if on_boundary.any():
        values, cases = corners.values[:, on_boundary], corners.cases[on_boundary]
        normals[on_boundary] = surface_nets.corner_normals(values, corners.centers)
        if not blocky or boxes.settings.smoothing:
            boundary_vertices = surface_nets.find_corner_vertices(cases)
            offsets[on_boundary[corner_vertices.corners]] = surface_nets.vertex_offsets(boundary_vertices, cases, values, corners.centers)
    units, positions = corners.units[corner_vertices.corners], corners.positions.take(corner_vertices.corners, axis=0)
    normals = normals.take(corner_vertices.corners, axis=0)
    for corner_level in {max(level - 1, 0), level}:
        if isinstance(transition := boxes.transition(corner_level), ViewerTransition):
            weights = transition.vertex_weights(positions) * (units == 1 << corner_level)
            offsets, normals = morph_vertices(positions, weights, transition.coarser, offsets, normals)
    return positions * units[:, None] + offsets.astype(np.float64) * units[:, None], normals


def _split_into_blocks(
    patch: PatchVertices, polygons: np.ndarray, polygon_blocks: np.ndarray, count: int, voxel_size: float
) -> Iterator[BlockMesh]:
    """Yield the meshes of `count` blocks. `polygon_blocks` (F,) is the block of each of `polygons` (F, 8)."""
    has_midpoints = (polygons[:, 1::2] >= 0).any(axis=1)
    fan_triangles, fan_sources = triangulate_fans(polygons[has_midpoints])
    triangles = np.concatenate([split_quads(patch.positions, polygons[~has_midpoints, 0::2]), fan_triangles])
    triangle_blocks = np.concatenate([np.repeat(polygon_blocks[~has_midpoints], 2), polygon_blocks[has_midpoints][fan_sources]])
    order = np.argsort(triangle_blocks.astype(np.int16), kind="stable")
    triangles, triangle_blocks = triangles.take(order, axis=0), triangle_blocks[order]
    vertex_blocks = np.full(len(patch.positions), -1, np.int16)
    vertex_blocks[triangles] = triangle_blocks[:, None]
    vertices = np.argsort(vertex_blocks, kind="stable")
    new_indices = np.empty(len(vertices), np.int32)
    new_indices[vertices] = np.arange(len(vertices), dtype=np.int32)
    triangles = new_indices.take(triangles)
    vertex_starts = np.searchsorted(vertex_blocks[vertices], np.arange(count + 1))
    triangle_starts = np.searchsorted(triangle_blocks, np.arange(count + 1))
    corners, cycles, normals, positions = (
        array.take(vertices, axis=0) for array in (patch.corners, patch.cycles, patch.normals, patch.positions)
    )
    positions *= voxel_size
    for block in range(count):
        rows = slice(vertex_starts[block], vertex_starts[block + 1])
        block_triangles = triangles[triangle_starts[block] : triangle_starts[block + 1]] - np.int32(vertex_starts[block])
        yield BlockMesh(corners[rows], cycles[rows], positions[rows], normals[rows], block_triangles)
