"""Comparing finds equal what is equal, measures what differs, and leaves the scene as it was."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from comparison import compare, sheet  # noqa: E402 - only where bpy is
from contact_sheet import enlarged, write_png  # noqa: E402
from farfield.addon.core.directions import held_out_views  # noqa: E402
from farfield.addon.core.progress import finish  # noqa: E402
from lettering import text_mask  # noqa: E402
from studio import looking_along, studio  # noqa: E402


@pytest.fixture
def ball():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return add_ball(1.0)


def add_ball(radius: float):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, radius=radius)
    added = bpy.context.object
    added.data.shade_smooth()
    return added


def test_a_copy_looks_like_its_original(ball):
    copy = ball.copy()
    bpy.context.scene.collection.objects.link(copy)
    copy["farfield_error"] = 0.05
    copy.hide_render = True
    before = {kind: len(getattr(bpy.data, kind)) for kind in ("scenes", "objects", "lights", "cameras", "worlds", "meshes")}
    compared = finish(compare([ball], copy, directions=held_out_views(3), samples=4))
    assert compared.ssim == pytest.approx(np.ones(3), abs=1e-3)
    assert compared.alpha_iou == pytest.approx(np.ones(3), abs=1e-3)
    assert compared.originals[0, ..., 3].sum() * 0.05**2 == pytest.approx(np.pi, rel=0.03)  # the area of the disc that a ball shows
    assert {kind: len(getattr(bpy.data, kind)) for kind in before} == before
    assert {image.type for image in bpy.data.images} <= {"RENDER_RESULT"}  # Blender's own place for what it rendered last
    assert copy.hide_render
    assert not ball.hide_render
    picture = sheet("A ball", compared, close_up=np.ones((2, 50, 50, 4), np.float32))
    assert picture.ndim == 3
    assert 0.0 <= picture.min() < picture.max() <= 1.0


def test_a_smaller_ball_overlaps_by_its_area(ball):
    small = add_ball(0.8)
    compared = finish(compare([ball], small, pixel_size=0.04, directions=held_out_views(2), samples=4))
    assert compared.alpha_iou == pytest.approx(np.full(2, 0.64), abs=0.02)
    assert compared.ssim.max() < 0.95
    assert compared.figures()["worst_ssim"] == pytest.approx(compared.ssim.min(), abs=1e-3)


def test_a_comparison_that_is_stopped_leaves_nothing(ball):
    small = add_ball(0.8)
    steps = compare([ball], small, pixel_size=0.1, directions=held_out_views(2), samples=1)
    next(steps)
    next(steps)
    steps.close()
    assert len(bpy.data.scenes) == 1
    assert not ball.hide_render
    assert not small.hide_render


def test_the_studio_lights_the_side_of_the_sun(ball):
    with studio([ball], samples=4) as room:
        lit, shaded = (room.picture([ball], np.array(side), np.zeros(3), 0.1, 24) for side in ((0.6, -0.64, 0.48), (-0.6, 0.64, -0.48)))
    assert lit[12, 12, :3].mean() > 2.0 * shaded[12, 12, :3].mean() > 0.1


def test_a_camera_looks_against_its_direction_and_stands_upright():
    matrix = np.array(looking_along(np.array([0.6, 0.0, 0.8]), np.array([1.0, 2.0, 3.0])))
    assert matrix[:3, 2] == pytest.approx([0.6, 0.0, 0.8])
    assert matrix[2, 0] == pytest.approx(0.0)
    assert matrix[2, 1] > 0.0
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0)


def test_png_files_hold_the_pixels_the_right_way_up(tmp_path):
    picture = np.random.default_rng(0).integers(0, 256, (5, 7, 3)) / 255.0
    write_png(tmp_path / "größe.png", picture)
    image = bpy.data.images.load(str(tmp_path / "größe.png"))
    try:
        assert np.array(image.pixels[:]).reshape(5, 7, 4)[..., :3] == pytest.approx(picture, abs=1e-6)
    finally:
        bpy.data.images.remove(image)


def test_letters_have_ink_where_they_should():
    mask = text_mask("L", 40)
    assert mask.shape[0] == 40
    rows, columns = np.nonzero(mask > 0.5)
    assert rows.max() < 32  # above the lower edge by the depth of a g
    lower = mask[rows.max() - 1] > 0.5
    upper = mask[rows.min() + 1] > 0.5
    assert lower.sum() > 2 * upper.sum()  # the foot of an L is broader than its head
    assert text_mask("LL", 40).sum() == pytest.approx(2.0 * mask.sum(), rel=0.05)
    assert text_mask("", 20).sum() == 0.0
    assert columns.min() >= 0


def test_enlarging_repeats_pixels():
    assert enlarged(np.arange(4).reshape(2, 2), 2).tolist() == [[0, 0, 1, 1], [0, 0, 1, 1], [2, 2, 3, 3], [2, 2, 3, 3]]
