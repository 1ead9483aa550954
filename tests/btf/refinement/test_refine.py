"""Refined silhouettes composite to the reference images, without gaps and double coverage, and the gradient is that of the error."""

from dataclasses import dataclass

import numpy as np
import pytest

from farfield.addon.core.billboards.texels import QuadPolygons, Texels, texels_under_quads
from farfield.addon.core.btf.capture.observations import ReferenceImage, ViewRender, compute_reference_image, low_order_lights
from farfield.addon.core.btf.capture.shards import ShardStore
from farfield.addon.core.btf.factorization.factors import Factors
from farfield.addon.core.btf.refinement import training
from farfield.addon.core.btf.refinement.fragments import Fragments, find_fragments
from farfield.addon.core.btf.refinement.refine import (
    RAYS_PER_SIDE,
    AlphaCompositing,
    TrainingView,
    compute_texel_colors,
    cull_hidden,
    refine_alpha,
    shade,
)
from farfield.addon.core.geometry.cameras import OrthographicView
from farfield.addon.core.geometry.directions import DirectionGrid
from farfield.addon.core.jobs.progress import run_to_end

SIZE, STACK_HEIGHT = (22, 10), 16
GRAY = 0.4
SQUARE = np.array([[0, 0], [8, 0], [8, 8], [0, 8]], float)


def two_sheets() -> QuadPolygons:
    """Return two sheets of 8 x 8 texels, one directly above the other."""
    corners = [np.column_stack([SQUARE, np.full(4, height)]) for height in (0.0, 0.2)]
    return QuadPolygons(corners, [SQUARE + [1.0, 1.0], SQUARE + [12.0, 1.0]])


def stack() -> QuadPolygons:
    """Return STACK_HEIGHT sheets above each other."""
    corners = [np.column_stack([SQUARE, np.full(4, height)]) for height in np.linspace(0.0, 0.4, STACK_HEIGHT)]
    return QuadPolygons(corners, [SQUARE + [11.0 * index + 1.0, 1.0] for index in range(STACK_HEIGHT)])


@dataclass
class GrayView:
    """A `TrainingViewSource` of gray `quads`."""

    view: OrthographicView
    reference: ReferenceImage
    quads: QuadPolygons

    @property
    def texels(self) -> Texels:
        return texels_under_quads(self.quads, (11 * len(self.quads.corners), SIZE[1]))

    def find_fragments(self) -> Fragments:
        return find_fragments(self.quads, self.texels, self.view, RAYS_PER_SIDE)

    def load(self) -> TrainingView:
        fragments = self.find_fragments()
        return TrainingView(fragments, shade(fragments, np.full((len(self.texels), 15), GRAY)), self.reference)


def gray_views(coverage: float, quads: QuadPolygons | None = None) -> list[GrayView]:
    """Return a perpendicular and two oblique views from above, with a gray reference of uniform `coverage`."""
    directions = [np.array(direction) / np.linalg.norm(direction) for direction in ([0, 0, 1], [0.1, 0, 1], [0, 0.1, 1])]
    alpha = np.full((8, 8), coverage, np.float32)
    reference = ReferenceImage(np.broadcast_to(GRAY * alpha[None, ..., None], (5, 8, 8, 3)).copy(), alpha)
    views = [OrthographicView(direction, np.array([4.0, 4.0, 0.0]), 8, 1.0) for direction in directions]
    return [GrayView(view, reference, quads or two_sheets()) for view in views]


def zero_factors(texel_count: int, view_count: int) -> Factors:
    weights = np.zeros((texel_count, 1), np.float32)
    return Factors(weights, np.ones((view_count, 1, 1), np.float32), np.ones(texel_count, bool))


def refine(views: list[GrayView], pbr_alpha: np.ndarray) -> Factors:
    return run_to_end(refine_alpha(views, zero_factors(len(pbr_alpha), len(views)), pbr_alpha, np.ones(len(views))))


def composite(view: GrayView, alpha: np.ndarray) -> np.ndarray:
    """Composite the coverage (8, 8) of a view."""
    fragments = view.find_fragments()
    fragment_alpha = np.clip((alpha[fragments.texel_indices] * fragments.weights).sum(axis=1), 0.0, 1.0)
    contributions = fragments.transmittance(fragment_alpha) * fragment_alpha
    return np.bincount(fragments.ray_indices // RAYS_PER_SIDE**2, contributions, minlength=64).reshape(8, 8) / RAYS_PER_SIDE**2


@pytest.mark.parametrize(("alpha", "coverage"), [(0.5, 1.0), (0.5, 0.5)], ids=["gap", "double coverage"])
def test_two_quads_composite_to_the_reference(alpha, coverage):
    """Two quads of alpha one half cover three quarters, whatever the reference shows."""
    views, texels = gray_views(coverage), texels_under_quads(two_sheets(), SIZE)
    pbr_alpha = np.full(len(texels), alpha, np.float32)
    factors = refine(views, pbr_alpha)
    for index, view in enumerate(views):
        before = np.abs(composite(view, pbr_alpha) - coverage)[1:-1, 1:-1]
        after = np.abs(composite(view, pbr_alpha + factors.weights @ factors.basis[index, :, 0]) - coverage)[1:-1, 1:-1]
        assert before.mean() == pytest.approx(0.25, abs=0.01)
        assert after.mean() < 0.3 * before.mean()


@pytest.mark.slow
@pytest.mark.parametrize("coverage", [0.3, pytest.param(0.9, marks=pytest.mark.exhaustive)])
def test_a_deep_stack_does_not_oscillate(coverage):
    """With many texels along a ray, each has little influence, and all together have much."""
    views = gray_views(coverage, stack())
    pbr_alpha = np.full(len(views[0].texels), 0.15, np.float32)
    factors = refine(views, pbr_alpha)
    for index, view in enumerate(views):
        after = composite(view, pbr_alpha + factors.weights @ factors.basis[index, :, 0])[1:-1, 1:-1]
        assert np.abs(after - coverage).mean() < 0.03


def test_correct_alpha_hardly_changes():
    views, texels = gray_views(0.75), texels_under_quads(two_sheets(), SIZE)
    factors = refine(views[:1], np.full(len(texels), 0.5, np.float32))
    assert np.abs(factors.weights @ factors.basis[0, :, 0]).max() < 0.02


def test_the_gradient_is_that_of_the_error():
    random = np.random.default_rng(0)
    view, texels = gray_views(0.6)[1], texels_under_quads(two_sheets(), SIZE)
    fragments = view.find_fragments()
    compositing = AlphaCompositing(TrainingView(fragments, random.random((len(fragments), 15)), view.reference), len(texels))
    alpha = random.uniform(0.2, 0.8, len(texels))
    gradient, preconditioner = compositing.gradient_and_preconditioner(alpha)
    for texel in random.permutation(np.flatnonzero(preconditioner))[:12]:
        step = np.zeros(len(texels))
        step[texel] = 1e-3
        numeric = (compositing.error(alpha + step) - compositing.error(alpha - step)) / 2e-3
        assert gradient[texel] == pytest.approx(numeric, rel=0.02, abs=0.02 * float(np.abs(gradient).max()))


def test_reference_images_are_sums_of_the_renders():
    grid = DirectionGrid(4)
    radiance = np.random.default_rng(1).random((len(grid) + 1, 2, 2, 3)).astype(np.float32)
    render = ViewRender(radiance, np.ones((2, 2), np.float32), np.zeros((6, 6), np.int32), np.zeros((6, 6)))
    colors = compute_reference_image(render, low_order_lights(grid)).colors
    np.testing.assert_allclose(colors[0], np.tensordot(grid.solid_angles, radiance[:-1], 1), rtol=1e-5)
    np.testing.assert_allclose(colors[3], np.tensordot(grid.solid_angles * grid.directions[:, 2], radiance[:-1], 1), atol=1e-5)
    np.testing.assert_allclose(colors[4], radiance[-1])


def test_fragments_behind_opaque_texels_are_culled():
    texels, view = texels_under_quads(two_sheets(), SIZE), OrthographicView(np.array([0.0, 0.0, 1.0]), np.array([4.0, 4.0, 0.0]), 8, 1.0)
    fragments = find_fragments(two_sheets(), texels, view, RAYS_PER_SIDE)
    opaque = cull_hidden(fragments, np.ones(len(texels), np.float32))
    assert set(texels.quad_indices[opaque.texel_indices].ravel()) == {1} and opaque.ray_count == fragments.ray_count
    np.testing.assert_array_equal(np.diff(opaque.ray_indices) > 0, True)
    transparent = cull_hidden(fragments, np.full(len(texels), 0.5, np.float32))
    np.testing.assert_array_equal(transparent.texel_indices, fragments.texel_indices)


def test_texel_colors_are_weighted_sums_over_the_lights():
    random = np.random.default_rng(4)
    color = Factors(random.random((6, 2)).astype(np.float32), random.normal(size=(3, 2, 12)).astype(np.float32), np.ones(6, bool))
    chromaticity, lights = random.random((6, 3)).astype(np.float32), random.random((4, 5))
    by_light = (color.weights @ color.basis[1]).reshape(6, 4, 3) * chromaticity[:, None]
    expected = np.einsum("nlc,lm->nmc", by_light, lights).reshape(6, 15)
    np.testing.assert_allclose(compute_texel_colors(color, 1, chromaticity, lights), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("free_bytes", [1e9, 0.0], ids=["memory", "folder"])
def test_stored_fragments_round_trip_through_memory_and_files(free_bytes, tmp_path, monkeypatch):
    store, gray_view = ShardStore(tmp_path), gray_views(0.6)[1]
    monkeypatch.setattr(ShardStore, "read_reference", lambda *_: gray_view.reference)
    [view] = training.training_views(two_sheets(), texels_under_quads(two_sheets(), SIZE), [gray_view.view], store)
    view.cache.free_bytes = free_bytes
    expected = gray_view.load()
    view.store_fragments(view.find_fragments(), expected.colors)
    assert len(list(tmp_path.iterdir())) == (0 if free_bytes else 1)
    monkeypatch.setattr(training, "find_fragments", None)  # must not be called again
    loaded = view.load()
    assert view.max_depth_complexity() == expected.fragments.max_depth_complexity == 2
    for name in ("ray_indices", "texel_indices", "weights"):
        np.testing.assert_array_equal(getattr(loaded.fragments, name), getattr(expected.fragments, name))
    assert loaded.fragments.ray_count == expected.fragments.ray_count and loaded.reference is gray_view.reference
    np.testing.assert_array_equal(loaded.colors, expected.colors)
    training.fragment_files(store).remove_all()
    assert not list(tmp_path.iterdir())
