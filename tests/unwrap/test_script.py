"""`scripts/unwrap.py`: input and output formats, the report, and the exit codes."""

import json

import bpy
import numpy as np
import pytest

import unwrap
from charts import dome
from farfield.addon.bridge.geometry.mesh_arrays import read_uvs
from farfield.addon.core.errors import FileError, GeometryError, SettingsError
from lib import command_line, environment
from shapes import sphere

pytestmark = pytest.mark.usefixtures("empty_scene", "coarse_packing")
SCRIPT = environment.ROOT / "scripts" / "unwrap.py"
REPORT_KEYS = (
    *("l2", "linf", "p95", "p99", "max_expansion", "symmetric_dirichlet", "anisotropy_p99", "anisotropic_fraction", "needles"),
    *("flips", "overlaps", "min_quality", "fill", "seconds", "density_ratio"),
)


@pytest.fixture
def head(tmp_path):
    """A sphere in a file whose path has spaces and non-ASCII letters."""
    folder = tmp_path / "été à la mer"
    folder.mkdir()
    return write_obj(folder / "tête.obj", sphere(8))


def write_obj(path, mesh):
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in mesh.triangles + 1]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def run(*arguments):
    return unwrap.main([str(argument) for argument in arguments], command_line.ProgressLine())


@pytest.mark.slow
@pytest.mark.parametrize("extension", [".obj", ".glb", ".blend"])
def test_every_output_format_contains_the_uv_map(head, extension):
    out, report = head.with_name(f"out{extension}"), head.with_name("report.json")
    assert "2 UV islands" in run(head, "--out", out, "--report", report)
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert set(REPORT_KEYS) <= set(figures)
    assert figures["flips"] == figures["overlaps"] == 0
    unwrap.scene_files.open_scene(out)
    [item] = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    assert len(item.data.uv_layers) == 1 and len(item.data.polygons) == len(sphere(8).triangles)
    assert np.ptp(read_uvs(item.data.uv_layers[0])) > 0.5


def test_shapes_of_bones_are_not_unwrapped(tmp_path, empty_scene):
    bpy.ops.mesh.primitive_ico_sphere_add()
    shape = bpy.context.object
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.armature_add()
    bpy.context.object.pose.bones[0].custom_shape = shape
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "in.blend"))
    summary = run(tmp_path / "in.blend", "--out", tmp_path / "out.blend")
    assert '"Cube"' in summary and "Icosphere" not in summary


def test_a_direction_implies_direction_importance(tmp_path):
    path = write_obj(tmp_path / "dome.obj", dome(12))
    report = tmp_path / "report.json"
    run(path, "--out", tmp_path / "out.blend", "--direction", "-0,-1,0", "--density-ratio", "2", "--report", report)
    assert json.loads(report.read_text())["density_ratio"] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("boundary", ["square", "circle"])
def test_a_fixed_boundary(tmp_path, boundary):
    path = write_obj(tmp_path / "dome.obj", dome(10))
    report = tmp_path / "report.json"
    run(path, "--out", tmp_path / "out.obj", "--boundary", boundary, "--min-quality", "0", "--report", report)
    figures = json.loads(report.read_text())
    assert figures["fill"] == pytest.approx({"square": 0.984, "circle": 0.773}[boundary], abs=0.02)
    assert figures["flips"] == figures["overlaps"] == 0


def test_the_image_is_written(head, monkeypatch):
    monkeypatch.setattr(unwrap, "STRETCH_IMAGE_RESOLUTION", 128)
    run(head, "--out", head.with_name("out.obj"), "--image", head.with_name("stretch.png"))
    assert head.with_name("stretch.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("flags", "error_type", "text"),
    [
        (("--out", "x.fbx"), FileError, "--out"),
        (("--out", "x.obj", "--image", "x.jpg"), FileError, ".png"),
        (("--out", "x.obj", "--direction", "0,0,0"), SettingsError, "no length"),
        (("--out", "x.obj", "--direction", "up"), SettingsError, "--direction"),
        (("--out", "x.obj", "--direction", "1,2"), SettingsError, "3 finite numbers"),
        (("--out", "x.obj", "--min-quality", "0.9"), SettingsError, "--min-quality"),
        (("--out", "x.obj", "--importance", "camera"), SettingsError, "no camera"),
        (("--out", "x.obj", "--uv-map", "Unwrap", "--importance", "vertex_group", "--vertex-group", "Ears"), GeometryError, "Ears"),
    ],
)
def test_invalid_input_is_a_one_line_error_and_writes_nothing(head, flags, error_type, text):
    before = sorted(head.parent.iterdir())
    flags = [head.with_name(flag) if flag.startswith("x.") else flag for flag in flags]
    with pytest.raises(error_type) as caught:
        run(head, *flags)
    assert text in str(caught.value) and "\n" not in str(caught.value)
    assert sorted(head.parent.iterdir()) == before


@pytest.mark.parametrize(
    "flags",
    [
        ("--out", "tête.obj"),
        ("--out", "out.blend", "--image", "z.png", "--report", "z.png"),
        ("--out", "out.blend", "--report", "tête.obj"),
        ("--out", "out.blend", "--report", "out.blend"),
    ],
)
def test_outputs_replace_neither_each_other_nor_the_input(head, flags):
    before = head.read_bytes()
    with pytest.raises(FileError, match="same file"):
        run(head, *(flag if flag.startswith("--") else head.with_name(flag) for flag in flags))
    assert [path.name for path in head.parent.iterdir()] == [head.name] and head.read_bytes() == before


def test_files_without_a_visible_mesh(head):
    head.with_name("empty.obj").write_text("# nothing\n")
    with pytest.raises(GeometryError, match="no mesh"):
        run(head.with_name("empty.obj"), "--out", head.with_name("out.blend"))
    unwrap.scene_files.open_scene(head)
    bpy.data.objects[0].hide_render = True
    unwrap.scene_files.save_scene(head.with_name("hidden.blend"))
    with pytest.raises(GeometryError, match="disabled in renders"):
        run(head.with_name("hidden.blend"), "--out", head.with_name("out.blend"))


@pytest.mark.slow
def test_what_an_output_lacks_is_named(head):
    unwrap.scene_files.open_scene(head)
    item = bpy.context.scene.objects[0]
    item.data.materials.clear()
    item.data.materials.append(bpy.data.materials.new("Skin"))
    item.modifiers.new("More", "SUBSURF")
    path = head.with_name("scene.blend")
    unwrap.scene_files.save_scene(path)
    summaries = {extension: run(path, "--out", head.with_name(f"out{extension}")) for extension in (".blend", ".obj", ".glb")}
    assert "lacks" not in summaries[".blend"]
    assert summaries[".obj"].endswith(" The .obj lacks materials and the effect of modifiers.")
    assert summaries[".glb"].endswith(" The .glb lacks the effect of modifiers.")


def test_all_meshes_of_a_file_in_one_texture(tmp_path, empty_scene):
    for x in (0.0, 3.0):
        bpy.ops.mesh.primitive_plane_add(calc_uvs=False, location=(x, 0.0, 0.0))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "in.blend"))
    report = tmp_path / "report.json"
    summary = run(tmp_path / "in.blend", "--out", tmp_path / "out.blend", "--combine-selected", "--report", report)
    assert summary.startswith("Unwrapped 2 meshes into one texture: ")
    figures = json.loads(report.read_text())["objects"]
    assert len(figures) == 2 and figures[0]["fill"] == figures[1]["fill"]
    uvs = [read_uvs(item.data.uv_layers["Unwrap"]) for item in bpy.context.scene.objects]
    gaps = np.maximum(uvs[0].min(axis=0) - uvs[1].max(axis=0), uvs[1].min(axis=0) - uvs[0].max(axis=0))
    assert gaps.max() > 0.0
