"""Rods on one quad get a crossing one, so that they do not disappear where it is seen edge-on; other shapes cost nothing more."""

import numpy as np
import pytest

from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.clustering.crossings import add_crossings
from farfield.addon.core.billboards.clustering.patches import Covering, Patch
from farfield.addon.core.billboards.levels import build_level
from farfield.addon.core.billboards.primitives import Primitives, find_components, from_mesh
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.geometry.directions import from_spherical
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate
from farfield.addon.core.geometry.transforms import frame_from_normal
from farfield.addon.core.imaging.raster import rasterize
from farfield.addon.core.jobs.progress import run_to_end
from shapes import box, cylinder

ERROR = 0.25


def column_covering(radius: float) -> tuple[Primitives, Covering]:
    """Return six columns of length 2 in a row along x, and one quad with the normal y for each."""
    column = cylinder(radius, 2.0, sides=16, cuts=2)
    count = len(column.triangles)
    primitives = from_mesh(concatenate([TriangleMesh(column.vertices + [x, 0.0, 0.0], column.triangles) for x in range(6)]))
    axes, patches = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), []
    for x in range(6):
        drawn, rectangle = np.arange(count) + count * x, np.array([-1.0, 1.0, x - radius, x + radius])
        patches.append(Patch(np.array([0.0, 1.0, 0.0]), 0.0, axes, rectangle, drawn, drawn))
    return primitives, Covering(patches, np.repeat(np.arange(6), count).astype(np.int32))


def no_sheets(primitives: Primitives) -> np.ndarray:
    return np.zeros(len(primitives), bool)


def measure_coverage(primitives: Primitives, covering: Covering) -> np.ndarray:
    """Return the pixels that quads cover with what they draw, over those of the source, from many sides."""
    flat = []
    for patch in covering.patches:
        corners = primitives.positions[patch.drawn]
        flat.append(corners - (corners @ patch.normal - patch.offset)[..., None] * patch.normal)
    ratios = []
    for direction in from_spherical(np.array([[1.1, azimuth] for azimuth in np.linspace(0.0, np.pi, 12)])):
        axes = frame_from_normal(direction)[:2]
        covered = [count_pixels(triangles @ axes.T) for triangles in (np.concatenate(flat), primitives.positions)]
        ratios.append(covered[0] / covered[1])
    return np.array(ratios)


def count_pixels(corners: np.ndarray) -> int:
    """Return how many pixels of 0.02 the triangles (T, 3, 2) cover."""
    pixels = [pixels for _, pixels, _ in rasterize(corners / 0.02 + 400.0, (1000, 800))]
    return len(np.unique(np.concatenate(pixels))) if pixels else 0


def test_columns_are_seen_from_everywhere():
    primitives, covering = column_covering(0.12)
    crossed = add_crossings(primitives, no_sheets(primitives), covering, ERROR)
    assert measure_coverage(primitives, covering).min() < 0.2
    assert measure_coverage(primitives, crossed).min() > 0.7  # At 45 degrees, both quads are foreshortened.
    assert len(crossed.patches) == 12 and np.array_equal(crossed.owner, covering.owner)


def test_crossing_quads_show_what_they_cross_within_the_error_and_are_not_shaded_by_it():
    primitives, covering = column_covering(0.12)
    crossed = add_crossings(primitives, no_sheets(primitives), covering, ERROR)
    for one, other in zip(crossed.patches[:6], crossed.patches[6:], strict=True):
        assert np.array_equal(one.drawn, other.drawn) and abs(one.normal @ other.normal) < 1e-9
        assert np.abs(primitives.positions[other.drawn] @ other.normal - other.offset).max() <= ERROR
        np.testing.assert_allclose(np.cross(*other.axes), other.normal, atol=1e-12)
    level = build_level(primitives, crossed, find_components(primitives), ERROR, BillboardSettings())
    assert level.joined.all() and len(level.quads) == 12
    assert len(level.quads.drawn) == 2 * len(primitives)


def test_other_shapes_get_none():
    board = from_mesh(box((2.0, 0.05, 0.3)))
    members = np.arange(len(board))
    rectangle = np.array([-1.0, 1.0, -0.15, 0.15])
    patch = Patch(np.array([0.0, 1.0, 0.0]), 0.0, np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), rectangle, members, members)
    for primitives, covering, error in (
        (board, Covering([patch], np.zeros(len(board), np.int32)), ERROR),
        (*column_covering(0.4), ERROR),
    ):
        assert add_crossings(primitives, no_sheets(primitives), covering, error).patches == covering.patches
    primitives, covering = column_covering(0.12)
    assert add_crossings(primitives, ~no_sheets(primitives), covering, ERROR).patches == covering.patches


def test_two_halves_of_a_rod_get_one_quad():
    mesh = box((0.1, 0.1, 2.0))
    primitives = from_mesh(mesh)
    side = np.sign(primitives.normals @ [1.0, 0.3, 0.1])
    frame = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    patches = []
    for half in (-1.0, 1.0):
        drawn = np.flatnonzero(side == half)
        patches.append(Patch(frame[2], 0.025 * half, frame[:2], np.array([-0.05, 0.05, -1.0, 1.0]), drawn, drawn))
    covering = Covering(patches, (side > 0.0).astype(np.int32))
    crossed = add_crossings(primitives, no_sheets(primitives), covering, 0.08)
    assert [patch.is_crossed for patch in crossed.patches] == [True, True, True]
    assert np.array_equal(crossed.patches[2].drawn, np.arange(len(primitives)))
    assert abs(crossed.patches[2].normal @ [0.0, 1.0, 0.0]) == pytest.approx(1.0)


def test_builds_have_them():
    (level,) = run_to_end(build_cloud(scaffold(), BillboardSettings(levels=1, error=0.04, solid_parts="quads"))).levels
    assert len(np.unique(level.quads.owner)) < len(level.quads)


def scaffold() -> TriangleMesh:
    """Return rods along all three axes in a cubic grid of side 2, two rods each way."""
    rods = []
    for axis in range(3):
        for first in (0, 2):
            for second in (0, 2):
                rod = box((0.08, 0.08, 2.2), cuts=2)
                rods.append(TriangleMesh(np.roll(rod.vertices + [first - 1.0, second - 1.0, 0.0], axis, axis=1), rod.triangles))
    return concatenate(rods)
