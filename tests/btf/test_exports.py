"""Exported files contain what the textures show, and appear completely or not at all."""

import inspect
import json
import signal
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes
from bridge.bakes import build_small_cloud, open_cloud
from farfield.addon.bridge.billboards.cloud_materials import FRONT_COLOR, FRONT_NORMAL
from farfield.addon.bridge.billboards.exports import write_glb
from farfield.addon.bridge.billboards.level_objects import PBR_MATERIAL, read_level_texels
from farfield.addon.bridge.billboards.scene_clouds import clouds_in
from farfield.addon.bridge.btf.export import image_folders
from farfield.addon.bridge.btf.levels.decode import read_relightable_texture
from farfield.addon.bridge.btf.levels.emission_levels import assign_relightable_material
from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.bridge.rendering.render_scene import render_scene
from farfield.addon.bridge.shading.node_builder import nodes_in
from farfield.addon.core.btf.compression import CompressedTextures
from farfield.addon.core.btf.factorization.factors import Factors
from farfield.addon.core.btf.settings import BtfSettings, ExportSettings
from farfield.addon.core.errors import FileError, GeometryError, SettingsError
from farfield.addon.core.files.glb import load_glb
from farfield.addon.core.geometry.directions import bonn_directions
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.btf import export_job
from farfield.addon.operators.btf.export_job import prepare_export
from farfield.addon.operators.job_run import run_job
from fmf_reader import read_fmf
from random_textures import decode_radiance, random_color_factors

SETTINGS = BtfSettings(views_per_side=4, lights_per_side=3)
FEW_DIRECTIONS = BtfSettings(views_per_side=2, lights_per_side=2)
BAKED = ExportSettings(directions="baked")


@pytest.fixture(autouse=True)
def fresh_scene(extension):
    blender_scenes.reset_scene()


@pytest.fixture(scope="module")
def cloud_file(extension, tmp_path_factory) -> Path:
    """A file with the active cloud of a ball with random relightable textures."""
    blender_scenes.reset_scene()
    ball = blender_scenes.ball("Bällchen", blender_scenes.create_material("Red", (0.8, 0.2, 0.1), 1.0))
    bpy.context.view_layer.objects.active = ball
    ball.select_set(True)
    bpy.ops.farfield.billboards_build(error=8.0, levels=1, samples=1, solid_parts="quads")
    cloud = clouds_in(bpy.context.scene)[0]
    assign_random_textures(cloud.levels[0])
    bpy.context.view_layer.objects.active = cloud.levels[0]
    path = tmp_path_factory.mktemp("cloud") / "cloud.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture
def cloud(cloud_file):
    """The cloud of `cloud_file`."""
    return open_cloud(cloud_file)


def assign_random_textures(level, settings: BtfSettings = SETTINGS) -> None:
    texels = read_level_texels(level)
    random = np.random.default_rng(0)
    color = random_color_factors(len(texels), views=settings.view_count, lights=settings.light_count)
    view_basis = random.normal(size=(settings.view_count, 2, 1)).astype(np.float32)
    alpha = Factors(random.random((len(texels), 2), np.float32), view_basis, color.known)
    chromaticity = random.uniform(0.5, 1.5, (len(texels), 3)).astype(np.float32)
    assign_relightable_material(level, texels, CompressedTextures(None, chromaticity, color, alpha), settings)


def export(cloud, target: Path, settings: ExportSettings = BAKED) -> Path:
    run_to_end(run_job(prepare_export(cloud.levels, target, settings)))
    return target


def read_image(path: Path) -> np.ndarray:
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.is_data = True
    return read_pixels(image)


@pytest.mark.slow
def test_textures_are_read_back_from_the_material(cloud):
    (level,) = cloud.levels
    texels, texture = read_level_texels(level), read_relightable_texture(level)
    color = random_color_factors(len(texels), views=16, lights=9)
    rows = texels.pixels[:, 1] * texture.size[0] + texels.pixels[:, 0]
    assert texture.size == texels.texture_size and (len(texture.views), len(texture.lights)) == (16, 9)
    np.testing.assert_allclose(texture.color.weights[rows], color.weights, atol=5e-4)
    np.testing.assert_allclose(texture.color.basis, color.basis, rtol=1e-3, atol=1e-3)
    assert texture.alpha.basis.shape == (16, 2, 1)
    assert texture.pbr_alpha.max() == 1.0


@pytest.mark.slow
def test_a_folder_contains_an_image_per_view_and_light(cloud, tmp_path):
    folder = export(cloud, tmp_path / "Ordner ü")
    (level,) = cloud.levels
    texture = read_relightable_texture(level)
    paths = sorted(folder.glob("tv*/tl*.exr"))
    assert len(paths) == 16 * 9 and len(list((folder / "coverage").iterdir())) == 16
    assert all(path.stem.endswith(path.parent.name) for path in paths)
    angles = np.loadtxt(folder / "views.txt")
    view, light = 5, 2

    names = [
        f"t{letter}{round(polar):03d}_p{letter}{round(azimuth):03d}"
        for letter, (_, polar, azimuth) in (("v", angles[view]), ("l", np.loadtxt(folder / "lights.txt")[light]))
    ]
    assert angles[view, 0] == view + 1
    expected = decode_radiance(texture, texture.views.directions[view], texture.lights.directions[light])
    read = read_image(folder / names[0] / f"{names[1]}_{names[0]}.exr")[..., :3]
    np.testing.assert_allclose(read, expected, rtol=1e-3, atol=1e-6)
    coverage = read_image(folder / "coverage" / f"{names[0]}.exr")[..., 0]
    np.testing.assert_allclose(coverage, texture.coverage(texture.views.directions[view]), atol=1e-3)
    header = paths[0].read_bytes()[:400]
    assert header.count(b"\0\1\0\0\0") >= 3, "channels are half floats"


@pytest.mark.slow
def test_a_btf_file_decodes_to_the_same_radiance(cloud, tmp_path):
    file = read_fmf(export(cloud, tmp_path / "cloud.btf", ExportSettings()))
    texture = read_relightable_texture(cloud.levels[0])
    directions = bonn_directions()
    assert (len(file.views), len(file.lights), file.size) == (81, 81, texture.size)
    expected = decode_radiance(texture, directions[40], directions[7])
    np.testing.assert_allclose(np.maximum(file.decode_image(40, 7), 0.0), expected, atol=1e-4)
    assert file.header["per_millimeter"] == pytest.approx(0.001 / read_level_texels(cloud.levels[0]).texel_size)


def test_a_glb_contains_the_normals_of_the_pbr_maps(cloud, tmp_path):
    (level,) = cloud.levels
    texels = read_level_texels(level)
    pbr_material = bpy.data.materials[level[PBR_MATERIAL]]
    normals = next(node.image for node in pbr_material.node_tree.nodes if node.label == FRONT_NORMAL)
    x, y = texels.pixels.T
    inside = read_pixels(next(node.image for node in pbr_material.node_tree.nodes if node.label == FRONT_COLOR))[y, x, 3] > 0.9
    expected = 2.0 * read_pixels(normals)[y, x, :3] - 1.0
    before = blender_scenes.count_data()
    path = export(cloud, tmp_path / "cloud.glb")
    assert blender_scenes.count_data() == before

    blender_scenes.reset_scene()
    bpy.ops.import_scene.gltf(filepath=str(path))
    (imported,) = [item for item in bpy.data.objects if item.type == "MESH"]
    nodes = imported.data.materials[0].node_tree.nodes
    shader = nodes["Principled BSDF"]
    assert shader.inputs["Base Color"].is_linked
    normal_map = next(node.inputs["Color"].links[0].from_node.image for node in nodes if node.type == "NORMAL_MAP")
    local = 2.0 * read_pixels(normal_map)[y, x, :3] - 1.0
    assert (local[:, 2] >= -0.01).all()
    # The tangent frame of every texel as an importer computes it: from the positions, UVs and normals in the file only.
    frames = read_frames(imported, texels)
    world_normals = np.einsum("nij,ni->nj", frames, local)
    facing = np.einsum("ni,ni->n", frames[:, 2], expected) > 0.05
    mask = inside & facing
    assert mask.mean() > 0.5
    np.testing.assert_allclose(world_normals[mask], expected[mask], atol=0.03)


def test_a_glb_leaves_out_properties_that_json_cannot_store(cloud, tmp_path, capfd):
    """The switch distance is infinite for an orthographic camera that always shows the error."""
    (level,), scene = cloud.levels, bpy.context.scene
    level["farfield_switch_distance"], level["limits"], level["kept"] = float("inf"), {"low": [0.0, float("nan")]}, {"low": [0.0, 1.0]}
    scene["size"] = float("nan")
    job = prepare_export(cloud.levels, tmp_path / "cloud.glb", BAKED)
    assert run_to_end(run_job(job)) == " ".join(['Wrote "cloud.glb".', *job.remarks])
    assert job.remarks == [
        f'The .glb lacks farfield_switch_distance, limits of "{level.name}".',
        f'The .glb lacks size of "{scene.name}".',
    ]
    extras = next(node["extras"] for node in load_glb((tmp_path / "cloud.glb").read_bytes())["nodes"] if "extras" in node)
    assert "farfield_error" in extras and extras["kept"] == {"low": [0.0, 1.0]} and not {"farfield_switch_distance", "limits"} & set(extras)
    assert np.isinf(level["farfield_switch_distance"]) and np.isnan(level["limits"]["low"][1]) and np.isnan(scene["size"])
    assert capfd.readouterr().err == ""


def test_an_error_of_the_exporter_of_glb_files_is_one_sentence(cloud, tmp_path, capfd):
    (tmp_path / "cloud.glb").mkdir()
    with pytest.raises(FileError, match=r"^Blender's glTF exporter failed: \[Errno \d+\] [^\n]*cloud\.glb'\.$"):
        write_glb(cloud.levels, tmp_path / "cloud.glb")
    assert capfd.readouterr().err == ""


def read_frames(item, texels) -> np.ndarray:
    """Return tangent, bitangent and normal (N, 3, 3) in world space at every texel of an imported mesh."""
    mesh, matrix = item.data, np.array(item.matrix_world)[:3, :3]
    mesh.calc_loop_triangles()
    uvs = np.array([corner.uv for corner in mesh.uv_layers[0].data])
    frames = np.zeros((len(texels), 3, 3))
    uv = (texels.pixels + 0.5) / texels.texture_size
    for triangle in mesh.loop_triangles:
        positions = np.array([mesh.vertices[vertex].co for vertex in triangle.vertices]) @ matrix.T
        corners = uvs[list(triangle.loops)]
        edges = np.linalg.solve(corners[1:] - corners[0], positions[1:] - positions[0])
        normal = matrix @ np.array(triangle.split_normals[0])
        edges -= (edges @ normal)[:, None] * normal  # The normals of a mesh of a solid part are those of the plane of a chart.
        frame = np.stack([edges[0] / np.linalg.norm(edges[0]), edges[1] / np.linalg.norm(edges[1]), normal])
        low, high = corners.min(axis=0), corners.max(axis=0)
        frames[((uv > low - 0.001) & (uv < high + 0.001)).all(axis=1)] = frame
    return frames


def test_textures_of_another_version_are_rejected(cloud):
    material = cloud.levels[0].data.materials[0]
    material["farfield_btf_layout"] = {**material["farfield_btf_layout"], "version": 1}
    with pytest.raises(GeometryError, match="another version of Farfield; bake them again"):
        read_relightable_texture(cloud.levels[0])


@pytest.mark.parametrize("layout", ["text", 3, [1, 2]])
def test_a_layout_that_is_none_counts_as_no_relightable_textures(cloud, layout):
    cloud.levels[0].data.materials[0]["farfield_btf_layout"] = layout
    with pytest.raises(GeometryError, match="has no relightable textures; bake them first"):
        read_relightable_texture(cloud.levels[0])


def edit(level: bpy.types.Object) -> None:
    bpy.context.view_layer.objects.active = level
    bpy.ops.object.mode_set(mode="EDIT")


def set_uv(level: bpy.types.Object, value: float) -> None:
    level.data.uv_layers[0].uv[0].vector.x = value


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (edit, "is in Edit Mode; switch to Object Mode first"),
        (lambda level: level.data.vertices[0].co.__setitem__(0, float("nan")), "was changed .*: its vertices are not finite"),
        (lambda level: set_uv(level, float("nan")), "was changed .*: its UV map leaves the atlas"),
        (lambda level: set_uv(level, 1e6), "was changed .*: its UV map leaves the atlas"),
        (lambda level: level.data.clear_geometry(), "was changed .*: it has no quads"),
        (lambda level: level.__setitem__("farfield_atlas", [10**6, 10**6]), "was changed .*: the size of its atlas"),
        (lambda level: level.__setitem__("farfield_atlas", [1, 2]), "was changed .*: its images have another size than its atlas"),
        (lambda level: level.__delitem__("farfield_error"), "was changed .*: its error is not a positive number"),
    ],
    ids=["edit mode", "vertex", "uv", "far uv", "geometry", "large atlas", "small atlas", "error"],
)
def test_textures_of_quads_that_cannot_be_read_are_rejected(cloud, tmp_path, change, message):
    """Parallax offsets and the normals of a .glb need the quads."""
    change(cloud.levels[0])
    for name in ("images", "cloud.glb"):
        with pytest.raises(GeometryError, match=message):
            prepare_export(cloud.levels, tmp_path / name, BAKED)


def test_a_level_whose_transform_is_not_finite_does_not_become_a_glb(cloud, tmp_path):
    cloud.levels[0].scale.x = float("nan")
    with pytest.raises(GeometryError, match="has a transform that is not finite; clear it"):
        prepare_export(cloud.levels, tmp_path / "cloud.glb", BAKED)


@pytest.mark.parametrize("label", ["Chromaticity", "Alpha Basis"])
def test_damaged_images_are_named(cloud, label):
    nodes = nodes_in(cloud.levels[0].data.materials[0].node_tree)
    blender_scenes.damage_packed_image(next(node.image for node in nodes if node.label == label))
    with pytest.raises(GeometryError, match=f'The image "{label}" .* is damaged; bake them again'):
        read_relightable_texture(cloud.levels[0])


def test_images_of_another_size_than_the_atlas_are_rejected(cloud):
    bpy.data.images[f"{cloud.levels[0].name} BTF Chromaticity"].scale(7, 7)
    with pytest.raises(GeometryError, match="have another size than its atlas; bake them again"):
        read_relightable_texture(cloud.levels[0])


@pytest.mark.parametrize(("size", "limit"), [((8, 6), 0), ((8, 6), 400), ((64, 48), 0), ((64, 48), 5000)])
def test_a_full_disk_is_noticed(tmp_path, size, limit):
    """Blender does not notice it with small images, which it writes in one go at their end. A limit on file sizes simulates the disk."""
    resource = pytest.importorskip("resource")
    pixels = np.random.default_rng(0).random((*size[::-1], 3))
    handler, limits = signal.signal(signal.SIGXFSZ, signal.SIG_IGN), resource.getrlimit(resource.RLIMIT_FSIZE)
    with render_scene("Farfield Images") as work:
        image = image_folders._new_image(work, size)
        image_folders._save_image(work, image, pixels, tmp_path / "complete.exr")
        assert (tmp_path / "complete.exr").stat().st_size > limit
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limits[1]))
            with pytest.raises((FileError, RuntimeError), match=r"truncated|could not be saved"):
                image_folders._save_image(work, image, pixels, tmp_path / "image.exr")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
            signal.signal(signal.SIGXFSZ, handler)


def test_moved_quads_are_exported(cloud, tmp_path):
    cloud.levels[0].data.vertices[0].co.x = 1e30
    assert (export(cloud, tmp_path / "images") / "coverage").is_dir()


@pytest.mark.slow
def test_an_octahedral_atlas_is_captured_from_the_source(cloud, tmp_path, monkeypatch):
    assert inspect.signature(export_job.write_octahedral_atlas).parameters["frames_per_side"].default == 12
    capture_small = partial(export_job.write_octahedral_atlas, frames_per_side=5, frame_resolution=32, samples=8)
    monkeypatch.setattr(export_job, "write_octahedral_atlas", capture_small)
    before = blender_scenes.count_data()
    folder = export(cloud, tmp_path / "Bällchen.octahedral")
    assert blender_scenes.count_data() == before
    metadata = json.loads((folder / "octahedral_atlas.json").read_text(encoding="utf-8"))
    assert (metadata["frames_per_side"], metadata["map"], len(metadata["frames"])) == (5, "octahedral", 25)
    alpha = read_image(folder / metadata["maps"]["color"]["file"])[..., 3]
    assert alpha.shape == (5 * 32, 5 * 32)
    # A ball of radius 1 covers the same fraction of each frame.
    coverage = alpha.reshape(5, 32, 5, 32).mean(axis=(1, 3))
    np.testing.assert_allclose(coverage, np.pi * (1.0 / metadata["half_side"]) ** 2 / 4.0, rtol=0.02)


@pytest.mark.parametrize("value", [float("nan"), 3e38])
def test_an_octahedral_atlas_needs_a_source_with_coordinates_that_can_be_rendered(cloud, tmp_path, value):
    bpy.data.objects["Bällchen"].scale.x = value
    job = prepare_export(cloud.levels, tmp_path / "a.octahedral", BAKED)
    with pytest.raises(GeometryError, match=r'"Bällchen" has [\d,]+ vertices with coordinates (that are not finite|above)'):
        run_to_end(run_job(job))
    assert not list(tmp_path.iterdir())


def test_an_octahedral_atlas_needs_the_source(cloud, tmp_path):
    bpy.data.objects.remove(bpy.data.objects["Bällchen"])
    with pytest.raises(GeometryError, match=r"Source objects of .* are missing"):
        prepare_export(cloud.levels, tmp_path / "a.octahedral", BAKED)


@pytest.mark.slow
def test_each_level_is_written_to_its_own_file(tmp_path):
    cloud = build_small_cloud()
    for level in cloud.levels:
        assign_random_textures(level, FEW_DIRECTIONS)
    export(cloud, tmp_path / "ball.btf")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ball_Ball_Cloud_L0.btf", "ball_Ball_Cloud_L1.btf"]
    export(cloud, tmp_path / "ball.glb")
    assert (tmp_path / "ball.glb").stat().st_size > 1000


@pytest.mark.parametrize("change", [lambda materials: materials.clear(), lambda materials: materials.__setitem__(0, None)])
def test_a_removed_relightable_material_can_be_restored_as_pbr(cloud, change):
    (level,) = cloud.levels
    change(level.data.materials)
    assert bpy.ops.farfield.btf_link_suns() == bpy.ops.farfield.btf_restore_pbr() == {"FINISHED"}
    assert level.data.materials[0].node_tree is not None and PBR_MATERIAL not in level


def test_names_of_levels_do_not_choose_folders(tmp_path):
    cloud = build_small_cloud()
    for level, name in zip(cloud.levels, ("../../escaped", f"{tmp_path}/absolute"), strict=True):
        level.name = name
        assign_random_textures(level, FEW_DIRECTIONS)
    folder = tmp_path / "jail" / "exports"
    export(cloud, folder / "ball.btf")
    export(cloud, folder / "images")
    assert sorted(path.suffix for path in folder.iterdir()) == ["", ".btf", ".btf"] and len(list((folder / "images").iterdir())) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["jail"] and [path.name for path in folder.parent.iterdir()] == ["exports"]


def test_objects_renamed_during_an_export_are_found(cloud, tmp_path):
    job = prepare_export(cloud.levels, tmp_path / "cloud.glb", BAKED)
    run_to_end(job.core_steps())
    cloud.levels[0].name = "Another"
    run_to_end(job.scene_steps(None))
    assert (tmp_path / "cloud.glb").exists()
    job = prepare_export(cloud.levels, tmp_path / "removed.glb", BAKED)
    bpy.data.objects.remove(cloud.levels[0])
    with pytest.raises(GeometryError, match="was removed while it was being exported"):
        run_to_end(job.scene_steps(None))
    assert [path.name for path in tmp_path.iterdir()] == ["cloud.glb"]


def test_a_cancelled_export_leaves_no_files(cloud, tmp_path):
    steps = run_job(prepare_export(cloud.levels, tmp_path / "folder", BAKED))
    for _ in range(30):
        next(steps)
    assert any(tmp_path.iterdir())
    steps.close()
    assert not any(tmp_path.iterdir())
    assert not [scene for scene in bpy.data.scenes if scene.name.startswith("Farfield")]


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("cloud.obj", FileError, r"\.glb .*\.btf .*no suffix"),
        ("full", FileError, "not empty"),
        ("cloud.btf", SettingsError, "equal numbers"),
    ],
)
def test_invalid_targets_are_rejected(cloud, tmp_path, name, error, message):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file.txt").touch()
    with pytest.raises(error, match=message):
        export(cloud, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["full"]


def test_errors_name_a_folder_that_cannot_be_created(cloud, tmp_path):
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    for name in ("cloud.glb", "cloud.btf", "cloud"):
        with pytest.raises(FileError, match="file"):
            export(cloud, tmp_path / "file" / name, ExportSettings())


def test_pbr_clouds_and_missing_images_are_rejected(cloud, tmp_path):
    bpy.data.images.remove(bpy.data.images[f"{cloud.levels[0].name} BTF Chromaticity"])
    with pytest.raises(GeometryError, match=r'The image "Chromaticity" .* is missing'):
        export(cloud, tmp_path / "cloud.btf")
    bpy.ops.farfield.btf_restore_pbr()
    with pytest.raises(GeometryError, match="bake them first"):
        export(cloud, tmp_path / "cloud.btf")
    assert not bpy.ops.farfield.btf_export.poll()


@pytest.mark.slow
def test_the_operator_writes_the_format_of_its_suffix(cloud, tmp_path):
    path = tmp_path / "cloud.btf"
    assert bpy.ops.farfield.btf_export(filepath=str(path), directions="bonn") == {"FINISHED"}
    assert read_fmf(path).size == read_relightable_texture(cloud.levels[0]).size
    with pytest.raises(RuntimeError, match="cannot be written as"):
        bpy.ops.farfield.btf_export(filepath=str(tmp_path / "cloud.png"))
