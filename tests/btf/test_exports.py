"""What goes out to other programs says what the textures show, and appears whole or not at all."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes
from farfield.addon.bridge.btf_clouds import texels_of_level, wear
from farfield.addon.bridge.btf_reading import baked_atlas
from farfield.addon.bridge.cloud_materials import FRONT_NORMAL
from farfield.addon.bridge.images import pixels_of
from farfield.addon.core.btf.compression import Compressed
from farfield.addon.core.btf.factors import Factors
from farfield.addon.core.btf.settings import BtfSettings, ExportSettings
from farfield.addon.core.directions import bonn_directions
from farfield.addon.core.errors import FileError, GeometryError, SettingsError
from farfield.addon.core.progress import finish
from farfield.addon.operators import btf_export_job
from farfield.addon.operators.billboards_clouds import clouds_in
from farfield.addon.operators.btf_export_job import prepare
from farfield.addon.operators.long_work import whole
from fmf_reader import read_fmf
from made_atlases import decoded, made_colour

SETTINGS = BtfSettings(views=16, lights=9)
BAKED = ExportSettings(directions="baked")


@pytest.fixture(autouse=True)
def fresh_scene(extension):
    blender_scenes.fresh()


@pytest.fixture(scope="module")
def cloud_file(extension, tmp_path_factory) -> Path:
    """A file with the cloud of a ball, active, in relightable textures of random numbers."""
    blender_scenes.fresh()
    ball = blender_scenes.ball("Bällchen", blender_scenes.material("Red", (0.8, 0.2, 0.1), 1.0))
    bpy.context.view_layer.objects.active = ball
    ball.select_set(True)
    bpy.ops.farfield.billboards_build(error=8.0, levels=1, samples=4)
    made = clouds_in(bpy.context.scene)[0]
    dress(made.levels[0])
    bpy.context.view_layer.objects.active = made.levels[0]
    path = tmp_path_factory.mktemp("cloud") / "cloud.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture
def cloud(cloud_file):
    """The cloud of `cloud_file`."""
    bpy.ops.wm.open_mainfile(filepath=str(cloud_file))
    return clouds_in(bpy.context.scene)[0]


def dress(level) -> None:
    texels = texels_of_level(level)
    random = np.random.default_rng(0)
    colour = made_colour(len(texels), views=16, lights=9)
    alpha = Factors(random.random((len(texels), 2), np.float32), random.normal(size=(16, 2, 1)).astype(np.float32), colour.known)
    hues = random.uniform(0.5, 1.5, (len(texels), 3)).astype(np.float32)
    wear(level, texels, Compressed(None, hues, colour, alpha), SETTINGS)


def exported(cloud, target: Path, settings: ExportSettings = BAKED) -> Path:
    finish(whole(prepare(cloud.levels, target, settings)))
    return target


def pixels_in(path: Path) -> np.ndarray:
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.is_data = True
    return pixels_of(image)


def test_textures_come_back_out_of_the_material(cloud):
    (level,) = cloud.levels
    texels, atlas = texels_of_level(level), baked_atlas(level)
    colour = made_colour(len(texels), views=16, lights=9)
    rows = texels.pixels[:, 1] * atlas.size[0] + texels.pixels[:, 0]
    assert atlas.size == texels.size and (len(atlas.views), len(atlas.lights)) == (16, 9)
    np.testing.assert_allclose(atlas.colour.weights[rows], colour.weights, atol=5e-4)
    np.testing.assert_allclose(atlas.colour.basis, colour.basis, rtol=1e-3, atol=1e-3)
    assert atlas.alpha.basis.shape == (16, 2, 1)
    assert atlas.plain.max() == 1.0


def test_a_folder_holds_a_picture_for_each_view_and_light(cloud, tmp_path):
    folder = exported(cloud, tmp_path / "Ordner ü")
    (level,) = cloud.levels
    atlas = baked_atlas(level)
    pictures = sorted(folder.glob("tv*/tl*.exr"))
    assert len(pictures) == 16 * 9 and len(list((folder / "coverage").iterdir())) == 16
    assert all(path.stem.endswith(path.parent.name) for path in pictures)
    angles = np.loadtxt(folder / "views.txt")
    view, light = 5, 2
    number = angles[view, 0]
    names = [
        f"t{letter}{round(each[1]):03d}_p{letter}{round(each[2]):03d}"
        for letter, each in (("v", angles[view]), ("l", np.loadtxt(folder / "lights.txt")[light]))
    ]
    assert number == view + 1
    expected = decoded(atlas, atlas.views.directions[view], atlas.lights.directions[light])
    read = pixels_in(folder / names[0] / f"{names[1]}_{names[0]}.exr")[..., :3]
    np.testing.assert_allclose(read, expected, rtol=1e-3, atol=1e-6)
    coverage = pixels_in(folder / "coverage" / f"{names[0]}.exr")[..., 0]
    np.testing.assert_allclose(coverage, atlas.coverage(atlas.views.directions[view]), atol=1e-3)
    header = pictures[0].read_bytes()[:400]
    assert header.count(b"\0\1\0\0\0") >= 3, "channels are half floats"


def test_a_btf_file_holds_the_same(cloud, tmp_path):
    file = read_fmf(exported(cloud, tmp_path / "cloud.btf", ExportSettings()))
    atlas = baked_atlas(cloud.levels[0])
    directions = bonn_directions()
    assert (len(file.views), len(file.lights), file.size) == (81, 81, atlas.size)
    expected = decoded(atlas, directions[40], directions[7])
    np.testing.assert_allclose(np.maximum(file.image(40, 7), 0.0), expected, atol=1e-4)
    assert file.header["per_millimetre"] == pytest.approx(0.001 / texels_of_level(cloud.levels[0]).side)


def test_a_glb_holds_the_normals_of_the_plain_maps(cloud, tmp_path):
    (level,) = cloud.levels
    texels = texels_of_level(level)
    plain = bpy.data.materials[level["farfield_plain_material"]]
    normals = next(node.image for node in plain.node_tree.nodes if node.label == FRONT_NORMAL)
    x, y = texels.pixels.T
    inside = pixels_of(next(node.image for node in plain.node_tree.nodes if node.label == "Front colour"))[y, x, 3] > 0.9
    meant = 2.0 * pixels_of(normals)[y, x, :3] - 1.0
    before = blender_scenes.counts()
    path = exported(cloud, tmp_path / "cloud.glb")
    assert blender_scenes.counts() == before

    blender_scenes.fresh()
    bpy.ops.import_scene.gltf(filepath=str(path))
    (read,) = [item for item in bpy.data.objects if item.type == "MESH"]
    nodes = read.data.materials[0].node_tree.nodes
    shader = nodes["Principled BSDF"]
    assert shader.inputs["Base Color"].is_linked
    picture = next(node.inputs["Color"].links[0].from_node.image for node in nodes if node.type == "NORMAL_MAP")
    local = 2.0 * pixels_of(picture)[y, x, :3] - 1.0
    assert (local[:, 2] >= -0.01).all()
    # The frame of every texel as a reader finds it: from positions, texture coordinates and vertex normals of the file alone.
    frames = frames_read(read, texels)
    shown = np.einsum("nij,ni->nj", frames, local)
    facing = np.einsum("ni,ni->n", frames[:, 2], meant) > 0.05
    chosen = inside & facing
    assert chosen.mean() > 0.5
    np.testing.assert_allclose(shown[chosen], meant[chosen], atol=0.03)


def frames_read(item, texels) -> np.ndarray:
    """(N, 3, 3): directions of the texture's x and y and the normal, in the world, at every texel, from an imported mesh."""
    mesh, matrix = item.data, np.array(item.matrix_world)[:3, :3]
    mesh.calc_loop_triangles()
    uvs = np.array([corner.uv for corner in mesh.uv_layers[0].data])
    frames = np.zeros((len(texels), 3, 3))
    at = (texels.pixels + 0.5) / texels.size
    for triangle in mesh.loop_triangles:
        positions = np.array([mesh.vertices[vertex].co for vertex in triangle.vertices]) @ matrix.T
        corners = uvs[list(triangle.loops)]
        edges = np.linalg.solve(corners[1:] - corners[0], positions[1:] - positions[0])
        normal = matrix @ np.array(triangle.split_normals[0])
        frame = np.stack([edges[0] / np.linalg.norm(edges[0]), edges[1] / np.linalg.norm(edges[1]), normal])
        low, high = corners.min(axis=0), corners.max(axis=0)
        frames[((at > low - 0.001) & (at < high + 0.001)).all(axis=1)] = frame
    return frames


def test_textures_of_another_version_are_refused(cloud):
    material = cloud.levels[0].data.materials[0]
    material["farfield_btf"] = {**material["farfield_btf"], "version": 1}
    with pytest.raises(GeometryError, match="another version of Farfield; bake them again"):
        baked_atlas(cloud.levels[0])


def test_an_octahedral_atlas_is_taken_from_the_original(cloud, tmp_path, monkeypatch):
    small = partial(btf_export_job.write_octahedral_atlas, resolution=32, samples=8)  # 144 pictures a map as ever, a few seconds
    monkeypatch.setattr(btf_export_job, "write_octahedral_atlas", small)
    before = blender_scenes.counts()
    folder = exported(cloud, tmp_path / "Bällchen.octahedral")
    assert blender_scenes.counts() == before
    words = json.loads((folder / "octahedral_atlas.json").read_text(encoding="utf-8"))
    assert (words["frames"], words["map"], len(words["pictures"])) == (12, "octahedral", 144)
    alpha = pixels_in(folder / words["maps"]["colour"]["file"])[..., 3]
    assert alpha.shape == (12 * 32, 12 * 32)
    # A ball of radius 1 covers the same part of each picture.
    shares = alpha.reshape(12, 32, 12, 32).mean(axis=(1, 3))
    np.testing.assert_allclose(shares, np.pi * (1.0 / words["half_side"]) ** 2 / 4.0, rtol=0.02)


def test_without_its_original_there_is_no_octahedral_atlas(cloud, tmp_path):
    bpy.data.objects.remove(bpy.data.objects["Bällchen"])
    with pytest.raises(GeometryError, match=r"The original of .* is gone"):
        prepare(cloud.levels, tmp_path / "a.octahedral", BAKED)


def test_several_levels_get_a_file_each(tmp_path):
    ball = blender_scenes.ball()
    bpy.context.view_layer.objects.active = ball
    bpy.ops.farfield.billboards_build(error=8.0, levels=2, samples=1)
    cloud = clouds_in(bpy.context.scene)[0]
    for level in cloud.levels:
        dress(level)
    exported(cloud, tmp_path / "ball.btf", ExportSettings())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ball_Ball_Cloud_L0.btf", "ball_Ball_Cloud_L1.btf"]
    exported(cloud, tmp_path / "ball.glb")
    assert (tmp_path / "ball.glb").stat().st_size > 1000


def test_a_stopped_export_leaves_nothing(cloud, tmp_path):
    steps = whole(prepare(cloud.levels, tmp_path / "folder", BAKED))
    for _ in range(30):
        next(steps)
    assert any(tmp_path.iterdir())
    steps.close()
    assert not any(tmp_path.iterdir())
    assert not [scene for scene in bpy.data.scenes if scene.name.startswith("Farfield")]


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("cloud.obj", FileError, r"\.glb .*\.btf .*no ending"),
        ("full", FileError, "not empty"),
        ("cloud.btf", SettingsError, "as many lights"),
    ],
)
def test_what_cannot_be_written_is_refused(cloud, tmp_path, name, error, words):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").touch()
    with pytest.raises(error, match=words):
        exported(cloud, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["full"]


def test_a_folder_that_cannot_be_made_is_named(cloud, tmp_path):
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    for name in ("cloud.glb", "cloud.btf", "cloud"):
        with pytest.raises(FileError, match="file"):
            exported(cloud, tmp_path / "file" / name, ExportSettings())


def test_plain_clouds_and_lost_images_are_refused(cloud, tmp_path):
    bpy.data.images.remove(bpy.data.images[f"{cloud.levels[0].name} BTF Tints"])
    with pytest.raises(GeometryError, match='lost the image "Tints"'):
        exported(cloud, tmp_path / "cloud.btf")
    bpy.ops.farfield.btf_plain()
    with pytest.raises(GeometryError, match="bake them first"):
        exported(cloud, tmp_path / "cloud.btf")
    assert not bpy.ops.farfield.btf_export.poll()


def test_the_operator_writes_what_its_file_says(cloud, tmp_path):
    path = tmp_path / "cloud.btf"
    assert bpy.ops.farfield.btf_export(filepath=str(path), directions="bonn") == {"FINISHED"}
    assert read_fmf(path).size == baked_atlas(cloud.levels[0]).size
    with pytest.raises(RuntimeError, match="cannot be written as"):
        bpy.ops.farfield.btf_export(filepath=str(tmp_path / "cloud.png"))
