"""Textured meshes for tests: a torus and a cube with several UV islands, and what all of their levels must keep."""

import numpy as np
from scipy.spatial import cKDTree

from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.texmesh.simplification.levels import SubsetLevel
from farfield.addon.core.texmesh.simplification.topology import find_islands
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh


def torus(rows: int = 48, columns: int = 24, islands: int = 8, seed: int = 0, has_materials: bool = False) -> TexturedMesh:
    """Return an uneven torus with UV islands of random shapes, which overlap, every third of them mirrored."""
    random = np.random.default_rng(seed)
    u, v = np.meshgrid(np.linspace(0.0, 2 * np.pi, rows, False), np.linspace(0.0, 2 * np.pi, columns, False), indexing="ij")
    radius = 0.4 + 0.05 * np.cos(3 * u + 2 * v) + 0.02 * random.normal(size=u.shape)
    positions = [(1.0 + radius * np.cos(v)) * np.cos(u), (1.0 + radius * np.cos(v)) * np.sin(u), radius * np.sin(v)]
    vertices = np.stack(positions, axis=-1).reshape(-1, 3)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    a, b, c, d = (np.stack([i + di, j + dj], axis=1) for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)))
    cells = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    triangles = (cells[..., 0] % rows * columns + cells[..., 1] % columns).astype(np.int32)
    centers = vertices[triangles].mean(axis=1)
    labels = cKDTree(centers[random.choice(len(centers), islands, replace=False)]).query(centers)[1]
    uvs = cells / [rows, columns] + 0.3 * labels[:, None, None]
    uvs[labels % 3 == 2, :, 0] *= -1.0
    materials = (labels % 2).astype(np.int32) if has_materials else None
    return build_textured_mesh(TriangleMesh(vertices, triangles, materials), uvs)


def cube(cells: int = 8) -> TexturedMesh:
    """Return a unit cube with cells x cells squares per side, each side a UV island of its own."""
    steps = np.arange(cells + 1) / cells
    x, y = (axis.ravel() for axis in np.meshgrid(steps, steps, indexing="ij"))
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij"))
    a, b, c, d = ((i + di) * (cells + 1) + j + dj for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)))
    side = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    corners, uvs = [], []
    for axis in range(3):
        for height in (0.0, 1.0):
            points = np.empty((len(x), 3))
            points[:, axis], points[:, (axis + 1) % 3], points[:, (axis + 2) % 3] = height, x, y
            triangles = side if height else side[:, ::-1]
            corners.append(points[triangles])
            uvs.append(np.stack([x if height else 1.0 - x, y], axis=1)[triangles] + 2.0 * len(uvs))
    vertices, index = np.unique(np.concatenate(corners).reshape(-1, 3), axis=0, return_inverse=True)
    return build_textured_mesh(TriangleMesh(vertices, index.reshape(-1, 3).astype(np.int32)), np.concatenate(uvs))


def plane(columns: int, rows: int, heights: np.ndarray | None = None, is_kept: np.ndarray | None = None) -> TexturedMesh:
    """Return a plane of unit squares with its coordinates, divided by 100, as texture coordinates; `heights` of its vertices by row."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0)))
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    a, b, c, d = first, first + 1, first + columns + 2, first + columns + 1
    triangles = np.stack([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)], axis=1)
    triangles = (triangles if is_kept is None else triangles.reshape(-1, 2, 3)[is_kept.reshape(-1, 2)]).reshape(-1, 3).astype(np.int32)
    vertices = np.stack([x, y, np.zeros(len(x)) if heights is None else heights.ravel()], axis=1)
    return build_textured_mesh(TriangleMesh(vertices, triangles), vertices[triangles][..., :2] / 100.0)


def uv_signs(mesh: TexturedMesh, wedge_triangles: np.ndarray) -> np.ndarray:
    """Return the signs (T,) of the areas of triangles in texture space."""
    first, second, third = mesh.uvs[wedge_triangles].transpose(1, 2, 0)
    (a, b), (c, d) = second - first, third - first
    return np.sign(a * d - b * c)


def euler_characteristic(triangles: np.ndarray) -> int:
    """Return the number of vertices and triangles minus that of edges."""
    return len(np.unique(triangles)) - len(find_edges(triangles).ends) + len(triangles)


def check_subset(mesh: TexturedMesh, level: SubsetLevel) -> None:
    """Check that a level has wedges of its vertices, and that these have its materials."""
    np.testing.assert_array_equal(mesh.wedge_vertices[level.wedge_triangles], level.triangles)
    materials = np.zeros(len(mesh.uvs), np.int32)
    materials[mesh.wedge_triangles.ravel()] = np.repeat(mesh.materials, 3)
    np.testing.assert_array_equal(materials[level.wedge_triangles], np.repeat(level.materials[:, None], 3, axis=1))


def check_no_flips(mesh: TexturedMesh, level: SubsetLevel) -> None:
    """Check that no triangle of a level has an area in texture space of a sign that no triangle of its UV island had."""
    islands = find_islands(mesh)
    signs = uv_signs(mesh, mesh.wedge_triangles)
    allowed = np.zeros((islands.max() + 1, 3), bool)
    allowed[islands, signs.astype(int) + 1] = True
    wedge_islands = np.zeros(len(mesh.uvs), int)
    wedge_islands[mesh.wedge_triangles] = islands[:, None]
    level_islands = wedge_islands[level.wedge_triangles]
    assert (level_islands == level_islands[:, :1]).all()
    assert allowed[level_islands[:, 0], uv_signs(mesh, level.wedge_triangles).astype(int) + 1].all()
