"""`scripts/clipbox.py`: kinds of files, paths, the report, exit codes."""

import json
import subprocess
import sys

import bpy
import numpy as np
import pytest

import clipbox
import command_line
import environment
from closed import open_edges, uses_of_directed_edges
from farfield.addon.bridge import terrain_objects
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.errors import FileError, GeometryError, SettingsError

pytestmark = pytest.mark.usefixtures("empty_scene")
SCRIPT = environment.ROOT / "scripts" / "clipbox.py"
SMALL = ("--boxes", "3", "--resolution", "32", "--threshold", "1")


def run(*arguments):
    clipbox.main([str(each) for each in (*SMALL, *arguments)], command_line.ProgressLine())


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "été à la mer"
    made.mkdir()
    return made


def read_ply(path):
    head, _, rest = path.read_bytes().partition(b"end_header\n")
    counts = [int(line.split()[2]) for line in head.decode("ascii").splitlines() if line.startswith("element")]
    vertices = np.frombuffer(rest, [("at", "<f8", 3), ("normal", "<f4", 3)], counts[0])
    faces = np.frombuffer(rest, [("count", "u1"), ("corners", "<i4", 3)], counts[1], vertices.nbytes)
    assert len(rest) == vertices.nbytes + faces.nbytes
    return vertices["at"], faces["corners"]


def test_a_ply_is_the_welded_union_of_all_boxes(folder):
    run("--terrain", "spheres", "--at", "-1,2,3", "--out", folder / "ground.ply", "--report", folder / "report.json")
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    vertices, triangles = read_ply(folder / "ground.ply")
    assert len(triangles) == report["triangles"] == sum(box["triangles"] for box in report["boxes"])
    assert [box["voxel"] for box in report["boxes"]] == [1.0, 2.0, 4.0]
    assert {"first build", "voxels", "surface", "write"} <= set(report["seconds"]) and report["peak_memory_mb"] > 0
    assert (uses_of_directed_edges(triangles) == 1).all()
    rim = np.abs(vertices - [-1, 2, 3]).max(axis=1) > 55
    assert rim[open_edges(triangles)].all()
    bpy.ops.wm.ply_import(filepath=str(folder / "ground.ply"))
    assert len(bpy.context.object.data.polygons) == len(triangles)


def test_an_obj_is_the_same(folder):
    for ending in ("ply", "obj"):
        run("--terrain", "sine", "--at", "0,0,9", "--out", folder / f"ground.{ending}")
    bpy.ops.wm.obj_import(filepath=str(folder / "ground.obj"), forward_axis="Y", up_axis="Z")
    vertices, triangles = read_ply(folder / "ground.ply")
    mesh = bpy.context.object.data
    assert len(mesh.polygons) == len(triangles) and np.allclose([vertex.co for vertex in mesh.vertices], vertices, atol=1e-4)


def test_far_away_an_obj_counts_from_a_place_near_by(folder):
    far = (-3e7, 2e6, 9.0)
    for ending in ("ply", "obj"):
        run("--terrain", "sine", f"--at={','.join(map(str, far))}", "--out", folder / f"ground.{ending}")
    word, *numbers = (folder / "ground.obj").read_text(encoding="ascii").partition("\n")[0].removeprefix("# ").split()
    origin = np.array(numbers, float)
    assert word == "origin" and np.abs(origin - far).max() <= 9.0
    bpy.ops.wm.obj_import(filepath=str(folder / "ground.obj"), forward_axis="Y", up_axis="Z")
    vertices, _ = read_ply(folder / "ground.ply")
    assert np.allclose([vertex.co for vertex in bpy.context.object.data.vertices], vertices - origin, atol=1e-4)


def test_a_blend_may_hold_plain_meshes_instead(folder):
    run("--freeze", "--per-box", "--collider-share", "20%", "--at", "10,0,20", "--out", folder / "plain.blend")
    bpy.ops.wm.open_mainfile(filepath=str(folder / "plain.blend"))
    assert not terrain_objects.standing_terrains(bpy.context.scene)
    parts = {item.name: len(item.data.polygons) for item in bpy.data.collections["Frozen Terrain"].objects}
    assert set(parts) == {"Box 1", "Box 2", "Box 3", "Collider"}
    whole = sum(count for name, count in parts.items() if name != "Collider")
    assert 0.1 < parts["Collider"] / whole < 0.3


def test_a_blend_holds_a_terrain_that_can_go_on(folder):
    out = folder / "ground.blend"
    run("--terrain", "cascades", "--seed", "4", "--at", "10,0,20", "--out", out)
    bpy.ops.wm.open_mainfile(filepath=str(out))
    [standing] = terrain_objects.standing_terrains(bpy.context.scene)
    assert standing.settings == ClipboxSettings(terrain="cascades", seed=4, boxes=3, resolution=32, threshold=1)
    assert standing.viewer.tolist() == [10.0, 0.0, 20.0] and standing.origin.tolist() == [0.0, 0.0, 0.0]
    blocks = standing.blocks().values()
    assert len(blocks) > 8 and all(block.data.materials[0] == standing.material for block in blocks)


def test_a_path_is_followed_and_ends_where_a_build_from_scratch_does(folder):
    path = folder / "path.csv"
    path.write_text("x,y,z\n" + "".join(f"{step},{0.5 * step},20\n" for step in range(1, 21)), encoding="utf-8")
    run("--at", "0,0,20", "--path", path, "--out", folder / "there.ply", "--report", folder / "report.json")
    run("--at", "20,10,20", "--out", folder / "scratch.ply")
    assert sorted(map(tuple, read_ply(folder / "there.ply")[0].tolist())) == sorted(
        map(tuple, read_ply(folder / "scratch.ply")[0].tolist())
    )
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert report["moves"] == 21 and report["reused_share"] > 0.9
    run("--at", "0,0,20", "--path", path, "--out", folder / "there.blend")
    [standing] = terrain_objects.standing_terrains(bpy.context.scene)
    assert standing.viewer.tolist() == [20.0, 10.0, 20.0]
    assert sum(len(block.data.polygons) for block in standing.blocks().values()) == report["triangles"]


@pytest.mark.parametrize(
    ("arguments", "error", "sentence"),
    [
        (("--out", "ground.stl"), FileError, r"\.blend, \.ply, \.obj"),
        (("--out", "ground.ply", "--at", "1,2"), SettingsError, "three numbers"),
        (("--out", "ground.ply", "--at", "a,b,c"), SettingsError, "three numbers"),
        (("--out", "ground.ply", "--at", "nan,0,0"), GeometryError, "farthest"),
        (("--out", "ground.ply", "--voxel", "0"), SettingsError, "--voxel"),
        (("--out", "ground.ply", "--resolution", "31"), SettingsError, "--resolution"),
        (("--out", "ground.ply", "--formula", "x.real"), SettingsError, "may not hold"),
        (("--out", "ground.ply", "--formula", "-1"), GeometryError, "no surface"),
        (("--out", "ground.blend", "--formula", "1"), GeometryError, "no surface"),
        (("--out", "ground.ply", "--path", "nowhere.csv"), FileError, "cannot be read"),
        (("--out", "ground.ply", "--freeze"), FileError, "only be written to a .blend"),
        (("--out", "ground.blend", "--per-box"), SettingsError, "give --freeze"),
        (("--out", "ground.blend", "--freeze", "--collider-share", "0"), SettingsError, "--collider-share"),
    ],
)
def test_bad_input_is_one_sentence(folder, monkeypatch, arguments, error, sentence):
    monkeypatch.chdir(folder)
    with pytest.raises(error, match=sentence):
        run(*arguments)
    assert not list(folder.iterdir())


@pytest.mark.parametrize("text", ["", "x,y,z\n", "1,2\n", "1,2,drei\n", "\x00"])
def test_a_path_without_places_is_refused(folder, text):
    (folder / "path.csv").write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match="path"):
        run("--path", folder / "path.csv", "--out", folder / "ground.ply")


def test_as_a_program_it_ends_with_its_codes(folder):
    command = [sys.executable, str(SCRIPT), *SMALL]
    done = subprocess.run([*command, "--out", str(folder / "a.ply")], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and (folder / "a.ply").is_file(), done.stderr
    bad = subprocess.run([*command, "--out", str(folder / "b.ply"), "--formula", "os"], capture_output=True, text=True, check=False)
    assert bad.returncode == 2 and bad.stderr.strip().count("\n") == 0 and "os" in bad.stderr and not (folder / "b.ply").exists()
