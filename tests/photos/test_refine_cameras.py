"""*Refine*: camera objects move so that their photographs fit to the others."""

from dataclasses import replace
from functools import cache

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from farfield.addon.bridge.photos.camera_objects import create_cameras
from farfield.addon.bridge.photos.scene_cameras import read_lens, read_photo_camera
from image_data import write_image
from photo_scenes import detailed_texture, distance_in_pixels, grid, photograph, ring

pytestmark = pytest.mark.usefixtures("empty_scene", "quick_merges")


def height(x, y):
    return 0.15 * np.sin(2 * x) * np.cos(3 * y)


@cache
def take_photographs():
    """The photographs of the mesh by a ring of three cameras."""
    mesh, uvs = grid(20, height)
    return [photograph(mesh, uvs, detailed_texture(), camera) for camera in ring(3)]


@pytest.fixture
def scene(tmp_path):
    """A mesh, and three cameras with photographs below an Empty that is turned and scaled with the mesh."""
    mesh, _ = grid(20, height)
    folder = tmp_path / "été"
    folder.mkdir()
    for each in take_photographs():
        write_image(folder / each.camera.name, each.pixels[::-1])
    parent, _ = create_cameras([each.camera for each in take_photographs()], folder, "Cameras", bpy.context.scene, is_y_up=False)
    data = bpy.data.meshes.new("Wand ü")
    data.from_pydata(mesh.vertices.tolist(), [], mesh.triangles.tolist())
    item = bpy.data.objects.new("Wand ü", data)
    bpy.context.collection.objects.link(item)
    item.matrix_world = parent.matrix_world = Matrix.LocRotScale((5.0, 0.0, 1.0), Matrix.Rotation(0.7, 3, "Y").to_quaternion(), (2.0,) * 3)
    bpy.context.view_layer.update()
    return mesh


def read_camera(name):
    bpy.context.view_layer.update()
    item = bpy.data.objects[name]
    return read_photo_camera(item, bpy.context.scene, bpy.context.evaluated_depsgraph_get())


def turn(name, angle=0.008):
    """Turn a camera around its own axis; returns the former camera."""
    former = read_camera(name)
    item = bpy.data.objects[name]
    item.rotation_quaternion = item.rotation_quaternion @ Matrix.Rotation(angle, 3, (1.0, 0.6, 0.3)).to_quaternion()
    bpy.context.view_layer.update()
    return former


def world(mesh):
    matrix = np.array(bpy.data.objects["Wand ü"].matrix_world)
    return replace(mesh, vertices=mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3])


def select(*names):
    for item in bpy.context.view_layer.objects:
        item.select_set(item.name in names)


@pytest.mark.slow
def test_a_selected_camera_moves_back_and_undo_works(scene, capfd):
    former = turn("1")
    wrong = distance_in_pixels(world(scene), read_camera("1"), former)
    others = {name: bpy.data.objects[name].matrix_world.copy() for name in ("0", "2")}
    select("1")
    bpy.ops.ed.undo_push(message="turned")
    assert bpy.ops.farfield.photos_refine() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="refined")
    assert "Refined 1 camera: " in "".join(capfd.readouterr())
    assert distance_in_pixels(world(scene), read_camera("1"), former) < 0.1 < 1.0 < wrong
    assert all(bpy.data.objects[name].matrix_world == matrix for name, matrix in others.items())
    assert bpy.data.objects["1"].parent is not None and read_lens(bpy.data.objects["1"].data) == former.lens
    bpy.ops.ed.undo()
    assert distance_in_pixels(world(scene), read_camera("1"), former) == pytest.approx(wrong, abs=1e-3)


@pytest.mark.slow
def test_the_camera_of_an_image_with_its_lens(scene):
    former = turn("2")
    select()
    image = bpy.data.objects["2"].data.background_images[0].image
    assert bpy.ops.farfield.photos_refine(image=image.name, lens=True) == {"FINISHED"}
    found = read_camera("2")
    assert distance_in_pixels(world(scene), found, former) < 0.2
    assert found.lens != former.lens and found.lens.focal[0] == pytest.approx(300.0, rel=0.02)


@pytest.mark.slow
def test_a_lens_of_blender_keeps_its_place(scene):
    """Without a stored lens, the focal length in millimeters changes."""
    data = bpy.data.objects["2"].data
    del data["farfield_lens"]
    former = read_camera("2")
    data.lens *= 1.02
    select("2")
    assert bpy.ops.farfield.photos_refine(lens=True) == {"FINISHED"}
    assert distance_in_pixels(world(scene), read_camera("2"), former) < 0.2 and read_lens(data) is None


def error(**arguments):
    before = {item.name: item.matrix_world.copy() for item in bpy.data.objects}
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.farfield.photos_refine(**arguments)
    assert {item.name: item.matrix_world for item in bpy.data.objects} == before
    message = str(caught.value).removeprefix("Error: ").strip()
    assert "\n" not in message
    return message


def test_what_cannot_be_refined(scene):
    assert 'No camera has "none.png" as background image' in error(image="none.png")
    select("1")
    bpy.data.objects["1"].constraints.new("TRACK_TO")
    assert 'The camera "1" is animated or has constraints' in error()
    bpy.data.objects["1"].constraints.clear()
    bpy.data.objects["Wand ü"].hide_set(True)
    assert "There is no visible mesh" in error()
    bpy.data.objects["Wand ü"].hide_set(False)
    for item in list(bpy.data.objects):
        if item.name in {"0", "2"}:
            bpy.data.objects.remove(item)
    assert "There is only one photograph" in error()
