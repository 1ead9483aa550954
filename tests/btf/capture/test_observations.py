"""Texels lie on their quads, and observations sample only the texels' own surfaces."""

import numpy as np
import pytest

from farfield.addon.core.billboards.texels import QuadPolygons, Texels, texels_under_quads
from farfield.addon.core.btf.capture import observations
from farfield.addon.core.btf.capture.observations import ID_BUFFER_SCALE, Observation, QuadFaceTable, ViewRender, observe
from farfield.addon.core.geometry.cameras import OrthographicView
from image_data import pixel_of

SIZE = (16, 16)
COLOR = (0.2, 0.4, 0.6)


def square(height: float = 0.0, low: int = 4, high: int = 12) -> QuadPolygons:
    """Return one quad over the texels low..high, with texels of unit size, at z = `height`."""
    corners = np.array([[low, low], [high, low], [high, high], [low, high]], float)
    return QuadPolygons([np.column_stack([corners, np.full(4, height)])], [corners])


def top_view(resolution: int = 16) -> OrthographicView:
    return OrthographicView(np.array([0.0, 0.0, 1.0]), np.array([8.0, 8.0, 0.0]), resolution, 16.0 / resolution)


def render_faces(faces: np.ndarray, height: float = 0.0) -> ViewRender:
    """Return the render of flat `faces` (H, W), -1 for none, at z = `height`."""
    covered = faces >= 0
    radiance = covered[None, ..., None] * np.array(COLOR, np.float32)
    face_ids = np.kron(faces, np.ones((ID_BUFFER_SCALE, ID_BUFFER_SCALE))).astype(np.int32)
    return ViewRender(radiance.astype(np.float32), covered.astype(np.float32), face_ids, np.where(face_ids >= 0, height, -np.inf))


def observe_square(render: ViewRender, texels: Texels | None = None) -> Observation:
    """Observe the square, which shows face 0, with an error of 0.5."""
    texels = texels_under_quads(square(), SIZE) if texels is None else texels
    return observe(texels, top_view(), render, QuadFaceTable(np.array([0, 1]), np.array([0]), 9), 0.5)


def test_texel_positions_match_their_pixels():
    texels = texels_under_quads(square(3.0), SIZE)
    np.testing.assert_allclose(texels.positions, np.column_stack([texels.pixels + 0.5, np.full(len(texels), 3.0)]), atol=1e-9)
    assert len(texels) >= 64
    assert len(np.unique(texels.pixels, axis=0)) == len(texels)


def test_texels_of_a_tilted_quad_are_on_its_plane():
    flat = square()
    tilted = flat.corners[0] @ np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [-0.8, 0.0, 0.6]])
    texels = texels_under_quads(QuadPolygons([tilted], flat.texel_coordinates), SIZE)
    normal = np.cross(tilted[1] - tilted[0], tilted[2] - tilted[0])
    assert np.abs((texels.positions - tilted[0]) @ normal).max() < 1e-9


@pytest.mark.parametrize("direction", [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
def test_the_frame_of_a_view_is_right_handed(direction):
    view = OrthographicView(np.array(direction), np.zeros(3), 8, 1.0)
    frame = np.stack([view.right, view.up, view.direction])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    np.testing.assert_allclose(view.project(np.zeros((1, 3)))[0], [[4.0, 4.0]])


def test_a_texel_takes_the_color_of_its_own_surface():
    observation = observe_square(render_faces(np.zeros((16, 16))))
    assert observation.known.all()
    np.testing.assert_allclose(observation.coverage, 1.0)
    np.testing.assert_allclose(observation.radiance, np.broadcast_to(COLOR, observation.radiance.shape), rtol=1e-6)


def test_texels_without_a_surface_are_known_and_empty():
    observation = observe_square(render_faces(np.full((16, 16), -1)))
    assert observation.known.all() and len(observation.visible) == 0
    assert (observation.coverage == 0.0).all()


@pytest.mark.parametrize(("height", "is_known"), [(5.0, False), (-5.0, True)], ids=["in front", "behind"])
def test_another_surface_hides_only_texels_behind_it(height, is_known):
    observation = observe_square(render_faces(np.full((16, 16), 7), height))
    assert (observation.known == is_known).all()
    assert len(observation.visible) == 0
    assert (observation.coverage == 0.0).all()


def test_colors_do_not_bleed_across_the_boundary_of_two_surfaces():
    faces = np.zeros((16, 16))
    faces[:, 8:] = 7
    render = render_faces(faces, 5.0)
    render.radiance[0, :, 8:] = 99.0
    texels = texels_under_quads(square(), SIZE)
    observation = observe_square(render, texels)
    assert observation.radiance.max() < 1.0
    left = texels.pixels[:, 0] < 8
    assert observation.known[left].all() and not observation.known[~left].any()


def test_coverage_is_the_covered_fraction_of_a_texel():
    """The edge divides the texels at x = 8: a third of each is covered, and its color is that of the surface alone."""
    render = render_faces(np.zeros((16, 16)))
    render.face_ids[:, 25:] = -1
    texels = texels_under_quads(square(), SIZE)
    observation = observe_square(render, texels)
    edge = texels.pixels[:, 0] == 8
    np.testing.assert_allclose(observation.coverage[edge], 1.0 / 3.0, rtol=1e-6)
    np.testing.assert_array_equal(observation.subsample_counts, np.where(edge, 3, 9)[observation.visible])
    np.testing.assert_allclose(observation.radiance[0], np.broadcast_to(COLOR, observation.radiance[0].shape), rtol=1e-6)


def test_antialiased_colors_are_unpremultiplied():
    opaque = render_faces(np.zeros((16, 16)))
    observation = observe_square(ViewRender(0.5 * opaque.radiance, 0.5 * opaque.coverage, opaque.face_ids, opaque.heights))
    np.testing.assert_allclose(observation.radiance[0], np.broadcast_to(COLOR, observation.radiance[0].shape), rtol=1e-6)


def test_pixels_of_a_side_view():
    view = OrthographicView(np.array([1.0, 0.0, 0.0]), np.array([8.0, 8.0, 0.0]), 16, 1.0)
    rows, columns = pixel_of(view, np.array([[0.0, 9.5, 2.5], [5.0, 100.0, 0.0]]))
    np.testing.assert_array_equal(rows, [10, 8])
    np.testing.assert_array_equal(columns, [9, 15])


@pytest.mark.parametrize("max_bytes", [0, 10**8], ids=["sorted keys", "table"])
def test_quad_face_table_contains_exactly_the_shown_faces(max_bytes, monkeypatch):
    """Also for faces in an image that no quad shows, beyond the last shown face."""
    monkeypatch.setattr(observations, "MAX_TABLE_BYTES", max_bytes)
    shown_faces = [[0, 3], [1], [], [2, 3, 4]]
    table = QuadFaceTable(np.cumsum([0, *map(len, shown_faces)]), np.concatenate(shown_faces).astype(np.int64), 5)
    quads, faces = (indices.ravel() for indices in np.meshgrid(np.arange(4), np.arange(-1, 12), indexing="ij"))
    expected = [face in shown_faces[quad] for quad, face in zip(quads, faces, strict=True)]
    np.testing.assert_array_equal(table.contains(quads, faces), expected)
