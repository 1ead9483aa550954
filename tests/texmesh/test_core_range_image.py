"""Range images: known surfaces, filters with known answers, and what a range image cannot represent."""

import numpy as np
import pytest

import shapes
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.scale_space.analysis import analyze_scale_space
from farfield.addon.core.texmesh.scale_space.range_image import RangeFilter, build_range_image, find_zero_crossings
from farfield.addon.core.texmesh.settings import AnalysisSettings
from farfield.addon.core.texmesh.textured_mesh import build_textured_mesh


def vase(sides: int = 240, cuts: int = 120) -> TriangleMesh:
    """A star-shaped surface around the Z axis, of height 2, without caps."""
    mesh = shapes.cylinder(1.0, 2.0, sides, cuts)
    return TriangleMesh(
        mesh.vertices * np.array([1.0, 1.0, 0.0]) * radius_of(mesh.vertices)[:, None] + mesh.vertices * [0, 0, 1], mesh.triangles
    )


def radius_of(points: np.ndarray) -> np.ndarray:
    return vase_radius(np.arctan2(points[:, 1], points[:, 0]), points[:, 2])


def vase_radius(angles: np.ndarray, heights: np.ndarray) -> np.ndarray:
    return 1.0 + 0.2 * np.cos(3.0 * angles) + 0.1 * np.sin(2.0 * heights)


def analyze(mesh: TriangleMesh, **settings):
    textured = build_textured_mesh(mesh, np.zeros((len(mesh.triangles), 3, 2)))
    return textured, run_to_end(analyze_scale_space(textured, [None], AnalysisSettings(analysis="range_image", **settings)))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_range_image_of_a_star_shaped_surface_is_its_radius(axis):
    mesh = vase()
    image = build_range_image(np.roll(mesh.vertices, axis - 2, axis=1), mesh.triangles, axis)
    rows, columns = image.ranges.shape
    angles = (np.arange(columns) + 0.5) * 2.0 * np.pi / columns - np.pi
    heights = (np.arange(rows) + 0.5) * 2.0 / rows - 1.0
    center = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    assert image.is_known.mean() > 0.995
    x, y = image.ranges * np.cos(angles) + center[0], image.ranges * np.sin(angles) + center[1]
    expected = vase_radius(np.arctan2(y, x), np.broadcast_to(heights[:, None], x.shape))
    np.testing.assert_allclose(np.hypot(x, y)[image.is_known], expected[image.is_known], atol=2e-3)
    assert image.is_seen.mean() > 0.995
    assert image.hidden < 0.002
    assert image.edge_on == 0.0


def test_columns_and_rows_follow_the_sampling():
    mesh = shapes.cylinder(1.0, 2.0, 300, 20)
    image = build_range_image(mesh.vertices, mesh.triangles, 2)
    np.testing.assert_allclose(image.ranges.shape, (20, 300), rtol=0.1)
    np.testing.assert_allclose(image.ranges[image.is_known], 1.0, atol=1e-3)
    np.testing.assert_allclose((image.row_length, image.column_length), (0.1, 2.0 * np.pi / 300), rtol=0.1)


def test_a_wrapped_sine_is_damped_by_the_window_of_the_paper():
    """The response to a sine is that of the truncated and normalized Gaussian."""
    columns, sigma = 120, 8.0
    wave = np.sin(2.0 * np.pi * 3.0 * np.arange(columns) / columns)
    image = np.tile(5.0 + wave, (9, 1))
    smooth = RangeFilter(image, np.ones(image.shape, bool)).smooth(sigma)
    offsets = np.arange(-11, 12)  # 1.4 times 8, rounded
    weights = np.exp(-0.5 * (offsets / sigma) ** 2)
    gain = (weights / weights.sum()) @ np.cos(2.0 * np.pi * 3.0 * offsets / columns)
    np.testing.assert_allclose(smooth, np.tile(5.0 + gain * wave, (9, 1)), atol=1e-12)


def test_the_laplacian_is_exact_for_parabolas_and_zero_for_planes():
    y, x = np.mgrid[0:60, 0:60].astype(float)
    inner = (slice(20, 40), slice(20, 40))
    known = np.ones(x.shape, bool)
    for phi, psi in ((1.0, 1.0), (0.25, 2.0)):
        sigma = 3.0
        heights = phi * (x - 30.0) ** 2 + 0.5 * psi * (y - 30.0) ** 2 + 3.0 * x
        laplacian = RangeFilter(heights, known, phi, psi).laplacian(sigma)
        np.testing.assert_allclose(laplacian[inner] / sigma**2, 3.0, rtol=1e-6)
        np.testing.assert_allclose(RangeFilter(3.0 * y - x, known, phi, psi).laplacian(sigma)[inner], 0.0, atol=1e-8)


def test_holes_have_no_influence_on_constants_and_crossings_avoid_them():
    random = np.random.default_rng(5)
    known = random.random((40, 50)) > 0.3
    filtering = RangeFilter(np.where(known, 2.0, 77.0), known)
    np.testing.assert_allclose(filtering.smooth(4.0), 2.0)
    np.testing.assert_allclose(filtering.laplacian(4.0), 0.0, atol=1e-12)
    pixels, _ = find_zero_crossings(random.standard_normal(known.shape), known, 0.0)
    assert known.ravel()[pixels].all()


def test_zero_crossings_are_at_the_nearer_pixel_and_wrap():
    values = np.tile(np.array([-1.0, -0.2, 0.9, 2.0, 0.4]), (3, 1))
    pixels, strengths = find_zero_crossings(values, np.ones(values.shape, bool), 0.0)
    np.testing.assert_array_equal(pixels % 5, [1, 4] * 3)
    np.testing.assert_allclose(strengths, [1.1, 1.4] * 3)


def test_ranges_fall_to_the_convergence_threshold_and_counts_fall():
    mesh, found = analyze(vase(80, 40), convergence=0.4)
    np.testing.assert_allclose(found.ranges[0], 1.0)
    np.testing.assert_allclose(found.ranges[-1], 0.4, atol=0.05)
    assert (np.diff(found.counts) <= 0).all()
    assert found.counts[0] == len(mesh.vertices)
    np.testing.assert_allclose(np.diff(found.sigmas), found.sigmas[-1] / 20.0)
    assert found.losses == ""


def test_what_is_not_star_shaped_is_named_with_its_area():
    """A cylinder within another of twice the radius, and a capped one."""
    outer = shapes.cylinder(2.0, 2.0, 60, 20)
    inner = shapes.cylinder(1.0, 2.0, 60, 20)
    textured, found = analyze(concatenate([outer, inner]))
    assert found.losses.startswith("33.3% of the area is not in the range image: 33.3% is behind other parts, 0.0% is edge-on")
    assert (found.last_scales[np.hypot(*textured.vertices[:, :2].T) < 1.5] == 0).all()
    _, found = analyze(shapes.box(cuts=12))
    assert "33.3% is edge-on" in found.losses


def test_scale_and_shift_do_not_matter():
    mesh = vase(60, 30)
    _, found = analyze(mesh)
    _, moved = analyze(TriangleMesh(mesh.vertices * 1024.0 + [64.0, -128.0, 32.0], mesh.triangles))
    assert (found.last_scales == moved.last_scales).mean() > 0.99
    np.testing.assert_allclose(moved.sigmas, 1024.0 * found.sigmas, rtol=1e-5)


def test_a_surface_across_the_axis_has_no_range_image():
    with pytest.raises(GeometryError, match="choose another axis"):
        analyze(shapes.sheet(5))
