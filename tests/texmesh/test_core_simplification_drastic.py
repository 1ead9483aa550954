"""Simplification where constraints stop it: how they are named, and each drastic step. Vertices stay with their wedges."""

import numpy as np
import pytest

from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.levels import SubsetLevel, simplify_by_cost
from farfield.addon.core.texmesh.simplification.topology import divide_into_surfaces
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from textured_models import check_no_flips, check_subset, plane, torus


def coarsest(mesh: TexturedMesh, target: int, drastic: bool, size: float = 1.0) -> SubsetLevel:
    chosen = TexmeshSettings(vertices="original", drastic_simplification=drastic, drastic_size=size)
    level = run_to_end(simplify_by_cost(mesh, None, [target], chosen)).levels[0]
    check_subset(mesh, level)
    if mesh.attributes.shape[1] == 0:
        check_no_flips(mesh, level)
    return level


def test_seams_of_normals_stop_the_collapses_until_they_are_unlocked():
    smooth = torus(24, 12, 1)
    _, normals = face_areas_and_normals(smooth.vertices[smooth.triangles])
    base = TriangleMesh(smooth.vertices, smooth.triangles)
    mesh = build_textured_mesh(base, smooth.corner_uvs, np.repeat(normals[:, None], 3, axis=1), has_normals=True)
    strict = coarsest(mesh, 100, drastic=False)
    assert len(strict.triangles) == len(mesh.triangles)
    assert strict.constraint.startswith("576 triangles remain instead of 100, because of 288 vertices these stay: 288 at corners")
    drastic = coarsest(mesh, 100, drastic=True)
    assert drastic.constraint == ""  # the vertex where both UV seams of the torus cross stays locked
    assert "Seams of normals, colors or other attributes were unlocked at 287 vertices." in drastic.drastic_steps


def test_ends_of_seams_are_freed():
    """A strip around a cylinder whose upper vertices are all at one pole, with a texture coordinate per triangle there."""
    count = 24
    angles = 2 * np.pi * np.arange(count) / count
    rings = [np.stack([np.cos(angles), np.sin(angles), np.full(count, height)], axis=1) for height in (1.0, 0.0)]
    vertices = np.concatenate([*rings, [[0.0, 0.0, 1.5], [0.0, 0.0, -0.5]]])
    i = np.arange(count)
    j = (i + 1) % count
    top, bottom = 2 * count, 2 * count + 1
    triangles = [[i, j, np.full(count, top)], [j, i, i + count], [j, i + count, j + count], [j + count, i + count, np.full(count, bottom)]]
    triangles = np.concatenate([np.stack(triple, axis=1) for triple in triangles]).astype(np.int32)
    uvs = np.concatenate([np.stack([angles, np.full(count, v)], axis=1) for v in (1.0, 2.0)] + [[[0.0, 0.0], [0.0, 3.0]]])
    corner_uvs = uvs[triangles]
    corner_uvs[:count, 2, 0] = angles + 0.1
    mesh = build_textured_mesh(TriangleMesh(vertices, triangles), corner_uvs)
    strict, drastic = (coarsest(mesh, 40, is_drastic) for is_drastic in (False, True))
    assert "ends of seams" in strict.constraint
    assert any("ends of seams could collapse" in sentence for sentence in drastic.drastic_steps)
    assert len(drastic.triangles) < len(strict.triangles)


def test_a_level_does_not_consist_of_locked_vertices():
    """A torus with a smooth half, in a level with fewer vertices than there are corners of its other half, keeps its smooth half."""
    smooth = torus(24, 12, 1)
    corners = smooth.vertices[smooth.triangles]
    normals = face_areas_and_normals(corners)[1] * (corners[..., 0].mean(axis=1) < 0.0)[:, None]
    base = TriangleMesh(smooth.vertices, smooth.triangles)
    mesh = build_textured_mesh(base, smooth.corner_uvs, np.repeat(normals[:, None], 3, axis=1), has_normals=True)
    level = coarsest(mesh, 200, drastic=True)
    assert level.constraint == ""
    assert 0.3 < (mesh.vertices[np.unique(level.triangles), 0] < 0.0).mean() < 0.7


def test_small_components_are_dropped_and_large_ones_stay():
    large = torus(24, 12, 1)
    offsets = np.array([[3.0, 0, 0], [0, 3.0, 0], [0, 0, 3.0]])
    tetrahedron = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 0.02
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    vertices = np.concatenate([large.vertices, *(tetrahedron + offset for offset in offsets)])
    triangles = np.concatenate([large.triangles, *(faces + len(large.vertices) + 4 * k for k in range(3))]).astype(np.int32)
    uvs = vertices @ np.array([[1.0, 0.2], [0.1, 1.0], [0.3, 0.4]])
    mesh = build_textured_mesh(TriangleMesh(vertices, triangles), uvs[triangles])
    level = coarsest(mesh, 20, drastic=True, size=0.2)
    assert "3 small components were dropped, 12 triangles." in level.drastic_steps
    kept = coarsest(mesh, 20, drastic=True, size=0.0)
    assert not any("components" in sentence for sentence in kept.drastic_steps)


def test_small_holes_are_closed():
    is_kept = np.ones((12, 12, 2), bool)
    is_kept[3, 3], is_kept[3, 8], is_kept[8, 4] = False, False, False
    mesh = plane(12, 12, is_kept=is_kept)
    strict, drastic = (coarsest(mesh, 4, is_drastic, size=4.0) for is_drastic in (False, True))
    assert any("closed" in sentence for sentence in drastic.drastic_steps)
    assert len(drastic.triangles) < len(strict.triangles)
    assert find_edges(drastic.triangles).face_counts.max() == 2


@pytest.mark.slow
def test_thin_islands_are_dropped():
    """An island of two triangles inside of another vanishes, the other island closes over it."""
    mesh = plane(10, 10)
    uvs = mesh.corner_uvs.copy()
    centers = mesh.vertices[mesh.triangles].mean(axis=1)
    uvs[(np.abs(centers - [5.5, 5.5, 0.0]) < 0.5).all(axis=1)] += 5.0
    mesh = build_textured_mesh(TriangleMesh(mesh.vertices, mesh.triangles), uvs)
    strict, drastic = (coarsest(mesh, 2, is_drastic) for is_drastic in (False, True))
    assert (mesh.uvs[strict.wedge_triangles] > 4.0).any() and not (mesh.uvs[drastic.wedge_triangles] > 4.0).any()
    assert any("islands" in sentence for sentence in drastic.drastic_steps)


def crossing_planes() -> TexturedMesh:
    """Return two planes of 8 x 8 squares that cross in the line x = 4, z = 0."""
    flat = plane(8, 8)
    upright = flat.vertices[:, [2, 1, 0]] + [4.0, 0.0, -4.0]
    vertices, index = np.unique(np.concatenate([flat.vertices, upright]), axis=0, return_inverse=True)
    triangles = index.reshape(-1)[np.concatenate([flat.triangles, flat.triangles + len(flat.vertices)])].astype(np.int32)
    is_upright = np.repeat([0.0, 1.0], len(flat.triangles))
    uvs = np.concatenate([flat.corner_uvs] * 2) + is_upright[:, None, None]
    return build_textured_mesh(TriangleMesh(vertices, triangles), uvs)


def test_vertices_where_surfaces_cross_are_locked_until_they_are_unlocked():
    mesh = crossing_planes()
    strict, drastic = (coarsest(mesh, 10, is_drastic) for is_drastic in (False, True))
    crossing = np.flatnonzero((mesh.vertices[:, 0] == 4.0) & (mesh.vertices[:, 2] == 0.0))
    assert len(crossing) == 9 and np.isin(crossing, strict.triangles).all()
    assert "18 at edges with more than two triangles" in strict.constraint  # each surface counts
    assert drastic.constraint == "" and not np.isin(crossing, drastic.triangles).all()


def test_crossing_surfaces_are_divided_where_they_continue_straight():
    mesh = crossing_planes()
    found = divide_into_surfaces(mesh)
    divided, sources, is_touched = found.mesh, found.fine_vertices, found.is_touching
    np.testing.assert_array_equal(divided.uvs, mesh.uvs[found.fine_wedges])
    np.testing.assert_array_equal(divided.wedge_vertices[divided.wedge_triangles], divided.triangles)
    assert len(divided.vertices) == len(mesh.vertices) + 9 and is_touched.sum() == 18
    np.testing.assert_array_equal(divided.vertices, mesh.vertices[sources])
    np.testing.assert_array_equal(sources[divided.triangles], mesh.triangles)
    assert find_edges(divided.triangles).face_counts.max() == 2
    normals = face_areas_and_normals(divided.vertices[divided.triangles])[1]
    edges = find_edges(divided.triangles)
    first, second = edges.interior_halfedges.T // 3
    np.testing.assert_allclose(np.einsum("ij,ij->i", normals[first], normals[second]), 1.0)


def test_manifold_meshes_are_not_divided():
    mesh = torus(12, 8, 3)
    found = divide_into_surfaces(mesh)
    assert found.mesh is mesh and not found.is_touching.any() and not found.is_reversed.any()
    np.testing.assert_array_equal(found.fine_vertices, np.arange(len(mesh.vertices)))
    np.testing.assert_array_equal(found.fine_wedges, np.arange(len(mesh.uvs)))
