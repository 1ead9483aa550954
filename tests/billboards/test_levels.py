"""Tests of the levels: they nest, their errors double, and each needs fewer quads and texels than the finer one."""

from itertools import pairwise

import numpy as np
import pytest

from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.cloud import Cloud
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate
from farfield.addon.core.jobs.progress import Progress, run_to_end
from shapes import box, bumpy_sphere, cylinder, leaf_cards, sheet

MESHES = {
    "bumpy": bumpy_sphere(8),
    "leaves": leaf_cards(60),
    "tree": concatenate([cylinder(radius=0.1, sides=16, cuts=5), leaf_cards(60)]),
}


@pytest.fixture(scope="module", params=MESHES)
def nested(request) -> tuple[TriangleMesh, Cloud]:
    """Return a mesh and its cloud of four levels."""
    mesh = MESHES[request.param]
    return mesh, run_to_end(build_cloud(mesh, BillboardSettings(error=0.01, levels=4)))


def test_errors_and_texel_sizes_double(nested):
    _, cloud = nested
    for index, level in enumerate(cloud.levels):
        assert level.error == pytest.approx(0.01 * cloud.longest_side * 2.0**index)
        assert level.texel_size == pytest.approx(0.5 * level.error)


def test_finer_owners_have_one_coarser_owner(nested):
    _, cloud = nested
    for finer, coarser in pairwise(cloud.levels):
        owners = np.unique(np.stack([finer.quads.owner, coarser.quads.owner], axis=1), axis=0)
        assert len(owners) == len(np.unique(finer.quads.owner))


def test_coarser_levels_are_smaller(nested):
    _, cloud = nested
    for finer, coarser in pairwise(cloud.levels):
        assert len(coarser.quads) <= len(finer.quads)
        assert coarser.texel_count < finer.texel_count


def test_every_level_shows_every_face_within_its_error(nested):
    mesh, cloud = nested
    for level in cloud.levels:
        quads = level.quads
        quad = np.repeat(np.arange(len(quads)), np.diff(quads.drawn_offsets))
        heights = np.einsum("kci,ki->kc", mesh.corners[quads.drawn] - quads.centers[quad][:, None], quads.frames[quad, 2])
        assert np.abs(heights).max() <= level.error
        np.testing.assert_array_equal(np.unique(quads.drawn), np.arange(len(mesh.triangles)))
    assert cloud.uncovered_faces == 0


def test_owners_are_existing_quads(nested):
    _, cloud = nested
    for level in cloud.levels:
        assert level.quads.owner.min() >= 0 and level.quads.owner.max() < len(level.quads)
        assert len(level.cutouts) == len(level.atlas.rectangles) == len(level.joined) == len(level.solid) == len(level.quads)


@pytest.mark.parametrize("method", ["clusters", "hough", pytest.param("decimate", marks=pytest.mark.exhaustive)])
def test_level_does_not_depend_on_coarser_ones(method):
    mesh = box(cuts=2)
    settings = (BillboardSettings(method=method, error=0.08, levels=levels) for levels in (1, 2))
    single, first = (run_to_end(build_cloud(mesh, each)).levels[0] for each in settings)
    assert single.quads.centers.tobytes() == first.quads.centers.tobytes()
    assert single.quads.owner.tobytes() == first.quads.owner.tobytes()


def test_level_without_detail_is_one_quad():
    bumpy_sheet = sheet(8, lambda x, y: 0.04 * np.sin(9.0 * x) * np.cos(8.0 * y))
    cloud = run_to_end(build_cloud(bumpy_sheet, BillboardSettings(error=0.02, levels=3)))
    assert len(cloud.levels[2].quads) == 1


@pytest.mark.parametrize("method", ["clusters", "hough", pytest.param("decimate", marks=pytest.mark.exhaustive)])
def test_progress_rises_from_0_to_nearly_1(method):
    steps: list[Progress] = []
    run_to_end(build_cloud(box(cuts=2), BillboardSettings(method=method, error=0.08, levels=2)), steps.append)
    fractions = [step.fraction for step in steps]
    assert all(0.0 <= fraction <= 1.0 for fraction in fractions)
    assert fractions[0] < 0.1 and fractions[-1] >= 0.95
    assert all(step.label for step in steps)
