"""The quads of a coarse mesh: one a triangle, cut to it, and one for triangles that lie in one plane."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..edges import edges_of
from ..mesh import face_areas_and_normals
from .fine_mesh import Decimated
from .patches import Covering, Patch, members_of
from .planes import frames_of
from .primitives import Primitives
from .rectangles import area, around, bounds_of, smallest_rectangle

FLAT = 0.05  # of the error: triangles whose corners are within this of each other's planes lie in one plane


def patches_of_triangles(
    primitives: Primitives, decimated: Decimated, error: float, max_normal_deviation: float, quad_cost: float
) -> tuple[np.ndarray, Covering]:
    """The primitives (K,) that the triangles stand for, and their covering, counted in these.

    Triangles of one plane share a quad where its area is worth it: `quad_cost` is what one more quad is worth, in mean areas of a triangle.
    """
    index = np.flatnonzero(decimated.primitive_of >= 0)
    bounded = _Bounded(primitives.subset(index), error, float(np.cos(max_normal_deviation)))
    corners = decimated.vertices[decimated.triangles]
    owned = members_of(decimated.primitive_of[index], len(corners))
    areas, normals = face_areas_and_normals(corners)
    labels = flat_parts(decimated.vertices, decimated.triangles, FLAT * error)
    patches: list[Patch] = []
    owner = np.full(len(index), -1, np.int32)
    for together in members_of(labels):
        largest = together[areas[together].argmax()]
        faces = np.concatenate([owned[triangle] for triangle in together])
        offset = float(normals[largest] @ corners[largest, 0])
        patch = None
        if len(together) > 1 and len(faces):
            patch = bounded.rectangle(normals[largest], offset, corners[together], faces)
            worth = areas[together].sum() + quad_cost * areas.mean() * (len(together) - 1)
            patch = patch if patch is not None and area(patch.rectangle) <= worth else None
        if patch is not None:
            owner[faces] = len(patches)
            patches.append(patch)
            continue
        for triangle in together:
            owner[owned[triangle]] = len(patches)
            patches.append(bounded.triangle(normals[triangle], corners[triangle], owned[triangle]))
    return index, Covering(patches, owner)


def flat_parts(vertices: np.ndarray, triangles: np.ndarray, tolerance: float) -> np.ndarray:
    """The part (T,) of every triangle: what hangs together over edges whose two triangles lie in one plane within `tolerance`."""
    a, b = edges_of(triangles).inner_sides.T
    corners = vertices[triangles]
    _, normals = face_areas_and_normals(corners)
    flat = np.einsum("ij,ij->i", normals[a // 3], normals[b // 3]) > 0.0
    for one, other in ((a, b), (b, a)):
        tip = vertices[triangles[other // 3, other % 3]]
        flat &= np.abs(np.einsum("ij,ij->i", tip - corners[one // 3, 0], normals[one // 3])) <= tolerance
    count = len(triangles)
    links = coo_matrix((np.ones(int(flat.sum()), bool), (a[flat] // 3, b[flat] // 3)), shape=(count, count))
    return connected_components(links, directed=False)[1]


class _Bounded:
    """Makes patches of planes that keep `primitives` within the error and the normal bound."""

    def __init__(self, primitives: Primitives, error: float, least_cosine: float) -> None:
        self.primitives, self.error, self.least_cosine = primitives, error, least_cosine

    def fits(self, index: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
        """Which of the primitives `index` lie within both bounds of the plane."""
        facing = self.primitives.normals[index] @ normal >= self.least_cosine
        return facing & (np.abs(self.primitives.positions[index] @ normal - offset) <= self.error).all(axis=1)

    def rectangle(self, normal: np.ndarray, offset: float, corners: np.ndarray, faces: np.ndarray) -> Patch | None:
        """The patch of several triangles `corners` (T, 3, 3) that lie in one plane and stand for `faces`; None where it keeps not all."""
        if not self.fits(faces, normal, offset).all():
            return None
        frame = frames_of(normal[None])[0, :2]
        points = np.concatenate([corners.reshape(-1, 3), self.primitives.positions[faces].reshape(-1, 3)])
        axes = smallest_rectangle(points @ frame.T) @ frame
        rectangle = around(bounds_of(points[:, None], axes))
        region = np.union1d(faces, self._reaching(normal, offset, axes, rectangle))
        return Patch(normal, offset, axes, rectangle, faces, region)

    def triangle(self, normal: np.ndarray, triangle: np.ndarray, owned: np.ndarray) -> Patch:
        """The patch of one triangle (3, 3): the rectangle on its longest side, and all primitives within the bounds that reach into it."""
        sides = np.roll(triangle, -1, axis=0) - triangle
        longest = sides[np.linalg.norm(sides, axis=1).argmax()]
        u = longest / np.linalg.norm(longest)
        axes = np.stack([u, np.cross(normal, u)])
        outline = triangle @ axes.T
        rectangle = around(np.repeat(outline, 2, axis=1))
        offset = float(normal @ triangle[0])
        shown = np.union1d(owned, self._reaching(normal, offset, axes, rectangle))
        middle, half = rectangle.reshape(2, 2).mean(axis=1), 0.5 * np.ptp(rectangle.reshape(2, 2), axis=1)
        return Patch(normal, offset, axes, rectangle, shown, shown, (outline - middle) / half)

    def _reaching(self, normal: np.ndarray, offset: float, axes: np.ndarray, rectangle: np.ndarray) -> np.ndarray:
        """Primitives within the bounds of a plane whose bounding boxes along `axes` touch `rectangle`."""
        near = np.flatnonzero(self.fits(np.arange(len(self.primitives)), normal, offset))
        bounds = bounds_of(self.primitives.positions[near], axes)
        touches = (
            (bounds[:, 0] <= rectangle[1])
            & (bounds[:, 1] >= rectangle[0])
            & (bounds[:, 2] <= rectangle[3])
            & (bounds[:, 3] >= rectangle[2])
        )
        return near[touches]
