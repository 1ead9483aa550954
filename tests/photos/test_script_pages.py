"""`scripts/photos.py` with UDIM tiles and several materials: a file for each page."""

import json
from functools import cache

import bpy
import numpy as np
import pytest

import photos
from farfield.addon.bridge.geometry.mesh_arrays import read_uvs
from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.core.errors import FileError
from image_data import read_image, write_image
from lib import command_line
from photo_scenes import SIZE, grid, photograph, ring, smooth_texture

pytestmark = pytest.mark.usefixtures("empty_scene", "quick_merges", "coarse_packing")
LEFT, RIGHT = np.s_[:, : SIZE // 2], np.s_[:, SIZE // 2 :]


def run(*arguments):
    return photos.main([str(argument) for argument in arguments], command_line.ProgressLine())


def write_obj(path, offset, materials=False):
    """Write the square; both halves fill a square of the UV map, the right one moved by `offset` in x."""
    mesh, uvs = grid(10)
    is_right = uvs.mean(axis=1)[:, 0] > 0.5
    moved = uvs * [2.0, 1.0]
    moved[is_right, :, 0] += offset - 1.0
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
    lines += [f"vt {u:.9g} {v:.9g}" for u, v in moved.reshape(-1, 2)]
    for material, chosen in enumerate((~is_right, is_right)):
        lines += [f"usemtl {('Holz', 'a/b')[material]}"] if materials else []
        for index in np.flatnonzero(chosen):
            lines.append("f " + " ".join(f"{vertex + 1}/{3 * index + corner + 1}" for corner, vertex in enumerate(mesh.triangles[index])))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@cache
def take_photographs():
    """The photographs of the square by a ring of three cameras."""
    mesh, uvs = grid(10)
    return [photograph(mesh, uvs, smooth_texture(), camera) for camera in ring(3)]


@pytest.fixture
def inputs(tmp_path):
    """The arguments behind the mesh."""
    cameras, lines = ring(3), []
    (tmp_path / "images").mkdir(), (tmp_path / "cameras").mkdir()
    lens = cameras[0].lens
    text = f"1 SIMPLE_PINHOLE {lens.size[0]} {lens.size[1]} {lens.focal[0]} {lens.center[0]} {lens.center[1]}\n"
    (tmp_path / "cameras" / "cameras.txt").write_text(text, encoding="utf-8")
    for index, (camera, each) in enumerate(zip(cameras, take_photographs(), strict=True), start=1):
        write_image(tmp_path / "images" / camera.name, each.pixels[::-1])
        r = camera.rotation
        w = 0.5 * np.sqrt(max(1.0 + np.trace(r), 1e-12))
        quaternion = (w, (r[2, 1] - r[1, 2]) / (4 * w), (r[0, 2] - r[2, 0]) / (4 * w), (r[1, 0] - r[0, 1]) / (4 * w))
        lines += [f"{index} {' '.join(repr(float(value)) for value in (*quaternion, *camera.translation))} 1 {camera.name}", ""]
    (tmp_path / "cameras" / "images.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return "--cameras", tmp_path / "cameras", "--images", tmp_path / "images", "--size", SIZE, "--no-sharpen"


def check_halves(first, second):
    """Check that two files show the halves of the texture."""
    for path, half in ((first, LEFT), (second, RIGHT)):
        found = read_image(path)[0][::-1].astype(np.float32) / 255.0
        expected = smooth_texture()[half].repeat(2, axis=1)
        assert np.sqrt(np.mean((found - expected)[8:-8, 8:-8] ** 2)) < 0.02, path


@pytest.mark.slow
@pytest.mark.parametrize("extension", [*(pytest.param(name, marks=pytest.mark.exhaustive) for name in (".blend", ".obj")), ".glb"])
def test_a_file_per_tile(inputs, tmp_path, extension):
    mesh, out = write_obj(tmp_path / "mesh.obj", 1.0), tmp_path / f"out{extension}"
    texture, report, stages = tmp_path / "wood.<UDIM>.png", tmp_path / "report.json", tmp_path / "stages"
    run(mesh, *inputs, "--texture", texture, "--out", out, "--report", report, "--stages", stages)
    check_halves(tmp_path / "wood.1001.png", tmp_path / "wood.1002.png")
    for tile in (1001, 1002):
        for name in ("confidence", "source", "holes"):
            assert read_image(tmp_path / f"wood.{tile}.{name}.png")[0].shape[:2] == (SIZE, SIZE)
    assert {path.name for path in stages.iterdir()} >= {"classes.wood.1001.png", "classes.wood.1002.png", "used.0.png"}
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert figures["size"] == SIZE and [page["name"] for page in figures["pages"]] == ["wood.1001.png", "wood.1002.png"]
    assert [page["tile"] for page in figures["pages"]] == [1001, 1002] and not any(page["material"] for page in figures["pages"])
    for key in ("texels", "holes"):
        assert figures[key] == sum(page[key] for page in figures["pages"])
    photos.scene_files.open_scene(out)
    [item] = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    images = [node.image for slot in item.material_slots for node in slot.material.node_tree.nodes if node.type == "TEX_IMAGE"]
    if extension == ".blend":
        assert images[0].source == "TILED" and images[0].packed_files and images[0].name == "wood"
        return
    assert len(images) == len(item.material_slots) == 2
    uvs = read_uvs(next(layer for layer in item.data.uv_layers if layer.active_render))
    assert uvs.min() >= 0.0 and uvs.max() <= 1.0
    for slot, image in enumerate(images):
        colors = read_pixels(image)[8:-8, 8:-8, :3]
        half = (LEFT, RIGHT)[next(polygon.center.x > 0.0 for polygon in item.data.polygons if polygon.material_index == slot)]
        assert np.sqrt(np.mean((colors - smooth_texture()[half].repeat(2, axis=1)[8:-8, 8:-8]) ** 2)) < 0.02


def test_a_single_tile_without_a_placeholder_is_an_image_that_repeats(inputs, tmp_path):
    """V from 1 to 2: the texture is that of the square from 0 to 1, and the UVs stay as they are."""
    mesh, uvs = grid(10)
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices] + [f"vt {u:.9g} {v + 1.0:.9g}" for u, v in uvs.reshape(-1, 2)]
    lines += ["f " + " ".join(f"{c}/{3 * index + k + 1}" for k, c in enumerate(row)) for index, row in enumerate(mesh.triangles + 1)]
    (tmp_path / "helmet.obj").write_text("\n".join(lines), encoding="utf-8")
    out = tmp_path / "out.glb"
    run(tmp_path / "helmet.obj", *inputs, "--texture", tmp_path / "t.png", "--out", out)
    found = read_image(tmp_path / "t.png")[0][::-1].astype(np.float32) / 255.0
    assert np.sqrt(np.mean((found - smooth_texture())[8:-8, 8:-8] ** 2)) < 0.02
    photos.scene_files.open_scene(out)
    [item] = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    stored = read_uvs(item.data.uv_layers[0])
    assert stored[:, 1].min() == pytest.approx(1.0, abs=1e-5) and stored[:, 1].max() == pytest.approx(2.0, abs=1e-5)
    [node] = [node for node in item.material_slots[0].material.node_tree.nodes if node.type == "TEX_IMAGE"]
    assert node.extension == "REPEAT"
    run(tmp_path / "helmet.obj", *inputs, "--texture", tmp_path / "u.<UDIM>.png")
    assert (tmp_path / "u.1011.png").is_file()


@pytest.mark.slow
def test_a_file_per_material(inputs, tmp_path):
    mesh, report = write_obj(tmp_path / "mesh.obj", 0.0, materials=True), tmp_path / "report.json"
    out, texture = tmp_path / "out.blend", tmp_path / "t.<MATERIAL>.png"
    run(mesh, *inputs, "--texture", texture, "--materials", "keep", "--out", out, "--report", report)
    check_halves(tmp_path / "t.Holz.png", tmp_path / "t.a_b.png")
    assert [page["material"] for page in json.loads(report.read_text(encoding="utf-8"))["pages"]] == ["Holz", "a/b"]
    photos.scene_files.open_scene(out)
    [item] = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    assert [slot.material.name for slot in item.material_slots] == ["t.Holz", "t.a_b"]


def test_names_without_placeholders_are_one_sentence(inputs, tmp_path):
    def fails(words, mesh, name, *arguments):
        with pytest.raises(FileError, match=words):
            run(mesh, *inputs, "--texture", tmp_path / name, *arguments)
        assert not list(tmp_path.glob("*.png"))

    tiled, stacked = write_obj(tmp_path / "tiled.obj", 1.0), write_obj(tmp_path / "stacked.obj", 0.0, materials=True)
    fails("UDIM tiles 1001, 1002; put <UDIM> into its name", tiled, "t.png")
    fails("for 2 materials; put <MATERIAL> into its name", stacked, "t.png", "--materials", "keep")
    fails("leave out <MATERIAL>", tiled, "t.<UDIM>.<MATERIAL>.png")


@pytest.mark.slow
def test_a_single_tile_with_a_placeholder(inputs, tmp_path):
    mesh = write_obj(tmp_path / "mesh.obj", 0.0, materials=True)
    run(mesh, *inputs, "--texture", tmp_path / "<MATERIAL>.<UDIM>.png", "--materials", "keep")
    check_halves(tmp_path / "Holz.1001.png", tmp_path / "a_b.1001.png")
