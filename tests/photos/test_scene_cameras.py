"""Scene cameras with background images as cameras of photographs, and cameras of photographs as scene cameras."""

import json
import math

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Euler, Matrix, Vector

from farfield.addon.bridge.photos import photo_images
from farfield.addon.bridge.photos.camera_objects import create_cameras, set_render_size
from farfield.addon.bridge.photos.photo_images import is_missing, open_background
from farfield.addon.bridge.photos.scene_cameras import LENS_PROPERTY, _read_frame, find_background, has_photograph, read_photo_camera
from farfield.addon.core.errors import FileError, ImageError, SettingsError
from farfield.addon.core.geometry.lenses import Lens, PhotoCamera
from farfield.addon.core.imaging.colors import encode_signed_srgb
from image_data import write_image
from photo_scenes import camera_at

pytestmark = pytest.mark.usefixtures("empty_scene")
SIZE = (60, 40)
RENDER_SIZES = [(600, 400), (1920, 1080), (400, 900), (500, 500)]
SENSORS = [("AUTO", 36.0, 24.0), ("HORIZONTAL", 30.0, 24.0), ("VERTICAL", 36.0, 20.0)]


def new_image(name="photo", size=SIZE, pixels=None):
    """A generated image."""
    image = bpy.data.images.new(name, *size)
    if pixels is not None:
        image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
        image.update()
    return image


def add_camera(image=None, **data):
    """A camera somewhere in the scene with a background image."""
    camera = bpy.data.cameras.new("Kamera ü")
    item = bpy.data.objects.new("Kamera ü", camera)
    bpy.context.collection.objects.link(item)
    item.matrix_world = Matrix.Translation((1.0, -2.0, 0.5)) @ Euler((1.1, 0.3, -0.6)).to_matrix().to_4x4()
    background = camera.background_images.new()
    background.image, background.frame_method = image or new_image(), "FIT"
    camera.show_background_images = True
    for name, value in data.items():
        setattr(camera, name, value)
    return item, background


def read(item):
    bpy.context.view_layer.update()
    return read_photo_camera(item, bpy.context.scene, bpy.context.evaluated_depsgraph_get())


def points_before(item, count=50, seed=0):
    """Random points (N, 3) in world space, in front of the camera."""
    bpy.context.view_layer.update()
    random = np.random.default_rng(seed)
    depths = random.uniform(1.0, 9.0, (count, 1))
    local = np.column_stack([random.uniform(-0.3, 0.3, (count, 2)) * depths, -depths])
    matrix = np.array(item.matrix_world.normalized(), float)
    return local @ matrix[:3, :3].T + matrix[:3, 3]


def frame_positions(item, points):
    """Positions (N, 2) in the frame that is rendered, 0 to 1, by Blender."""
    return np.array([world_to_camera_view(bpy.context.scene, item, Vector(point))[:2] for point in points])


def error_of(item, kind=SettingsError):
    with pytest.raises(kind) as caught:
        read(item)
    assert "\n" not in str(caught.value) and str(caught.value).endswith(".")
    return str(caught.value)


@pytest.mark.parametrize("render_size", RENDER_SIZES)
@pytest.mark.parametrize("sensor", SENSORS)
def test_the_frame_is_that_of_blender(render_size, sensor):
    item, _ = add_camera(lens=31.0, shift_x=0.13, shift_y=-0.2)
    item.data.sensor_fit, item.data.sensor_width, item.data.sensor_height = sensor
    set_render_size(bpy.context.scene, render_size)
    bpy.context.scene.render.pixel_aspect_x = 1.3
    corners = np.array(item.data.view_frame(scene=bpy.context.scene))
    corners = corners[:, :2] / -corners[:, 2:]
    frame, _ = _read_frame(item.data, bpy.context.scene)
    size, center = np.array([frame.width, frame.height]), frame.center
    assert size == pytest.approx(np.ptp(corners, axis=0), rel=1e-5)
    assert center == pytest.approx(corners.mean(axis=0), abs=1e-6)


@pytest.mark.parametrize("render_size", RENDER_SIZES)
@pytest.mark.parametrize("sensor", SENSORS)
def test_a_stretched_image_fills_the_frame(render_size, sensor):
    item, background = add_camera(shift_x=-0.1, shift_y=0.15)
    item.data.sensor_fit, item.data.sensor_width, item.data.sensor_height = sensor
    background.frame_method = "STRETCH"
    set_render_size(bpy.context.scene, render_size)
    points = points_before(item)
    positions, depths, is_valid = read(item).project(points)
    assert is_valid.all() and depths.min() >= 1.0 - 1e-6
    assert positions == pytest.approx(frame_positions(item, points) * SIZE, abs=1e-3)


def test_known_placements():
    """A frame of 2 x 1, a square image of 40 x 40 pixels: where the center of the frame lies in the image, and how much it shows."""
    set_render_size(bpy.context.scene, (200, 100))
    item, background = add_camera(new_image(size=(40, 40)), lens=36.0, sensor_width=36.0)
    axis = item.matrix_world @ Vector((0.0, 0.0, -1.0))
    right = item.matrix_world @ Vector((0.25, 0.0, -1.0))
    up = item.matrix_world @ Vector((0.0, 0.25, -1.0))

    def positions(**placement):
        for name, value in placement.items():
            setattr(background, name, value)
        return read(item).project(np.array([axis, right, up]))[0]

    close = {"abs": 1e-4}
    assert positions(frame_method="STRETCH") == pytest.approx(np.array([[20, 20], [30, 20], [20, 40]]), **close)
    assert positions(frame_method="FIT") == pytest.approx(np.array([[20, 20], [40, 20], [20, 40]]), **close)
    assert positions(frame_method="CROP") == pytest.approx(np.array([[20, 20], [30, 20], [20, 30]]), **close)
    assert positions(offset=(0.1, 0.0)) == pytest.approx(np.array([[16, 20], [26, 20], [16, 30]]), **close)
    assert positions(offset=(0.0, 0.0), scale=0.5) == pytest.approx(np.array([[20, 20], [40, 20], [20, 40]]), **close)
    turned = positions(rotation=0.5 * math.pi)  # clockwise: what is above the center is at its left in the image
    assert turned == pytest.approx(np.array([[20, 20], [20, 40], [0, 20]]), **close)


def test_scale_of_the_camera_does_not_matter_and_parents_do():
    item, _ = add_camera()
    points = points_before(item)
    expected = read(item).project(points)[0]
    item.scale = (3.0, 0.2, 5.0)
    assert read(item).project(points)[0] == pytest.approx(expected, abs=1e-3)
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.collection.objects.link(parent)
    item.scale, item.parent = (1.0, 1.0, 1.0), parent
    parent.matrix_world = Matrix.Translation((0.0, 5.0, 0.0)) @ Matrix.Rotation(0.7, 4, "X") @ Matrix.Scale(2.0, 4)
    bpy.context.view_layer.update()
    moved = np.array([parent.matrix_world @ Vector(point) for point in points])
    assert read(item).project(moved)[0] == pytest.approx(expected, abs=1e-3)
    parent.scale = (1.0, 4.0, 1.0)
    assert "sheared by its parent" in error_of(item)


def test_constraints_count():
    item, background = add_camera()
    background.frame_method = "STRETCH"
    set_render_size(bpy.context.scene, SIZE)
    target = bpy.data.objects.new("Target", None)
    bpy.context.collection.objects.link(target)
    target.location = (4.0, 4.0, 4.0)
    constraint = item.constraints.new("TRACK_TO")
    constraint.target, constraint.track_axis, constraint.up_axis = target, "TRACK_NEGATIVE_Z", "UP_Y"
    assert read(item).project(np.array([target.location]))[0][0] == pytest.approx((30.0, 20.0), abs=1e-3)


def test_only_shown_images_count():
    item, background = add_camera()
    assert has_photograph(item) and find_background(item.data).image == background.image
    second = item.data.background_images.new()
    second.image = new_image("second")
    background.show_background_image = False
    assert find_background(item.data).image.name == "second"
    second.source = "MOVIE_CLIP"
    assert not has_photograph(item)
    second.source, item.data.show_background_images = "IMAGE", False
    assert not has_photograph(item)


def test_cameras_that_cannot_be_used():
    item, background = add_camera()
    item.data.type = "ORTHO"
    assert "is orthographic" in error_of(item)
    item.data.type = "PANO"
    assert "is panoramic" in error_of(item)
    item.data.type = "PERSP"
    background.scale = 0.0
    assert "no scale" in error_of(item)
    for stored in ("{", "[]", "3", '{"model": "PINHOLE"}', json.dumps({"model": "X", "size": [1, 1], "focal": [1, 1], "center": [0, 0]})):
        item.data[LENS_PROPERTY] = stored
        assert LENS_PROPERTY in error_of(item)
    item.data[LENS_PROPERTY] = 3.5
    assert LENS_PROPERTY in error_of(item)


def distorted(camera):
    lens = Lens("OPENCV", camera.lens.size, (310.0, 295.0), (140.0, 128.5), (-0.1, 0.02, 0.001, -0.002))
    return PhotoCamera(camera.name, lens, camera.rotation, camera.translation)


@pytest.mark.parametrize("render_size", RENDER_SIZES)
@pytest.mark.parametrize("is_distorted", [False, True])
def test_imported_cameras_project_like_the_file(tmp_path, render_size, is_distorted):
    cameras = [camera_at(position) for position in ((3.0, 1.0, 2.0), (0.0, 0.0, 4.0), (-2.0, 1.5, -3.0))]
    cameras = [distorted(camera) for camera in cameras] if is_distorted else cameras
    set_render_size(bpy.context.scene, render_size)
    parent, missing = create_cameras(cameras, tmp_path, "Kameras", bpy.context.scene, is_y_up=False)
    assert missing == 3 and [item.name for item in parent.children] == ["photo", "photo.001", "photo.002"]
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (100, 3))
    for camera, item in zip(cameras, parent.children, strict=True):
        assert read(item).project(points)[0] == pytest.approx(camera.project(points)[0], abs=1e-3)


@pytest.mark.parametrize("render_size", RENDER_SIZES)
def test_the_camera_view_shows_imported_photographs_where_they_belong(tmp_path, render_size):
    write_image(tmp_path / "photo.png", np.zeros((240, 300, 3), np.uint8))
    lens = Lens("PINHOLE", (300, 240), (310.0, 280.0), (140.0, 128.5))
    start = camera_at((3.0, 1.0, 2.0))
    camera = PhotoCamera("photo.png", lens, start.rotation, start.translation)
    set_render_size(bpy.context.scene, render_size)
    parent, missing = create_cameras([camera], tmp_path, "Kameras", bpy.context.scene, is_y_up=False)
    [item] = parent.children
    assert missing == 0 and not item.data.background_images[0].image.has_data, "photographs are loaded when they are needed"
    del item.data[LENS_PROPERTY]  # the lens of Blender and the placement of the image remain
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (100, 3))
    found = read(item)
    assert found.lens.size == (300, 240)
    assert found.project(points)[0] == pytest.approx(camera.project(points)[0], abs=2e-3)


def test_cameras_follow_their_parent(tmp_path):
    cameras = [camera_at((3.0, 1.0, 2.0)), camera_at((0.0, -1.0, 4.0))]
    parent, _ = create_cameras(cameras, tmp_path, "Cameras", bpy.context.scene, is_y_up=True)
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (100, 3))
    turned = points[:, [0, 2, 1]] * (1.0, -1.0, 1.0)
    for camera, item in zip(cameras, parent.children, strict=True):
        assert read(item).project(turned)[0] == pytest.approx(camera.project(points)[0], abs=1e-3)
    parent.rotation_euler, parent.scale, parent.location = (0.0, 0.0, 0.0), (2.5, 2.5, 2.5), (1.0, 2.0, 3.0)
    for camera, item in zip(cameras, parent.children, strict=True):
        assert read(item).project(2.5 * points + (1.0, 2.0, 3.0))[0] == pytest.approx(camera.project(points)[0], abs=1e-3)


class TestPixels:
    """The pixels of background images."""

    def pixels(self, alpha=1.0):
        """Colors (H, W, 4) of 8 bits without symmetry."""
        random = np.random.default_rng(4).integers(0, 256, (SIZE[1], SIZE[0], 4)).astype(np.float32) / np.float32(255.0)
        random[..., 3] = alpha
        return random

    def photograph(self, image, **background_properties):
        item, background = add_camera(image)
        for name, value in background_properties.items():
            setattr(background, name, value)
        return open_background(read(item), background).read()

    def test_files_generated_and_packed_images_are_equal(self, tmp_path, monkeypatch):
        pixels = self.pixels()
        stored = np.rint(255.0 * pixels[..., :3]).astype(np.uint8)
        path = write_image(tmp_path / "Straße 写真.png", stored[::-1])
        generated, loaded, packed = new_image("generated", pixels=pixels), bpy.data.images.load(str(path)), bpy.data.images.load(str(path))
        packed.pack()
        write_image(tmp_path / "16.png", (stored.astype(np.uint16) * 257)[::-1])
        deep = bpy.data.images.load(str(tmp_path / "16.png"))
        for image in (generated, loaded, packed):
            found = self.photograph(image)
            assert found.pixels.dtype == np.uint8 and found.mask is None and np.array_equal(found.pixels, stored)
        monkeypatch.setattr(photo_images, "_has_file_reader", lambda: False)
        assert np.array_equal(self.photograph(loaded).pixels, stored), "some builds of Blender lack the module that reads files"
        monkeypatch.undo()
        found = self.photograph(deep)
        assert found.pixels == pytest.approx(pixels[..., :3], abs=1e-3)
        deep.pack()
        assert self.photograph(deep).pixels == pytest.approx(pixels[..., :3], abs=1e-3)

    @pytest.mark.parametrize("flips", [(True, False), (False, True), (True, True)])
    def test_flips_mirror_pixels_and_mask(self, flips):
        pixels = self.pixels()
        pixels[:10, :30, 3] = 0.2
        image = new_image(pixels=pixels)
        plain, flipped = self.photograph(image), self.photograph(image, use_flip_x=flips[0], use_flip_y=flips[1])
        step = np.s_[:: -1 if flips[1] else 1, :: -1 if flips[0] else 1]
        assert np.array_equal(flipped.pixels, plain.pixels[step]) and np.array_equal(flipped.mask, plain.mask[step])

    def test_transparent_pixels_are_masked(self):
        pixels = self.pixels()
        pixels[3:9, 5:20, 3] = 0.4
        assert np.array_equal(self.photograph(new_image(pixels=pixels)).mask, pixels[..., 3] >= 0.5)

    def test_floats_are_encoded(self):
        image = bpy.data.images.new("hdr", *SIZE, float_buffer=True)
        linear = self.pixels() * np.float32(4.0)
        linear[..., 3] = 1.0
        image.pixels.foreach_set(linear.ravel())
        found = self.photograph(image)
        assert found.pixels.dtype == np.float32
        assert found.pixels == pytest.approx(encode_signed_srgb(linear[..., :3]), abs=1e-3)

    def test_other_color_spaces_are_converted(self):
        image = bpy.data.images.new("wide", *SIZE)
        image.colorspace_settings.name = "Linear Rec.2020"
        gray = np.repeat(self.pixels()[..., :1], 4, axis=2)
        gray[..., 3] = 1.0
        image.pixels.foreach_set(gray.ravel())
        scenes, images = len(bpy.data.scenes), len(bpy.data.images)
        found = self.photograph(image).pixels
        assert (len(bpy.data.scenes), len(bpy.data.images)) == (scenes, images)
        assert found == pytest.approx(encode_signed_srgb(gray[..., :3]), abs=5e-3), "gray is gray in all of these color spaces"

    def test_missing_files_and_movies_are_one_sentence(self, tmp_path):
        item, background = add_camera()
        [missing] = create_cameras([camera_at((0.0, 0.0, 3.0))], tmp_path, "Cameras", bpy.context.scene, is_y_up=False)[0].children
        image = missing.data.background_images[0].image
        assert is_missing(image) and not is_missing(background.image)
        with pytest.raises(FileError, match=r"photo\.png"):
            open_background(read(missing), missing.data.background_images[0])
        background.image = bpy.data.images.new("tiles", 8, 8, tiled=True)
        with pytest.raises(ImageError, match="not a single image"):
            open_background(read(item), background)

    def test_an_image_of_another_size_than_its_lens(self, tmp_path):
        write_image(tmp_path / "photo.png", np.zeros((20, 30, 3), np.uint8))
        [item] = create_cameras([camera_at((0.0, 0.0, 3.0))], tmp_path, "Cameras", bpy.context.scene, is_y_up=False)[0].children
        with pytest.raises(ImageError, match="30 x 20 pixels, but its camera 300 x 240"):
            open_background(read(item), item.data.background_images[0]).read()
