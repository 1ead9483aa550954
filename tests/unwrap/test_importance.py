"""Importance: from directions, as in the paper, and from cameras with occlusion."""

import numpy as np
import pytest

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.geometry.cameras import CameraProjection
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.unwrap.importance import from_direction, from_direction_gradual, from_visible_pixels
from farfield.addon.core.unwrap.visibility import visible_pixel_areas
from shapes import sheet, sphere

NORMALS = np.array([[0.0, 0, 1], [0, 0, -1], [1, 0, 0.1], [1, 0, -0.1]])
ABOVE = np.array([0.0, 0.0, 3.0])


def orthographic(half_size=1.0, size=(200, 200)):
    """A camera from above that shows x and y from -half_size to half_size, and z from 10 (near) to -10."""
    projection = np.diag([1.0 / half_size, 1.0 / half_size, -0.1, 1.0])
    return CameraProjection(projection, size)


def test_faces_towards_the_direction_are_important():
    assert from_direction(NORMALS, ABOVE).tolist() == [1, 0, 1, 0]


@pytest.mark.parametrize("function", [from_direction, lambda normals, direction: from_direction_gradual(normals, direction, 4.0)])
@pytest.mark.parametrize("direction", [(0.0, 0.0, 0.0), (np.nan, 0.0, 1.0), (np.inf, 0.0, 0.0)])
def test_a_direction_without_length_is_an_error(function, direction):
    with pytest.raises(SettingsError, match="no length"):
        function(NORMALS, np.array(direction))


def test_gradual_importance_gives_the_weights_of_the_paper():
    k = 1.2
    ratio = np.sqrt((k + 1.0) / (k - 1.0))
    cosines = np.linspace(-1.0, 1.0, 9)
    normals = np.column_stack([np.sqrt(1.0 - cosines**2), 0.0 * cosines, cosines])
    weights = ratio ** (2.0 * from_direction_gradual(normals, ABOVE, ratio))
    expected = 1.0 / (-cosines + k)  # V points from the viewer to the surface
    assert weights / weights[0] == pytest.approx(expected / expected[0])


def test_an_unoccluded_sheet_shows_its_area_in_pixels():
    mesh = sheet(6)
    half_size = 2.0 * np.abs(mesh.vertices[:, :2]).max()
    pixel_areas = visible_pixel_areas(mesh, orthographic(half_size))
    areas, _ = face_areas_and_normals(mesh.corners)
    assert pixel_areas == pytest.approx(areas * (100.0 / half_size) ** 2)


def test_the_back_of_a_sphere_is_hidden():
    mesh = sphere(24)
    pixel_areas = visible_pixel_areas(mesh, orthographic(1.5, (600, 600)))
    height = mesh.corners.mean(axis=1)[:, 2]
    assert (pixel_areas[height > 0.3] > 0.0).all()
    assert pixel_areas[height < -0.1].max() == 0.0
    assert pixel_areas.sum() == pytest.approx(np.pi * 200.0**2, rel=0.03)


def test_occluders_hide_the_surface_behind_them():
    mesh, camera = sheet(10), orthographic(2.0, (400, 400))
    unoccluded = visible_pixel_areas(mesh, camera)
    screen = TriangleMesh(mesh.vertices * [0.5, 1.0, 1.0] + [0.0, 0.0, 1.0], mesh.triangles)
    occluded = visible_pixel_areas(mesh, camera, [screen])
    is_behind = mesh.corners[:, :, 0].max(axis=1) < 0.49
    assert occluded[is_behind].max() == 0.0
    is_beside = mesh.corners[:, :, 0].min(axis=1) > 0.51
    assert np.array_equal(occluded[is_beside], unoccluded[is_beside])
    below = TriangleMesh(screen.vertices - [0.0, 0.0, 2.0], mesh.triangles)
    assert np.array_equal(visible_pixel_areas(mesh, camera, [below]), unoccluded)


def test_surfaces_outside_the_view_show_no_pixels():
    mesh = sheet(4)
    outside, behind = TriangleMesh(mesh.vertices + [50.0, 0, 0], mesh.triangles), TriangleMesh(mesh.vertices + [0, 0, 20.0], mesh.triangles)
    assert visible_pixel_areas(outside, orthographic(1e-3)).max() == 0.0
    assert visible_pixel_areas(behind, orthographic(5.0)).max() == 0.0


def test_texel_density_follows_pixel_density_within_the_ratio():
    areas = np.ones(6)
    importance = from_visible_pixels(np.array([100.0, 100.0, 50.0, 25.0, 1.0, 0.0]), areas, 4.0)
    assert 4.0**importance == pytest.approx([4.0, 4.0, 2.0, 1.0, 1.0, 1.0])
    assert from_visible_pixels(np.zeros(6), areas, 4.0).max() == 0.0
