"""Importance of surface triangles: their desired relative texel density, from 0 (lowest) to 1 (highest)."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from ..errors import SettingsError
from ..geometry.cameras import CameraProjection
from ..geometry.mesh import TriangleMesh, face_areas_and_normals
from .settings import UnwrapSettings
from .visibility import visible_pixel_areas

REFERENCE_PERCENTILE = 95.0  # The pixel density at this percentile of the visible area gets importance 1; denser triangles get no more.


def compute_importance(
    mesh: TriangleMesh,
    settings: UnwrapSettings,
    cameras: Sequence[CameraProjection],
    occluders: Callable[[], Iterable[TriangleMesh]],
    normal_signs: np.ndarray,
    group_weights: np.ndarray,
) -> np.ndarray:
    """Return the importance (T,) of the triangles of `mesh`, in world space, of the kind in `settings`.

    Args:
        cameras: those whose pixels count.
        occluders: returns other meshes that may hide the surface, in world space.
        normal_signs: (T,) -1 where the normals of `mesh` point inwards, else 1.
        group_weights: (V,) weights of the vertex group, 0 without one.

    Raises:
        SettingsError: the direction has no length or is not finite.
    """
    areas, normals = face_areas_and_normals(mesh.corners)
    if settings.importance == "direction":
        return from_direction(normal_signs[:, None] * normals, np.array(settings.direction))
    if settings.importance == "gradual":
        return from_direction_gradual(normal_signs[:, None] * normals, np.array(settings.direction), settings.density_ratio)
    if settings.importance in ("camera", "cameras"):
        pixel_areas = np.max([visible_pixel_areas(mesh, camera, occluders()) for camera in cameras], axis=0)
        return from_visible_pixels(pixel_areas, areas, settings.density_ratio)
    if settings.importance == "vertex_group":
        return group_weights[mesh.triangles].mean(axis=1)
    return np.zeros(len(mesh.triangles))


def from_direction(normals: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the importance (T,) of triangles with unit `normals` (T, 3): 1 where they face `direction` (3,), towards the viewer, else 0.

    Raises:
        SettingsError: the direction has no length or is not finite.
    """
    return (normals @ _normalize(direction) > 0.0).astype(np.float64)


def from_direction_gradual(normals: np.ndarray, direction: np.ndarray, ratio: float) -> np.ndarray:
    """Return the importance (T,) of triangles that grows with how directly their unit `normals` (T, 3) point in `direction` (3,).

    The weights are 1 / (<N, V> + k) with V along the view (section 3.2 of the paper). k is chosen so that the largest weight is
    `ratio` squared times the smallest.

    Raises:
        SettingsError: the direction has no length or is not finite.
    """
    cosines = normals @ _normalize(direction)
    if ratio <= 1.0:
        return np.zeros(len(normals))
    k = (ratio**2 + 1.0) / (ratio**2 - 1.0)
    return np.clip(np.log((k + 1.0) / (k - cosines)) / np.log(ratio**2), 0.0, 1.0)


def from_visible_pixels(pixel_areas: np.ndarray, areas: np.ndarray, ratio: float) -> np.ndarray:
    """Return the importance (T,) of triangles whose texel density follows their pixel density, within a factor of `ratio`.

    Args:
        pixel_areas: (T,) visible areas in pixels.
        areas: (T,) areas on the surface.
        ratio: largest texel density over the smallest.
    """
    density = np.divide(pixel_areas, areas, out=np.zeros(len(areas)), where=areas > 0.0)
    is_visible = density > 0.0
    if not is_visible.any() or ratio <= 1.0:
        return np.zeros(len(areas))
    order = np.argsort(density)
    cumulative = np.cumsum(np.where(is_visible, areas, 0.0)[order])
    reference = density[order][np.searchsorted(cumulative, 0.01 * REFERENCE_PERCENTILE * cumulative[-1])]
    relative = np.log(np.where(is_visible, density, 1.0) / reference) / np.log(ratio)
    return np.where(is_visible, np.clip(1.0 + relative, 0.0, 1.0), 0.0)


def _normalize(direction: np.ndarray) -> np.ndarray:
    direction = np.asarray(direction, np.float64)
    length = float(np.linalg.norm(direction))
    if not np.isfinite(length) or length == 0.0:
        raise SettingsError(
            "Direction has no length; enter a vector that points from the surface towards the viewer.", settings=("direction",)
        )
    return direction / length
