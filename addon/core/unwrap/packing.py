"""Charts packed into the UV square, each as large as it should be beside the others."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError

TEXELS = 1024  # along the side that the charts are packed for


def packed(layouts: list[np.ndarray], triangles: list[np.ndarray], margin: float) -> list[np.ndarray]:
    """The `layouts` (V, 2) of charts turned and moved apart, and all scaled by one factor, so that they fill the unit square well.

    triangles: (T, 3) of each. margin: room around each chart, as a share of the square's side.
    """
    upright = [_upright(layout) for layout in layouts]
    if len(upright) > 1:
        upright = _side_by_side(upright, triangles, margin)
    low = np.min([layout.min(axis=0) for layout in upright], axis=0)
    high = np.max([layout.max(axis=0) for layout in upright], axis=0)
    scale = (1.0 - 2.0 * margin) / float((high - low).max())
    return [margin + scale * (layout - low) for layout in upright]


def _upright(layout: np.ndarray) -> np.ndarray:
    """`layout` turned so that its bounding box is the smallest, the longer side along u."""
    try:
        hull = layout[ConvexHull(layout).vertices]
    except QhullError:  # hardly more than a line
        hull = layout
    sides = np.roll(hull, -1, axis=0) - hull
    angles = np.arctan2(sides[:, 1], sides[:, 0]) % (0.5 * np.pi)
    turned = np.stack([np.cos(angles), np.sin(angles), -np.sin(angles), np.cos(angles)], axis=1).reshape(-1, 2, 2)
    extents = np.ptp(turned @ hull.T, axis=2)
    best = int(extents.prod(axis=1).argmin())
    made = layout @ turned[best].T
    return made if extents[best, 0] >= extents[best, 1] else made @ np.array([[0.0, 1.0], [-1.0, 0.0]])


def _side_by_side(layouts: list[np.ndarray], triangles: list[np.ndarray], margin: float) -> list[np.ndarray]:
    """The charts moved apart by xatlas, which packs outlines texel by texel. It gets places alone from there: its coordinates are single
    floats, and its turns mirror."""
    import xatlas  # here, so that importing the core needs only NumPy and SciPy

    area = sum(float(np.ptp(layout, axis=0).prod()) for layout in layouts)
    options = xatlas.PackOptions()
    options.resolution, options.padding = 0, int(np.ceil(margin * TEXELS))
    options.texels_per_unit = TEXELS / np.sqrt(area)
    options.rotate_charts = options.rotate_charts_to_axis = False
    atlas = xatlas.Atlas()
    held = [_outline(layout, drawn, 1.0 / options.texels_per_unit) for layout, drawn in zip(layouts, triangles, strict=True)]
    for coordinates, drawn in held:  # all held at once: xatlas takes what comes from the same address for the same chart
        atlas.add_uv_mesh(coordinates, drawn)
    atlas.generate(pack_options=options)
    size = np.array([atlas.width, atlas.height], np.float64)
    return [layout + _shift(layout, atlas.get_mesh(index), size / options.texels_per_unit) for index, layout in enumerate(layouts)]


def _outline(layout: np.ndarray, triangles: np.ndarray, texel: float) -> tuple[np.ndarray, np.ndarray]:
    """A chart as xatlas takes it, coordinates (V, 2) float32 and triangles uint32; of one thinner than a texel, which it would not place,
    a box."""
    extent = np.ptp(layout, axis=0)
    if extent.min() >= texel:
        return (layout - layout.min(axis=0)).astype(np.float32), triangles.astype(np.uint32)
    box = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * np.maximum(extent, texel)
    return box.astype(np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.uint32)


def _shift(layout: np.ndarray, placed: tuple[np.ndarray, np.ndarray, np.ndarray], size: np.ndarray) -> np.ndarray:
    """How far (2,) a chart has to go to where it was `placed`, with coordinates over `size` (2,)."""
    return placed[2].min(axis=0) * size - layout.min(axis=0)
