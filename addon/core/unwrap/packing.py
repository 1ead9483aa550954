"""Packs charts into the UV square without changing their relative scale."""

import numpy as np

from ..geometry.convex_hulls import convex_hull
from .raster_packing import Placement, place_charts

PACKING_RESOLUTION = 1024  # Texels per side of the square that xatlas packs into.
MAX_CHARTS_AS_RASTERS = 1000
MAX_CHART_SIDE = 8 * PACKING_RESOLUTION  # Texels; the time of xatlas grows with the bounding boxes of charts, however thin they are.


def pack_charts(uvs: list[np.ndarray], triangles: list[np.ndarray], margin: float) -> list[np.ndarray]:
    """Return the `uvs` (V, 2) of charts, rotated and moved apart, and scaled by one common factor to fill the unit square.

    triangles: (T, 3) of each chart. margin: margin around each chart, as a fraction of the side of the square.
    """
    oriented = [orient(uv) for uv in uvs]
    if len(oriented) > 1:
        placed = place_charts(oriented, triangles, margin) if len(oriented) <= MAX_CHARTS_AS_RASTERS else None
        oriented = (
            _pack_with_xatlas(oriented, triangles, margin)
            if placed is None
            else [_move(uv, placement) for uv, placement in zip(oriented, placed[0], strict=True)]
        )
    low = np.min([uv.min(axis=0) for uv in oriented], axis=0)
    high = np.max([uv.max(axis=0) for uv in oriented], axis=0)
    scale = (1.0 - 2.0 * margin) / float((high - low).max())
    return [margin + scale * (uv - low) for uv in oriented]


def _move(uv: np.ndarray, placement: Placement) -> np.ndarray:
    """Return `uv` (V, 2), turned and moved to a placement."""
    turned = uv @ np.linalg.matrix_power(np.array([[0.0, 1.0], [-1.0, 0.0]]), placement.turns)
    return turned - turned.min(axis=0) + placement.corner


def orient(uv: np.ndarray) -> np.ndarray:
    """Return `uv` (V, 2) rotated to the bounding box of minimum area, with the longer side along u."""
    hull = convex_hull(uv)
    edges = np.roll(hull, -1, axis=0) - hull
    angles = np.arctan2(edges[:, 1], edges[:, 0]) % (0.5 * np.pi)
    rotations = np.stack([np.cos(angles), np.sin(angles), -np.sin(angles), np.cos(angles)], axis=1).reshape(-1, 2, 2)
    extents = np.ptp(rotations @ hull.T, axis=2)
    best = int(extents.prod(axis=1).argmin())
    rotated = uv @ rotations[best].T
    return rotated if extents[best, 0] >= extents[best, 1] else rotated @ np.array([[0.0, 1.0], [-1.0, 0.0]])


def _pack_with_xatlas(uvs: list[np.ndarray], triangles: list[np.ndarray], margin: float) -> list[np.ndarray]:
    """Return the charts moved apart by xatlas, which packs silhouettes texel by texel.

    Only translations are taken from xatlas: its coordinates are single precision, and its rotations may mirror a chart. It gets texels as
    units, because it never ends where the squares of coordinates are infinite.
    """
    import xatlas  # Here, so that importing the core needs only NumPy and SciPy.

    extents = np.array([np.ptp(uv, axis=0) for uv in uvs])
    texel_size = max(float(np.sqrt(extents.prod(axis=1).sum())) / PACKING_RESOLUTION, float(extents.max()) / MAX_CHART_SIDE)
    options = xatlas.PackOptions()
    options.resolution, options.padding = 0, int(np.ceil(margin * PACKING_RESOLUTION))
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
