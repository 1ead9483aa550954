"""Pictures of photographs with the mesh drawn into them, which show whether cameras and mesh fit to each other."""

import numpy as np

from ...geometry.mesh import TriangleMesh, face_areas_and_normals
from ...imaging.raster import locate_pixels
from .photograph import Photograph

MAX_SIDE = 1600  # pixels; larger photographs are drawn smaller
LINE_COLOR = np.array([1.0, 0.45, 0.05], np.float32)
SHADE = 0.35  # opacity of the shaded mesh
DIMMED = 0.6  # brightness of the photograph around the mesh
CREASE_COSINE = 0.8  # The edge between faces is drawn if the cosine between their normals is smaller.
DEPTH_STEP = 0.02  # A line separates neighboring pixels whose depths differ by a larger fraction.


def draw_overlay(mesh: TriangleMesh, photograph: Photograph) -> np.ndarray:
    """Return a picture (H, W, 3) float32, sRGB-encoded, row 0 at the bottom: the photograph, dark where no triangle is, with the shaded
    mesh over it, its silhouettes and creases as lines."""
    camera = photograph.camera
    image, (every, _) = photograph.shrink(MAX_SIDE)
    image = np.clip(image, 0.0, 1.0)
    height, width = image.shape[:2]
    positions, depths, is_valid = camera.project(mesh.vertices)
    triangles = mesh.triangles[is_valid[mesh.triangles].all(axis=1)]
    located = locate_pixels(positions[triangles] / every.step, depths[triangles], (width, height))
    corners = mesh.vertices[triangles]
    normals = face_areas_and_normals(corners)[1]
    covered = located.covered
    image[~covered] *= np.float32(DIMMED)
    if not covered.any():
        return image
    pixel_normals, pixel_depths = np.zeros((height, width, 3)), np.full((height, width), np.inf)
    pixel_normals[covered] = normals[located.triangles]
    points = located.interpolate(corners)
    pixel_depths[covered] = located.interpolate(depths[triangles][..., None])[:, 0]
    towards = camera.position - points
    facing = np.einsum("nc,nc->n", towards / np.linalg.norm(towards, axis=1, keepdims=True), pixel_normals[covered])
    image[covered] += np.float32(SHADE) * (np.abs(facing)[:, None].astype(np.float32) - image[covered])
    image[_find_lines(pixel_normals, pixel_depths, covered)] = LINE_COLOR
    return image


def _find_lines(normals: np.ndarray, depths: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Return the pixels (H, W) bool on silhouettes and creases, given normals (H, W, 3) and depths (H, W)."""
    lines = np.zeros(covered.shape, bool)
    for axis in (0, 1):
        first, second = (tuple(slice(*ends) if axis == other else slice(None) for other in (0, 1)) for ends in ((None, -1), (1, None)))
        both = covered[first] & covered[second]
        is_line = covered[first] != covered[second]
        near = np.minimum(depths[first], depths[second])
        with np.errstate(invalid="ignore"):
            is_line |= both & (np.abs(depths[first] - depths[second]) > DEPTH_STEP * near)
        is_line |= both & (np.einsum("hwc,hwc->hw", normals[first], normals[second]) < CREASE_COSINE)
        lines[first] |= is_line
        lines[second] |= is_line
    return lines
