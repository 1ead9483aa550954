"""Imports of cameras: what the file browser names, and overlays, only for selected meshes and for photographs that exist."""

import json

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.core.photos.importers import READERS
from farfield.addon.operators.photos.import_cameras import CAMERA_FILES
from image_data import write_image
from photo_scenes import grid

pytestmark = pytest.mark.usefixtures("empty_scene")
SIZE = (60, 40)
NAMES = ["0.png Overlay", "1.png Overlay"]


@pytest.fixture
def project(tmp_path):
    """Two white photographs from above the square of `grid`, and the file with their cameras."""
    (tmp_path / "images").mkdir()
    frames = []
    for index in range(2):
        write_image(tmp_path / "images" / f"{index}.png", np.ones((SIZE[1], SIZE[0], 3), np.float32))
        matrix = np.eye(4)
        matrix[:3, 3] = (0.1 * index, 0.0, 4.0)
        frames.append({"file_path": f"images/{index}.png", "transform_matrix": matrix.tolist()})
    lens = {"w": SIZE[0], "h": SIZE[1], "fl_x": 50.0, "fl_y": 50.0, "cx": 0.5 * SIZE[0], "cy": 0.5 * SIZE[1]}
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(lens | {"frames": frames}), encoding="utf-8")
    return path


@pytest.fixture
def wall():
    mesh, _ = grid(2)
    data = bpy.data.meshes.new("Wall")
    data.from_pydata(mesh.vertices.tolist(), [], mesh.triangles.tolist())
    item = bpy.data.objects.new("Wall", data)
    bpy.context.collection.objects.link(item)
    item.select_set(True)
    return item


def import_cameras(path, **arguments):
    assert bpy.ops.farfield.photos_import_cameras(filepath=str(path), **arguments) == {"FINISHED"}


def overlay_names():
    return sorted(image.name for image in bpy.data.images if "Overlay" in image.name)


def test_the_selected_mesh_is_drawn_into_the_photographs(project, wall, capfd):
    import_cameras(project)
    assert overlay_names() == NAMES
    assert 'Imported 2 cameras. Drew 2 overlays; open them in the Image Editor, for example "0.png Overlay".' in capfd.readouterr().out
    pixels = read_pixels(bpy.data.images[NAMES[0]])[..., :3]
    assert pixels[20, 30].min() > 0.9 and pixels[2, 2].max() < 0.7, "the wall is in the middle, and dark around it"


def test_nothing_is_drawn_without_a_selected_mesh_or_on_request(project, wall, capfd):
    wall.select_set(False)
    import_cameras(project)
    wall.select_set(True)
    import_cameras(project, draw_overlays=False)
    assert overlay_names() == [] and "verlay" not in capfd.readouterr().out


def test_only_imported_photographs_that_exist_are_drawn(project, wall, capfd):
    import_cameras(project)
    for name in NAMES:
        bpy.data.images.remove(bpy.data.images[name])
    (project.parent / "images" / "0.png").unlink()
    import_cameras(project)
    assert len(overlay_names()) == 1 and overlay_names()[0].startswith("1.png")
    assert "1 photograph not found" in "".join(capfd.readouterr())


def test_cameras_stay_if_overlays_fail(project, wall, capfd):
    write_image(project.parent / "images" / "1.png", np.ones((7, 9, 3), np.float32))
    import_cameras(project)
    assert overlay_names() == [] and len(bpy.data.cameras) == 2
    message = "".join(capfd.readouterr())
    assert "Imported 2 cameras. Overlays were not drawn:" in message and "9 x 7 pixels" in message


def test_one_undo_removes_cameras_and_overlays(project, wall):
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    import_cameras(project)
    bpy.ops.ed.undo_push(message="Import Cameras")
    bpy.ops.ed.undo()
    assert overlay_names() == [] and not bpy.data.cameras


def test_the_file_browser_names_every_camera_file():
    named = " ".join(files for _, files in CAMERA_FILES)
    assert all(extension in named for extension in READERS) and {"COLMAP", "Metashape"} <= {program for program, _ in CAMERA_FILES}
