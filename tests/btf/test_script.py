"""`scripts/btf.py` writes a file with a relightable cloud, and exports for other programs."""

import json
import shutil

import bpy
import pytest

import btf
from bridge import blender_scenes
from bridge.bakes import to_flags
from farfield.addon.bridge.billboards.scene_clouds import clouds_in
from farfield.addon.bridge.btf.levels.decode import read_relightable_texture
from farfield.addon.bridge.btf.materials.emission_material import CLUSTERS
from farfield.addon.core.errors import FileError, GeometryError, SettingsError
from fmf_reader import read_fmf
from lib import command_line, scene_files

EMISSION = ("--model", "emission")
QUICK = to_flags(
    {"model": "emission", "views_per_side": 2, "lights_per_side": 2, "samples": 1, "shadows_per_side": 4, "executor": "serial"}
)


@pytest.fixture(scope="module")
def shared_cloud_file(extension, tmp_path_factory):
    """A file with a ball and its cloud with one level."""
    blender_scenes.reset_scene()
    ball = blender_scenes.ball("Bällchen")
    bpy.context.view_layer.objects.active = ball
    bpy.ops.farfield.billboards_build(error=10.0, levels=1, samples=1, solid_parts="quads")
    path = tmp_path_factory.mktemp("cloud") / "in.blend"
    scene_files.save_scene(path)
    return path


@pytest.fixture
def cloud_file(shared_cloud_file, tmp_path):
    """A copy of that file in its own folder."""
    return shutil.copy(shared_cloud_file, tmp_path / "in.blend")


def main(*arguments) -> None:
    btf.main([str(argument) for argument in arguments], command_line.ProgressLine())


@pytest.mark.slow
def test_local_pca_with_exports(cloud_file):
    folder = cloud_file.parent
    local = ("--codec", "lpca", "--clusters", "3", "--cluster-components", "2", "--no-blend-texels")
    exports = [argument for name in ("cloud.glb", "cloud.btf", "images") for argument in ("--export", folder / name)]
    outputs = ("--report", folder / "r.json", "--curve", folder / "Kurve ü.png", "--directions", "baked", *exports)
    main(cloud_file, "--out", folder / "out.blend", *QUICK, *local, *outputs)
    assert {path.name for path in folder.iterdir()} == {
        *("in.blend", "out.blend", "cloud.glb", "cloud.btf", "images", "r.json", "Kurve ü.png"),
    }
    assert len(list((folder / "images").glob("tv*/*.exr"))) == 16
    assert len(read_fmf(folder / "cloud.btf").views) == 4
    report = json.loads((folder / "r.json").read_text(encoding="utf-8"))
    assert report["seconds"]["export"] > 0.0
    scene_files.open_scene(folder / "out.blend")
    (level,) = clouds_in(bpy.context.scene)[0].levels
    texture = read_relightable_texture(level)
    assert (texture.color.clusters, texture.color.components) == (3, 2)
    assert len(set(texture.color.labels)) > 1
    assert any(node.label == CLUSTERS for node in level.data.materials[0].node_tree.nodes)
    texels, basis_values = report["levels"][0]["texels"], 3 * 2 * 4 * 5 * 3
    assert [fit["components"] for fit in report["levels"][0]["component_errors"]] == [0, 1, 2]
    assert (folder / "Kurve ü.png").read_bytes().startswith(b"\x89PNG")
    assert report["compressed_bytes"] == 2 * (texels * (3 + 9 + 2 + 13 + 24) + basis_values + 13 * 4 + 24 * 16) + texels


@pytest.mark.parametrize(
    ("flags", "error", "message"),
    [
        (("--export", "{folder}/cloud.obj"), FileError, "must have one of these suffixes"),
        ((*EMISSION, "--export", "{folder}"), FileError, "is not empty"),
        (
            (*EMISSION, "--codec", "lpca", "--clusters", "256", "--views-per-side", "16"),
            SettingsError,
            r"a lookup table of 46080 x \d+ pixels",
        ),
        ((*EMISSION, "--components", "64", "--views-per-side", "32", "--lights-per-side", "32"), SettingsError, "Reduce one of them"),
        (("--export", "{folder}/cloud.btf"), SettingsError, "add --model emission"),
        (("--curve", "{folder}/c.png"), SettingsError, "add --model emission"),
        (("--directions", "sideways"), SystemExit, "2"),
        (("--work", ""), SystemExit, "2"),
        (("--report", "{folder}/in.blend"), FileError, "same file"),
        (("--curve", "{folder}/c.png", "--report", "{folder}/c.png"), FileError, "same file"),
        (("--export", "{folder}/a.glb", "--export", "{folder}/b/../a.glb"), FileError, "same file"),
        (("--export", "{folder}/a.glb", "--report", "{folder}/a.glb"), FileError, "same file"),
        ((*EMISSION, "--export", "{folder}/in.blend/images"), FileError, "not a folder"),
        (
            (*EMISSION, "--export", "{folder}/a.btf", "--directions", "baked", "--views-per-side", "2", "--lights-per-side", "3"),
            SettingsError,
            "equal numbers of view and light directions, not 4 and 9",
        ),
    ],
)
def test_invalid_arguments_are_rejected_before_the_bake(cloud_file, flags, error, message):
    folder = cloud_file.parent
    with pytest.raises(error, match=message):
        main(cloud_file, "--out", folder / "out.blend", *(flag.format(folder=folder) for flag in flags))
    assert [path.name for path in folder.iterdir()] == ["in.blend"]


def test_levels_that_cannot_be_exported_are_named_before_the_bake(cloud_file):
    scene_files.open_scene(cloud_file)
    clouds_in(bpy.context.scene)[0].levels[0].rotation_euler.x = float("nan")
    scene_files.save_scene(cloud_file)
    with pytest.raises(GeometryError, match=r'The level ".* Cloud L0" has a transform that is not finite; clear it'):
        main(cloud_file, "--out", cloud_file.with_name("out.blend"), "--export", cloud_file.with_name("a.glb"), "--samples", "1")
    assert [path.name for path in cloud_file.parent.iterdir()] == ["in.blend"]
