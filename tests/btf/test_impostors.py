"""An octahedral impostor matches its source at the frames and between them. Its files and the decimation baseline are valid."""

import json

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes
from farfield.addon.bridge.btf.export.octahedral_capture import capture_atlas
from farfield.addon.bridge.btf.export.octahedral_files import write_octahedral_atlas
from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.core.btf.octahedral import FrameGrid
from farfield.addon.core.errors import FileError, GeometryError, SettingsError
from farfield.addon.core.geometry.cameras import OrthographicView
from farfield.addon.core.imaging import metrics
from farfield.addon.core.jobs.progress import run_to_end
from impostor_sampling import sample_rays
from lib import baselines
from lib.impostors import build_impostor
from lib.studio import open_studio

BETWEEN = np.array([0.5, -0.8, 0.3]) / np.linalg.norm([0.5, -0.8, 0.3])


@pytest.fixture(autouse=True)
def fresh_scene():
    blender_scenes.reset_scene()


def ball_and_box():
    """Return a rough red ball with a blue box on its side."""
    ball = blender_scenes.ball(material=blender_scenes.create_material("Red", (0.8, 0.2, 0.1), 0.8))
    box = blender_scenes.box(material=blender_scenes.create_material("Blue", (0.2, 0.3, 0.7), 0.8))
    box.scale, box.location, box.rotation_euler = (0.5, 0.5, 0.5), (1.2, 0.0, 0.9), (0.3, 0.4, 0.5)
    bpy.context.view_layer.update()
    return [ball, box]


def capture(objects, frames=3, pixels=32, samples=4):
    return run_to_end(capture_atlas(blender_scenes.read_objects(*objects), FrameGrid(frames), pixels, samples))


def render_source_and_impostor(objects, impostor, view, samples=6):
    """Render the source, if there is one, and the impostor in the studio from `view`."""
    impostor.face_viewer(view.direction)
    renders = [objects, impostor.objects] if objects else [impostor.objects]
    with open_studio([*objects, *impostor.objects], samples) as studio:
        return [studio.render(visible, view.direction, view.center, view.pixel_size, view.resolution) for visible in renders]


@pytest.mark.slow
def test_the_normals_heights_and_alpha_of_a_ball():
    ball = blender_scenes.ball(material=blender_scenes.create_material("Red", (0.8, 0.2, 0.1), 0.3), segments=48)
    ball.location = (100.0, -50.0, 7.0)
    bpy.context.view_layer.update()
    atlas = capture([ball], pixels=48)
    assert atlas.center == pytest.approx([100.0, -50.0, 7.0], abs=1e-4)
    assert atlas.uniform_roughness_metallic == pytest.approx([0.3, 0.0], abs=1e-3)
    for number in range(len(atlas.grid)):
        view, tile = atlas.view(number), atlas.tile(number)
        inside = atlas.color[tile][..., 3] > 0.99
        row, column = np.nonzero(inside)
        x, y = ((values + 0.5 - 0.5 * view.resolution) * view.pixel_size for values in (column, row))
        height = np.sqrt(1.0 - np.minimum(x**2 + y**2, 1.0))
        expected_normals = x[:, None] * view.right + y[:, None] * view.up + height[:, None] * view.direction
        is_not_grazing = height > 0.3
        assert inside.sum() * view.pixel_size**2 == pytest.approx(np.pi, rel=0.1)
        assert atlas.color[tile][inside][:, :3] == pytest.approx(np.tile([0.8, 0.2, 0.1], (len(row), 1)), abs=1e-3)
        assert atlas.height[tile][inside][is_not_grazing] * atlas.half_side == pytest.approx(height[is_not_grazing], abs=0.05)
        assert np.einsum("mi,mi->m", atlas.normal[tile][inside][is_not_grazing], expected_normals[is_not_grazing]).min() > 0.99


def test_stacked_transparent_leaves_keep_their_color():
    """Paths through them must not be terminated randomly: color and coverage of a pixel would become inconsistent."""
    leaf = blender_scenes.create_material("Leaf", (0.2, 0.6, 0.1))
    blender_scenes.shader_of(leaf).inputs["Alpha"].default_value = 0.2
    cards = [blender_scenes.card(f"Card {number}", leaf) for number in range(8)]
    for number, card in enumerate(cards):
        card.location.z = 0.1 * number
    bpy.context.view_layer.update()
    atlas = capture(cards, frames=2, samples=1)
    covered = atlas.color[..., 3] > 0.5
    assert covered.any()
    assert atlas.color[covered][:, :3] == pytest.approx(np.tile([0.2, 0.6, 0.1], (covered.sum(), 1)), abs=2e-3)
    assert np.abs(atlas.height).max() < 0.95


@pytest.mark.parametrize(("total_bytes", "frames", "images"), [(300_000, 3, 2), (73_728, 12, 2), (10**9, 16, 3)])
def test_frame_resolution_is_the_largest_that_fits(total_bytes, frames, images):
    resolution = baselines.compute_frame_resolution(total_bytes, frames, images)
    assert 4 * images * (frames * resolution) ** 2 <= total_bytes < 4 * images * (frames * (resolution + 1)) ** 2


def test_too_few_bytes_are_rejected_with_the_minimum():
    with pytest.raises(SettingsError, match="at least 73,728 bytes"):
        baselines.compute_frame_resolution(73_727, 12, 2)


def test_roughness_needs_an_image_only_if_it_varies():
    objects = ball_and_box()
    assert not baselines.has_varying_surface(blender_scenes.read_objects(*objects))
    blender_scenes.shader_of(bpy.data.materials["Blue"]).inputs["Roughness"].default_value = 0.3
    assert baselines.has_varying_surface(blender_scenes.read_objects(*objects))


@pytest.mark.exhaustive
def test_matches_the_source_at_and_between_frames():
    objects = ball_and_box()
    total_bytes = 8 * (8 * 72) ** 2
    impostor = run_to_end(baselines.build_octahedral_impostor(objects, total_bytes, 4, frames=8))
    assert impostor.nbytes == total_bytes
    for direction, min_psnr, min_iou in ((FrameGrid(8).directions[17], 30.0, 0.96), (BETWEEN, 27.0, 0.92)):
        view = OrthographicView(direction, np.array(impostor.quads.location), 72, 2.2 * impostor.half_side / 72)
        source, rendered = render_source_and_impostor(objects, impostor, view)
        window = metrics.crop_to_object(source[..., 3])
        assert metrics.psnr(metrics.composite_over_gray(source[window]), metrics.composite_over_gray(rendered[window])) > min_psnr
        assert metrics.alpha_iou(source[..., 3], rendered[..., 3]) > min_iou


@pytest.mark.slow
@pytest.mark.parametrize("upper", [False, pytest.param(True, marks=pytest.mark.exhaustive)], ids=["whole", "upper"])
def test_the_shader_matches_the_reference(upper):
    source = blender_scenes.read_objects(*ball_and_box())
    atlas = run_to_end(capture_atlas(source, FrameGrid(3, upper), 32, 4))
    impostor = build_impostor("Impostor", atlas)
    view = OrthographicView(BETWEEN, atlas.center, 32, 2.2 * atlas.half_side / 32)
    (rendered,) = render_source_and_impostor([], impostor, view, 16)
    offsets = (np.arange(32 * 4) + 0.5) / 4.0 - 16.0
    x, y = (values.ravel() * view.pixel_size for values in np.meshgrid(offsets, offsets))
    ray_samples = sample_rays(atlas, atlas.center + x[:, None] * view.right + y[:, None] * view.up, BETWEEN)
    alpha = ray_samples.color[:, 3].reshape(32, 4, 32, 4).mean(axis=(1, 3))
    assert metrics.psnr(alpha, rendered[..., 3]) > 30.0


@pytest.mark.exhaustive
def test_an_impostor_shades_itself():
    lower, upper = blender_scenes.card("Lower"), blender_scenes.card("Upper")
    lower.scale = (2.0, 2.0, 1.0)
    upper.location = (0.9, -1.1, 1.4)  # between the lower card and the studio's Sun
    bpy.context.view_layer.update()
    atlas = capture([lower, upper], frames=8, pixels=48)
    self_shadowing, without_self_shadowing = (build_impostor("Impostor", atlas, bias) for bias in (1.0, 1e3))
    direction = np.array([-0.6, 0.6, 0.8]) / np.linalg.norm([-0.6, 0.6, 0.8])
    view = OrthographicView(direction, atlas.center, 64, 2.0 * atlas.half_side / 64)
    source, shaded = render_source_and_impostor([lower, upper], self_shadowing, view)
    (lit,) = render_source_and_impostor([], without_self_shadowing, view)
    source, shaded, lit = (image[..., :3].mean(axis=2) for image in (source, shaded, lit))
    is_in_shadow, is_lit = lit - source > 0.3, (np.abs(lit - source) < 0.1) & (source > 0.3)
    assert is_in_shadow.sum() > 100 and is_lit.sum() > 250
    assert shaded[is_in_shadow].mean() < 0.5 * (source[is_in_shadow].mean() + lit[is_in_shadow].mean())
    assert shaded[is_lit].mean() > 0.8 * lit[is_lit].mean()


def test_cancelled_captures_and_removed_impostors_leave_no_data():
    source = blender_scenes.read_objects(*ball_and_box())
    before = blender_scenes.count_data()
    cancelled = capture_atlas(source, FrameGrid(2), 16, 1)
    next(cancelled)
    next(cancelled)
    cancelled.close()
    assert blender_scenes.count_data() == before
    build_impostor("Impostor", run_to_end(capture_atlas(source, FrameGrid(2), 16, 1))).remove()
    assert blender_scenes.count_data() == before


def test_files_contain_the_captured_atlas(tmp_path):
    objects = ball_and_box()
    before = blender_scenes.count_data()
    paths = run_to_end(write_octahedral_atlas(objects, tmp_path / "Bäume", 3, 16, samples=4))
    assert blender_scenes.count_data() == before
    assert sorted(path.name for path in paths) == sorted(path.name for path in (tmp_path / "Bäume").iterdir())
    atlas = capture(objects, pixels=16)
    metadata = json.loads((tmp_path / "Bäume" / "octahedral_atlas.json").read_text(encoding="utf-8"))
    assert (metadata["frames_per_side"], metadata["frame_resolution"], metadata["map"]) == (3, 16, "octahedral")
    assert metadata["half_side"] == pytest.approx(atlas.half_side) and metadata["center"] == pytest.approx(atlas.center)
    assert [frame["direction"] for frame in metadata["frames"]] == pytest.approx(atlas.grid.directions, abs=1e-8)
    assert (metadata["roughness"], metadata["metallic"]) == pytest.approx((0.8, 0.0), abs=1e-3)
    for key, expected in atlas.encode().items():
        image = bpy.data.images.load(str(tmp_path / "Bäume" / metadata["maps"][key]["file"]))
        image.colorspace_settings.is_data = True
        image.alpha_mode = "CHANNEL_PACKED"
        assert np.abs(read_pixels(image) - expected).max() < 0.6 / 255.0


@pytest.mark.parametrize(("frames", "resolution", "message"), [(1, 32, "12 is the usual"), (4, 7, "at least 8 pixels per side")])
def test_invalid_sizes_are_rejected(tmp_path, frames, resolution, message):
    with pytest.raises(SettingsError, match=message):
        run_to_end(write_octahedral_atlas([blender_scenes.box()], tmp_path, frames, resolution))
    assert list(tmp_path.iterdir()) == []


def test_a_file_as_folder_is_rejected(tmp_path):
    (tmp_path / "atlas").write_text("in the way")
    with pytest.raises(FileError, match="atlas"):
        run_to_end(write_octahedral_atlas([blender_scenes.box()], tmp_path / "atlas", 2, 8))


def test_decimation_keeps_the_materials_and_the_triangle_limit():
    objects = ball_and_box()
    low = np.array([-1.0, -1.0, -1.0])
    baseline = baselines.decimate(objects, 300)
    mesh = baseline.data
    mesh.calc_loop_triangles()
    assert 270 <= len(mesh.loop_triangles) <= 300
    assert [material.name for material in mesh.materials] == ["Red", "Blue"]
    assert {polygon.material_index for polygon in mesh.polygons} == {0, 1}
    corners = np.array([baseline.matrix_world @ vertex.co for vertex in mesh.vertices])
    assert corners.min(axis=0) == pytest.approx(low, abs=0.1)
    assert not baseline.modifiers


def test_decimation_keeps_seams_closed_and_both_sides_of_cards():
    """A ball whose faces share no vertices, as after an import, and a card that coincides with its own back side."""
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
    baseline = baselines.decimate([ball, card, back], 200)
    edges = {}
    for polygon in baseline.data.polygons:
        for edge in polygon.edge_keys:
            edges[edge] = edges.get(edge, 0) + 1
    on_ball = [count for edge, count in edges.items() if all(baseline.data.vertices[vertex].co.z < 2.0 for vertex in edge)]
    assert on_ball and set(on_ball) == {2}
    cards = [polygon for polygon in baseline.data.polygons if polygon.center.z > 2.0]
    assert {round(polygon.normal.z) for polygon in cards} == {1, -1}


def test_a_high_triangle_limit_leaves_the_mesh_unchanged():
    baseline = baselines.decimate(ball_and_box(), 10**6)
    assert len(baseline.data.polygons) == len(bpy.data.objects["Ball"].data.polygons) + 6


def test_decimating_an_empty_mesh_is_rejected():
    empty = bpy.data.objects.new("Hollow", bpy.data.meshes.new("Hollow"))
    bpy.context.scene.collection.objects.link(empty)
    with pytest.raises(GeometryError, match="Hollow"):
        baselines.decimate([empty], 100)
