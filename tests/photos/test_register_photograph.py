"""*Register Photograph*: pairs of points of an image become a camera object."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.photos import point_pairs
from farfield.addon.bridge.photos.scene_cameras import find_background, read_photo_camera, store_lens
from farfield.addon.core.geometry.lenses import Lens, PhotoCamera

pytestmark = pytest.mark.usefixtures("empty_scene")

SIZE = (640, 480)
LENS = Lens("SIMPLE_RADIAL", SIZE, (700.0, 700.0), (320.0, 240.0), (-0.03,))
CAMERA = PhotoCamera("Aufnahme ü.png", LENS, np.diag([1.0, -1.0, -1.0]), np.array([0.1, -0.2, 5.0]))


def add_image(name="Aufnahme ü.png", size=SIZE):
    return bpy.data.images.new(name, *size)


def points(count, seed=0):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3))


def add_pairs(image, count, wrong=None):
    places = points(count)
    positions, _, _ = CAMERA.project(places)
    if wrong is not None:
        positions[wrong] += (90.0, -40.0)
    for place, position in zip(places, positions, strict=True):
        point_pairs.add_point(image, place)
        point_pairs.add_position(image, position)
    return image.farfield_registration


def register(image):
    assert bpy.ops.farfield.photos_register(image=image.name) == {"FINISHED"}
    bpy.context.view_layer.update()
    [item] = [item for item in bpy.context.scene.objects if item.type == "CAMERA" and find_background(item.data).image == image]
    return item


def error(image_name):
    before = {item.name for item in bpy.data.objects}
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.farfield.photos_register(image=image_name)
    assert {item.name for item in bpy.data.objects} == before
    message = str(caught.value).removeprefix("Error: ").strip()
    assert "\n" not in message
    return message


def test_points_and_positions_in_any_order_make_pairs():
    image = add_image()
    point_pairs.add_position(image, (10.0, 20.0))
    point_pairs.add_point(image, (1.0, 2.0, 3.0))
    point_pairs.add_point(image, (4.0, 5.0, 6.0))
    indices, found, positions = point_pairs.read_pairs(image)
    assert indices == [0] and found.tolist() == [[1.0, 2.0, 3.0]] and positions.tolist() == [[10.0, 20.0]]
    point_pairs.add_point(image, (7.0, 8.0, 9.0))
    assert len(image.farfield_registration.pairs) == 3, "the second pair has a point already"
    point_pairs.remove_incomplete(image)
    assert len(image.farfield_registration.pairs) == 1


def test_copies_restore_all_values():
    image = add_image()
    group = add_pairs(image, 7)
    register(image)
    copies = point_pairs.copy_pairs(image)
    point_pairs.add_point(image, (0.0, 0.0, 0.0))
    assert not group.is_registered
    point_pairs.restore_pairs(image, copies, is_registered=True)
    assert point_pairs.copy_pairs(image) == copies and group.is_registered and len(group.pairs) == 7


@pytest.mark.slow
def test_a_camera_is_created_and_a_second_run_moves_it(capfd):
    image = add_image()
    group = add_pairs(image, 8)
    item = register(image)
    assert 'Registered "Aufnahme ü": 0.0' in capfd.readouterr().out
    found = read_photo_camera(item, bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    checked = points(50, seed=1)
    assert (
        np.abs(found.project(checked)[0] - CAMERA.project(checked)[0]).max() < 0.3
    )  # the positions have noise of float32, and small distortions are preferred
    assert group.is_registered and not any(pair.is_wrong for pair in group.pairs)
    item.location = (9.0, 9.0, 9.0)
    bpy.context.view_layer.update()
    assert register(image) == item
    assert np.allclose(item.matrix_world.translation, CAMERA.position, atol=2e-2)
    assert [each.type for each in bpy.context.scene.objects] == ["CAMERA"]


def test_a_wrong_pair_is_named(capfd):
    image = add_image()
    group = add_pairs(image, 8, wrong=3)
    register(image)
    assert "Pair 4 did not fit" in capfd.readouterr().out
    assert [pair.is_wrong for pair in group.pairs] == [index == 3 for index in range(8)]
    assert np.linalg.norm(group.pairs[3].residual) > 80.0


def test_with_the_lens_of_another_photograph_four_pairs_are_enough():
    image = add_image()
    group = add_pairs(image, 4)
    assert "has 4 of the 6 pairs of points that are needed, or 4 if its lens is known" in error(image.name)
    other = bpy.data.objects.new("Other", bpy.data.cameras.new("Other"))
    bpy.context.scene.collection.objects.link(other)
    group.lens_camera = other
    assert 'The camera "Other" has no photograph' in error(image.name)
    other.data.background_images.new().image = add_image("small", (64, 48))
    other.data.show_background_images = True
    assert '"Other" has 64 x 48 pixels and "Aufnahme ü.png" 640 x 480' in error(image.name)
    store_lens(other.data, LENS)
    item = register(image)
    assert np.allclose(item.matrix_world.translation, CAMERA.position, atol=1e-3)


def test_pairs_are_removed_and_residuals_forgotten():
    image = add_image()
    group = add_pairs(image, 7)
    register(image)
    assert bpy.ops.farfield.photos_remove_pair(image=image.name, index=2) == {"FINISHED"}
    assert len(group.pairs) == 6 and not group.is_registered
    with pytest.raises(RuntimeError, match="has 6 pairs of points"):
        bpy.ops.farfield.photos_remove_pair(image=image.name, index=6)
    assert bpy.ops.farfield.photos_remove_pair(image=image.name) == {"FINISHED"}
    assert not len(group.pairs)


def test_images_that_cannot_be_registered():
    assert 'There is no image "none"' in error("none")
    assert "Open a photograph" in error("")
    missing = bpy.data.images.new("missing.png", 1, 1)
    missing.source, missing.filepath = "FILE", "//missing.png"
    assert '"missing.png" has no pixels' in error("missing.png")


def test_undo_removes_the_camera_and_the_residuals():
    image = add_image()
    image.use_fake_user = True
    add_pairs(image, 8)
    bpy.ops.ed.undo_push(message="pairs")
    register(image)
    bpy.ops.ed.undo_push(message="registered")
    bpy.ops.ed.undo()
    group = bpy.data.images["Aufnahme ü.png"].farfield_registration
    assert len(group.pairs) == 8 and not group.is_registered
    assert not [item for item in bpy.data.objects if item.type == "CAMERA"]


def test_pairs_are_saved_with_the_file(tmp_path):
    image = add_image()
    image.use_fake_user = True
    add_pairs(image, 8)
    copies = point_pairs.copy_pairs(image)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "datei.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "datei.blend"))
    assert point_pairs.copy_pairs(bpy.data.images["Aufnahme ü.png"]) == copies
