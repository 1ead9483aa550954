"""A comparison gives equal objects equal scores, measures differences, and leaves the scene unchanged."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from farfield.addon.bridge.overlays.line_chart import rasterize_text  # noqa: E402
from farfield.addon.core.geometry.directions import held_out_views  # noqa: E402
from farfield.addon.core.jobs.progress import run_to_end  # noqa: E402
from lib.comparison import compare_cloud, draw_comparison_sheet  # noqa: E402 - only if bpy is available
from lib.contact_sheet import enlarge, write_png  # noqa: E402
from lib.studio import look_at_matrix, open_studio  # noqa: E402


@pytest.fixture
def ball():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return add_ball(1.0)


def add_ball(radius: float):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, radius=radius)
    ball = bpy.context.object
    ball.data.shade_smooth()
    return ball


def test_a_copy_looks_like_its_source(ball):
    copy = ball.copy()
    bpy.context.scene.collection.objects.link(copy)
    copy["farfield_error"] = 0.05
    copy.hide_render = True
    counts = {
        collection: len(getattr(bpy.data, collection)) for collection in ("scenes", "objects", "lights", "cameras", "worlds", "meshes")
    }
    comparison = run_to_end(compare_cloud([ball], copy, directions=held_out_views(3), samples=4))
    assert comparison.ssim == pytest.approx(np.ones(3), abs=1e-3)
    assert comparison.alpha_iou == pytest.approx(np.ones(3), abs=1e-3)
    assert comparison.source_renders[0, ..., 3].sum() * 0.05**2 == pytest.approx(np.pi, rel=0.03)  # the area of the silhouette of a ball
    assert {collection: len(getattr(bpy.data, collection)) for collection in counts} == counts
    assert {image.type for image in bpy.data.images} <= {"RENDER_RESULT"}  # Blender stores the last render there
    assert copy.hide_render
    assert not ball.hide_render
    sheet = draw_comparison_sheet("A ball", comparison, close_up=np.ones((2, 50, 50, 4), np.float32))
    assert sheet.ndim == 3
    assert 0.0 <= sheet.min() < sheet.max() <= 1.0


def test_a_smaller_ball_overlaps_by_its_area(ball):
    small = add_ball(0.8)
    comparison = run_to_end(compare_cloud([ball], small, pixel_size=0.04, directions=held_out_views(2), samples=4))
    assert comparison.alpha_iou == pytest.approx(np.full(2, 0.64), abs=0.02)
    assert comparison.ssim.max() < 0.95
    assert comparison.to_report()["worst_ssim"] == pytest.approx(comparison.ssim.min(), abs=1e-3)


def test_a_cancelled_comparison_leaves_nothing(ball):
    small = add_ball(0.8)
    steps = compare_cloud([ball], small, pixel_size=0.1, directions=held_out_views(2), samples=1)
    next(steps)
    next(steps)
    steps.close()
    assert len(bpy.data.scenes) == 1
    assert not ball.hide_render
    assert not small.hide_render


def test_the_studio_lights_the_side_that_faces_the_sun(ball):
    with open_studio([ball], samples=4) as studio:
        lit, shaded = (
            studio.render([ball], np.array(direction), np.zeros(3), 0.1, 24) for direction in ((0.6, -0.64, 0.48), (-0.6, 0.64, -0.48))
        )
    assert lit[12, 12, :3].mean() > 2.0 * shaded[12, 12, :3].mean() > 0.1


def test_a_camera_looks_against_its_direction_and_is_upright():
    matrix = np.array(look_at_matrix(np.array([0.6, 0.0, 0.8]), np.array([1.0, 2.0, 3.0])))
    assert matrix[:3, 2] == pytest.approx([0.6, 0.0, 0.8])
    assert matrix[2, 0] == pytest.approx(0.0)
    assert matrix[2, 1] > 0.0
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0)


def test_png_files_contain_the_pixels_the_right_way_up(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3)) / 255.0
    write_png(tmp_path / "größe.png", pixels)
    image = bpy.data.images.load(str(tmp_path / "größe.png"))
    try:
        assert np.array(image.pixels[:]).reshape(5, 7, 4)[..., :3] == pytest.approx(pixels, abs=1e-6)
    finally:
        bpy.data.images.remove(image)


def test_letters_have_the_right_shape():
    mask = rasterize_text("L", 40)
    assert mask.shape[0] == 40
    rows, columns = np.nonzero(mask > 0.5)
    assert rows.max() < 32  # leaves space for descenders
    lower = mask[rows.max() - 1] > 0.5
    upper = mask[rows.min() + 1] > 0.5
    assert lower.sum() > 2 * upper.sum()  # an L is broader at its base
    assert rasterize_text("LL", 40).sum() == pytest.approx(2.0 * mask.sum(), rel=0.05)
    assert rasterize_text("", 20).sum() == 0.0
    assert columns.min() >= 0


def test_enlarging_repeats_pixels():
    assert enlarge(np.arange(4).reshape(2, 2), 2).tolist() == [[0, 0, 1, 1], [0, 0, 1, 1], [2, 2, 3, 3], [2, 2, 3, 3]]
