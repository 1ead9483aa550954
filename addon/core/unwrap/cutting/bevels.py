"""Rounded and chamfered edges: narrow bands of high curvature between faces that are flat or developable.

A box with rounded edges has no sharp edge, but a person would cut it in the middle of these bands, and not keep it in one piece.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from ...arrays import TINY
from ...geometry.edges import halfedge_ends
from ...geometry.mesh import face_areas_and_normals
from .chart import Chart, label_components, split_vertices
from .creases import fold_angles

COPLANAR_FOLD = np.radians(1.0)  # Triangles with a smaller fold between them are one facet.
MAX_BEVEL_FOLD = np.radians(50.0)  # Larger folds belong to no band.
MIN_CURVATURE = 14.0  # Of a band, times the square root of the area of the connected part.
MIN_FACE_AREA = 0.01  # As a fraction of the area of the connected part.
MAX_FACE_CURVATURE = 0.1  # Integral of the absolute Gaussian curvature inside a face that counts as developable, in radians.
MIN_FACES_AREA = 0.6  # Of all developable faces of a region, as a fraction of its area: other regions are too curved to be divided here,
MIN_CLEAR_AREA = 0.98  # and so are those where these faces and bands cover less,
MIN_REGION_CURVATURE = 1.2  # Radians as above in a region that is divided; a corner of a box has 1.6, a bent sheet 0.
MIN_STRIPS_AREA = 0.5  # Of quads among all facets of bands: through irregular triangles, a cut is ragged.
MIN_CONTRAST = 3.0  # or the mean curvature of bands is not so many times larger than that of the rest.
PREFERENCE = 0.03  # Turn in radians by which the largest face gets more of a band, so that the middle of it goes to one side all along.
MAX_TURN = np.radians(100.0)  # From a face into a bevel: to its middle, and from there to that of a corner.
MIN_COMMON_BORDER = 0.2  # Of a facet with the one from which its band is reached, as a fraction of its perimeter.


def divide_at_bevels(surface: Chart, halfedges: np.ndarray, creases: np.ndarray, component: np.ndarray, regions: np.ndarray) -> np.ndarray:
    """Return the region (T,) of each triangle after dividing regions in the middle of bevels, and bevels that are regions among others.

    Args:
        surface: T triangles, whose polygons are not divided.
        halfedges: (I, 2), 3 t + c, pairs across which triangles are connected.
        creases: (I,) bool, which of them are sharp edges.
        component: (T,) the connected part.
        regions: (T,) before.
    """
    vertices, triangles = surface.vertices, surface.triangles
    count, pairs = len(triangles), halfedges // 3
    folds, areas = fold_angles(vertices, triangles, halfedges), face_areas_and_normals(vertices[triangles])[0]
    lengths = np.linalg.norm(np.subtract(*vertices[halfedge_ends(triangles, halfedges[:, 0])].transpose(1, 0, 2)), axis=1)
    part_areas = np.bincount(component, areas)
    is_flat = folds < COPLANAR_FOLD
    if surface.polygon_ids is not None:
        is_flat |= surface.polygon_ids[pairs[:, 0]] == surface.polygon_ids[pairs[:, 1]]
    total, facets = label_components(count, halfedges[is_flat])
    is_side = facets[pairs[:, 0]] != facets[pairs[:, 1]]
    sides, side_folds, side_lengths = facets[pairs[is_side]], folds[is_side], lengths[is_side]
    turns = np.where(side_folds < MAX_BEVEL_FOLD, side_lengths * side_folds, 0.0)
    curvatures = np.bincount(sides.ravel(), np.repeat(0.5 * turns, 2), total) / np.maximum(np.bincount(facets, areas, total), TINY)
    curvatures = curvatures[facets] * np.sqrt(part_areas[component])
    is_band = curvatures > MIN_CURVATURE
    if not is_band.any():
        return regions
    is_inside = ~creases & ~is_band[pairs].any(axis=1)
    face_count, faces = label_components(count, halfedges[is_inside])
    face_areas = np.bincount(faces, areas, face_count)
    integrals = _integrate_curvature(vertices, triangles, halfedges[is_inside], faces, face_count)
    is_face = (face_areas[faces] > MIN_FACE_AREA * part_areas[component]) & ~is_band
    if not is_face.any():
        return regions
    is_good = (integrals[faces] < MAX_FACE_CURVATURE) & is_face
    facet_bands, facet_faces, ranks = np.zeros(total, bool), np.zeros(total, np.int64), np.empty(face_count)
    facet_bands[facets], facet_faces[facets] = ~is_face, faces  # A facet of a face is inside of it.
    ranks[np.argsort(-face_areas, kind="stable")] = np.arange(face_count) / face_count
    owners = _grow(sides, side_folds, side_lengths, facet_bands, PREFERENCE * ranks[facet_faces])
    owner_faces = np.where(owners >= 0, facet_faces[owners], -1)[facets]
    is_inside_region = regions[pairs[:, 0]] == regions[pairs[:, 1]]
    region_integrals = _integrate_curvature(vertices, triangles, halfedges[is_inside_region], regions, int(regions.max()) + 1)
    is_strip = (np.bincount(facets) > 1)[facets]
    may_divide = _may_divide(regions, faces, areas, curvatures, is_band & (owner_faces >= 0), is_good, region_integrals)
    may_divide &= np.bincount(regions, areas * (is_band & is_strip)) >= MIN_STRIPS_AREA * np.bincount(regions, areas * is_band)
    # A bevel that is a region of its own joins the region of its face, and regions with several faces are divided.
    face_regions = np.zeros(face_count, np.int64)
    face_regions[faces] = np.where(may_divide[regions], regions.max() + 1 + faces, regions)
    is_moved = (owner_faces >= 0) & may_divide[regions]
    return np.where(is_moved, face_regions[owner_faces], regions)


def _may_divide(
    regions: np.ndarray,
    faces: np.ndarray,
    areas: np.ndarray,
    curvatures: np.ndarray,
    is_band: np.ndarray,
    is_good: np.ndarray,
    integrals: np.ndarray,
) -> np.ndarray:
    """Return which regions (R,) bool to divide: those of bevels alone, and those of developable faces with much sharper bevels between.

    regions, faces, areas, curvatures: (T,). is_band, is_good: (T,) bool, in bevels, and in large developable faces. integrals: (R,) the
    integral of the absolute Gaussian curvature.
    """
    count = int(regions.max()) + 1
    region_areas = np.maximum(np.bincount(regions, areas, count), TINY)
    bands, good = (np.bincount(regions, areas * kind, count) / region_areas for kind in (is_band, is_good))
    face_counts = np.bincount(np.unique(np.stack([regions, faces], axis=1)[is_good], axis=0)[:, 0], minlength=count)
    means = [
        np.bincount(regions, areas * curvatures * kind, count) / np.maximum(np.bincount(regions, areas * kind, count), TINY)
        for kind in (is_band, ~is_band)
    ]
    has_faces = (
        (face_counts > 1)
        & (integrals > MIN_REGION_CURVATURE)
        & (good > MIN_FACES_AREA)
        & (bands + good > MIN_CLEAR_AREA)
        & (means[0] > MIN_CONTRAST * means[1])
    )
    return has_faces | (bands > MIN_CLEAR_AREA)


def _grow(sides: np.ndarray, folds: np.ndarray, lengths: np.ndarray, is_band: np.ndarray, handicaps: np.ndarray) -> np.ndarray:
    """Return for each of F facets the one outside of bands from which it is reached with the smallest turn, -1 where from none.

    sides: (I, 2) facets at edges. folds, lengths: (I,). is_band: (F,) bool. handicaps: (F,) turn that is added to those from each facet.
    """
    total = len(is_band)
    perimeters = np.bincount(sides.ravel(), np.repeat(lengths, 2), total)
    starts, ends = np.concatenate([sides, sides[:, ::-1]]).T.astype(np.int64)  # The product below exceeds 32 bits.
    keys, indices = np.unique(starts * total + ends, return_inverse=True)
    borders = np.bincount(indices, np.concatenate([lengths, lengths]))
    turns = np.bincount(indices, np.concatenate([lengths * folds] * 2)) / np.maximum(borders, TINY)
    starts, ends = np.divmod(keys, total)
    is_used = is_band[ends] & (borders > MIN_COMMON_BORDER * perimeters[ends]) & (turns < MAX_BEVEL_FOLD)
    costs = np.where(is_band[starts], turns, turns + handicaps[starts])[is_used] + TINY
    graph = coo_array((costs, (starts[is_used], ends[is_used])), shape=(total, total)).tocsr()
    distances, _, owners = dijkstra(graph, indices=np.flatnonzero(~is_band), return_predecessors=True, min_only=True, limit=MAX_TURN)
    return np.where(np.isfinite(distances), owners, -1)


def _integrate_curvature(
    vertices: np.ndarray, triangles: np.ndarray, halfedges: np.ndarray, faces: np.ndarray, face_count: int
) -> np.ndarray:
    """Return the integral of the absolute Gaussian curvature inside each of `faces` (T,), connected across `halfedges` (I, 2)."""
    corner_vertices = split_vertices(triangles, halfedges)
    total = int(corner_vertices.max()) + 1
    corners = vertices[triangles]
    edges = np.roll(corners, -1, axis=1) - corners
    cosines = -np.einsum("tci,tci->tc", edges, np.roll(edges, 1, axis=1))
    sines = np.linalg.norm(np.cross(edges, np.roll(edges, 1, axis=1)), axis=2)
    defects = 2.0 * np.pi - np.bincount(corner_vertices.ravel(), np.arctan2(sines, cosines).ravel(), total)
    is_boundary = np.ones(triangles.size, bool)
    is_boundary[halfedges.ravel()] = False
    triangle, corner = np.divmod(np.flatnonzero(is_boundary), 3)
    for step in (1, 2):
        defects[corner_vertices[triangle, (corner + step) % 3]] = 0.0
    vertex_faces = np.zeros(total, np.int64)
    vertex_faces[corner_vertices] = faces[:, None]
    return np.bincount(vertex_faces, np.abs(defects), face_count)
