"""Features of analyzed meshes as colors and as plots."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.bridge.overlays.face_overlay import spread_colors
from farfield.addon.bridge.texmesh.level_sets import FIGURES, level_sets_in
from farfield.addon.bridge.texmesh.scale_attributes import SCALE_ATTRIBUTE, read_scales
from farfield.addon.operators.texmesh.overlays import overlay
from textured_scenes import textured_ball

pytestmark = pytest.mark.usefixtures("empty_scene")
SMALL = {"levels": "number", "number": 3, "views": 2, "max_image": 64, "vertices": "original"}


@pytest.fixture
def ball() -> bpy.types.Object:
    """A ball whose vertices have the scales 0 to 20, as after an analysis."""
    item = textured_ball(8, "Ball")
    scales = np.arange(len(item.data.vertices), dtype=np.int32) % 21
    item.data.attributes.new(SCALE_ATTRIBUTE, "INT", "POINT").data.foreach_set("value", scales)
    yield item
    overlay.hide()


def test_it_shows_and_hides(ball):
    assert bpy.ops.farfield.texmesh_overlay() == {"FINISHED"} and overlay.is_shown
    assert bpy.ops.farfield.texmesh_overlay() == {"FINISHED"} and not overlay.is_shown


def test_corners_have_the_colors_of_their_vertices(ball):
    bpy.context.scene.farfield_texmesh_inspection.lowest_scale = 7
    found = overlay.read_colors(ball)
    mesh = ball.data
    mesh.calc_loop_triangles()
    scales = read_scales(mesh)[np.array([triangle.vertices[:] for triangle in mesh.loop_triangles])]
    assert found.corners.shape == (len(scales), 3, 3) and found.colors.shape == (len(scales), 3, 4)
    assert np.array_equal(found.colors[..., 3] > 0.0, scales >= 7)
    for scale in (7, 12, 20):
        assert len(np.unique(found.colors[scales == scale], axis=0)) == 1


def test_another_lowest_scale_has_another_key(ball):
    group = bpy.context.scene.farfield_texmesh_inspection
    first = overlay.find_key(ball)
    group.lowest_scale = 9
    assert overlay.find_key(ball) != first is not None


def test_meshes_without_scales_have_no_colors(ball):
    bpy.ops.mesh.primitive_cube_add()
    assert overlay.find_key(bpy.context.object) is None
    bpy.data.objects.remove(ball)
    with pytest.raises(RuntimeError, match="Analyze a mesh first"):
        bpy.ops.farfield.texmesh_overlay()


@pytest.mark.slow
def test_levels_can_be_shown_without_an_analysis_of_the_original(ball):
    ball.data.attributes.remove(ball.data.attributes[SCALE_ATTRIBUTE])
    bpy.ops.farfield.texmesh_levels(**SMALL)
    (levels,) = level_sets_in(bpy.context.scene)
    assert overlay.find_key(ball) is None and all(overlay.read_colors(level) is not None for level in levels.levels)


def test_edit_mode_is_survived(ball):
    bpy.ops.object.mode_set(mode="EDIT")
    assert overlay.read_colors(ball) is None
    bpy.ops.object.mode_set(mode="OBJECT")
    assert overlay.read_colors(ball) is not None


def test_colors_of_faces_are_spread_to_their_corners():
    colors = spread_colors(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert colors.shape == (6, 4) and (colors[:3] == colors[0]).all() and colors.dtype == np.float32
    own = np.random.default_rng(0).random((2, 3, 4)).astype(np.float32)
    assert np.array_equal(spread_colors(own), own.reshape(6, 4))


@pytest.mark.slow
def test_levels_have_a_plot_with_three_charts(ball):
    bpy.ops.farfield.texmesh_levels(**SMALL)
    (levels,) = level_sets_in(bpy.context.scene)
    bpy.context.view_layer.objects.active = levels.levels[0]
    for _ in range(2):
        assert bpy.ops.farfield.texmesh_plot() == {"FINISHED"}
    names = [image.name for image in bpy.data.images if "Plot" in image.name]
    assert names == ["Ball Scale Plot"]
    image = bpy.data.images["Ball Scale Plot"]
    pixels = read_pixels(image)
    assert tuple(image.size) == (720, 1260) and (pixels[..., 3] == 1.0).all()
    for chart in np.split(pixels[..., :3], 3):
        assert (np.abs(chart - [0.80, 0.25, 0.15]).max(axis=2) < 0.01).sum() > 50, "a line"
    levels.collection[FIGURES] = "{"
    with pytest.raises(RuntimeError, match="make the levels again"):
        bpy.ops.farfield.texmesh_plot()


def test_an_analyzed_mesh_has_a_plot_of_its_features(ball):
    assert bpy.ops.farfield.texmesh_plot() == {"FINISHED"}
    assert tuple(bpy.data.images["Ball Scale Plot"].size) == (720, 420)


def test_editors_show_the_former_plot_after_undo_and_the_new_one_after_redo(ball):
    bpy.context.preferences.edit.use_global_undo = True
    area = bpy.context.window_manager.windows[0].screen.areas[0]
    area.ui_type = "IMAGE_EDITOR"
    shown = []
    for _ in range(2):
        bpy.ops.ed.undo_push(message="Before")
        bpy.ops.farfield.texmesh_plot()
        bpy.ops.ed.undo_push(message="Plot")
        area.spaces.active.image = bpy.data.images["Ball Scale Plot"]
        shown.append(area.spaces.active.image.session_uid)
    bpy.ops.ed.undo()
    assert area.spaces.active.image.session_uid == shown[0]
    bpy.ops.ed.redo()
    assert area.spaces.active.image.session_uid == shown[1]


def test_others_have_none():
    bpy.ops.mesh.primitive_cube_add()
    with pytest.raises(RuntimeError, match="Select an object with levels"):
        bpy.ops.farfield.texmesh_plot()
