"""`scripts/btf.py`: a file with a cloud in, a relightable one out, and what other programs read beside it."""

import json
import shutil

import bpy
import pytest

import btf
import command_line
import scene_files
from bridge import blender_scenes
from farfield.addon.bridge.btf_materials import CLUSTERS
from farfield.addon.bridge.btf_reading import baked_atlas
from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.operators.billboards_clouds import clouds_in
from fmf_reader import read_fmf

QUICK = ("--views", "4", "--lights", "4", "--samples", "1", "--shadows", "16")


@pytest.fixture(scope="module")
def made_once(extension, tmp_path_factory):
    """A file with a ball and its cloud of one level."""
    blender_scenes.fresh()
    ball = blender_scenes.ball("Bällchen")
    bpy.context.view_layer.objects.active = ball
    bpy.ops.farfield.billboards_build(error=10.0, levels=1, samples=1)
    path = tmp_path_factory.mktemp("cloud") / "in.blend"
    scene_files.save_scene(path)
    return path


@pytest.fixture
def cloud_file(made_once, tmp_path):
    """That file in a folder of its own."""
    return shutil.copy(made_once, tmp_path / "in.blend")


def main(*arguments) -> None:
    btf.main([str(argument) for argument in arguments], command_line.ProgressLine())


def test_exports_stand_beside_the_result(cloud_file):
    folder = cloud_file.parent
    exports = [word for name in ("cloud.glb", "cloud.btf", "pictures") for word in ("--export", folder / name)]
    main(cloud_file, "--out", folder / "out.blend", *QUICK, "--directions", "baked", *exports, "--report", folder / "r.json")
    assert {path.name for path in folder.iterdir()} == {"in.blend", "out.blend", "cloud.glb", "cloud.btf", "pictures", "r.json"}
    assert len(list((folder / "pictures").glob("tv*/*.exr"))) == 16
    assert len(read_fmf(folder / "cloud.btf").views) == 4
    assert json.loads((folder / "r.json").read_text(encoding="utf-8"))["seconds"]["export"] > 0.0


def test_local_pca_is_asked_for_by_name(cloud_file):
    folder = cloud_file.parent
    local = ("--codec", "lpca", "--clusters", "3", "--cluster-components", "2", "--no-blend-texels")
    main(cloud_file, "--out", folder / "out.blend", *QUICK, *local, "--report", folder / "r.json", "--curve", folder / "Kurve ü.png")
    report = json.loads((folder / "r.json").read_text(encoding="utf-8"))
    scene_files.open_scene(folder / "out.blend")
    (level,) = clouds_in(bpy.context.scene)[0].levels
    atlas = baked_atlas(level)
    assert (atlas.colour.clusters, atlas.colour.components) == (3, 2)
    assert len(set(atlas.colour.labels)) > 1
    assert any(node.label == CLUSTERS for node in level.data.materials[0].node_tree.nodes)
    texels, numbers = report["levels"][0]["texels"], 3 * 2 * 4 * 5 * 3
    assert [fit["components"] for fit in report["levels"][0]["fits"]] == [0, 1, 2]
    assert (folder / "Kurve ü.png").read_bytes().startswith(b"\x89PNG")
    assert report["compressed_bytes"] == 2 * (texels * (3 + 9 + 2 + 13 + 24) + numbers + 13 * 4 + 24 * 16) + texels


@pytest.mark.parametrize(
    ("flags", "error", "words"),
    [
        (("--export", "{folder}/cloud.obj"), FileError, "must have one of these endings"),
        (("--export", "{folder}"), FileError, "is not empty"),
        (("--codec", "lpca", "--clusters", "256", "--views", "256"), SettingsError, r"a table of 46080 x \d+ pixels"),
        (("--components", "64", "--views", "1024", "--lights", "1024"), SettingsError, "take fewer of one of them"),
        (("--directions", "sideways"), SystemExit, "2"),
    ],
)
def test_what_cannot_be_done_is_refused_before_the_bake(cloud_file, flags, error, words):
    folder = cloud_file.parent
    with pytest.raises(error, match=words):
        main(cloud_file, "--out", folder / "out.blend", *(flag.format(folder=folder) for flag in flags))
    assert [path.name for path in folder.iterdir()] == ["in.blend"]
