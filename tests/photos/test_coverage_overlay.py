"""The operator Show Photo Coverage: its message, and that its overlay never shows what is no longer true."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.photos.camera_objects import create_cameras
from farfield.addon.bridge.photos.coverage_overlay import overlay
from farfield.addon.bridge.unwrap.stretch_display import overlay as stretch_overlay
from image_data import write_image
from photo_scenes import camera_at, grid

pytestmark = pytest.mark.usefixtures("empty_scene", "coarse_packing")


@pytest.fixture
def wall(tmp_path):
    """A selected square, moved along x, and a gray photograph of it from above."""
    camera = camera_at((0.0, 0.0, 3.5), name="above.png")
    write_image(tmp_path / camera.name, np.full((240, 300, 3), 0.5, np.float32))
    mesh, _ = grid(5)
    data = bpy.data.meshes.new("Wall")
    data.from_pydata((mesh.vertices - [1.0, 0.0, 0.0]).tolist(), [], mesh.triangles.tolist())
    item = bpy.data.objects.new("Wall", data)
    bpy.context.collection.objects.link(item)
    item.location.x = 1.0
    create_cameras([camera], tmp_path, "Cameras", bpy.context.scene, is_y_up=False)
    item.select_set(True)
    bpy.context.view_layer.update()
    yield item
    overlay.hide()


def toggle():
    return bpy.ops.farfield.photos_show_coverage()


def test_it_shows_and_hides_and_leaves_the_mesh_alone(wall, capfd):
    attributes = list(wall.data.attributes.keys())
    assert toggle() == {"FINISHED"} and overlay.is_shown
    assert "100% of the surface is shown, 0% lies between photographs, 0% has" in capfd.readouterr().out
    assert list(wall.data.attributes.keys()) == attributes and not bpy.data.images["above.png"].has_data
    colors = overlay.read_colors(wall)
    assert colors.is_world and colors.corners.shape == (50, 3, 3) and len(np.unique(colors.colors, axis=0)) == 1
    assert colors.corners[..., 0].min() == pytest.approx(-1.0, abs=0.01)  # in world space
    assert toggle() == {"FINISHED"} and not overlay.is_shown and overlay.find_key(wall) is None


def test_what_no_camera_shows_is_reported(wall, capfd):
    wall.location.x = 50.0
    bpy.context.view_layer.update()
    toggle()
    assert "0% of the surface is shown, 0% lies between photographs, 100% has" in capfd.readouterr().out


@pytest.mark.parametrize("change", ["mesh", "object", "camera", "parent"])
def test_changes_hide_it(wall, change):
    toggle()
    camera = next(item for item in bpy.data.objects if item.type == "CAMERA")
    if change == "mesh":
        wall.data.vertices[0].co.z += 1.0
        wall.data.update()
    else:
        {"object": wall, "camera": camera, "parent": camera.parent}[change].location.z += 0.5
    bpy.context.view_layer.update()
    assert not overlay.is_shown


def test_changes_of_others_do_not_hide_it(wall):
    other = bpy.data.objects.new("Other", bpy.data.meshes.new("Other"))
    bpy.context.collection.objects.link(other)
    bpy.context.view_layer.update()
    toggle()
    other.location.x = 2.0
    wall.select_set(False)
    bpy.context.view_layer.update()
    assert overlay.is_shown


def test_undo_and_other_files_hide_it(wall):
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    bpy.context.scene.frame_end = 100
    bpy.ops.ed.undo_push(message="after")
    toggle()
    bpy.ops.ed.undo()
    assert not overlay.is_shown
    toggle()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert not overlay.is_shown


def test_only_one_overlay_of_faces_is_shown(wall):
    toggle()
    stretch_overlay.show()
    assert stretch_overlay.is_shown and not overlay.is_shown
    toggle()
    assert overlay.is_shown and not stretch_overlay.is_shown
    overlay.hide()
    lists = bpy.app.handlers
    assert not any("face_overlay" in each.__module__ for each in (*lists.depsgraph_update_post, *lists.undo_post, *lists.load_pre))


def test_it_says_what_is_missing(wall):
    wall.select_set(False)
    with pytest.raises(RuntimeError, match="Select a mesh object"):
        toggle()
