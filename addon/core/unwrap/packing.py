"""Packs charts into the tiles of a texture without changing their relative scale."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import TINY
from ..geometry.convex_hulls import convex_hull
from ..geometry.mesh import scaled_normals
from ..geometry.transforms import signed_areas
from ..jobs.progress import Steps
from .cutting.boundaries import boundary_edges
from .raster_packing import Placement, RasterGrid, max_density, place_charts
from .texture import Texture, tile_origins

XATLAS_SIDE = 1024  # Texels per side of the square that xatlas packs into.
XATLAS_PADDING = 1.25  # That square may become larger, and the margin smaller with it.
MAX_CHARTS_AS_RASTERS = 1000  # More are packed by xatlas, which is faster but packs into one square only;
MAX_CHARTS_WITHOUT_XATLAS = 5000  # the limit for other textures.
MAX_CHART_SIDE = 8 * XATLAS_SIDE  # Texels; the time of xatlas grows with the bounding boxes of charts, however thin they are.
MAX_TILE_FILL = 0.85  # Tiles that are filled at a given density hardly get fuller.
DENSITY_STEP, MAX_ATTEMPTS = 0.93, 12  # A density that does not fit is lowered by this factor so many times.
FEWER_TILES_DENSITY = 0.97  # Charts that fill all tiles to a small part, because one of them is large, fit into fewer ones at this density.
MIN_UPRIGHT_GRADIENT = 0.5  # Mean gradient of height in a chart, 1 where it is vertical, above which its surface has an upright position.
MAX_STRAIGHT_BOX = 1.05  # Bounding box of a chart whose boundary runs along the axes, relative to the smallest one.
MIN_STRAIGHT = 0.5  # Fraction of the boundary in its main direction, below which a chart may be turned freely.
MAX_ROUND_ASPECT = 2.0  # Sides of the bounding box of such a chart.
MAX_CHARTS_FOR_CHOICE, MIN_DENSITY_GAIN = 24, 1.01  # With up to so many charts, these are turned where that raises the density.
COMPACT_STEPS = 90  # Angles per quarter turn.
DIRECTION_BINS = 180  # Per quarter turn.
QUARTER_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])  # Turns rows of coordinates counter-clockwise.


@dataclass(frozen=True)
class Packing:
    """Packed charts.

    Attributes:
        uvs: (V, 2) of each chart, in UDIM tiles of side 1.
        density: Texels per unit of length.
        tile_count: Number of used tiles.
    """

    uvs: list[np.ndarray]
    density: float
    tile_count: int


def pack_charts(
    uvs: Sequence[np.ndarray], triangles: Sequence[np.ndarray], texture: Texture, may_turn: Sequence[bool] | None = None
) -> Steps[Packing]:
    """Return the `uvs` (V, 2) of charts, rotated, moved apart, and scaled by one common factor to fill a texture.

    Args:
        uvs: (V, 2) of each chart.
        triangles: (T, 3) of each chart.
        texture: to fill.
        may_turn: whether each chart may be rotated. None: all may.
    """
    may_turn = [True] * len(uvs) if may_turn is None else may_turn
    grid = RasterGrid.of_tile(texture.inside, texture.margin)
    is_square = texture.size[0] == texture.size[1] and texture.max_tiles == 1
    if len(uvs) > (MAX_CHARTS_AS_RASTERS if is_square else MAX_CHARTS_WITHOUT_XATLAS):
        oriented = [orient_smallest(uv) if turns else uv for uv, turns in zip(uvs, may_turn, strict=True)]
        return _arrange_placed(oriented, triangles, None, texture)
    oriented = [orient(uv, faces) if turns else uv for uv, faces, turns in zip(uvs, triangles, may_turn, strict=True)]
    placed = yield from place_charts(oriented, triangles, may_turn, grid)
    packing = _arrange_placed(oriented, triangles, placed, texture)
    is_round = [turns and _is_round(uv, faces) for uv, faces, turns in zip(oriented, triangles, may_turn, strict=True)]
    for way in (orient_smallest, _orient_compact) if any(is_round) and len(uvs) <= MAX_CHARTS_FOR_CHOICE else ():
        turned = [way(uv) if may_be_slanted else uv for uv, may_be_slanted in zip(oriented, is_round, strict=True)]
        placed = yield from place_charts(turned, triangles, may_turn, grid)
        other = _arrange_placed(turned, triangles, placed, texture)
        if other.density > MIN_DENSITY_GAIN * packing.density:
            packing, oriented = other, turned
    if texture.max_tiles == 1 or 0.0 < texture.density <= packing.density:
        return packing
    density = texture.density
    if density == 0.0:
        placed = yield from place_charts(oriented, triangles, may_turn, grid, texture.max_tiles)
        if placed is None:
            return packing
        packing = _arrange_placed(oriented, triangles, placed, texture)
        density = FEWER_TILES_DENSITY * packing.density
    placed = yield from _place_in_few_tiles(oriented, triangles, may_turn, grid, texture.max_tiles, density)
    if placed is None:
        return packing
    filled = _arrange_placed(oriented, triangles, placed, texture)
    return filled if texture.density > 0.0 or filled.tile_count < packing.tile_count else packing


def _place_in_few_tiles(
    uvs: list[np.ndarray], triangles: Sequence[np.ndarray], may_turn: Sequence[bool], grid: RasterGrid, max_tiles: int, density: float
) -> Steps[list[Placement] | None]:
    """Return the placements of charts in tiles that are filled one after the other, at `density` or the highest one that fits."""
    area = sum(float(np.abs(signed_areas(uv[faces])).sum()) for uv, faces in zip(uvs, triangles, strict=True))
    tile_area = float(grid.rows * grid.columns) * grid.cell_texels**2
    density = min(density, max_density(uvs, may_turn, grid), float(np.sqrt(MAX_TILE_FILL * max_tiles * tile_area / max(area, TINY))))
    for attempt in range(MAX_ATTEMPTS):
        placed = yield from place_charts(uvs, triangles, may_turn, grid, max_tiles, density * DENSITY_STEP**attempt)
        if placed is not None:
            return placed
    return None


def turn_upright(uv: np.ndarray, triangles: np.ndarray, vertices: np.ndarray) -> np.ndarray | None:
    """Return `uv` (V, 2) of a chart, rotated so that the Z axis of its surface points along v; None where it is hardly vertical.

    triangles: (T, 3). vertices: (V, 3).
    """
    corners, heights = uv[triangles], vertices[triangles, 2]
    edges = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)  # Opposite to each corner.
    up = 0.5 * np.einsum("tc,tci->i", heights, edges[..., ::-1] * [-1.0, 1.0])  # The gradient of height, times area, summed.
    area = float(np.linalg.norm(scaled_normals(vertices[triangles]), axis=1).sum()) * 0.5
    length = float(np.linalg.norm(up))
    if length <= max(MIN_UPRIGHT_GRADIENT * np.sqrt(area * float(signed_areas(corners).sum())), TINY):
        return None
    sine, cosine = up / length
    return uv @ np.array([[cosine, sine], [-sine, cosine]])


def _arrange_placed(
    oriented: list[np.ndarray], triangles: Sequence[np.ndarray], placed: list[Placement] | None, texture: Texture
) -> Packing:
    """Return the packing of charts that have been placed as rasters; by xatlas where they did not fit."""
    if placed is None:
        return _arrange(_pack_with_xatlas(oriented, triangles, texture.margin / max(texture.size)), [0] * len(oriented), texture)
    moved = [_move(uv, placement) for uv, placement in zip(oriented, placed, strict=True)]
    return _arrange(moved, [placement.tile for placement in placed], texture)


def _arrange(moved: list[np.ndarray], tiles: list[int], texture: Texture) -> Packing:
    """Return the packing of charts that have been moved apart, uv (V, 2) of each, in the lower left corner of their `tiles`."""
    count = max(tiles) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    for tile, uv in zip(tiles, moved, strict=True):
        low[tile], high[tile] = np.minimum(low[tile], uv.min(axis=0)), np.maximum(high[tile], uv.max(axis=0))
    density = float((texture.inside / np.maximum((high - low).max(axis=0), TINY)).min())
    if texture.density > 0.0:
        density = min(density, texture.density)
    corner = 0.5 * (np.array(texture.size) - texture.inside)
    origins = tile_origins(count)
    uvs = [origins[tile] + (corner + density * (uv - low[tile])) / texture.size for tile, uv in zip(tiles, moved, strict=True)]
    return Packing(uvs, density, count)


def _move(uv: np.ndarray, placement: Placement) -> np.ndarray:
    """Return `uv` (V, 2), turned and moved to a placement."""
    turned = uv @ np.linalg.matrix_power(QUARTER_TURN, placement.turns)
    return turned - turned.min(axis=0) + placement.corner


def orient(uv: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return `uv` (V, 2), turned so that most of the boundary of a chart runs along the axes, if its bounding box is hardly larger than
    the smallest one. The longer side of the box is along u. triangles: (T, 3)."""
    smallest, (angle, straight_fraction) = orient_smallest(uv), _main_direction(uv, triangles)
    straight = _turn(uv, np.array([angle]), np.prod)
    boxes = [np.ptp(turned, axis=0).prod() for turned in (straight, smallest)]
    return straight if straight_fraction >= MIN_STRAIGHT and boxes[0] <= MAX_STRAIGHT_BOX * boxes[1] else smallest


def orient_smallest(uv: np.ndarray) -> np.ndarray:
    """Return `uv` (V, 2), turned to the bounding box of minimum area, with the longer side along u."""
    return _turn(uv, _hull_angles(uv), np.prod)


def _orient_compact(uv: np.ndarray) -> np.ndarray:
    """Return `uv` (V, 2), turned so that the longer side of the bounding box, which is along u, is shortest."""
    return _turn(uv, np.concatenate([_hull_angles(uv), np.linspace(0.0, 0.5 * np.pi, COMPACT_STEPS, endpoint=False)]), np.max)


def _turn(uv: np.ndarray, angles: np.ndarray, size: Callable[..., np.ndarray]) -> np.ndarray:
    """Return `uv` (V, 2), turned by that of `angles` (A,) with the least `size` of its extents, with the longer one along u."""
    rotations = np.stack([np.cos(angles), np.sin(angles), -np.sin(angles), np.cos(angles)], axis=1).reshape(-1, 2, 2)
    extents = np.ptp(rotations @ convex_hull(uv).T, axis=2)
    best = int(size(extents, axis=1).argmin())
    rotated = uv @ rotations[best].T
    return rotated if extents[best, 0] >= extents[best, 1] else rotated @ QUARTER_TURN


def _hull_angles(uv: np.ndarray) -> np.ndarray:
    hull = convex_hull(uv)
    return _edge_angles(hull, np.roll(hull, -1, axis=0))[0]


def _is_round(uv: np.ndarray, triangles: np.ndarray) -> bool:
    """Return whether a chart `uv` (V, 2) has no direction along which it should lie. triangles: (T, 3)."""
    length, width = np.ptp(orient_smallest(uv), axis=0)
    return bool(length <= MAX_ROUND_ASPECT * width) and _main_direction(uv, triangles)[1] < MIN_STRAIGHT


def _edge_angles(starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles (E,) of edges, modulo a quarter turn, and their lengths (E,)."""
    edges = ends - starts
    return np.arctan2(edges[:, 1], edges[:, 0]) % (0.5 * np.pi), np.linalg.norm(edges, axis=1)


def _main_direction(uv: np.ndarray, triangles: np.ndarray) -> tuple[float, float]:
    """Return the angle, modulo a quarter turn, that most of the boundary of a chart is close to, and the fraction of its length that is.

    uv: (V, 2). triangles: (T, 3).
    """
    angles, lengths = _edge_angles(*uv[boundary_edges(triangles)].transpose(1, 0, 2))
    bins = (angles / (0.5 * np.pi) * DIRECTION_BINS).astype(np.int64) % DIRECTION_BINS
    sums = np.bincount(bins, lengths, DIRECTION_BINS)
    best = int((sums + np.roll(sums, 1) + np.roll(sums, -1)).argmax())
    is_near = (bins - best + 1) % DIRECTION_BINS <= 2
    angles, near = angles[is_near], lengths[is_near]
    longest, total = angles[near.argmax()], max(float(near.sum()), TINY)
    offsets = (angles - longest + 0.25 * np.pi) % (0.5 * np.pi) - 0.25 * np.pi
    return float(longest + offsets @ near / total), total / max(float(lengths.sum()), TINY)


def _pack_with_xatlas(uvs: list[np.ndarray], triangles: Sequence[np.ndarray], margin: float) -> list[np.ndarray]:
    """Return the charts moved apart by xatlas, which packs silhouettes texel by texel.

    Only translations are taken from xatlas: its coordinates are single precision, and its rotations may mirror a chart. It gets texels as
    units, because it never ends where the squares of coordinates are infinite. margin: relative to the side of the square.
    """
    import xatlas  # Here, so that importing the core needs only NumPy and SciPy.

    extents = np.array([np.ptp(uv, axis=0) for uv in uvs])
    texel_size = max(float(np.sqrt(extents.prod(axis=1).sum())) / XATLAS_SIDE, float(extents.max()) / MAX_CHART_SIDE)
    options = xatlas.PackOptions()
    options.resolution, options.padding = 0, int(np.ceil(XATLAS_PADDING * margin * XATLAS_SIDE))
    options.texels_per_unit = 1.0
    options.rotate_charts = options.rotate_charts_to_axis = False
    atlas = xatlas.Atlas()
    meshes = [_to_xatlas(uv / texel_size, faces) for uv, faces in zip(uvs, triangles, strict=True)]
    for uv, faces in meshes:  # All arrays stay alive: xatlas takes data at the same address for the same chart.
        atlas.add_uv_mesh(uv, faces)
    atlas.generate(pack_options=options)
    size = np.array([atlas.width, atlas.height], np.float64) * texel_size
    return [uv + _translation(uv, atlas.get_mesh(index), size) for index, uv in enumerate(uvs)]


def _to_xatlas(uv: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a chart as coordinates (V, 2) float32 and triangles uint32; a box where it is thinner than a texel, as xatlas drops these.

    uv: (V, 2) in texels.
    """
    extent = np.ptp(uv, axis=0)
    if extent.min() >= 1.0:
        return (uv - uv.min(axis=0)).astype(np.float32), triangles.astype(np.uint32)
    box = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * np.maximum(extent, 1.0)
    return box.astype(np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.uint32)


def _translation(uv: np.ndarray, packed_mesh: tuple[np.ndarray, np.ndarray, np.ndarray], size: np.ndarray) -> np.ndarray:
    """Return the translation (2,) of a chart to its packed position; xatlas divides its coordinates by `size` (2,)."""
    return packed_mesh[2].min(axis=0) * size - uv.min(axis=0)
