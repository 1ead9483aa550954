"""Planes of quads pass through most of the area that they show, and stay within the error of all of it."""

import numpy as np
import pytest

from farfield.addon.core.billboards.clustering.patches import Patch
from farfield.addon.core.billboards.clustering.planes import PlaneBounds, fit_planes
from farfield.addon.core.billboards.clustering.rectangles import fit_rectangle
from farfield.addon.core.billboards.clustering.refits import refit_planes
from farfield.addon.core.billboards.primitives import Primitives, from_mesh
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.geometry.transforms import frame_from_normal

BOUNDS = PlaneBounds(0.1, 0.5)
DROP = 0.1  # Of the bevel below the roof.


def beveled_roof(angle: float = 0.0) -> Primitives:
    """A flat roof from x = -1 to 1 with a bevel along x = 1, as four triangles, turned about the y axis by `angle`."""
    points = np.array([[x, y, z] for x, z in ((-1.0, 0.0), (1.0, 0.0), (1.1, -DROP)) for y in (-1.0, 1.0)])
    turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    return from_mesh(TriangleMesh(points @ turn.T, np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]], np.int32)))


def minimax_patch(primitives: Primitives) -> Patch:
    """A patch in the minimax plane of all primitives."""
    everything = np.arange(len(primitives))
    planes = fit_planes(primitives, [everything])
    normal = planes.normals[0]
    axes, rectangle = fit_rectangle(primitives.points, frame_from_normal(normal)[:2])
    return Patch(normal, float(planes.offsets[0]), axes, rectangle, everything, everything)


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_plane_moves_to_the_roof_and_keeps_the_bevel_within_the_error(angle):
    primitives = beveled_roof(angle)
    patch = minimax_patch(primitives)
    (refitted,) = refit_planes(primitives, [patch], BOUNDS)
    roof, everything = primitives.points[:4], primitives.points

    def farthest(of: Patch, points: np.ndarray) -> float:
        return float(np.abs(points @ of.normal - of.offset).max())

    assert farthest(patch, roof) > 0.04
    assert farthest(refitted, roof) < 1e-2
    assert farthest(refitted, everything) <= BOUNDS.error * (1.0 + 1e-6)
    np.testing.assert_array_equal(refitted.drawn, patch.drawn)
    np.testing.assert_allclose(
        np.vstack([refitted.axes, refitted.normal]) @ np.vstack([refitted.axes, refitted.normal]).T, np.eye(3), atol=1e-9
    )
    local = everything @ refitted.axes.T
    low, high = refitted.rectangle[0::2], refitted.rectangle[1::2]
    assert (local >= low - 1e-9).all() and (local <= high + 1e-9).all()


def test_a_flat_patch_stays_where_it_is():
    primitives = beveled_roof()
    flat = primitives.subset(np.array([0, 1]))
    patch = minimax_patch(flat)
    (refitted,) = refit_planes(flat, [patch], BOUNDS)
    np.testing.assert_allclose(refitted.normal, patch.normal, atol=1e-9)
    assert refitted.offset == pytest.approx(patch.offset, abs=1e-9)


def test_normals_within_the_bounds_stay_so():
    primitives = beveled_roof()
    patch = minimax_patch(primitives)
    bounds = PlaneBounds(0.1, float(primitives.normals[2] @ patch.normal) - 1e-6)  # The bevel is at the limit.
    (refitted,) = refit_planes(primitives, [patch], bounds)
    assert (primitives.normals @ refitted.normal >= bounds.min_cosine - 1e-6).all()
