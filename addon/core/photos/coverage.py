"""Which triangles photographs show, before anything is merged (Textures Revisited, section 4.1 and Figure 7)."""

from collections.abc import Iterable

import numpy as np

from ..geometry.mesh import TriangleMesh, check_points, face_areas_and_normals, vertex_normals
from ..jobs.progress import Progress, Steps
from .photographs import Photograph
from .stages import INTERPOLATED, PHOTOGRAPHED, UNBOUND
from .texels import corner_normals
from .views import View

CORNER_SAMPLES = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6.0  # barycentric


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
    check_points(mesh.vertices, "mesh")
    origin = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))  # float32 is exact enough near it
    mesh = TriangleMesh(mesh.vertices - origin, mesh.triangles)
    corners, normals = mesh.corners, corner_normals(mesh, vertex_normals(mesh.vertices, mesh.triangles))
    points = [np.einsum("i,tic->tc", weights, corners) for weights in CORNER_SAMPLES]
    directions = [_unit(np.einsum("i,tic->tc", weights, normals)) for weights in CORNER_SAMPLES]
    bound, is_shown = np.zeros((3, len(corners)), bool), np.zeros(len(corners), bool)
    for index, photograph in enumerate(photographs):
        yield Progress(index / count, "Finding visible faces")
        photograph.check()
        view = View(photograph.camera.relative_to(origin), mesh, photograph.mask)
        is_visible = np.zeros_like(bound)
        for corner in range(3):
            is_visible[corner, view.see(points[corner], directions[corner]).indices] = True
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


def _unit(vectors: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(lengths > 0.0, lengths, 1.0)
