"""Viewers read from cameras and 3D Viewports see what Blender shows."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("bpy")

import bpy
import mathutils
from bpy_extras.object_utils import world_to_camera_view

from bridge import blender_scenes
from farfield.addon.bridge import viewers
from farfield.addon.core.geometry.viewers import FULL_SPHERE


@pytest.fixture
def scene(extension):
    """A scene with a camera that looks somewhere."""
    blender_scenes.reset_scene()
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.matrix_world = mathutils.Matrix.LocRotScale((3.0, -20.0, 7.0), mathutils.Euler((1.2, 0.1, 0.4)), (2.0, 2.0, 2.0))
    bpy.context.view_layer.update()
    return scene


def fake_area(size, window_matrix, view_matrix, perspective):
    """A 3D Viewport with these matrices; without a window Blender does not compute them."""
    region_3d = SimpleNamespace(window_matrix=window_matrix, view_matrix=view_matrix, view_perspective=perspective)
    space = SimpleNamespace(region_3d=region_3d, clip_start=0.01, clip_end=2000.0)
    regions = [SimpleNamespace(type="UI", width=7, height=7), SimpleNamespace(type="WINDOW", width=size[0], height=size[1])]
    return SimpleNamespace(spaces=SimpleNamespace(active=space), regions=regions)


@st.composite
def lenses(draw):
    """Settings of a camera and of a render."""
    camera = {
        "type": draw(st.sampled_from(["PERSP", "ORTHO"])),
        "sensor_fit": draw(st.sampled_from(["AUTO", "HORIZONTAL", "VERTICAL"])),
        "sensor_width": draw(st.floats(5.0, 80.0)),
        "sensor_height": draw(st.floats(5.0, 80.0)),
        "lens": draw(st.floats(10.0, 200.0)),
        "ortho_scale": draw(st.floats(0.5, 500.0)),
        "shift_x": draw(st.floats(-1.0, 1.0)),
        "shift_y": draw(st.floats(-1.0, 1.0)),
        "clip_start": draw(st.floats(0.01, 1.0)),
        "clip_end": draw(st.floats(10.0, 1e5)),
    }
    render = {
        "resolution_x": draw(st.integers(20, 4000)),
        "resolution_y": draw(st.integers(20, 4000)),
        "resolution_percentage": draw(st.integers(20, 200)),
        "pixel_aspect_x": draw(st.floats(1.0, 3.0)),
        "pixel_aspect_y": draw(st.floats(1.0, 3.0)),
    }
    return camera, render


def set_lens(scene, lens):
    for item, values in zip((scene.camera.data, scene.render), lens, strict=True):
        for name, value in values.items():
            setattr(item, name, value)


def blender_matrix(scene, size):
    render = scene.render
    aspect = {"scale_x": render.pixel_aspect_x, "scale_y": render.pixel_aspect_y}
    return scene.camera.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=size[0], y=size[1], **aspect)


class TestCamera:
    """Cameras with the render settings of the scene."""

    def test_the_projection_is_that_of_blender(self, scene):
        @settings(max_examples=30)
        @given(lens=lenses())
        def check(lens):
            set_lens(scene, lens)
            projection = viewers.camera_projection(scene, scene.camera)
            expected = np.array(blender_matrix(scene, projection.size), np.float64)
            np.testing.assert_allclose(projection.matrix, expected, rtol=1e-4, atol=1e-4)

        check()

    def test_positions_are_in_the_image_where_blender_says(self, scene):
        @settings(max_examples=30)
        @given(lens=lenses(), seed=st.integers(0, 2**32 - 1))
        def check(lens, seed):
            lens[1].update(pixel_aspect_x=1.0, pixel_aspect_y=1.0, resolution_percentage=100)  # the function ignores them
            set_lens(scene, lens)
            viewer = viewers.camera_viewer(scene, scene.camera)
            camera_positions = np.random.default_rng(seed).uniform([-9.0, -9.0, -90.0], [9.0, 9.0, -1.0], (20, 3))
            positions = camera_positions @ viewer.matrix[:3, :3].T + viewer.position
            pixels, depths = viewer.project(positions)
            shown = np.array([world_to_camera_view(scene, scene.camera, mathutils.Vector(position)) for position in positions])
            np.testing.assert_allclose(depths, -camera_positions[:, 2], rtol=1e-5)
            np.testing.assert_allclose(pixels / viewer.projection.size, shown[:, :2], rtol=1e-3, atol=2e-3)

        check()

    def test_the_scale_of_a_camera_does_not_count(self, scene):
        viewer = viewers.camera_viewer(scene, scene.camera)
        np.testing.assert_allclose(viewer.matrix[:3, :3].T @ viewer.matrix[:3, :3], np.eye(3), atol=1e-6)
        assert viewer.position.tolist() == pytest.approx([3.0, -20.0, 7.0])

    def test_an_animated_lens_is_read_from_the_evaluated_camera(self, scene):
        data = scene.camera.data
        for frame, lens in ((1, 20.0), (11, 120.0)):
            data.lens = lens
            data.keyframe_insert("lens", frame=frame)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        scene.frame_set(11)
        left, right, _, _ = viewers.camera_projection(scene, scene.camera.evaluated_get(depsgraph)).window
        assert right - left == pytest.approx(36.0 / 120.0)

    def test_a_panoramic_camera_sees_everything(self, scene):
        scene.camera.data.type = "PANO"
        projection = viewers.camera_projection(scene, scene.camera)
        assert (projection.kind, projection.window) == ("panoramic", FULL_SPHERE)
        assert viewers.camera_viewer(scene, scene.camera).frustum_planes().shape == (0, 4)

    def test_other_objects_see_like_a_new_camera(self, scene):
        light = bpy.data.objects.new("Light", bpy.data.lights.new("Light", "SUN"))
        expected = viewers.camera_projection(scene, scene.camera)
        for item in (light, None):
            assert viewers.camera_projection(scene, item).window == pytest.approx(expected.window)


class TestViewport:
    """3D Viewports."""

    def test_a_view_through_the_camera_agrees_with_the_camera(self, scene):
        """A viewport of the size of the image whose camera frame is neither moved nor zoomed shows the same."""

        @settings(max_examples=30)
        @given(lens=lenses())
        def check(lens):
            lens[1]["pixel_aspect_x"] = lens[1]["pixel_aspect_y"] = 1.0
            set_lens(scene, lens)
            camera = viewers.camera_viewer(scene, scene.camera)
            matrix = blender_matrix(scene, camera.projection.size)
            area = fake_area(camera.projection.size, matrix, mathutils.Matrix(), "CAMERA")
            view = viewers.build_viewer(viewers.viewer_matrix(scene, area.spaces.active.region_3d), viewers.viewer_projection(scene, area))
            np.testing.assert_allclose(view.matrix, camera.matrix)
            np.testing.assert_allclose(view.projection.window, camera.projection.window, rtol=1e-4, atol=1e-4)
            assert view.projection.size == camera.projection.size
            assert view.projection.near == pytest.approx(camera.projection.near, rel=1e-3, abs=1e-2)
            assert view.projection.far == pytest.approx(camera.projection.far, rel=1e-3)

        check()

    def test_the_frame_of_the_camera_may_be_zoomed_and_moved(self, scene):
        camera = viewers.camera_viewer(scene, scene.camera)
        zoom = np.diag([0.5, 0.5, 1.0, 1.0])  # in clip space
        zoom[0, 3] = 0.2
        matrix = mathutils.Matrix((zoom @ np.array(blender_matrix(scene, camera.projection.size))).tolist())
        area = fake_area(camera.projection.size, matrix, mathutils.Matrix(), "CAMERA")
        left, right, bottom, top = viewers.viewer_projection(scene, area).window
        expected = np.array(camera.projection.window)
        assert (bottom, top) == pytest.approx(tuple(2.0 * expected[2:]))
        assert (right - left) == pytest.approx(2.0 * (expected[1] - expected[0])) and left + right < 0.0

    def test_a_free_view_has_its_own_matrix_and_clipping(self, scene):
        view_matrix = mathutils.Matrix.Translation((1.0, 2.0, 3.0)).inverted()
        near, far = 0.01, 2000.0
        window_matrix = mathutils.Matrix(
            ((1.5, 0, 0, 0), (0, 2.0, 0, 0), (0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)), (0, 0, -1, 0))
        )
        area = fake_area((400, 300), window_matrix, view_matrix, "PERSP")
        projection = viewers.viewer_projection(scene, area)
        assert (projection.kind, projection.size, projection.near, projection.far) == ("perspective", (400, 300), near, far)
        assert projection.window == pytest.approx((-1 / 1.5, 1 / 1.5, -0.5, 0.5))
        assert viewers.viewer_matrix(scene, area.spaces.active.region_3d).translation == mathutils.Vector((1.0, 2.0, 3.0))

    def test_a_parallel_view_sees_behind_its_position(self, scene):
        window_matrix = mathutils.Matrix(((0.1, 0, 0, 0), (0, 0.2, 0, 0), (0, 0, -1e-3, 0), (0, 0, 0, 1)))
        projection = viewers.viewer_projection(scene, fake_area((400, 200), window_matrix, mathutils.Matrix(), "ORTHO"))
        assert projection.kind == "orthographic" and projection.window == pytest.approx((-10.0, 10.0, -5.0, 5.0))
        assert (projection.near, projection.far) == pytest.approx((-1000.0, 1000.0))

    def test_a_real_viewport_is_read(self, scene):
        areas = [area for window in bpy.context.window_manager.windows for area in window.screen.areas if area.type == "VIEW_3D"]
        if not areas:
            pytest.skip("this Blender has no window")
        projection = viewers.viewer_projection(scene, areas[0])
        left, right, bottom, top = projection.window
        assert right > left and top > bottom and projection.far > projection.near

    def test_without_a_viewport_the_camera_counts_and_without_a_camera_the_cursor(self, scene):
        assert viewers.viewer_matrix(scene, None) == scene.camera.matrix_world
        assert viewers.viewer_projection(scene, None) == viewers.camera_projection(scene, scene.camera)
        scene.camera = None
        scene.cursor.location = (7.0, 8.0, 9.0)
        assert viewers.viewer_matrix(scene, None).translation == mathutils.Vector((7.0, 8.0, 9.0))
        assert viewers.viewer_projection(scene, None).field_of_view[0] == pytest.approx(2.0 * math.atan(18.0 / 50.0))


def test_an_orthographic_camera_of_scale_0_has_a_finite_resolution(scene):
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 0.0
    assert np.isfinite(viewers.camera_projection(scene, scene.camera).pixel_densities).all()


def test_a_camera_that_does_not_reach_the_end_of_a_terrain_is_named(empty_scene):
    assert viewers.describe_camera_range(empty_scene, 5000.0) == ""
    bpy.ops.object.camera_add()
    empty_scene.camera = bpy.context.object
    empty_scene.camera.data.clip_end = 100.0
    assert viewers.describe_camera_range(empty_scene, 5000.0) == 'The camera "Camera" shows nothing beyond 100 m; raise Clip End to 5 km.'
    empty_scene.camera.data.clip_end = 5000.0
    assert viewers.describe_camera_range(empty_scene, 5000.0) == ""
