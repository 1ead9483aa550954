"""Patches of a coarse mesh: one per triangle, cut to it, and one per group of triangles in one plane. Flat input needs no coarse mesh."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ...geometry.edges import find_edges
from ...geometry.mesh import face_areas_and_normals
from ...geometry.transforms import frames_from_normals
from ..clustering.patches import Covering, Patch, group_by_label
from ..clustering.planes import PlaneBounds, fit_planes
from ..clustering.rectangles import compute_bounds, enclosing_rectangle, fit_rectangle, rectangle_area
from ..primitives import Components, Primitives
from .reference_mesh import DecimatedMesh

FLAT_TOLERANCE = 0.05  # In errors: triangles with corners within this distance of each other's planes are in one plane.


def build_triangle_patches(
    primitives: Primitives, decimated: DecimatedMesh, bounds: PlaneBounds, quad_cost: float
) -> tuple[np.ndarray, Covering]:
    """Build the patches of a coarse mesh.

    Triangles of one plane share a quad if its area is worth it. `quad_cost`: of one more quad, in mean areas of a triangle.

    Returns:
        The indices (K,) of the primitives that are assigned to a triangle, and the covering of these, in their numbering.
    """
    indices = np.flatnonzero(decimated.assignment >= 0)
    builder = _PatchBuilder(primitives.subset(indices), bounds)
    corners = decimated.vertices[decimated.triangles]
    assigned = group_by_label(decimated.assignment[indices], len(corners))
    areas, normals = face_areas_and_normals(corners)
    labels = find_flat_regions(decimated.vertices, decimated.triangles, FLAT_TOLERANCE * bounds.error)
    patches: list[Patch] = []
    owner = np.full(len(indices), -1, np.int32)
    for region in group_by_label(labels):
        largest = region[areas[region].argmax()]
        faces = np.concatenate([assigned[triangle] for triangle in region])
        offset = float(normals[largest] @ corners[largest, 0])
        patch = None
        if len(region) > 1 and len(faces):
            patch = builder.build_rectangle(normals[largest], offset, corners[region], faces)
            max_area = areas[region].sum() + quad_cost * areas.mean() * (len(region) - 1)
            patch = patch if patch is not None and rectangle_area(patch.rectangle) <= max_area else None
        if patch is not None:
            owner[faces] = len(patches)
            patches.append(patch)
            continue
        for triangle in region:
            owner[assigned[triangle]] = len(patches)
            patches.append(builder.build_triangle(normals[triangle], corners[triangle], assigned[triangle]))
    return indices, Covering(patches, owner)


def find_flat_regions(vertices: np.ndarray, triangles: np.ndarray, tolerance: float) -> np.ndarray:
    """Label (T,) the regions of triangles that are connected by edges whose two triangles are in one plane within `tolerance`."""
    a, b = find_edges(triangles).interior_halfedges.T
    corners = vertices[triangles]
    _, normals = face_areas_and_normals(corners)
    is_flat = np.einsum("ij,ij->i", normals[a // 3], normals[b // 3]) > 0.0
    for halfedge, twin in ((a, b), (b, a)):
        opposite = vertices[triangles[twin // 3, twin % 3]]
        heights = np.einsum("ij,ij->i", opposite - corners[halfedge // 3, 0], normals[halfedge // 3])
        is_flat &= np.abs(heights) <= tolerance
    count = len(triangles)
    links = coo_matrix((np.ones(int(is_flat.sum()), bool), (a[is_flat] // 3, b[is_flat] // 3)), shape=(count, count))
    return connected_components(links, directed=False)[1]


class _PatchBuilder:
    """Builds patches on planes, with all primitives that satisfy `bounds`."""

    def __init__(self, primitives: Primitives, bounds: PlaneBounds) -> None:
        self.primitives, self.bounds = primitives, bounds

    def build_rectangle(self, normal: np.ndarray, offset: float, corners: np.ndarray, faces: np.ndarray) -> Patch | None:
        """Build the patch of several triangles `corners` (T, 3, 3) in one plane and the `faces` assigned to them.

        Returns None if the plane violates the bounds of a face.
        """
        positions = self.primitives.positions[faces]
        if not self.bounds.contain(positions, self.primitives.normals[faces], normal, offset).all():
            return None
        frame = frames_from_normals(normal[None])[0, :2]
        points = np.concatenate([corners.reshape(-1, 3), positions.reshape(-1, 3)])
        axes, rectangle = fit_rectangle(points, frame)
        region = np.union1d(faces, self._find_touching(normal, offset, axes, rectangle))
        return Patch(normal, offset, axes, rectangle, faces, region)

    def build_triangle(self, normal: np.ndarray, triangle: np.ndarray, assigned: np.ndarray) -> Patch:
        """Build the patch of one triangle (3, 3): the rectangle on its longest edge, with all primitives within bounds that touch it."""
        edges = np.roll(triangle, -1, axis=0) - triangle
        longest = edges[np.linalg.norm(edges, axis=1).argmax()]
        u = longest / np.linalg.norm(longest)
        axes = np.stack([u, np.cross(normal, u)])
        outline = triangle @ axes.T
        rectangle = enclosing_rectangle(np.repeat(outline, 2, axis=1))
        offset = float(normal @ triangle[0])
        drawn = np.union1d(assigned, self._find_touching(normal, offset, axes, rectangle))
        center, half_size = rectangle.reshape(2, 2).mean(axis=1), 0.5 * np.ptp(rectangle.reshape(2, 2), axis=1)
        return Patch(normal, offset, axes, rectangle, drawn, drawn, (outline - center) / half_size)

    def _find_touching(self, normal: np.ndarray, offset: float, axes: np.ndarray, rectangle: np.ndarray) -> np.ndarray:
        """Find the primitives within the bounds of a plane whose bounding boxes along `axes` touch `rectangle`."""
        near = np.flatnonzero(self.bounds.contain(self.primitives.positions, self.primitives.normals, normal, offset))
        boxes = compute_bounds(self.primitives.positions[near], axes)
        touches = (
            (boxes[:, 0] <= rectangle[1]) & (boxes[:, 1] >= rectangle[0]) & (boxes[:, 2] <= rectangle[3]) & (boxes[:, 3] >= rectangle[2])
        )
        return near[touches]


def cover_flat_surfaces(
    primitives: Primitives, components: Components, bounds: PlaneBounds, quad_cost: float
) -> tuple[np.ndarray, Covering]:
    """Cover connected surfaces with one quad each if all `primitives` are in one plane, within FLAT_TOLERANCE of the error.

    Front and back faces need separate quads. Surfaces for which one quad would waste too much area, and loose parts, which could share one,
    are not covered. `quad_cost`: of one more quad, in mean areas of a triangle.

    Returns:
        The indices (K,) of the covered primitives, none if the input is not flat, and the covering of these, in their numbering.
    """
    plane = fit_planes(primitives, [np.arange(len(primitives))])
    normal, offset = plane.normals[0], float(plane.offsets[0])
    cosines = primitives.normals @ normal
    flat_bounds = PlaneBounds(FLAT_TOLERANCE * bounds.error)
    is_flat = flat_bounds.contain(primitives.positions, primitives.normals, normal, offset) & (np.abs(cosines) >= bounds.min_cosine)
    indices: list[np.ndarray] = []
    patches: list[Patch] = []
    labels = np.unique(2 * components.labels + (cosines > 0.0), return_inverse=True)[1].reshape(-1)
    for members in group_by_label(labels) if is_flat.all() else []:
        if components.loose[members].any():
            continue
        sign = 1.0 if cosines[members[0]] > 0.0 else -1.0
        first = sum(len(other) for other in indices)
        drawn, frame = np.arange(first, first + len(members)), frames_from_normals(sign * normal[None])[0, :2]
        patch = Patch(sign * normal, sign * offset, *fit_rectangle(primitives.points[primitives.find_points(members)], frame), drawn, drawn)
        areas = primitives.areas[members]
        if rectangle_area(patch.rectangle) <= areas.sum() + quad_cost * areas.mean() * (len(members) - 1):
            indices.append(members)
            patches.append(patch)
    owner = np.repeat(np.arange(len(patches), dtype=np.int32), [len(members) for members in indices])
    return np.concatenate([np.empty(0, np.int64), *indices]), Covering(patches, owner)
