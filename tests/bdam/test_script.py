"""`scripts/bdam.py`: the four commands, their output files, reports and exit codes."""

import json
import shutil
import subprocess
import sys

import bpy
import numpy as np
import pytest
from PIL import Image

import bdam
from farfield.addon.bridge.bdam.objects import SceneTerrain
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.errors import FarfieldError, FileError, SettingsError
from lib import command_line, environment

pytestmark = pytest.mark.usefixtures("empty_scene")
SCRIPT = environment.ROOT / "scripts" / "bdam.py"
SMALL = ("--patch-size", "16", "--executor", "serial", "--cell-size", "10")
VIEW = ("--from", "-300,-300,200", "--to", "0,0,40")
KEYS = {"origin", "triangles", "patches", "tiles", "max_error_px", "seconds", "peak_memory_mb"}


def run(*arguments):
    return bdam.main([str(argument) for argument in arguments], command_line.ProgressLine())


def read_report(path):
    report = json.loads(path.read_text(encoding="utf-8"))
    assert report.keys() >= KEYS and report["peak_memory_mb"] > 0 and all(seconds >= 0 for seconds in report["seconds"].values())
    return report


def write_source(path, size=65, west=0):
    y, x = np.mgrid[0:size, west : west + size] / 64.0
    np.save(path, (60.0 * np.sin(7.0 * x) * np.cos(6.0 * y) + 3.0 * np.sin(90.0 * x + 70.0 * y)).astype(np.float32))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory, extension):
    """A folder with the store of a hilly field with a texture, and the report of its build."""
    path = tmp_path_factory.mktemp("été à la mer")
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (700, 700, 3), np.uint8)).save(path / "ground.png")
    write_source(path / "hills.npy")
    run("build", path / "hills.npy", "--out", path / "store", "--texture", path / "ground.png", *SMALL, "--report", path / "build.json")
    return path


def read_ply(path):
    header, _, content = path.read_bytes().partition(b"end_header\n")
    counts = [int(line.split()[2]) for line in header.decode("ascii").splitlines() if line.startswith("element")]
    vertices = np.frombuffer(content, [("position", "<f8", 3), ("normal", "<f4", 3)], counts[0])
    faces = np.frombuffer(content, [("count", "u1"), ("corners", "<i4", 3)], counts[1], vertices.nbytes)
    return vertices["position"], vertices["normal"], faces["corners"]


def test_build_and_info_report_the_same_store(folder):
    report = read_report(folder / "build.json")
    summary = run("info", folder / "store", "--report", folder / "info.json")
    info = read_report(folder / "info.json")
    for key in ("origin", "triangles", "patches", "tiles", "crs", "rows", "columns", "bytes"):
        assert report[key] == info[key]
    assert info["rows"] == 65 and report["tiles"] > 1 and info["texture"]["format"] == "jpeg"
    assert sum(level["patches"] for level in info["levels"]) == info["patches"]
    assert info["levels"][-1]["max_error"] == 0.0 and "65 by 65 heights" in summary


def test_a_ply_has_the_samples_of_the_source_in_local_meters(folder):
    run("extract", folder / "store", *VIEW, "--tolerance", "0.01", "--out", folder / "cut.ply", "--report", folder / "cut.json")
    report = read_report(folder / "cut.json")
    positions, normals, triangles = read_ply(folder / "cut.ply")
    assert len(triangles) == report["triangles"] and report["max_error_px"] <= 0.01 and 1 <= report["tiles"] <= 64
    heights = np.load(folder / "hills.npy")[::-1]
    origin = np.array(report["origin"])
    columns, rows = np.rint((positions[:, :2] + origin) / 10.0).astype(int).T
    assert np.abs(positions[:, :2] + origin - 10.0 * np.stack([columns, rows], axis=1)).max() < 1e-9
    with TerrainStore(folder / "store") as store:
        assert np.abs(positions[:, 2] - heights[rows, columns]).max() <= 0.51 * store.header.height_step
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5) and (normals[:, 2] > 0.0).all()
    corners = positions[triangles]
    (ax, ay), (bx, by) = (corners[:, 1, :2] - corners[:, 0, :2]).T, (corners[:, 2, :2] - corners[:, 0, :2]).T
    areas = ax * by - ay * bx
    assert (areas > 0.0).all() and np.isclose(0.5 * areas.sum(), 640.0**2)


def test_a_larger_tolerance_gives_fewer_triangles(folder):
    counts = []
    for tolerance in (0.5, 5.0, 50.0):
        run("extract", folder / "store", *VIEW, "--tolerance", tolerance, "--out", folder / "cut.ply", "--report", folder / "cut.json")
        report = read_report(folder / "cut.json")
        assert report["max_error_px"] <= tolerance
        counts.append(report["triangles"])
    assert counts[0] > counts[1] > counts[2]


def test_an_obj_contains_the_same(folder):
    for ending in ("ply", "obj"):
        run("extract", folder / "store", *VIEW, "--out", folder / f"cut.{ending}")
    positions, _, triangles = read_ply(folder / "cut.ply")
    bpy.ops.wm.obj_import(filepath=str(folder / "cut.obj"), forward_axis="Y", up_axis="Z")
    mesh = bpy.context.object.data
    assert len(mesh.polygons) == len(triangles) and np.allclose([vertex.co for vertex in mesh.vertices], positions, atol=1e-3)


def test_a_blend_contains_the_terrain_with_its_texture(folder):
    run("extract", folder / "store", *VIEW, "--out", folder / "cut.blend", "--report", folder / "cut.json")
    bpy.ops.wm.open_mainfile(filepath=str(folder / "cut.blend"))
    [root] = [item for item in bpy.data.objects if item.type == "EMPTY"]
    terrain = SceneTerrain.of_object(root)
    report = read_report(folder / "cut.json")
    assert terrain.folder == folder / "store" and len(terrain.tiles()) == report["tiles"]
    assert sum(len(tile.data.polygons) for tile in terrain.tiles().values()) == report["triangles"]
    assert any(image.packed_file for image in bpy.data.images)
    scene = bpy.context.scene
    assert tuple(scene.camera.matrix_world.translation) == (-300.0, -300.0, 200.0)
    assert np.degrees(scene.camera.data.angle) == pytest.approx(50.0) and scene.camera.data.clip_end > 640.0
    assert (scene.render.resolution_x, scene.render.resolution_y) == (800, 600)
    assert [item.data.type for item in scene.objects if item.type == "LIGHT"] == ["SUN"] and scene.world.name.startswith("Farfield Sky")


@pytest.fixture(scope="module")
def colored(tmp_path_factory, extension):
    """A folder with the store of hills on which red grows to the east and green to the north."""
    path = tmp_path_factory.mktemp("couleurs d'été")
    y, x = np.mgrid[0:700, 0:700]
    Image.fromarray(np.stack([x // 3, (699 - y) // 3, np.full_like(x, 60)], axis=-1).astype(np.uint8)).save(path / "ground.png")
    write_source(path / "hills.npy")
    run("build", path / "hills.npy", "--out", path / "store", "--texture", path / "ground.png", *SMALL)
    return path


def check_colors(mesh):
    """Check the colors of images at the corners of an imported mesh, which is 640 m wide."""
    textures = [next(node.image for node in material.node_tree.nodes if node.type == "TEX_IMAGE") for material in mesh.materials]
    images = [np.array(image.pixels).reshape(image.size[1], image.size[0], -1) for image in textures]
    uvs = np.array([corner.uv for corner in mesh.uv_layers[0].data])
    assert len(images) > 1 and (uvs >= 0.0).all() and (uvs <= 1.0).all()
    vertices = np.array([vertex.co for vertex in mesh.vertices])
    for polygon in list(mesh.polygons)[::7]:
        image = images[polygon.material_index]
        for loop in polygon.loop_indices:
            x, y = np.minimum((uvs[loop] * image.shape[1::-1]).astype(int), 511)
            expected = (vertices[mesh.loops[loop].vertex_index, :2] + 320.0) / 640.0 * 233.0
            assert np.abs(255.0 * image[y, x, :2] - expected).max() < 6.0


def test_an_obj_and_a_glb_have_the_textures(colored):
    run("extract", colored / "store", *VIEW, "--tolerance", "0.5", "--out", colored / "à cut.obj", "--report", colored / "cut.json")
    report = read_report(colored / "cut.json")
    bpy.ops.wm.obj_import(filepath=str(colored / "à cut.obj"), forward_axis="Y", up_axis="Z")
    mesh = bpy.context.object.data
    assert len(mesh.polygons) == report["triangles"]
    check_colors(mesh)
    run("extract", colored / "store", *VIEW, "--tolerance", "0.5", "--out", colored / "à cut.obj")
    (colored / "à cut.mtl").write_text("newmtl mine", encoding="utf-8")
    (colored / "à cut.obj").unlink()
    with pytest.raises(FileError, match=r"would replace .*à cut\.mtl.*, which Farfield did not write"):
        run("extract", colored / "store", *VIEW, "--tolerance", "0.5", "--out", colored / "à cut.obj")
    run("extract", colored / "store", *VIEW, "--tolerance", "0.5", "--out", colored / "cut.glb")
    bpy.ops.import_scene.gltf(filepath=str(colored / "cut.glb"))
    mesh = bpy.context.object.data
    assert len(mesh.polygons) == report["triangles"]
    check_colors(mesh)


@pytest.mark.slow
def test_verify_names_what_is_damaged(folder, tmp_path):
    assert "undamaged" in run("verify", folder / "store")
    write_source(tmp_path / "hills.npy")
    run("build", tmp_path / "hills.npy", "--out", tmp_path / "store", *SMALL)
    path = tmp_path / "store" / "geometry.bdam"
    content = bytearray(path.read_bytes())
    content[60] ^= 4
    path.write_bytes(content)
    with pytest.raises(FileError, match=r"damaged in 1 parts: patch 0/\d+; the rest can be used"):
        run("verify", tmp_path / "store", "--report", tmp_path / "report.json")
    assert len(read_report(tmp_path / "report.json")["damaged"]) == 1


def test_a_store_with_a_damaged_structure_is_usable_and_named(folder, tmp_path):
    shutil.copytree(folder / "store", tmp_path / "store")
    path = tmp_path / "store" / "structure.bdam"
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(FileError, match=r'damaged in 1 parts: file "structure\.bdam"; the rest can be used'):
        run("verify", tmp_path / "store")
    assert 'structure.bdam" is damaged' in run("info", tmp_path / "store", "--report", tmp_path / "info.json")
    summary = run("extract", tmp_path / "store", *VIEW, "--out", tmp_path / "cut.ply", "--report", tmp_path / "cut.json")
    run("extract", folder / "store", *VIEW, "--out", folder / "cut.ply")
    assert (tmp_path / "cut.ply").read_bytes() == (folder / "cut.ply").read_bytes()
    (warning,) = read_report(tmp_path / "cut.json")["warnings"]
    assert warning in summary and read_report(tmp_path / "info.json")["warnings"] == [warning]
    run("extract", tmp_path / "store", *VIEW, "--out", tmp_path / "cut.blend")


def test_a_store_can_be_moved(folder, tmp_path):
    write_source(tmp_path / "hills.npy")
    run("build", tmp_path / "hills.npy", "--out", tmp_path / "store", *SMALL)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "store").rename(tmp_path / "elsewhere" / "moved")
    assert "undamaged" in run("verify", tmp_path / "elsewhere" / "moved")


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("build", "none.npy", "--out", "new"), FileError, "does not exist"),
        (("build", "hills.npy", "--out", "."), FileError, "which contains the input"),
        (("build", "hills.npy", "--out", "new", "--patch-size", "16", "--height-step", "-1"), SettingsError, "--height-step"),
        (("build", "hills.npy", "--out", "new", "--texture", "hills.npy"), FileError, "texture"),
        (("build", "hills.npy", "--out", "new", "--executor", "many"), SettingsError, "Executor must be"),
        (("build", "hills.npy", "--out", "new", "--executor", "dask:many"), SettingsError, "Executor must be dask:tcp"),
        (("info", "new"), FileError, "no terrain"),
        (("extract", "new", *VIEW, "--out", "cut.ply"), FileError, "no terrain"),
        (("extract", "store", *VIEW, "--out", "cut.stl"), FileError, r"\.blend, \.ply, \.obj"),
        (("extract", "store", "--from", "1,2", "--to", "0,0,0", "--out", "cut.ply"), SettingsError, "--from.*three numbers"),
        (("extract", "store", "--from", "1,2,3", "--to", "1,2,3", "--out", "cut.ply"), SettingsError, "look at another position"),
        (("extract", "store", *VIEW, "--out", "cut.ply", "--size", "800"), SettingsError, "--size"),
        (("extract", "store", *VIEW, "--out", "cut.ply", "--fov", "180"), SettingsError, "--fov"),
        (("extract", "store", *VIEW, "--out", "cut.ply", "--tolerance", "nan"), SettingsError, "--tolerance"),
    ],
)
def test_invalid_input_is_named_and_nothing_is_written(folder, monkeypatch, arguments, error, message):
    monkeypatch.chdir(folder)
    before = sorted(path.name for path in folder.iterdir())
    with pytest.raises(FarfieldError, match=message) as caught:
        run(*arguments)
    assert isinstance(caught.value, error)
    assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.slow
def test_both_ways_of_calling_and_exit_codes(folder):
    assert "undamaged" in run("verify", folder / "store")
    command = [sys.executable, str(SCRIPT), "verify", str(folder)]
    outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    assert outcome.returncode == 2 and "undamaged" not in outcome.stdout and len(outcome.stderr.splitlines()) == 1
