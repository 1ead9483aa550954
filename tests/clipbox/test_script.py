"""`scripts/clipbox.py`: output files, paths, the report and exit codes."""

import json

import bpy
import numpy as np
import pytest

import bdam
import clipbox
from farfield.addon.bridge.clipbox import objects as terrain_objects
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.errors import FileError, GeometryError, SettingsError
from image_data import write_image
from lib import command_line, environment
from script_runs import run_script
from watertight import directed_edge_counts, open_edges

pytestmark = pytest.mark.usefixtures("empty_scene")
SCRIPT = environment.ROOT / "scripts" / "clipbox.py"
SMALL = ("--boxes", "3", "--resolution", "32", "--threshold", "1")


def run(*arguments):
    clipbox.main([str(argument) for argument in (*SMALL, *arguments)], command_line.ProgressLine())


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "été à la mer"
    path.mkdir()
    return path


def read_ply(path):
    header, _, content = path.read_bytes().partition(b"end_header\n")
    counts = [int(line.split()[2]) for line in header.decode("ascii").splitlines() if line.startswith("element")]
    vertices = np.frombuffer(content, [("position", "<f8", 3), ("normal", "<f4", 3)], counts[0])
    faces = np.frombuffer(content, [("count", "u1"), ("corners", "<i4", 3)], counts[1], vertices.nbytes)
    assert len(content) == vertices.nbytes + faces.nbytes
    return vertices["position"], faces["corners"]


def test_a_ply_contains_the_welded_boxes(folder):
    run("--terrain", "spheres", "--at", "-1,2,3", "--out", folder / "ground.ply", "--report", folder / "report.json")
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    vertices, triangles = read_ply(folder / "ground.ply")
    assert len(triangles) == report["triangles"] == sum(box["triangles"] for box in report["boxes"])
    assert [box["voxel_size"] for box in report["boxes"]] == [1.0, 2.0, 4.0]
    assert {"first build", "voxels", "surface", "write"} <= set(report["seconds"]) and report["peak_memory_mb"] > 0
    assert (directed_edge_counts(triangles) == 1).all()
    on_boundary = np.abs(vertices - [-1, 2, 3]).max(axis=1) > 55
    assert on_boundary[open_edges(triangles)].all()
    bpy.ops.wm.ply_import(filepath=str(folder / "ground.ply"))
    assert len(bpy.context.object.data.polygons) == len(triangles)


def test_an_obj_contains_the_same(folder):
    for ending in ("ply", "obj"):
        run("--terrain", "sine", "--at", "0,0,9", "--out", folder / f"ground.{ending}")
    bpy.ops.wm.obj_import(filepath=str(folder / "ground.obj"), forward_axis="Y", up_axis="Z")
    vertices, triangles = read_ply(folder / "ground.ply")
    mesh = bpy.context.object.data
    assert len(mesh.polygons) == len(triangles) and np.allclose([vertex.co for vertex in mesh.vertices], vertices, atol=1e-4)


def test_an_obj_far_from_the_origin_is_relative_to_a_near_position(folder):
    far = (-3e7, 2e6, 9.0)
    for ending in ("ply", "obj"):
        run("--terrain", "sine", f"--at={','.join(map(str, far))}", "--out", folder / f"ground.{ending}")
    keyword, *numbers = (folder / "ground.obj").read_text(encoding="ascii").partition("\n")[0].removeprefix("# ").split()
    origin = np.array(numbers, float)
    assert keyword == "origin" and np.abs(origin - far).max() <= 9.0
    bpy.ops.wm.obj_import(filepath=str(folder / "ground.obj"), forward_axis="Y", up_axis="Z")
    vertices, _ = read_ply(folder / "ground.ply")
    assert np.allclose([vertex.co for vertex in bpy.context.object.data.vertices], vertices - origin, atol=1e-4)


def test_a_blend_can_contain_regular_meshes_instead(folder):
    run("--convert-to-mesh", "--per-box", "--collider-fraction", "20%", "--at", "10,0,20", "--out", folder / "meshes.blend")
    bpy.ops.wm.open_mainfile(filepath=str(folder / "meshes.blend"))
    assert not terrain_objects.SceneTerrain.in_scene(bpy.context.scene)
    collections = (bpy.data.collections[name] for name in ("Terrain Mesh", "Terrain Mesh Collider"))
    parts = {item.name: len(item.data.polygons) for collection in collections for item in collection.objects}
    assert set(parts) == {"Box 1", "Box 2", "Box 3", "Collider"}
    total = sum(count for name, count in parts.items() if name != "Collider")
    assert 0.1 < parts["Collider"] / total < 0.3


def test_a_blend_contains_a_terrain_that_can_follow(folder):
    out = folder / "ground.blend"
    run("--terrain", "cascades", "--seed", "4", "--at", "10,0,20", "--out", out)
    bpy.ops.wm.open_mainfile(filepath=str(out))
    [terrain] = terrain_objects.SceneTerrain.in_scene(bpy.context.scene)
    assert terrain.settings == ClipboxSettings(terrain="cascades", seed=4, boxes=3, resolution=32, threshold=1)
    assert terrain.viewer.tolist() == [10.0, 0.0, 20.0] and terrain.origin.tolist() == [0.0, 0.0, 0.0]
    blocks = terrain.blocks().values()
    assert len(blocks) > 8 and all(block.data.materials[0] == terrain.material for block in blocks)


@pytest.mark.slow
def test_the_end_of_a_path_equals_a_build_from_scratch(folder):
    path = folder / "path.csv"
    path.write_text("x,y,z\n" + "".join(f"{step},{0.5 * step},20\n" for step in range(1, 9)), encoding="utf-8")
    run("--at", "0,0,20", "--path", path, "--out", folder / "path.ply", "--report", folder / "report.json")
    run("--at", "8,4,20", "--out", folder / "scratch.ply")
    assert sorted(map(tuple, read_ply(folder / "path.ply")[0].tolist())) == sorted(map(tuple, read_ply(folder / "scratch.ply")[0].tolist()))
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert report["moves"] == 9 and report["reused_fraction"] > 0.9
    run("--at", "0,0,20", "--path", path, "--out", folder / "path.blend")
    [terrain] = terrain_objects.SceneTerrain.in_scene(bpy.context.scene)
    assert terrain.viewer.tolist() == [8.0, 4.0, 20.0]
    assert sum(len(block.data.polygons) for block in terrain.blocks().values()) == report["triangles"]


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("--out", "ground.stl"), FileError, r"\.blend, \.ply, \.obj"),
        (("--out", "ground.ply", "--at", "1,2"), SettingsError, "three numbers"),
        (("--out", "ground.ply", "--at", "a,b,c"), SettingsError, "three numbers"),
        (("--out", "ground.ply", "--at", "nan,0,0"), GeometryError, "too far from the origin"),
        (("--out", "ground.ply", "--voxel-size", "0"), SettingsError, "--voxel-size"),
        (("--out", "ground.ply", "--resolution", "31"), SettingsError, "--resolution"),
        (("--out", "ground.ply", "--formula", "x.real"), SettingsError, "is not allowed"),
        (("--out", "ground.ply", "--formula", "-1"), GeometryError, "no surface"),
        (("--out", "ground.blend", "--formula", "1"), GeometryError, "no surface"),
        (("--out", "ground.ply", "--path", "nowhere.csv"), FileError, "does not exist"),
        (("--out", "ground.ply", "--convert-to-mesh"), FileError, "must end in .blend"),
        (("--out", "ground.blend", "--per-box"), SettingsError, "needs --convert-to-mesh"),
        (("--out", "ground.blend", "--convert-to-mesh", "--collider-fraction", "0"), SettingsError, "--collider-fraction"),
    ],
)
def test_invalid_input_gives_one_error_message(folder, monkeypatch, arguments, error, message):
    monkeypatch.chdir(folder)
    with pytest.raises(error, match=message):
        run(*arguments)
    assert not list(folder.iterdir())


@pytest.mark.parametrize("text", ["", "x,y,z\n", "1,2\n", "1,2,drei\n", "\x00"])
def test_a_path_without_positions_is_rejected(folder, text):
    (folder / "path.csv").write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match="path"):
        run("--path", folder / "path.csv", "--out", folder / "ground.ply")


@pytest.mark.slow
def test_exit_codes(folder):
    success, failure = run_script(SCRIPT, [*SMALL, "--out", folder / "a.ply"], [*SMALL, "--out", folder / "b.ply", "--formula", "os"])
    assert success.returncode == 0 and (folder / "a.ply").is_file(), success.stderr
    assert (
        failure.returncode == 2 and failure.stderr.strip().count("\n") == 0 and "os" in failure.stderr and not (folder / "b.ply").exists()
    )


def test_sources_stay_where_they_are_for_the_saved_scene(folder, monkeypatch):
    np.save(folder / "dem.npy", np.zeros((8, 8)))
    monkeypatch.chdir(folder)
    run("--terrain", "heights", "--source", "dem.npy", "--at", "0,0,9", "--out", "ground.blend")
    bpy.ops.wm.open_mainfile(filepath=str(folder / "ground.blend"))
    [terrain] = terrain_objects.SceneTerrain.in_scene(bpy.context.scene)
    assert terrain.settings.source == str(folder / "dem.npy")


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--out", "ground.ply", "--report", "ground.ply"), "same file"),
        (("--out", "ground.ply", "--report", "dem.npy", "--terrain", "heights", "--source", "dem.npy"), "same file"),
        (("--out", "ground.ply", "--path", "path.csv", "--report", "path.csv"), "same file"),
        (("--out", "ground.blend", "--terrain", "heights", "--source", "//dem.npy"), "relative to the .blend file"),
        (("--out", "ground.blend", "--terrain", "heights", "--source", "dem.npy", "--source-color", "a" * 300), "too long"),
    ],
)
def test_paths_are_checked_before_any_work(folder, monkeypatch, flags, message):
    monkeypatch.chdir(folder)
    np.save(folder / "dem.npy", np.zeros((8, 8)))
    (folder / "path.csv").write_text("0,0,0\n")
    with pytest.raises(FileError, match=message):
        run(*flags)
    assert {path.name for path in folder.iterdir()} == {"dem.npy", "path.csv"}


@pytest.mark.parametrize("script", ["clipbox", "bdam"])
def test_a_damaged_openexr_file_is_one_sentence(tmp_path, script, capfd):
    path = write_image(tmp_path / "a.exr", np.random.default_rng(1).random((64, 64, 1), np.float32), {"compression": "piz"})
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    runs = {
        "clipbox": lambda: run("--terrain", "heights", "--source", path, "--out", tmp_path / "out.ply"),
        "bdam": lambda: bdam.main(["build", str(path), "--out", str(tmp_path / "store")], command_line.ProgressLine()),
    }
    with pytest.raises(FileError, match="is damaged or truncated"):
        runs[script]()
    assert capfd.readouterr().err == ""
