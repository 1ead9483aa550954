"""Heat diffusion on meshes: eigenfunctions of the sphere, identities of the Laplacian, curvature of known shapes."""

import numpy as np
import pytest

import shapes
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.scale_space.analysis import (
    assemble_laplacian,
    integrate_mean_curvature,
    integrate_over_vertices,
    mollify_lengths,
    triangle_areas,
)
from farfield.addon.core.texmesh.scale_space.diffusion import build_levels, choose_times, diffuse, find_aggregates, search_last_sigma


def laplacian_and_masses(mesh: TriangleMesh):
    lengths = mollify_lengths(mesh.vertices, mesh.triangles)
    areas = triangle_areas(lengths)
    ones = np.ones(mesh.triangles.shape)
    count = len(mesh.vertices)
    return assemble_laplacian(mesh.triangles, lengths, count), integrate_over_vertices(mesh.triangles, areas, ones, count)


def harmonics(points: np.ndarray) -> dict[int, np.ndarray]:
    """Spherical harmonics of degrees 1 to 4 at unit vectors, not normalized."""
    x, y, z = points.T
    return {1: z + 0.5 * x, 2: x * y, 3: x * y * z, 4: x**4 - 6.0 * x**2 * y**2 + y**4}


@pytest.mark.parametrize("rings, coarse", [(24, False), (56, True)])
def test_eigenfunctions_of_the_sphere_decay_with_their_eigenvalues(rings, coarse):
    mesh = shapes.sphere(rings)
    laplacian, masses = laplacian_and_masses(mesh)
    spacing = np.sqrt(np.median(masses))
    levels = build_levels(laplacian, masses, mesh.vertices, 1.6 * spacing, 0.3 if coarse else 0.0)
    assert (len(levels) > 1) == coarse
    times, growth = choose_times(spacing, 0.6)
    functions = np.stack(list(harmonics(mesh.vertices).values()), axis=1)
    laplacians, ranges = run_to_end(diffuse(levels, masses[:, None] * functions, times, growth))
    for index, degree in enumerate(harmonics(mesh.vertices)):
        value = degree * (degree + 1)
        decay = np.exp(-value * times)
        used = decay > 0.2
        found = ranges[:, index] / np.ptp(functions[:, index])
        np.testing.assert_allclose(found[used], decay[used], rtol=0.3 if coarse else 0.08)
        amplitudes = np.einsum("v,sv->s", masses * functions[:, index], laplacians[:, :, index]) / (masses @ functions[:, index] ** 2)
        np.testing.assert_allclose(amplitudes[used], value * decay[used], rtol=0.1)


def test_times_grow_geometrically_to_the_last_scale():
    times, growth = choose_times(0.01, 0.3)
    np.testing.assert_allclose(times[1:] / times[:-1], float(growth))
    np.testing.assert_allclose(np.sqrt(2.0 * times[-1]), 0.3)
    assert np.sqrt(2.0 * times[0]) <= 0.01
    assert len(times) == 20


def test_constants_do_not_change_and_heat_is_conserved():
    mesh = shapes.bumpy_sphere(30)
    laplacian, masses = laplacian_and_masses(mesh)
    levels = build_levels(laplacian, masses, mesh.vertices, 0.2, 1.0)
    assert len(levels) > 1
    times, growth = choose_times(0.05, 0.8)
    signals = np.stack([np.ones(len(masses)), mesh.vertices[:, 0]], axis=1)
    laplacians, ranges = run_to_end(diffuse(levels, masses[:, None] * signals, times, growth))
    np.testing.assert_allclose(ranges[:, 0], 0.0, atol=1e-9)
    np.testing.assert_allclose(masses @ laplacians[-1], 0.0, atol=1e-5)
    assert (np.diff(ranges[:, 1]) < 0.0).all()


def test_coarse_functions_sum_to_one_and_keep_the_area():
    mesh = shapes.bumpy_sphere(30)
    laplacian, masses = laplacian_and_masses(mesh)
    levels = build_levels(laplacian, masses, mesh.vertices, 0.2, 1.0)
    for level in levels[1:]:
        np.testing.assert_allclose(level.prolongation.sum(axis=1), 1.0)
        np.testing.assert_allclose(level.mass.sum(), masses.sum())
        np.testing.assert_allclose(level.laplacian.sum(axis=0), 0.0, atol=1e-9)


def test_roots_are_more_than_two_edges_from_each_other_and_reach_everything():
    mesh = shapes.sphere(12)
    neighbors = abs(laplacian_and_masses(mesh)[0]).tocsr() + 0.0
    rank = np.random.default_rng(4).permutation(len(mesh.vertices))
    roots, aggregates = find_aggregates(neighbors, rank)
    pattern = (neighbors > 0.0).astype(float).toarray()
    two_edges = pattern @ pattern > 0.0
    assert (two_edges[np.ix_(roots, roots)] == np.eye(len(roots), dtype=bool)).all()
    assert two_edges[np.arange(len(rank)), roots[aggregates]].all()


def test_linear_functions_have_the_energy_of_their_gradient():
    mesh = shapes.sheet(7)
    laplacian, masses = laplacian_and_masses(mesh)
    function = mesh.vertices @ [2.0, -1.0, 0.0]
    np.testing.assert_allclose(function @ (laplacian @ function), 5.0, rtol=1e-3)
    np.testing.assert_allclose(masses.sum(), 1.0, rtol=1e-3)


def test_thin_and_degenerate_triangles_are_mollified():
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 1.0, 0.0], [0.5, 1.0, 0.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 3], [3, 4, 0]], np.int32)
    lengths = mollify_lengths(vertices, triangles)
    assert (2.0 * lengths.max(axis=1) < lengths.sum(axis=1)).all()
    assert (triangle_areas(lengths) > 0.0).all()
    np.testing.assert_allclose(lengths, mollify_lengths(vertices[:, [1, 2, 0]], triangles))
    laplacian = assemble_laplacian(triangles, lengths, len(vertices))
    assert np.isfinite(laplacian.data).all()
    assert np.linalg.eigvalsh(laplacian.toarray()).min() > -1e-6


def test_a_sliver_beside_good_triangles_hardly_changes_the_diffusion():
    """A plane with and without a vertex almost on an edge."""
    mesh = shapes.sheet(9)
    first, corner = mesh.triangles[0], mesh.triangles[0, 0]
    added = 0.5 * (mesh.vertices[first[1]] + mesh.vertices[first[2]]) + 1e-9 * (mesh.vertices[corner] - mesh.vertices[first[1]])
    sliver = len(mesh.vertices)
    split = np.array([[corner, first[1], sliver], [corner, sliver, first[2]], [sliver, first[1], first[2]]], np.int32)
    cut = TriangleMesh(np.concatenate([mesh.vertices, [added]]), np.concatenate([mesh.triangles[1:], split]).astype(np.int32))
    results = []
    for each in (mesh, cut):
        laplacian, masses = laplacian_and_masses(each)
        times, growth = choose_times(0.1, 0.5)
        values = np.sin(5.0 * each.vertices[:, 0])
        levels = build_levels(laplacian, np.maximum(masses, 1e-12), each.vertices, 0.1, 0.0)
        results.append(run_to_end(diffuse(levels, (masses * values)[:, None], times, growth))[0][-1, : len(mesh.vertices), 0])
    np.testing.assert_allclose(results[0], results[1], atol=0.03 * np.abs(results[0]).max())


def test_mean_curvature_of_known_shapes():
    cube = shapes.box((1.0, 2.0, 3.0), cuts=4)
    points, triangles = np.unique(np.round(cube.vertices, 9), axis=0, return_inverse=True)
    triangles = triangles.reshape(-1)[cube.triangles]
    total = integrate_mean_curvature(points, triangles, find_edges(triangles)).sum()
    np.testing.assert_allclose(total, 0.25 * np.pi * 4.0 * 6.0)  # half the angle times length, over four edges of each length
    ball = shapes.sphere(40)
    inside = ball.triangles[:, ::-1]
    edges = find_edges(ball.triangles)
    np.testing.assert_allclose(integrate_mean_curvature(ball.vertices, ball.triangles, edges).sum(), 4.0 * np.pi, rtol=2e-3)
    np.testing.assert_allclose(integrate_mean_curvature(ball.vertices, inside, find_edges(inside)).sum(), -4.0 * np.pi, rtol=2e-3)
    flat = shapes.sheet(5)
    np.testing.assert_allclose(integrate_mean_curvature(flat.vertices, flat.triangles, find_edges(flat.triangles)), 0.0, atol=1e-12)


def test_a_system_that_is_singular_is_one_sentence():
    mesh = shapes.sphere(6)
    laplacian, masses = laplacian_and_masses(mesh)
    levels = build_levels(0.0 * laplacian, 0.0 * masses, mesh.vertices, 0.5, 2.0)
    with pytest.raises(GeometryError, match="triangles are tiny compared to its size"):
        search_last_sigma(levels, np.zeros((len(masses), 1)), np.ones(1), 0.25, 1.0)
