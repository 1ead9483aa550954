"""Levels nest, their errors double, and each takes less than the one below."""

from itertools import pairwise

import numpy as np
import pytest

from farfield.addon.core.billboards.build import build
from farfield.addon.core.billboards.cloud import Cloud
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.mesh import TriangleMesh, merge
from farfield.addon.core.progress import Progress, finish
from shapes import box, bumpy_sphere, cards, cylinder, sheet

MESHES = {
    "bumpy": bumpy_sphere(),
    "leaves": cards(100),
    "tree": merge([cylinder(radius=0.1, sides=16, cuts=5), cards(60)]),
}


@pytest.fixture(scope="module", params=MESHES)
def nested(request) -> tuple[TriangleMesh, Cloud]:
    """A mesh and its cloud of four levels."""
    mesh = MESHES[request.param]
    return mesh, finish(build(mesh, BillboardSettings(error=0.01, levels=4)))


def test_errors_and_texels_double(nested):
    _, cloud = nested
    for level, place in zip(cloud.levels, range(4), strict=True):
        assert level.error == pytest.approx(0.01 * cloud.longest_side * 2.0**place)
        assert level.texel == pytest.approx(0.5 * level.error)


def test_each_finer_owner_has_one_coarser_owner(nested):
    _, cloud = nested
    for finer, coarser in pairwise(cloud.levels):
        owners = np.unique(np.stack([finer.quads.owner, coarser.quads.owner], axis=1), axis=0)
        assert len(owners) == len(np.unique(finer.quads.owner))


def test_coarser_levels_take_less(nested):
    _, cloud = nested
    for finer, coarser in pairwise(cloud.levels):
        assert len(coarser.quads) <= len(finer.quads)
        assert coarser.texels < finer.texels


def test_every_level_shows_every_face_within_its_own_error(nested):
    mesh, cloud = nested
    for level in cloud.levels:
        quads = level.quads
        quad = np.repeat(np.arange(len(quads)), np.diff(quads.drawn_offsets))
        gaps = np.einsum("kci,ki->kc", mesh.corners[quads.drawn] - quads.centers[quad][:, None], quads.frames[quad, 2])
        assert np.abs(gaps).max() <= level.error
        np.testing.assert_array_equal(np.unique(quads.drawn), np.arange(len(mesh.triangles)))
    assert cloud.uncovered_faces == 0


def test_owners_are_quads_that_stand(nested):
    _, cloud = nested
    for level in cloud.levels:
        assert level.quads.owner.min() >= 0 and level.quads.owner.max() < len(level.quads)
        assert len(level.cutouts) == len(level.atlas.rectangles) == len(level.joined) == len(level.solid) == len(level.quads)


@pytest.mark.parametrize("method", ["clusters", "hough", "decimate"])
def test_a_level_is_the_same_however_many_stand_above_it(method):
    mesh = box(cuts=2)
    alone, among = (finish(build(mesh, BillboardSettings(method=method, error=0.08, levels=levels))).levels[0] for levels in (1, 2))
    assert alone.quads.centers.tobytes() == among.quads.centers.tobytes()
    assert alone.quads.owner.tobytes() == among.quads.owner.tobytes()


def test_a_level_too_coarse_for_detail_is_one_quad():
    relief = sheet(8, lambda x, y: 0.04 * np.sin(9.0 * x) * np.cos(8.0 * y))
    cloud = finish(build(relief, BillboardSettings(error=0.02, levels=3)))
    assert len(cloud.levels[2].quads) == 1


@pytest.mark.parametrize("method", ["clusters", "hough", "decimate"])
def test_progress_rises_from_nothing_to_nearly_all(method):
    steps: list[Progress] = []
    finish(build(box(cuts=2), BillboardSettings(method=method, error=0.08, levels=2)), steps.append)
    fractions = [step.fraction for step in steps]
    assert all(0.0 <= fraction <= 1.0 for fraction in fractions)
    assert fractions[0] < 0.1 and fractions[-1] >= 0.95
    assert all(step.label for step in steps)
