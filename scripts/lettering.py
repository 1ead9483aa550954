"""Words as pixels: Blender's own font, its outlines filled in NumPy, so that no font file and no other package is needed."""

import bpy
import numpy as np

SUPERSAMPLES = 4  # in each direction
CAPITALS = 0.72  # font size as a share of a line's height
BASELINE = 0.28  # above the lower edge, as a share of a line's height


def text_mask(text: str, height: int) -> np.ndarray:
    """How much of each pixel the ink of `text` covers: (height, W) float64 in 0..1, row 0 at the top, in Blender's own font."""
    vertices, triangles = _outline(text)
    scale = CAPITALS * height * SUPERSAMPLES
    points = vertices * scale + [0.0, BASELINE * height * SUPERSAMPLES]
    width = int(np.ceil(points[:, 0].max() / SUPERSAMPLES)) + 1 if len(points) else 1
    fine = np.zeros((height * SUPERSAMPLES, width * SUPERSAMPLES), bool)
    for corners in points[triangles]:
        _fill(fine, corners)
    return fine.reshape(height, SUPERSAMPLES, width, SUPERSAMPLES).mean(axis=(1, 3))[::-1]


def _outline(text: str) -> tuple[np.ndarray, np.ndarray]:
    """The ink of `text` as vertices (V, 2), in units of the font's size from the baseline, and triangles (T, 3)."""
    curve = bpy.data.curves.new("Farfield Label", "FONT")
    curve.body = text
    holder = bpy.data.objects.new(curve.name, curve)
    mesh = bpy.data.meshes.new_from_object(holder)
    try:
        mesh.calc_loop_triangles()
        vertices = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", vertices)
        triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
        mesh.loop_triangles.foreach_get("vertices", triangles)
        return vertices.reshape(-1, 3)[:, :2].astype(np.float64), triangles.reshape(-1, 3)
    finally:
        bpy.data.meshes.remove(mesh)
        bpy.data.curves.remove(curve)


def _fill(fine: np.ndarray, corners: np.ndarray) -> None:
    """Set the samples of `fine` (H, W) inside the triangle `corners` (3, 2) of x and y, whichever way it winds."""
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(corners.max(axis=0)).astype(int), [fine.shape[1], fine.shape[0]])
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]] + 0.5
    edges = np.roll(corners, -1, axis=0) - corners
    sides = [edge[0] * (y - corner[1]) - edge[1] * (x - corner[0]) for corner, edge in zip(corners, edges, strict=True)]
    inside = np.all([side >= 0.0 for side in sides], axis=0) | np.all([side <= 0.0 for side in sides], axis=0)
    fine[low[1] : high[1], low[0] : high[0]] |= inside
