"""Levels of meshes as bytes: what is decoded is what was encoded, and coarse levels are the beginning of fine ones."""

from types import SimpleNamespace

import numpy as np
import pytest

from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.simplification.levels import Simplification, SubsetLevel, simplify_by_cost
from farfield.addon.core.texmesh.simplification.settings import SimplificationSettings
from farfield.addon.core.texmesh.streaming.mesh_coding import decode_level, encode_mesh, quantize
from farfield.addon.core.texmesh.streaming.mesh_order import OrderedMesh, find_records, order_mesh
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh
from textured_models import cube, plane, torus

MODELS = {"torus": torus(has_materials=True), "cube": cube(), "plane": plane(12, 9)}


def make_levels(mesh: TexturedMesh) -> tuple[Simplification, OrderedMesh]:
    targets = [len(mesh.triangles) * percent // 100 for percent in (40, 15, 5)]
    result = run_to_end(simplify_by_cost(mesh, None, targets, SimplificationSettings()))
    return result, order_mesh(mesh, result.levels, result)


def sort_triangles(corners: np.ndarray, materials: np.ndarray) -> np.ndarray:
    """Return rows of the corner values (T, 3, C) and materials, each with its smallest corner first, in ascending order."""
    rows = []
    for triangle, material in zip(corners.tolist(), materials.tolist(), strict=True):
        first = triangle.index(min(triangle))
        rows.append([material, *triangle[first], *triangle[(first + 1) % 3], *triangle[(first + 2) % 3]])
    return np.array(sorted(rows))


def corner_values(positions: np.ndarray, wedge_vertices: np.ndarray, uvs: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    return np.concatenate([positions[wedge_vertices[triangles]], uvs[triangles]], axis=2)


@pytest.mark.parametrize("name", MODELS)
def test_decoded_levels_are_the_encoded_ones(name):
    mesh = MODELS[name]
    result, ordered = make_levels(mesh)
    content, levels, bounds, uv_bounds = encode_mesh(ordered, (1.0,) * len(ordered.levels), 2)
    positions = quantize(mesh.vertices, bounds).astype(int)
    uvs = quantize(mesh.uvs * [1.0, -1.0] + [0.0, 1.0], uv_bounds).astype(int)
    fine = SubsetLevel(mesh.triangles, mesh.wedge_triangles, mesh.materials, 0, "", ())
    for index, subset in enumerate([*result.levels[::-1], fine]):
        decoded = decode_level(content, SimpleNamespace(levels=levels), index)
        expected = corner_values(positions, mesh.wedge_vertices, uvs, subset.wedge_triangles)
        found = corner_values(decoded.positions.astype(int), decoded.wedge_vertices, decoded.uvs.astype(int), decoded.triangles)
        np.testing.assert_array_equal(sort_triangles(found, decoded.materials), sort_triangles(expected, subset.materials))
        np.testing.assert_array_equal(decoded.parents, ordered.parents[: len(decoded.parents)])
        assert len(decoded.positions) == levels[index].vertex_count and len(decoded.uvs) == levels[index].wedge_count


@pytest.mark.parametrize("name", MODELS)
def test_coarse_vertices_come_first_and_are_parents(name):
    mesh = MODELS[name]
    result, ordered = make_levels(mesh)
    known = 0
    for level, subset in zip(ordered.levels, result.levels[::-1], strict=False):
        assert set(np.unique(subset.triangles)) == set(ordered.vertices[: level.vertex_count])
        assert (ordered.parents[known : level.vertex_count] < known).all()
        known = level.vertex_count
    assert (ordered.parents[: ordered.levels[0].vertex_count] == -1).all()
    assert (ordered.parents[ordered.levels[0].vertex_count :] >= 0).all()


def test_records_insert_vertices_next_to_those_that_are_there():
    mesh = torus()
    result, ordered = make_levels(mesh)
    records = find_records(mesh, ordered, result)
    present = set(range(ordered.levels[0].vertex_count))
    for inserted, neighbor in zip(records.inserted.tolist(), records.neighbors.tolist(), strict=True):
        assert neighbor in present and inserted not in present
        present.add(inserted)
    assert present == set(range(len(mesh.vertices)))
    np.testing.assert_array_equal(records.texels, mesh.uvs[result.removed_wedges[::-1]][-len(records.texels) :])
