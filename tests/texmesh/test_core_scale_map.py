"""The scale map of any mesh: what it promises, structures of known size, and difficult input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shapes
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.scale_space.analysis import analyze_scale_space, encode_lightness, sample_lightness
from farfield.addon.core.texmesh.scale_space.features import SCALES, ScaleMap, rank_coverage, thin_features
from farfield.addon.core.texmesh.settings import AnalysisSettings
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh


def textured(mesh: TriangleMesh, uvs: np.ndarray | None = None) -> TexturedMesh:
    return build_textured_mesh(mesh, mesh.corners[..., :2] if uvs is None else uvs)


def analyze(mesh: TexturedMesh, texture: np.ndarray | None = None, **values) -> ScaleMap:
    return run_to_end(analyze_scale_space(mesh, [texture], AnalysisSettings(**values)))


def irregular_ball(count: int = 800, seed: int = 3) -> TriangleMesh:
    """A ball with bumps whose vertices are at random positions of a grid, so that no two parts are equal."""
    mesh = shapes.sphere(int(np.sqrt(count / 2.0)))
    random = np.random.default_rng(seed)
    directions = mesh.vertices + 0.02 * random.standard_normal(mesh.vertices.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    x, y, z = directions.T
    return TriangleMesh(directions * (1.0 + 0.15 * np.sin(4.0 * x + y) + 0.1 * z * np.cos(5.0 * y))[:, None], mesh.triangles)


def check(found: ScaleMap, mesh: TexturedMesh) -> None:
    """What every scale map promises."""
    assert found.last_scales.shape == found.strengths.shape == (len(mesh.vertices),)
    assert found.last_scales.dtype == np.int8
    assert found.strengths.dtype == np.float32
    assert np.isfinite(found.strengths).all()
    assert len(found.sigmas) == len(found.counts) == len(found.ranges) == SCALES
    assert (found.counts == [(found.last_scales >= scale).sum() for scale in range(SCALES)]).all()
    assert found.sigmas[0] == 0.0
    assert (np.diff(found.sigmas) > 0.0).all()
    assert np.isfinite(found.ranges).all()


def test_short_bumps_end_at_lower_scales_than_long_ones():
    """A long tube with bumps of two wavelengths, each on one half."""
    tube = shapes.cylinder(1.0, 40.0, 16, 240)
    heights = tube.vertices[:, 2]
    bumps = np.where(heights < 0.0, 0.05 * np.sin(2.0 * np.pi * heights), 0.4 * np.sin(2.0 * np.pi * heights / 8.0))
    mesh = textured(TriangleMesh(tube.vertices * np.stack([1.0 + bumps, 1.0 + bumps, np.ones(len(bumps))], axis=1), tube.triangles))
    found = analyze(mesh, noise=0.05, spacing=0.0)
    inside = np.abs(np.abs(mesh.vertices[:, 2]) - 10.0) < 6.0
    is_short = mesh.vertices[:, 2] < 0.0
    last_short, last_long = (found.sigmas[found.last_scales[inside & part].max()] for part in (is_short, ~is_short))
    assert last_short < 0.7
    assert last_long > 1.4


def test_features_of_a_box_are_its_edges():
    mesh = textured(shapes.box(cuts=16))
    found = analyze(mesh)
    on_edge = (np.abs(np.abs(mesh.vertices) - 0.5) < 1e-9).sum(axis=1) >= 2
    assert on_edge[found.last_scales > 0].mean() > 0.9
    assert found.last_scales[on_edge].max() >= 10


@pytest.mark.slow
def test_edges_of_a_texture_are_features_where_the_shape_is_flat():
    sheet = shapes.sheet(40)
    mesh = textured(sheet, 0.1 + 0.8 * sheet.corners[..., :2])  # away from where the texture repeats
    texture = np.zeros((64, 64, 3), np.float32)
    texture[:, 32:] = 0.8
    found = analyze(mesh, texture)
    distances = np.abs(mesh.vertices[:, 0] - 0.5)
    assert (distances[found.last_scales >= 5] < 0.06).all()
    assert found.last_scales[distances < 0.03].max() == SCALES - 1
    assert found.counts[1] > 0
    assert analyze(mesh, texture, texture_weight=0.0).counts[1] == 0


def test_the_weight_decides_between_shape_and_texture():
    sheet = shapes.sheet(40, lambda x, y: 0.0 * x + 0.3 * np.abs(y - 0.3))
    mesh = textured(sheet, 0.1 + 0.8 * sheet.corners[..., :2])
    texture = np.zeros((64, 64, 3), np.float32)
    texture[:, 32:] = 0.8
    for weight, at_crease, at_edge in ((0.0, True, False), (0.5, True, True), (1.0, False, True)):
        found = analyze(mesh, texture, texture_weight=weight)
        to_edge, to_crease = np.abs(mesh.vertices[found.last_scales >= 3, :2] - [0.5, 0.3]).T
        assert ((to_crease < 0.03) & (to_edge > 0.2)).any() == at_crease
        assert ((to_edge < 0.03) & (to_crease > 0.2)).any() == at_edge


def test_flat_and_constant_signals_have_no_features():
    mesh = textured(shapes.sheet(20))
    for texture in (None, np.full((16, 16, 3), 0.3, np.float32)):
        found = analyze(mesh, texture)
        check(found, mesh)
        assert found.counts[1] == 0


@pytest.mark.parametrize("unit", [1e-30, *(pytest.param(unit, marks=pytest.mark.exhaustive) for unit in (1e-3, 1e6, 1e30))])
def test_units_do_not_matter(unit):
    mesh = irregular_ball()
    expected = analyze(textured(mesh))
    found = analyze(textured(TriangleMesh(mesh.vertices * unit, mesh.triangles)))
    assert (found.last_scales == expected.last_scales).mean() > 0.995
    np.testing.assert_allclose(found.sigmas, expected.sigmas * unit, rtol=1e-9)
    np.testing.assert_allclose(found.ranges, expected.ranges, rtol=1e-6)


@pytest.mark.slow
@settings(max_examples=3)
@given(seed=st.integers(0, 10**6))
def test_rotation_position_and_order_of_vertices_do_not_matter(seed):
    mesh = irregular_ball()
    expected = analyze(textured(mesh, np.zeros((len(mesh.triangles), 3, 2))))
    random = np.random.default_rng(seed)
    order = random.permutation(len(mesh.vertices))
    place = np.argsort(order)
    moved = (mesh.vertices @ shapes.random_rotation(seed).T + random.standard_normal(3))[order]
    shuffled = TriangleMesh(moved, place[mesh.triangles][random.permutation(len(mesh.triangles))].astype(np.int32))
    found = analyze(textured(shuffled, np.zeros((len(mesh.triangles), 3, 2))))
    reference, result = textured(mesh).vertices, textured(shuffled).vertices
    back = (result - moved[place[0]]) @ shapes.random_rotation(seed) + mesh.vertices[0]
    nearest = np.argmin(((reference[:, None] - back) ** 2).sum(axis=2), axis=1)
    assert (found.last_scales[nearest] == expected.last_scales).mean() > 0.99
    np.testing.assert_allclose(found.sigmas, expected.sigmas, rtol=1e-9)


def test_components_boundaries_and_single_triangles():
    parts = [shapes.sheet(6), shapes.sphere(6), shapes.soup(3)]
    moved = [TriangleMesh(part.vertices + [3.0 * index, 0.0, 0.0], part.triangles) for index, part in enumerate(parts)]
    for mesh in (textured(concatenate(moved)), textured(shapes.soup(1)), textured(shapes.soup(400)), textured(shapes.box(cuts=1))):
        check(analyze(mesh), mesh)


def test_a_vertex_without_triangles_is_no_feature():
    mesh = textured(irregular_ball(400))
    lonely = TexturedMesh(**{**vars(mesh), "vertices": np.concatenate([mesh.vertices, [[0.1, 0.2, 0.3]]])})
    found = analyze(lonely)
    check(found, lonely)
    assert found.last_scales[-1] == 0


def test_thinned_features_keep_their_distance_and_none_is_lost():
    random = np.random.default_rng(8)
    points, strengths = random.random((800, 3)), random.random(800)
    scales = random.integers(0, SCALES, 800).astype(np.int8)
    sigmas = np.concatenate([[0.0], 0.02 * 1.15 ** np.arange(SCALES - 1)])
    thinned = thin_features(points, scales, strengths, sigmas, 1.0)
    assert (thinned <= scales).all()
    assert ((thinned > 0) == (scales > 0)).all()
    for scale in (2, 8, 14, 20):
        kept = points[thinned >= scale]
        distances = np.linalg.norm(kept[:, None] - kept, axis=2) + 10.0 * np.eye(len(kept))
        assert distances.min() >= sigmas[scale]
    np.testing.assert_array_equal(thin_features(points, scales, strengths, sigmas, 0.0), scales)


def test_detail_finer_than_the_mesh_does_not_alias():
    """A checkerboard of single texels is gray, one of large squares is not; textures repeat."""
    mesh = shapes.sheet(8)
    rows, columns = np.indices((256, 256))
    fine = np.repeat(((rows + columns) % 2)[..., None], 3, axis=2).astype(np.float32)
    coarse = np.repeat(((rows // 128 + columns // 128) % 2)[..., None], 3, axis=2).astype(np.float32)
    gray = float(encode_lightness(np.array(0.5)))
    lightness, has_texture = sample_lightness(textured(mesh), [fine])
    assert has_texture.all()
    np.testing.assert_allclose(lightness, gray, atol=0.02)
    for shift in (0.0, 3.0, -7.0):
        lightness = sample_lightness(textured(mesh, mesh.corners[..., :2] + shift), [coarse])[0]
        assert np.ptp(lightness) > 0.99


def test_several_materials_and_textures_of_any_content():
    mesh = shapes.sheet(10)
    materials = (mesh.corners[..., 0].mean(axis=1) > 0.5).astype(np.int32)
    parted = textured(TriangleMesh(mesh.vertices, mesh.triangles, materials))
    wild = np.random.default_rng(2).standard_normal((5, 7, 3)).astype(np.float32) * 100.0
    wild[0, 0] = np.nan, np.inf, -np.inf
    half = run_to_end(analyze_scale_space(parted, [wild, None], AnalysisSettings()))
    assert half.losses.startswith("50.0% of the area has no texture")
    check(half, parted)
    both = run_to_end(analyze_scale_space(parted, [np.zeros((2, 2, 3), np.float32), np.ones((1, 1, 3), np.float32)], AnalysisSettings()))
    assert both.losses == ""
    assert both.counts[1] > 0


def test_lightness_is_that_of_the_cie():
    np.testing.assert_allclose(encode_lightness(np.array([0.0, 0.18, 1.0, 7.0])), [0.0, 0.4950, 1.0, 1.0], atol=1e-3)


def test_vertices_between_features_are_ordered_by_coverage():
    """The first ones of a flat square without features are spread over it."""
    random = np.random.default_rng(1)
    points = np.concatenate([random.random((800, 2)), 0.5 + 1e-6 * random.random((800, 2))])
    points = np.concatenate([points, np.zeros((len(points), 1))], axis=1)
    scales = np.zeros(len(points), np.int8)
    scales[0] = 7
    sigmas = np.concatenate([[0.0], 0.02 * 1.15 ** np.arange(SCALES - 1)])
    strengths = rank_coverage(points, scales, random.random(len(points)), sigmas, 1.0)
    assert strengths[0] == 0.0
    for scale in (1, 8, 14):
        chosen = points[strengths >= scale]
        distances = np.linalg.norm(np.concatenate([chosen, points[:1]])[:, None] - chosen, axis=2)
        distances[np.arange(len(chosen)), np.arange(len(chosen))] = 1.0
        assert distances.min() >= sigmas[scale]
        assert np.linalg.norm(points[:, None] - np.concatenate([chosen, points[:1]]), axis=2).min(axis=1).max() < 6.0 * sigmas[scale]
