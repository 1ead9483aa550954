"""Moving, scaling and turning the input moves, scales and turns the output."""

import numpy as np
import pytest

from farfield.addon.core.billboards.build import build
from farfield.addon.core.billboards.cloud import Cloud
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.mesh import TriangleMesh, longest_side, merge
from farfield.addon.core.progress import finish
from shapes import box, bumpy_sphere, cards, rotation

EXACT = ("clusters", "hough")  # decimate works in single precision in places, so that its choices may differ
BUMPY = bumpy_sphere(8)


def cloud_of(mesh: TriangleMesh, **how) -> Cloud:
    return finish(build(mesh, BillboardSettings(**({"error": 0.03, "levels": 2} | how))))


def placed(mesh: TriangleMesh, scale: float = 1.0, turn: np.ndarray | None = None, offset=0.0) -> TriangleMesh:
    vertices = scale * mesh.vertices
    return TriangleMesh((vertices if turn is None else vertices @ turn.T) + offset, mesh.triangles)


@pytest.mark.parametrize("method", EXACT)
@pytest.mark.parametrize("power", [-20, 20])
def test_scaling_by_powers_of_two_scales_every_number_exactly(power, method):
    """Nothing is rounded in another way, so any difference would be a length that hides in the code."""
    scale = 2.0**power
    before, after = cloud_of(BUMPY, method=method), cloud_of(placed(BUMPY, scale), method=method)
    for small, large in zip(before.levels, after.levels, strict=True):
        assert large.error == scale * small.error and large.texel == scale * small.texel
        np.testing.assert_array_equal(large.quads.centers, scale * small.quads.centers)
        np.testing.assert_array_equal(large.quads.half_sizes, scale * small.quads.half_sizes)
        for name in ("frames", "drawn_offsets", "drawn", "owner"):
            np.testing.assert_array_equal(getattr(large.quads, name), getattr(small.quads, name))
        np.testing.assert_array_equal(large.atlas.rectangles, small.atlas.rectangles)
    assert after.max_plane_distance == before.max_plane_distance


@pytest.mark.parametrize("method", EXACT)
def test_moving_by_whole_numbers_moves_every_number_exactly(method):
    offset = np.array([1000.0, -7.0, 64.0])
    before, after = cloud_of(BUMPY, method=method), cloud_of(placed(BUMPY, offset=offset), method=method)
    for here, there in zip(before.levels, after.levels, strict=True):
        np.testing.assert_allclose(there.quads.centers, here.quads.centers + offset, atol=1e-12)
        for name in ("frames", "half_sizes", "drawn", "owner"):
            np.testing.assert_array_equal(getattr(there.quads, name), getattr(here.quads, name))


@pytest.mark.parametrize("method", ["clusters", "hough", "decimate"])
@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_tiny_and_enormous_units_change_little(unit, method):
    how = {"method": method, "error": 0.1, "levels": 1}
    mesh = box(cuts=1) if method == "decimate" else BUMPY  # decimate takes long over what is not flat
    before, after = cloud_of(mesh, **how), cloud_of(placed(mesh, unit, offset=unit * np.array([3.0, -2.0, 1.0])), **how)
    assert after.longest_side == pytest.approx(unit * before.longest_side)
    assert len(after.levels[0].quads) == pytest.approx(len(before.levels[0].quads), rel=0.15)
    assert after.levels[0].texels == pytest.approx(before.levels[0].texels, rel=0.1)
    assert after.max_plane_distance <= 1.0 and after.uncovered_faces == 0


@pytest.mark.parametrize("seed", range(3))
def test_a_turned_box_has_turned_faces(seed):
    turn = rotation(seed)
    mesh = placed(box((1.0, 2.0, 3.0)), turn=turn, offset=[4.0, 5.0, 6.0])
    quads = cloud_of(mesh, error=0.02, levels=1).levels[0].quads
    assert len(quads) == 6
    local = (quads.centers - [4.0, 5.0, 6.0]) @ turn / [0.5, 1.0, 1.5]
    np.testing.assert_allclose(local, quads.frames[:, 2] @ turn, atol=1e-9)
    np.testing.assert_allclose(np.sort(np.abs(local), axis=1), np.tile([0.0, 0.0, 1.0], (6, 1)), atol=1e-9)


@pytest.mark.parametrize("mesh", [BUMPY, merge([BUMPY, placed(cards(60), 1.5)])], ids=["bumpy", "with leaves"])
def test_turning_changes_little(mesh):
    """The error is asked for as the same length, since the bounding box does not turn along."""
    turned = placed(mesh, turn=rotation(1))
    share = 0.03 * longest_side(mesh.vertices) / longest_side(turned.vertices)
    before, after = cloud_of(mesh), cloud_of(turned, error=share)
    for here, there in zip(before.levels, after.levels, strict=True):
        assert there.error == pytest.approx(here.error)
        assert len(there.quads) == pytest.approx(len(here.quads), rel=0.25)
        assert there.texels == pytest.approx(here.texels, rel=0.1)


def test_renumbering_faces_changes_little():
    order = np.random.default_rng(0).permutation(len(BUMPY.triangles))
    before, after = cloud_of(BUMPY, levels=1), cloud_of(TriangleMesh(BUMPY.vertices, BUMPY.triangles[order]), levels=1)
    assert len(after.levels[0].quads) == pytest.approx(len(before.levels[0].quads), rel=0.15)
    assert after.levels[0].texels == pytest.approx(before.levels[0].texels, rel=0.1)
