"""How photographs and mesh fit to each other: which triangles and texels photographs show, and pictures of photographs with the mesh drawn
into them (Textures Revisited, section 4.1 and Figures 7 to 9)."""

from collections.abc import Iterable

import numpy as np

from ..geometry.mesh import TriangleMesh, face_areas_and_normals
from ..imaging.images import sample_bilinear
from ..imaging.raster import locate_pixels
from ..jobs.progress import Progress, Steps
from .photographs.photograph import Photograph
from .photographs.surface import Surface
from .photographs.views import MIN_TRUST, View

CORNER_SAMPLES = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6.0  # barycentric
MAX_STAGE_SIDE, MAX_OVERLAY_SIDE = 800, 1600  # pixels; larger photographs are drawn smaller
LINE_COLOR = np.array([1.0, 0.45, 0.05], np.float32)
SHADE = 0.35  # opacity of the shaded mesh
DIMMED = 0.6  # brightness of the photograph around the mesh
CREASE_COSINE = 0.8  # The edge between faces is drawn if the cosine between their normals is smaller.
DEPTH_STEP = 0.02  # A line separates neighboring pixels whose depths differ by a larger fraction.
UNUSED_COLOR = np.array([0.9, 0.1, 0.1], np.float32)
UNUSED_OPACITY = 0.6
CLASS_COLORS = np.array([[0.0, 0.0, 0.0], [0.25, 0.65, 0.3], [0.2, 0.4, 0.85], [0.85, 0.2, 0.2]], np.float32)
UNCOVERED, PHOTOGRAPHED, INTERPOLATED, UNBOUND = range(4)


def classify_triangles(mesh: TriangleMesh, photographs: Iterable[Photograph], count: int) -> Steps[np.ndarray]:
    """Return the class (T,) uint8 of each triangle of `mesh`: PHOTOGRAPHED if one of the `count` photographs shows all of its corners,
    INTERPOLATED if photographs show them, but no photograph all of them, otherwise UNBOUND.

    A corner is represented by a point between the vertex and the center of the triangle: a vertex on the border of the mesh is next to the
    background in every photograph, and so never visible, and one at a sharp edge has a normal that no triangle has. Photographs are read
    one after the other, and memory does not grow with their number.

    Raises:
        GeometryError: the mesh is not finite.
        ImageError: a photograph or mask does not have the size that its camera says.
    """
    surface = Surface.around_origin(mesh)
    samples = [surface.locate(weights) for weights in CORNER_SAMPLES]
    bound, is_shown = np.zeros((3, len(mesh.triangles)), bool), np.zeros(len(mesh.triangles), bool)
    for index, photograph in enumerate(photographs):
        yield Progress(index / count, "Finding visible faces")
        photograph.check()
        view = View(photograph.camera.relative_to(surface.origin), surface.mesh, photograph.mask)
        is_visible = np.zeros_like(bound)
        for corner, (points, normals) in enumerate(samples):
            is_visible[corner, view.see(points, normals).indices] = True
        bound |= is_visible
        is_shown |= is_visible.all(axis=0)
    classes = np.where(bound.all(axis=0), INTERPOLATED, UNBOUND).astype(np.uint8)
    classes[is_shown] = PHOTOGRAPHED
    return classes


def measure_classes(mesh: TriangleMesh, classes: np.ndarray) -> dict[int, float]:
    """Return the fraction of the area of `mesh` by class, given the `classes` (T,) of its triangles; 0 if the mesh has no area."""
    areas, _ = face_areas_and_normals(mesh.corners)
    total = max(float(areas.sum()), np.finfo(float).tiny)
    return {each: float(areas[classes == each].sum()) / total for each in (PHOTOGRAPHED, INTERPOLATED, UNBOUND)}


def draw_trust(photograph: Photograph, cells: np.ndarray) -> np.ndarray:
    """Return the photograph as a small picture (H, W, 3), red where its cells (h, w), evenly divided, or its mask say that it shows
    something else than the surface."""
    image, area = photograph.shrink(MAX_STAGE_SIDE)
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    positions = np.stack([(columns.ravel() + 0.5) / image.shape[1], (rows.ravel() + 0.5) / image.shape[0]], axis=1)
    trust = sample_bilinear(cells[..., None], positions * cells.shape[::-1])[:, 0].reshape(image.shape[:2])
    is_unused = trust <= MIN_TRUST
    if photograph.mask is not None:
        is_unused |= ~photograph.mask[area]
    image[is_unused] += np.float32(UNUSED_OPACITY) * (UNUSED_COLOR - image[is_unused])
    return np.clip(image, 0.0, 1.0)


def classify_texels(triangles: np.ndarray, found: np.ndarray, corners: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """Return the class (N,) uint8 of each texel: UNCOVERED, PHOTOGRAPHED, INTERPOLATED between vertices that photographs show, or UNBOUND.

    Args:
        triangles: (N,) of the texels, -1 for none. found: (N,) bool, a photograph shows them. corners: (T, 3) vertices of the triangles.
        bound: (V,) bool, a photograph shows the vertex.
    """
    is_bound = np.append(bound[corners].all(axis=1), True)
    classes = np.where(is_bound[triangles], INTERPOLATED, UNBOUND).astype(np.uint8)
    classes[found] = PHOTOGRAPHED
    classes[triangles < 0] = UNCOVERED
    return classes


def draw_overlay(mesh: TriangleMesh, photograph: Photograph) -> np.ndarray:
    """Return a picture (H, W, 3) float32, sRGB-encoded, row 0 at the bottom: the photograph, dark where no triangle is, with the shaded
    mesh over it, its silhouettes and creases as lines."""
    camera = photograph.camera
    image, (every, _) = photograph.shrink(MAX_OVERLAY_SIDE)
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
