"""How many pixels the errors of patches cover at most: what decides about a cut for a viewer."""

from dataclasses import dataclass

import numpy as np

from ...geometry.viewers import Viewer
from ..store.terrain_store import TerrainStore

MIN_DEPTH = 1e-3  # meters. Errors stay finite, so that a tolerance that fits a triangle budget exists also around the viewer


@dataclass(frozen=True)
class CutSettings:
    """How a cut is chosen.

    tolerance: pixels. exaggeration: factor of heights. culls: whether patches outside of the view stay coarse. margin: by which the view
    that culls is larger on every side, as a fraction of its size.
    """

    tolerance: float = 1.0
    exaggeration: float = 1.0
    culls: bool = False
    margin: float = 0.0


class Culling:
    """Finds boxes that may overlap the frustum of an image that is larger on every side by a fraction of its size.

    A box is invisible if it lies outside of one plane; one near an edge of the frustum may count as visible without being it. A box is
    visible if one inside of it is. Nothing is outside of a panorama.
    """

    def __init__(self, viewer: Viewer, margin: float = 0.0, exaggeration: float = 1.0) -> None:
        """exaggeration: factor of the heights of boxes."""
        planes = viewer.frustum_planes(margin)
        planes[:, 2] *= exaggeration
        self._weights = np.hstack([np.minimum(planes[:, :3], 0.0), np.maximum(planes[:, :3], 0.0)])
        self._offsets = planes[:, 3:]

    def are_visible(self, boxes: np.ndarray) -> np.ndarray:
        """Return whether boxes (6, N) float64, lowest and highest x, y and z without exaggeration, may be visible, (N,) bool."""
        values = self._weights @ boxes
        values += self._offsets
        return (values >= 0.0).all(axis=0)


class ProjectedErrors:
    """The errors in pixels that decide about a cut for a viewer in the local frame; 0 for patches that are culled.

    They are upper bounds of how far in the image any sample of the field inside of it moves vertically to the surface of the patch. They
    never grow from a patch to its descendants, because the errors and boxes of a store are nested.

    A sample p that moves up by e to q moves by e |u + w(p) v| / depth(q) in the image plane at depth 1, where u and v are the changes
    across and along the view direction of a vertical unit length, and w(p) is the place in the image plane. The grandchild of the patch
    in whose triangle p lies has p in its bounding box. The ranges of coordinates in camera space of that box, clipped to the image, bound
    w(p). The depth of p is at least that of the nearest corner, and at least the distance of the box times the cosine of the largest angle
    to the view direction. The depth of q is at least that of p less e |v|; q may be outside of the box.
    """

    def __init__(self, store: TerrainStore, viewer: Viewer, settings: CutSettings) -> None:
        self._store, self._kind = store, viewer.projection.kind
        self._culling = Culling(viewer, settings.margin, settings.exaggeration) if settings.culls else None
        exaggeration, densities = settings.exaggeration, np.array(viewer.projection.pixel_densities)
        shortest, longest = viewer.scale_range
        across, along = viewer.inverse[:2, 2], float(viewer.inverse[2, 2])
        self._depth_per_meter, self._loss = shortest, exaggeration * longest
        self._scale = exaggeration * float(densities.max()) * longest
        if self._kind == "orthographic":
            self._scale = exaggeration * float(np.hypot(*(densities * across)))
        elif self._kind == "perspective":
            self._loss = exaggeration * abs(along)
            self._densities, self._window = exaggeration * densities[:, None], np.array(viewer.projection.window).reshape(2, 2)
            self._across, self._along = across[:, None], along
        self._weights, self._offsets = self._create_functions(viewer, exaggeration)

    def _create_functions(self, viewer: Viewer, exaggeration: float) -> tuple[np.ndarray, np.ndarray]:
        """Return weights (12, 6) and offsets (12, 1) of linear functions of boxes: along each axis, how far the box lies before and behind
        the viewer (6); and in camera space the smallest x, y and depth (3), and the largest (3)."""
        to_camera = viewer.inverse[:3] * [[1.0], [1.0], [-1.0]]
        positive, negative = np.maximum(to_camera[:, :3], 0.0), np.minimum(to_camera[:, :3], 0.0)
        zeros = np.zeros((3, 3))
        weights = np.block([[np.eye(3), zeros], [zeros, -np.eye(3)], [positive, negative], [negative, positive]])
        weights[:, [2, 5]] *= exaggeration
        offsets = np.concatenate([-viewer.position, viewer.position, to_camera[:, 3], to_camera[:, 3]])
        return weights, offsets[:, None]

    def __call__(self, patches: np.ndarray) -> np.ndarray:
        """Return the errors (N,) float64 of patches, given by their numbers (N,)."""
        errors = self._store.bounds[patches, 6].astype(np.float64)
        boxes = self._take_boxes(patches)
        pixels = self._bound_pixels_per_meter(boxes, errors)
        if self._culling is not None:
            pixels *= self._culling.are_visible(boxes).reshape(pixels.shape)
        return errors * pixels.max(axis=0)

    def are_surfaces_visible(self, patches: np.ndarray) -> np.ndarray:
        """Return whether any mesh of the vertices of patches, given by their numbers (N,), may be visible, (N,) bool.

        That may be so although they are culled: coarse surfaces reach beyond the boxes of grandchildren, but not beyond the patch's own.
        """
        if self._culling is None:
            return np.ones(len(patches), bool)
        return self._culling.are_visible(self._store.bounds.take(patches, axis=0)[:, :6].T.astype(np.float64))

    def _take_boxes(self, patches: np.ndarray) -> np.ndarray:
        """Return the boxes (6, 4 N) float64 of the grandchildren of patches (N,): those of the first ones, then those of the second ones
        and so on."""
        return self._store.bounds.take(self._store.links.find_grandchildren(patches).ravel(), axis=0)[:, :6].T.astype(np.float64)

    def _bound_pixels_per_meter(self, boxes: np.ndarray, errors: np.ndarray) -> np.ndarray:
        """Return how many pixels a meter covers at most (4, N) where patches with `errors` (N,) overlap boxes (6, 4 N)."""
        if self._kind == "orthographic":
            return np.full((4, len(errors)), self._scale)
        values = self._weights @ boxes
        values += self._offsets
        offsets = np.maximum(values[0:3], values[3:6])
        np.maximum(offsets, 0.0, out=offsets)
        depths = _measure_lengths(offsets)
        depths *= self._depth_per_meter
        scale: float | np.ndarray = self._scale  # pixels at depth 1
        if self._kind == "perspective":
            nearest, farthest = np.maximum(values[8], MIN_DEPTH), np.maximum(values[11], MIN_DEPTH)
            places = values[[6, 7, 9, 10]].reshape(2, 2, -1)  # lowest and highest x and y
            places[0] /= np.where(places[0] < 0.0, nearest, farthest)
            places[1] /= np.where(places[1] > 0.0, nearest, farthest)
            np.maximum(places, self._window[:, :1], out=places)
            np.minimum(places, self._window[:, 1:], out=places)
            reach = np.maximum(-places[0], places[1])
            reach *= reach
            depths /= np.sqrt(1.0 + reach[0] + reach[1])
            np.maximum(depths, values[8], out=depths)
            places *= self._along
            places += self._across
            factors = np.abs(places, out=places).max(axis=0)
            factors *= self._densities
            scale = _measure_lengths(factors).reshape(4, -1)
        depths = depths.reshape(4, -1) - errors * self._loss
        return scale / np.maximum(depths, MIN_DEPTH, out=depths)


def _measure_lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths (N,) of vectors (2 or 3, N), which are overwritten."""
    vectors *= vectors
    for axis in vectors[1:]:
        vectors[0] += axis
    return np.sqrt(vectors[0])
