"""What matters: from directions, as in the paper, and from cameras with what hides what."""

import numpy as np
import pytest

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.unwrap.importance import from_direction, from_look, from_pixels
from farfield.addon.core.unwrap.visibility import Shot, shown_pixels
from shapes import sheet, sphere

NORMALS = np.array([[0.0, 0, 1], [0, 0, -1], [1, 0, 0.1], [1, 0, -0.1]])
ABOVE = np.array([0.0, 0.0, 3.0])


def orthographic(half=1.0, size=(200, 200)):
    """From far above, looking down on x and y from -half to half; depths from z = 10 to z = -10."""
    projection = np.diag([1.0 / half, 1.0 / half, -0.1, 1.0])
    return Shot(projection, size)


def test_what_faces_a_direction_matters():
    assert from_direction(NORMALS, ABOVE).tolist() == [1, 0, 1, 0]


@pytest.mark.parametrize("kind", [from_direction, lambda normals, direction: from_look(normals, direction, 4.0)])
@pytest.mark.parametrize("direction", [(0.0, 0.0, 0.0), (np.nan, 0.0, 1.0), (np.inf, 0.0, 0.0)])
def test_a_direction_without_length_is_refused(kind, direction):
    with pytest.raises(SettingsError, match="no length"):
        kind(NORMALS, np.array(direction))


def test_the_papers_weights():
    k = 1.2
    ratio = np.sqrt((k + 1.0) / (k - 1.0))
    towards = np.linspace(-1.0, 1.0, 9)
    normals = np.column_stack([np.sqrt(1.0 - towards**2), 0.0 * towards, towards])
    weights = ratio ** (2.0 * from_look(normals, ABOVE, ratio))
    by_paper = 1.0 / (-towards + k)  # V looks down on the surface
    assert weights / weights[0] == pytest.approx(by_paper / by_paper[0])


def test_a_sheet_shows_as_many_pixels_as_it_covers():
    mesh = sheet(6)
    half = 2.0 * np.abs(mesh.vertices[:, :2]).max()
    pixels = shown_pixels(mesh, orthographic(half))
    areas, _ = face_areas_and_normals(mesh.corners)
    assert pixels == pytest.approx(areas * (100.0 / half) ** 2)


def test_what_is_hidden_shows_no_pixels():
    mesh = sphere(24)
    pixels = shown_pixels(mesh, orthographic(1.5, (600, 600)))
    height = mesh.corners.mean(axis=1)[:, 2]
    assert (pixels[height > 0.3] > 0.0).all()
    assert pixels[height < -0.1].max() == 0.0
    assert pixels.sum() == pytest.approx(np.pi * 200.0**2, rel=0.03)


def test_what_stands_before_a_surface_hides_it():
    mesh, shot = sheet(10), orthographic(2.0, (400, 400))
    open_to = shown_pixels(mesh, shot)
    screen = TriangleMesh(mesh.vertices * [0.5, 1.0, 1.0] + [0.0, 0.0, 1.0], mesh.triangles)
    behind = shown_pixels(mesh, shot, [screen])
    covered = mesh.corners[:, :, 0].max(axis=1) < 0.49
    assert behind[covered].max() == 0.0
    beside = mesh.corners[:, :, 0].min(axis=1) > 0.51
    assert np.array_equal(behind[beside], open_to[beside])
    below = TriangleMesh(screen.vertices - [0.0, 0.0, 2.0], mesh.triangles)
    assert np.array_equal(shown_pixels(mesh, shot, [below]), open_to)


def test_what_lies_behind_or_beside_the_camera_shows_no_pixels():
    mesh = sheet(4)
    shot = orthographic(1e-3)
    assert shown_pixels(TriangleMesh(mesh.vertices + [50.0, 0, 0], mesh.triangles), shot).max() == 0.0
    assert shown_pixels(TriangleMesh(mesh.vertices + [0, 0, 20.0], mesh.triangles), orthographic(5.0)).max() == 0.0


def test_texels_follow_pixels_within_a_factor():
    areas = np.ones(6)
    importance = from_pixels(np.array([100.0, 100.0, 50.0, 25.0, 1.0, 0.0]), areas, 4.0)
    assert 4.0**importance == pytest.approx([4.0, 4.0, 2.0, 1.0, 1.0, 1.0])
    assert from_pixels(np.zeros(6), areas, 4.0).max() == 0.0
