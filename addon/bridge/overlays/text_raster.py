"""Text as pixels. The outlines of Blender's own font are filled with NumPy, so that no font file and no other package is needed."""

import bpy
import numpy as np

from ..geometry.mesh_arrays import read_loop_triangles, read_loop_vertices, read_positions

PAPER_GRAY = 0.93
INK_GRAY = 0.12
LINE_HEIGHT = 20  # pixels
SUPERSAMPLES = 4  # per axis
FONT_SIZE_FRACTION = 0.72  # font size relative to the line height
BASELINE_FRACTION = 0.28  # distance of the baseline from the lower edge relative to the line height


def rasterize_text(text: str, height: int) -> np.ndarray:
    """Return the ink coverage of each pixel of `text`: (height, W) float64 in 0..1, row 0 at the top, in Blender's own font."""
    vertices, triangles = _text_outline(text)
    scale = FONT_SIZE_FRACTION * height * SUPERSAMPLES
    points = vertices * scale + [0.0, BASELINE_FRACTION * height * SUPERSAMPLES]
    width = int(np.ceil(points[:, 0].max() / SUPERSAMPLES)) + 1 if len(points) else 1
    samples = np.zeros((height * SUPERSAMPLES, width * SUPERSAMPLES), bool)
    _fill_triangles(samples, points[triangles])
    return samples.reshape(height, SUPERSAMPLES, width, SUPERSAMPLES).mean(axis=(1, 3))[::-1]


def draw_text(image: np.ndarray, text: str, y: int, x: int, color: float | tuple[float, float, float] = INK_GRAY) -> None:
    """Draw `text` into `image`, row 0 at the top, with its upper left corner at (x, y). Text beyond the image is clipped."""
    mask = rasterize_text(text, LINE_HEIGHT)[: image.shape[0] - y, : image.shape[1] - x]
    area = image[y : y + mask.shape[0], x : x + mask.shape[1]]
    area += mask[..., None] * (np.asarray(color) - area)


def _text_outline(text: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the filled outline of `text`: vertices (V, 2), in units of the font size from the baseline, and triangles (T, 3)."""
    curve = bpy.data.curves.new("Farfield Label", "FONT")
    curve.body = text
    text_object = bpy.data.objects.new(curve.name, curve)
    mesh = bpy.data.meshes.new_from_object(text_object)
    try:
        loops, _ = read_loop_triangles(mesh)
        return read_positions(mesh)[:, :2].astype(np.float64), read_loop_vertices(mesh)[loops]
    finally:
        bpy.data.meshes.remove(mesh)
        bpy.data.curves.remove(curve)


def _fill_triangles(samples: np.ndarray, corners: np.ndarray) -> None:
    """Set the `samples` (H, W) inside the triangles `corners` (T, 3, 2) of x and y, for both windings."""
    low = np.maximum(np.floor(corners.min(axis=1)).astype(int), 0)
    high = np.minimum(np.ceil(corners.max(axis=1)).astype(int), [samples.shape[1], samples.shape[0]])
    widths, heights = np.maximum(high - low, 0).T
    counts = widths * heights  # the samples of the box around each triangle, which are tested one after the other
    owner = np.repeat(np.arange(len(corners)), counts)
    row, column = np.divmod(np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts), widths[owner])
    column, row = column + low[owner, 0], row + low[owner, 1]
    edges = np.roll(corners, -1, axis=1) - corners
    signs = [
        edges[owner, side, 0] * (row + 0.5 - corners[owner, side, 1]) - edges[owner, side, 1] * (column + 0.5 - corners[owner, side, 0])
        for side in range(3)
    ]
    inside = np.all([sign >= 0.0 for sign in signs], axis=0) | np.all([sign <= 0.0 for sign in signs], axis=0)
    samples[row[inside], column[inside]] = True
