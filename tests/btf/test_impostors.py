"""An octahedral impostor looks like its original where a frame stands, and nearly so between; files and baselines keep their word."""

import json

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

import baselines
from bridge import blender_scenes
from farfield.addon.bridge.btf_octahedral import impostor
from farfield.addon.bridge.btf_octahedral_capture import capture_atlas, surface_varies
from farfield.addon.bridge.btf_octahedral_exports import write_octahedral_atlas
from farfield.addon.bridge.images import pixels_of
from farfield.addon.core import metrics
from farfield.addon.core.btf.octahedral import FrameGrid, look_up
from farfield.addon.core.btf.texels import View
from farfield.addon.core.errors import FileError, GeometryError, SettingsError
from farfield.addon.core.progress import finish
from studio import studio

BETWEEN = np.array([0.5, -0.8, 0.3]) / np.linalg.norm([0.5, -0.8, 0.3])


@pytest.fixture(autouse=True)
def fresh_scene():
    blender_scenes.fresh()


def ball_and_box():
    """A dull red ball with a blue box on its side."""
    ball = blender_scenes.ball(made=blender_scenes.material("Red", (0.8, 0.2, 0.1), 0.8))
    box = blender_scenes.box(made=blender_scenes.material("Blue", (0.2, 0.3, 0.7), 0.8))
    box.scale, box.location, box.rotation_euler = (0.5, 0.5, 0.5), (1.2, 0.0, 0.9), (0.3, 0.4, 0.5)
    bpy.context.view_layer.update()
    return [ball, box]


def captured(objects, frames=3, pixels=32, samples=4):
    return finish(capture_atlas(blender_scenes.taken(*objects), FrameGrid(frames), pixels, samples))


def pictures(objects, made, view, samples=12):
    """Original and impostor in the studio as `view` has them."""
    made.face(view.direction)
    with studio([*objects, *made.objects], samples) as room:
        return [room.picture(shown, view.direction, view.center, view.pixel, view.side) for shown in (objects, made.objects)]


def test_a_ball_is_captured_with_its_normals_heights_and_alpha():
    ball = blender_scenes.ball(made=blender_scenes.material("Red", (0.8, 0.2, 0.1), 0.3))
    ball.location = (100.0, -50.0, 7.0)
    bpy.context.view_layer.update()
    atlas = captured([ball], pixels=48)
    assert atlas.center == pytest.approx([100.0, -50.0, 7.0], abs=1e-4)
    assert atlas.plain_surface == pytest.approx([0.3, 0.0], abs=1e-3)
    for number in range(len(atlas.grid)):
        view, tile = atlas.view(number), atlas.tile(number)
        inside = atlas.colour[tile][..., 3] > 0.99
        row, column = np.nonzero(inside)
        x, y = ((values + 0.5 - 0.5 * view.side) * view.pixel for values in (column, row))
        height = np.sqrt(1.0 - np.minimum(x**2 + y**2, 1.0))
        outwards = x[:, None] * view.right + y[:, None] * view.up + height[:, None] * view.direction
        near = height > 0.3
        assert inside.sum() * view.pixel**2 == pytest.approx(np.pi, rel=0.1)
        assert atlas.colour[tile][inside][:, :3] == pytest.approx(np.tile([0.8, 0.2, 0.1], (len(row), 1)), abs=1e-3)
        assert atlas.height[tile][inside][near] * atlas.half_side == pytest.approx(height[near], abs=0.05)
        assert np.einsum("mi,mi->m", atlas.normal[tile][inside][near], outwards[near]).min() > 0.99


def test_stacks_of_half_transparent_leaves_keep_their_colour():
    """Paths through them must not end at random: colour and coverage of a pixel would no longer fit each other."""
    made = blender_scenes.material("Leaf", (0.2, 0.6, 0.1))
    blender_scenes.shader_of(made).inputs["Alpha"].default_value = 0.2
    cards = [blender_scenes.card(f"Card {number}", made) for number in range(8)]
    for number, card in enumerate(cards):
        card.location.z = 0.1 * number
    bpy.context.view_layer.update()
    atlas = captured(cards, frames=2, samples=1)
    covered = atlas.colour[..., 3] > 0.5
    assert covered.any()
    assert atlas.colour[covered][:, :3] == pytest.approx(np.tile([0.2, 0.6, 0.1], (covered.sum(), 1)), abs=2e-3)
    assert np.abs(atlas.height).max() < 0.95


def test_roughness_gets_an_image_only_where_it_differs():
    objects = ball_and_box()
    assert not surface_varies(blender_scenes.taken(*objects))
    blender_scenes.shader_of(bpy.data.materials["Blue"]).inputs["Roughness"].default_value = 0.3
    assert surface_varies(blender_scenes.taken(*objects))


def test_at_a_frame_and_between_frames_it_is_nearly_the_original():
    objects = ball_and_box()
    total = 8 * (8 * 72) ** 2
    made = finish(baselines.octahedral_impostor(objects, total, 4, frames=8))
    assert made.bytes == total
    for direction, least, overlap in ((FrameGrid(8).directions[17], 30.0, 0.96), (BETWEEN, 27.0, 0.92)):
        view = View(direction, np.array(made.quads.location), 72, 2.2 * made.half_side / 72)
        original, shown = pictures(objects, made, view)
        window = metrics.crop_to_object(original[..., 3])
        assert metrics.psnr(metrics.over_grey(original[window]), metrics.over_grey(shown[window])) > least
        assert metrics.alpha_iou(original[..., 3], shown[..., 3]) > overlap


@pytest.mark.parametrize("upper", [False, True], ids=["whole", "upper"])
def test_the_shader_sees_what_the_reference_sees(upper):
    source = blender_scenes.taken(*ball_and_box())
    atlas = finish(capture_atlas(source, FrameGrid(5, upper), 32, 4))
    made = impostor("Impostor", atlas)
    view = View(BETWEEN, atlas.center, 48, 2.2 * atlas.half_side / 48)
    _, shown = pictures([], made, view, 64)
    parts = (np.arange(48 * 4) + 0.5) / 4.0 - 24.0
    x, y = (values.ravel() * view.pixel for values in np.meshgrid(parts, parts))
    seen = look_up(atlas, atlas.center + x[:, None] * view.right + y[:, None] * view.up, BETWEEN)
    alpha = seen.colour[:, 3].reshape(48, 4, 48, 4).mean(axis=(1, 3))
    assert metrics.psnr(alpha, shown[..., 3]) > 30.0


def test_it_shades_itself_where_something_stands_before_the_sun():
    lower, upper = blender_scenes.card("Lower"), blender_scenes.card("Upper")
    lower.scale = (2.0, 2.0, 1.0)
    upper.location = (0.9, -1.1, 1.4)  # before the studio's sun
    bpy.context.view_layer.update()
    atlas = captured([lower, upper], frames=8, pixels=48)
    shading, not_shading = (impostor("Impostor", atlas, bias) for bias in (1.0, 1e3))
    direction = np.array([-0.6, 0.6, 0.8]) / np.linalg.norm([-0.6, 0.6, 0.8])
    view = View(direction, atlas.center, 64, 2.0 * atlas.half_side / 64)
    original, shaded = pictures([lower, upper], shading, view)
    _, lit = pictures([], not_shading, view)
    original, shaded, lit = (picture[..., :3].mean(axis=2) for picture in (original, shaded, lit))
    shadow, light = lit - original > 0.3, (np.abs(lit - original) < 0.1) & (original > 0.3)
    assert shadow.sum() > 100 and light.sum() > 250
    assert shaded[shadow].mean() < 0.5 * (original[shadow].mean() + lit[shadow].mean())
    assert shaded[light].mean() > 0.8 * lit[light].mean()


def test_nothing_is_left_of_a_capture_or_of_an_impostor_that_is_removed():
    source = blender_scenes.taken(*ball_and_box())
    before = blender_scenes.counts()
    stopped = capture_atlas(source, FrameGrid(2), 16, 1)
    next(stopped)
    next(stopped)
    stopped.close()
    assert blender_scenes.counts() == before
    impostor("Impostor", finish(capture_atlas(source, FrameGrid(2), 16, 1))).remove()
    assert blender_scenes.counts() == before


def test_files_say_what_was_captured(tmp_path):
    objects = ball_and_box()
    before = blender_scenes.counts()
    paths = finish(write_octahedral_atlas(objects, tmp_path / "Bäume", 3, 16, samples=4))
    assert blender_scenes.counts() == before
    assert sorted(path.name for path in paths) == sorted(path.name for path in (tmp_path / "Bäume").iterdir())
    atlas = captured(objects, pixels=16)
    layout = json.loads((tmp_path / "Bäume" / "octahedral_atlas.json").read_text(encoding="utf-8"))
    assert (layout["frames"], layout["frame_pixels"], layout["map"]) == (3, 16, "octahedral")
    assert layout["half_side"] == pytest.approx(atlas.half_side) and layout["center"] == pytest.approx(atlas.center)
    assert [picture["direction"] for picture in layout["pictures"]] == pytest.approx(atlas.grid.directions, abs=1e-8)
    assert (layout["roughness"], layout["metallic"]) == pytest.approx((0.8, 0.0), abs=1e-3)
    for key, expected in atlas.encoded().items():
        image = bpy.data.images.load(str(tmp_path / "Bäume" / layout["maps"][key]["file"]))
        image.colorspace_settings.is_data = True
        image.alpha_mode = "CHANNEL_PACKED"
        assert np.abs(pixels_of(image) - expected).max() < 0.6 / 255.0


@pytest.mark.parametrize(("frames", "resolution", "words"), [(1, 32, "12 is the usual"), (4, 7, "8 pixels a side or more")])
def test_bad_sizes_are_refused(tmp_path, frames, resolution, words):
    with pytest.raises(SettingsError, match=words):
        finish(write_octahedral_atlas([blender_scenes.box()], tmp_path, frames, resolution))
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "atlas").write_text("in the way")
    with pytest.raises(FileError, match="atlas"):
        finish(write_octahedral_atlas([blender_scenes.box()], tmp_path / "atlas", 2, 8))


def test_a_decimated_peer_has_no_more_triangles_than_asked_and_the_same_materials():
    objects = ball_and_box()
    low = np.array([-1.0, -1.0, -1.0])
    baseline = baselines.decimated(objects, 300)
    mesh = baseline.data
    mesh.calc_loop_triangles()
    assert 270 <= len(mesh.loop_triangles) <= 300
    assert [made.name for made in mesh.materials] == ["Red", "Blue"]
    assert {polygon.material_index for polygon in mesh.polygons} == {0, 1}
    corners = np.array([baseline.matrix_world @ vertex.co for vertex in mesh.vertices])
    assert corners.min(axis=0) == pytest.approx(low, abs=0.1)
    assert not baseline.modifiers


def test_decimated_seams_stay_closed_and_fronts_and_backs_stay_two():
    """A ball whose faces share no vertex, as importers leave it, and a card that lies upon its own back."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16)
    ball = bpy.context.object
    bpy.ops.object.modifier_add(type="EDGE_SPLIT")
    ball.modifiers[0].split_angle = 0.0
    card = blender_scenes.card()
    card.location.z = 3.0
    card.data.from_pydata([], [], []) if not card.data.vertices else None
    back = card.copy()
    back.scale = (1.0, 1.0, -1.0)
    bpy.context.scene.collection.objects.link(back)
    bpy.context.view_layer.update()
    baseline = baselines.decimated([ball, card, back], 200)
    edges = {}
    for polygon in baseline.data.polygons:
        for edge in polygon.edge_keys:
            edges[edge] = edges.get(edge, 0) + 1
    on_ball = [count for edge, count in edges.items() if all(baseline.data.vertices[vertex].co.z < 2.0 for vertex in edge)]
    assert on_ball and set(on_ball) == {2}
    cards = [polygon for polygon in baseline.data.polygons if polygon.center.z > 2.0]
    assert {round(polygon.normal.z) for polygon in cards} == {1, -1}


def test_enough_triangles_leave_the_mesh_as_it_is():
    baseline = baselines.decimated(ball_and_box(), 10**6)
    assert len(baseline.data.polygons) == len(bpy.data.objects["Ball"].data.polygons) + 6


def test_nothing_to_decimate_is_refused():
    empty = bpy.data.objects.new("Hollow", bpy.data.meshes.new("Hollow"))
    bpy.context.scene.collection.objects.link(empty)
    with pytest.raises(GeometryError, match="Hollow"):
        baselines.decimated([empty], 100)
