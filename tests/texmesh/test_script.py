"""`scripts/texmesh.py`: outputs, reports, unusual meshes, and the exit codes."""

import json

import bpy
import numpy as np
import pytest

import texmesh
from farfield.addon.bridge.texmesh.level_sets import level_sets_in
from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.texmesh.perception.calibration import Answer
from farfield.addon.core.texmesh.perception.recorded_answers import RecordedAnswer, write_answers
from glb_reader import read_glb
from glb_scenes import random_image
from lib import command_line, environment
from textured_scenes import checker_image, count_triangles, textured_ball, textured_material

pytestmark = pytest.mark.usefixtures("empty_scene", "few_samples")
SCRIPT = environment.ROOT / "scripts" / "texmesh.py"
FAST = ("--views", "1", "--max-image", "32", "--vertices", "original")


@pytest.fixture
def folder(tmp_path):
    """A folder whose path has spaces and non-ASCII letters."""
    path = tmp_path / "été à la mer"
    path.mkdir()
    return path


@pytest.fixture
def ball(folder):
    """A textured sphere of 224 triangles in a file."""
    textured_ball(8)
    return save(folder)


def save(folder):
    path = folder / "bällchen.blend"
    texmesh.scene_files.save_scene(path)
    return path


def run(*arguments):
    return texmesh.main([str(argument) for argument in arguments], command_line.ProgressLine())


def make(path, *flags, out="out.blend"):
    """Make levels with `flags` and return the summary and the figures of the objects."""
    report = path.with_name("report.json")
    summary = run("levels", path, "--out", path.with_name(out), "--report", report, *FAST, *flags)
    return summary, json.loads(report.read_text(encoding="utf-8"))


@pytest.mark.slow
def test_a_scene_with_levels(folder):
    textured_ball()
    ball = save(folder)
    summary, report = make(ball, "--number", "3", "--views", "2", "--max-image", "64")
    (figures,) = report["objects"]
    assert '"Bällchen" has 3 levels' in summary and figures["name"] == "Bällchen"
    assert report["seconds"]["levels"] > 0.0 and report["peak_memory_mb"] > 1.0 and report["skipped"] == []
    texmesh.scene_files.open_scene(ball.with_name("out.blend"))
    (levels,) = level_sets_in(bpy.context.scene)
    assert [count_triangles(item.data) for item in levels.levels] == [level["triangles"] for level in figures["levels"]]
    assert levels.errors == [level["pixel_size"] for level in figures["levels"]]


def test_ratios_are_reached(ball):
    _, report = make(ball, "--ratios", "25%, 0.5")
    assert [level["triangles"] for level in report["objects"][0]["levels"]] == [224, 112, 56]


@pytest.mark.parametrize("quantized", [True, pytest.param(False, marks=pytest.mark.exhaustive)])
def test_a_file_per_level(ball, quantized):
    _, report = make(ball, "--ratios", "0.5,0.1", *(() if quantized else ("--no-quantized",)), out="out.glb")
    assert not ball.with_name("out.glb").exists()
    counts = [level["triangles"] for level in report["objects"][0]["levels"]]
    for number, count in enumerate(counts):
        path = ball.with_name(f"out-L{number}.glb")
        assert (b"KHR_mesh_quantization" in path.read_bytes()) == quantized
        texmesh.scene_files.open_scene(path)
        (item,) = [item for item in bpy.context.scene.objects if item.type == "MESH"]
        assert count_triangles(item.data) == count and item.name == f"Bällchen_LOD{number}"
        assert [image.size[0] for image in bpy.data.images if image.size[0]] == [32]
        points = np.array([vertex.co for vertex in item.data.vertices])
        np.testing.assert_allclose(np.linalg.norm(points, axis=1) * item.matrix_world.to_scale().x, 1.0, atol=1e-4)
        assert min(polygon.normal @ polygon.center for polygon in item.data.polygons) > 0.0, "faces point outwards"


def test_one_file_with_all_levels(ball):
    make(ball, "--ratios", "0.5,0.1", "--one-file", out="out.glb")
    document = parse_glb(ball.with_name("out.glb"))
    (root,) = (document["nodes"][index] for index in document["scenes"][0]["nodes"])
    assert root["extensions"]["MSFT_lod"]["ids"] == [1, 2]
    coverages = root["extras"]["MSFT_screencoverage"]
    assert len(coverages) == 3 and coverages == sorted(coverages, reverse=True) and coverages[-1] == 0.0
    assert [node["name"] for node in document["nodes"]] == [f"Bällchen_LOD{number}" for number in range(3)]
    assert len(document["images"]) == 1 and [material["name"] for material in document["materials"]] == ["Paint"]


@pytest.mark.slow
def test_levels_have_smaller_images_and_normals_for_their_surface(folder):
    """The images of all maps: colors, and normals, which the exporter's tangents turn into those of the level."""
    item = textured_ball(8)
    material = item.data.materials[0] = textured_material(checker_image("Large", 256))
    tree = material.node_tree
    node, normal_map = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    node.image = random_image("Bumps", 256)
    tree.links.new(node.outputs["Color"], normal_map.inputs["Color"])
    tree.links.new(normal_map.outputs["Normal"], tree.nodes["Principled BSDF"].inputs["Normal"])
    path = save(folder)
    sizes, counts = {}, {}
    for name, flags in {"own": (), "same": ("--no-rebake-textures",), "webp": ("--webp",), "one": ("--one-file",)}.items():
        summary, _ = make(path, "--ratios", "0.1", *flags, out=f"{name}.glb")
        assert ("Images of levels have 128 pixels per side." in summary) == (name in ("own", "webp"))
        assert "normals of these images stay" not in summary
        for file in sorted(folder.glob(f"{name}*.glb")):
            texmesh.scene_files.open_scene(file)
            sizes[file.stem] = sorted(image.size[0] for image in bpy.data.images if image.size[0])
            counts[file.stem] = file.stat().st_size
            assert b"TANGENT" not in file.read_bytes()
    assert {name for name, found in sizes.items() if found == [128, 128]} == {"own-L1", "webp-L1"}
    assert all(found == [256, 256] for name, found in sizes.items() if name not in ("own-L1", "webp-L1"))
    assert counts["own-L0"] == counts["same-L0"] > counts["webp-L0"] and counts["same-L1"] > counts["own-L1"] > counts["webp-L1"]


def parse_glb(path):
    data = path.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def test_several_materials_become_primitives(folder):
    item = textured_ball(8)
    plain = textured_material(None, "Plain")
    plain.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.1, 0.4, 0.6, 1.0)
    for material in (textured_material(checker_image("Second", 16), "Second"), plain):
        item.data.materials.append(material)
    for polygon in item.data.polygons:
        polygon.material_index = polygon.index % 3 if polygon.center.z > 0.0 else 0
    path = save(folder)
    make(path, "--ratios", "0.6", out="out.glb")
    document = parse_glb(path.with_name("out-L1.glb"))
    assert len(document["meshes"][0]["primitives"]) == 3 and len(document["images"]) == 2
    assert all({"NORMAL", "TEXCOORD_0"} <= set(primitive["attributes"]) for primitive in document["meshes"][0]["primitives"])
    factors = [material["pbrMetallicRoughness"].get("baseColorFactor", [1.0] * 4) for material in document["materials"]]
    np.testing.assert_allclose(factors, [[1.0] * 4, [1.0] * 4, [0.1, 0.4, 0.6, 1.0]], atol=1e-6)


@pytest.mark.slow
def test_answers_of_judges_move_levels(ball):
    """Two judges who need twice the distances of FLIP: the same levels switch twice as far away. A flag counts more than answers."""
    files = []
    for judge in range(2):
        stimuli = np.linspace(0.02, 0.2, 10)
        answers = [Answer(1, 9.0 if stimulus > 0.1 else 11.0, 10.0 + judge) for stimulus in stimuli]
        records = [
            RecordedAnswer("vase", float(stimulus), answer, 5.0 + 0.5 * judge) for stimulus, answer in zip(stimuli, answers, strict=True)
        ]
        files.append(ball.with_name(f"judge {judge}.json"))
        files[-1].write_text(write_answers(records))
    flags = ("--ratios", "0.5,0.25")
    plain, judged = (make(ball, *flags, *more)[1]["objects"][0]["levels"] for more in ((), ("--answers", *files)))
    assert [level["triangles"] for level in judged] == [level["triangles"] for level in plain]
    for before, after in zip(plain[1:], judged[1:], strict=True):
        assert after["pixel_size"] == pytest.approx(2.0 * before["pixel_size"])
        assert after["pixels"] == pytest.approx(0.5 * before["pixels"], abs=0.5)
    named = make(ball, *flags, "--answers", *files, "--distance-factor", "3")[1]["objects"][0]["levels"]
    assert named[1]["pixel_size"] == pytest.approx(3.0 * plain[1]["pixel_size"])
    files[0].write_text("{}")
    with pytest.raises(FileError, match="has no answers"):
        make(ball, "--answers", *files)


def test_analysis_and_plot(ball):
    report, plot = ball.with_name("r.json"), ball.with_name("p.png")
    assert "features at scales 1, 5, 10 and 20" in run("analyze", ball, "--report", report, "--plot", plot)
    (figures,) = json.loads(report.read_text(encoding="utf-8"))["objects"]
    assert figures["vertices"] == figures["features"][0] == 114 and len(figures["ranges"]) == len(figures["sigmas"]) == 21
    assert plot.read_bytes().startswith(b"\x89PNG")


def remove_uvs(item):
    item.data.uv_layers.remove(item.data.uv_layers[0])


def remove_materials(item):
    item.data.materials.clear()


def move_uvs(item):
    for entry in item.data.uv_layers[0].uv:
        entry.vector *= 3.0


def flatten_uvs(item):
    values = item.data.uv_layers[0].uv
    for polygon in item.data.polygons:
        for loop in polygon.loop_indices:
            if polygon.index % 7 == 0:
                values[loop].vector = (0.5, 0.5)
            elif polygon.index % 2:
                values[loop].vector.x *= -1.0


def add_fin(item):
    """Add a face at an edge that has two already."""
    mesh = item.data
    a, b = mesh.edges[len(mesh.edges) // 2].vertices
    points = [vertex.co.copy() for vertex in mesh.vertices]
    faces = [list(polygon.vertices) for polygon in mesh.polygons]
    uvs = [tuple(entry.vector) for entry in mesh.uv_layers[0].uv]
    mesh.clear_geometry()
    mesh.from_pydata([*points, 2.0 * points[a]], [], [*faces, [a, b, len(points)]])
    for entry, uv in zip(mesh.uv_layers.new(name="UVMap").uv, [*uvs, (0, 0), (1, 0), (0, 1)], strict=True):
        entry.vector = uv


def mix_images(item):
    tree = item.data.materials[0].node_tree
    mix, other = tree.nodes.new("ShaderNodeMixRGB"), tree.nodes.new("ShaderNodeTexImage")
    other.image = checker_image("Dirt")
    tree.links.new(tree.nodes["Image Texture"].outputs["Color"], mix.inputs[1])
    tree.links.new(other.outputs["Color"], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.nodes["Principled BSDF"].inputs["Base Color"])


def use_two_uv_maps(item):
    item.data.uv_layers.new(name="Second")
    material = textured_material(checker_image("Detail", 16), "Detail")
    node = material.node_tree.nodes.new("ShaderNodeUVMap")
    node.uv_map = "Second"
    material.node_tree.links.new(node.outputs["UV"], material.node_tree.nodes["Image Texture"].inputs["Vector"])
    item.data.materials.append(material)
    for polygon in item.data.polygons:
        polygon.material_index = polygon.index % 2


def add_shape_keys(item):
    item.shape_key_add(name="Basis")
    item.shape_key_add(name="Wide").data[0].co *= 1.2
    item.data.shape_keys.use_relative = False


def add_lattice(item):
    bpy.ops.object.add(type="LATTICE")
    item.modifiers.new("Cage", "LATTICE").object = bpy.context.object


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (remove_uvs, '"Bällchen" has no UV map; only its geometry counts.'),
        (remove_materials, '"Bällchen" has no image texture; only its geometry counts.'),
        (move_uvs, 'The UV map of "Bällchen" leaves the image; the analysis repeats the image there.'),
        (flatten_uvs, "triangles without area in its UV map."),
        (flatten_uvs, "triangles mirrored in its UV map, as its levels have."),
        (add_fin, '"Bällchen" has 1 edge with more than two faces; its levels may be open there.'),
        (mix_images, 'Materials of "Bällchen" mix images; only "Checker" counts, bake them to count all.'),
        (use_two_uv_maps, 'The images of "Bällchen" use several UV maps; only "UVMap" counts, the others are carried.'),
        (add_shape_keys, 'The levels of "Bällchen" have its current shape; they do not follow its shape keys.'),
        (add_lattice, 'The levels of "Bällchen" have its current shape; they do not follow its modifier "Cage".'),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_unusual_meshes_have_levels_and_a_sentence(folder, change, sentence):
    change(textured_ball(8))
    path = save(folder)
    summary, report = make(path, "--ratios", "0.5", "--vertices", "original", out="out.glb")
    assert sentence in summary
    fine, coarse = report["objects"][0]["levels"]
    assert coarse["constraint"] or coarse["triangles"] == pytest.approx(0.5 * fine["triangles"], rel=0.02)
    assert read_glb(path.with_name("out-L1.glb"))


def test_what_a_range_image_loses_is_said(folder):
    bpy.ops.mesh.primitive_torus_add(major_segments=24, minor_segments=12)
    summary = run("analyze", save(folder), "--analysis", "range_image")
    assert "%" in summary and "axis" in summary


def test_linked_meshes_have_levels(ball):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(ball), link=True) as (source, target):
        target.objects = source.objects
    bpy.context.scene.collection.objects.link(target.objects[0])
    path = ball.with_name("linked.blend")
    texmesh.scene_files.save_scene(path)
    summary, _ = make(path, "--ratios", "0.5")
    assert '"Bällchen" has 2 levels' in summary
    texmesh.scene_files.open_scene(path.with_name("out.blend"))
    assert all(item.library is None for item in level_sets_in(bpy.context.scene)[0].levels)


def test_a_missing_image_is_named(folder):
    item = textured_ball(8)
    image = item.data.materials[0].node_tree.nodes["Image Texture"].image = bpy.data.images.new("Lost", 8, 8)
    image.source, image.filepath = "FILE", str(folder / "lost.png")
    with pytest.raises(FileError, match=r'The image "Lost.*" is missing or empty .*lost.png'):
        make(save(folder))
    assert sorted(path.name for path in folder.iterdir()) == ["bällchen.blend"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flags", "error_type", "text"),
    [
        (("--out", "x.fbx"), FileError, "--out"),
        (("--out", "bällchen-L7.glb", "--report", "bällchen.blend"), FileError, "same file"),
        (("--out", "x.glb", "--report", "x-L1.glb"), FileError, "same file"),
        (("--out", "none.blend/x.glb"), FileError, "none.blend"),
        (("--out", "x.glb", "--ratios", "0.5,2"), SettingsError, "fractions between 0 and 1"),
        (("--out", "x.glb", "--ratios", "0.5,50%"), SettingsError, "twice"),
        (("--out", "x.glb", "--ratios", "half"), SettingsError, '"half"'),
        (("--out", "x.glb", "--ratios", "0.0001"), SettingsError, "no level for every ratio"),
        (("--out", "x.glb", "--ratios", "0.5", "--number", "3"), SettingsError, "exclude each other"),
        (("--out", "x.blend", "--number", "1"), SettingsError, "--number"),
        (("--out", "x.blend", "--max-triangles", "4"), SettingsError, "budget"),
    ],
)
def test_invalid_input_is_one_sentence_and_leaves_nothing(ball, flags, error_type, text):
    ball.with_name("none.blend").write_bytes(b"")
    before = {path: path.stat().st_size for path in ball.parent.rglob("*")}
    flags = [ball.parent / flag if "." in flag and not flag[0].isdigit() else flag for flag in flags]
    with pytest.raises(error_type) as caught:
        run("levels", ball, *FAST, *flags)
    assert text in str(caught.value) and "\n" not in str(caught.value)
    assert {path: path.stat().st_size for path in ball.parent.rglob("*")} == before


def test_a_file_of_small_objects_stays_as_it_is(folder):
    bpy.ops.mesh.primitive_plane_add()
    (figures,) = make(save(folder))[1]["objects"]
    assert [level["triangles"] for level in figures["levels"]] == [2]


def test_levels_are_exported_by_the_operator(ball):
    texmesh.scene_files.open_scene(ball)
    bpy.context.view_layer.objects.active = item = bpy.data.objects["Bällchen"]
    item.select_set(True)
    assert not bpy.ops.farfield.texmesh_export.poll()
    bpy.ops.farfield.texmesh_levels(levels="ratios", ratios="0.5", views=2, max_image=64, vertices="original")
    path = ball.with_name("tree.glb")
    assert bpy.ops.farfield.texmesh_export(filepath=str(path), one_file=True) == {"FINISHED"}
    assert len(parse_glb(path)["nodes"]) == 2
    assert bpy.ops.farfield.texmesh_export(filepath=str(path)) == {"FINISHED"}
    assert {entry.name for entry in ball.parent.glob("tree-*")} == {"tree-L0.glb", "tree-L1.glb"}
    with pytest.raises(RuntimeError, match=r"must end in \.glb"):
        bpy.ops.farfield.texmesh_export(filepath=str(path.with_suffix(".obj")))
    with pytest.raises(RuntimeError, match="is a folder; name a file in it"):
        bpy.ops.farfield.texmesh_export(filepath=str(path.parent))
