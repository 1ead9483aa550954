"""Simplification of textured meshes: what levels keep, the order of the collapses, and their perceptual values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.levels import Simplification, extract_level, simplify_by_cost, simplify_in_order
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from textured_models import check_no_flips, check_subset, cube, euler_characteristic, plane, torus

STRICT = TexmeshSettings(protected_fraction=0.0, drastic_simplification=False)


def random_order(mesh: TexturedMesh, targets: list[int], chosen: TexmeshSettings, seed: int = 0) -> Simplification:
    priorities = np.random.default_rng(seed).uniform(size=len(mesh.vertices))
    return run_to_end(simplify_in_order(mesh, priorities, targets, chosen))


@pytest.mark.parametrize("by_cost", [False, True])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.exhaustive)])
def test_levels_are_subsets_of_a_closed_surface_without_flips(seed, by_cost):
    mesh = torus(seed=seed, has_materials=True)
    targets = [len(mesh.triangles) * percent // 100 for percent in (50, 25, 10)]
    chosen = TexmeshSettings(vertices="original", drastic_simplification=False)
    result = run_to_end(simplify_by_cost(mesh, None, targets, chosen)) if by_cost else random_order(mesh, targets, chosen, seed)
    for target, level in zip(targets, result.levels, strict=True):
        assert level.constraint == "" and not level.drastic_steps
        assert abs(len(level.triangles) - target) <= max(0.01 * target, 1)
        check_subset(mesh, level)
        check_no_flips(mesh, level)
        assert (find_edges(level.triangles).face_counts == 2).all()
        assert euler_characteristic(level.triangles) == 0


def test_the_record_of_collapses_repeats_the_levels():
    mesh = torus()
    targets = [1000, 400]
    result = random_order(mesh, targets, STRICT)
    assert len(set(result.removed)) == len(result.removed)
    position = np.arange(len(mesh.vertices))
    for count, removed, kept in zip(range(1, len(result.removed) + 1), result.removed, result.kept, strict=True):
        position[position == removed] = kept
        for level in result.levels:
            if level.collapse_count == count:
                triangles = position[mesh.triangles]
                triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
                np.testing.assert_array_equal(triangles, level.triangles)


def test_vertices_of_low_priority_are_removed_first():
    mesh = torus(islands=1)
    priorities = np.random.default_rng(1).permutation(len(mesh.vertices)).astype(float)
    result = run_to_end(simplify_in_order(mesh, priorities, [len(mesh.triangles) // 2], STRICT))
    first = priorities[result.removed[: len(mesh.vertices) // 20]]
    assert first.max() < 0.3 * len(mesh.vertices)
    assert np.median(priorities[result.removed]) < 0.3 * len(mesh.vertices)


def test_ties_are_broken_by_perceptual_values():
    """Of vertices with equal priorities, those of the flat part go first."""
    heights = np.zeros((21, 21))
    heights[:, 10:] = np.random.default_rng(2).uniform(size=(21, 11))
    mesh = plane(20, 20, heights)
    result = run_to_end(simplify_in_order(mesh, np.zeros(len(mesh.vertices)), [600], STRICT))
    assert (mesh.vertices[result.removed][:, 0] < 10.0).all()


def test_vertices_that_would_be_seen_wait_whatever_their_priority():
    heights = np.random.default_rng(2).uniform(size=(21, 21))
    heights[:, :14] = 0.0
    mesh = plane(20, 20, heights)
    priorities = -mesh.vertices[:, 2]
    kept = run_to_end(simplify_in_order(mesh, priorities, [700], TexmeshSettings(protected_fraction=0.5, drastic_simplification=False)))
    assert (mesh.vertices[kept.removed][:, 0] < 14.0).all()


def test_seams_of_a_cube_collapse_in_pairs_to_its_corners():
    """All 12 triangles of the coarsest cube have the texture of their side, so the texture is that of the fine cube."""
    mesh = cube()
    result = run_to_end(simplify_by_cost(mesh, None, [200, 12], TexmeshSettings(drastic_simplification=False)))
    for level in result.levels:
        coarse = extract_level(mesh, level)
        corners = coarse.vertices[coarse.triangles]
        assert np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0 == pytest.approx(1.0)
        sides = (coarse.corner_uvs[..., 0].mean(axis=1) // 2).astype(int)
        uv = coarse.corner_uvs - 2.0 * sides[:, None, None]
        for axis, height in ((axis, height) for axis in range(3) for height in (0.0, 1.0)):
            on_side = sides == 2 * axis + int(height)
            points = corners[on_side]
            np.testing.assert_array_equal(points[..., axis], height)
            np.testing.assert_allclose(uv[on_side][..., 1], points[..., (axis + 2) % 3], atol=1e-12)
    assert len(result.levels[-1].triangles) == 12


def test_extracted_levels_have_the_positions_and_wedges_of_the_fine_mesh_bit_for_bit():
    mesh = torus(has_materials=True)
    level = random_order(mesh, [500], STRICT).levels[0]
    coarse = extract_level(mesh, level)
    np.testing.assert_array_equal(coarse.vertices[coarse.triangles], mesh.vertices[level.triangles])
    np.testing.assert_array_equal(coarse.corner_uvs, mesh.uvs[level.wedge_triangles])
    np.testing.assert_array_equal(coarse.wedge_vertices[coarse.wedge_triangles], coarse.triangles)
    assert len(coarse.vertices) == len(np.unique(level.triangles))


def test_the_perceptual_value_of_a_peak_is_its_height():
    heights = np.zeros((7, 7))
    heights[3, 3] = 0.25
    mesh = plane(6, 6, heights)
    result = run_to_end(simplify_in_order(mesh, -mesh.vertices[:, 2], [len(mesh.triangles) - 2], STRICT))
    np.testing.assert_allclose(result.perceptual_values, [0.25])


def test_perceptual_values_contain_those_of_absorbed_vertices():
    mesh = torus()
    result = random_order(mesh, [300], STRICT)
    absorbed = np.zeros(len(mesh.vertices))
    for removed, kept, value in zip(result.removed, result.kept, result.perceptual_values, strict=True):
        assert value >= absorbed[removed]
        absorbed[kept] += value


def test_perceptual_values_are_zero_inside_of_a_plane_and_positive_on_a_rough_surface():
    chosen = TexmeshSettings(protected_fraction=0.0)
    rough = random_order(torus(), [600], chosen).perceptual_values
    assert np.isfinite(rough).all() and (rough > 0.0).mean() > 0.9
    mesh = plane(12, 12)
    flat = random_order(mesh, [100], chosen)
    is_inside = ~find_edges(mesh.triangles).boundary_vertices[flat.removed]
    np.testing.assert_allclose(flat.perceptual_values[is_inside], 0.0, atol=1e-6)


def test_a_tetrahedron_and_a_triangle_remain():
    tetrahedron = TriangleMesh(
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    )
    for mesh in (tetrahedron, TriangleMesh(tetrahedron.vertices, tetrahedron.triangles[:1])):
        textured = build_textured_mesh(mesh, mesh.corners[..., :2] + mesh.corners[..., 2:] * [0.3, 0.7])
        level = random_order(textured, [1], TexmeshSettings()).levels[0]
        assert len(level.triangles) == len(mesh.triangles)
        assert ("instead of 1" in level.constraint) == (len(mesh.triangles) > 1)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**16), islands=st.integers(1, 30), by_cost=st.booleans(), has_holes=st.booleans())
def test_no_input_gives_flips_or_edges_with_more_than_two_triangles(seed, islands, by_cost, has_holes):
    mesh = torus(12, 10, islands, seed, has_materials=seed % 2 == 0)
    if has_holes:
        kept = np.random.default_rng(seed).uniform(size=len(mesh.triangles)) < 0.9
        base = TriangleMesh(mesh.vertices, mesh.triangles[kept], mesh.materials[kept])
        mesh = build_textured_mesh(base, mesh.corner_uvs[kept])
    steps = simplify_by_cost(mesh, None, [100, 40, 4], TexmeshSettings(vertices="original"))
    result = run_to_end(steps) if by_cost else random_order(mesh, [100, 40, 4], TexmeshSettings(), seed)
    for target, level in zip([100, 40, 4], result.levels, strict=True):
        assert len(level.triangles)
        assert (level.constraint == "") == (len(level.triangles) <= 1.01 * target)
        check_subset(mesh, level)
        check_no_flips(mesh, level)
        assert find_edges(level.triangles).face_counts.max() <= 2


@pytest.mark.parametrize("targets", [[10, 20], [0], [-5]])
def test_targets_must_be_positive_and_descend(targets):
    with pytest.raises(SettingsError, match="descend"):
        random_order(plane(3, 3), targets, STRICT)


def test_priorities_must_be_finite_and_one_per_vertex():
    mesh = plane(3, 3)
    for priorities in (np.zeros(3), np.full(len(mesh.vertices), np.nan)):
        with pytest.raises(SettingsError, match="16 finite priorities"):
            run_to_end(simplify_in_order(mesh, priorities, [4], STRICT))
