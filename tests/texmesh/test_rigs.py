"""Levels of meshes that armatures and shape keys deform: they are deformed like their source."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.geometry.mesh_arrays import read_positions
from farfield.addon.bridge.texmesh.level_sets import level_sets_in
from farfield.addon.core.geometry.distance import TriangleTree
from textured_scenes import checker_image, textured_ball, textured_material

pytestmark = pytest.mark.usefixtures("empty_scene", "few_samples")
RADIUS, HEIGHT = 0.4, 4.0
SMALL = {"levels": "ratios", "ratios": "0.3,0.1", "views": 1, "max_image": 32, "vertices": "original"}


@pytest.fixture
def tube(request) -> bpy.types.Object:
    """A tube of two bones, with weights that change along it, under an armature that is moved and turned."""
    item = add_tube()
    rig = add_bones()
    upper = np.clip(read_positions(item.data)[:, 2] - HEIGHT / 2 + 0.5, 0.0, 1.0)
    for name, weights in (("Lower", 1.0 - upper), ("Upper", upper)):
        group = item.vertex_groups.new(name=name)
        for index, weight in enumerate(weights.tolist()):
            group.add([index], weight, "REPLACE")
    item.parent = rig
    if getattr(request, "param", "") == "parent":
        item.parent_type = "ARMATURE"
    else:
        item.modifiers.new("Skeleton", "ARMATURE").object = rig
    rig.location, rig.rotation_euler = (3.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    bpy.context.view_layer.objects.active = item
    item.select_set(True)
    return item


def add_tube(segments: int = 12, rings: int = 16) -> bpy.types.Object:
    rows, columns = np.mgrid[: rings + 1, :segments]
    angles = 2.0 * np.pi * columns / segments
    radii = RADIUS * (1.0 - 0.4 * rows / rings)
    vertices = np.stack([radii * np.cos(angles), radii * np.sin(angles), HEIGHT * rows / rings], axis=-1).reshape(-1, 3)
    corners = np.stack([columns, columns + 1, columns + 1, columns], axis=-1)[:-1], np.stack([rows, rows, rows + 1, rows + 1], axis=-1)[:-1]
    mesh = bpy.data.meshes.new("Tube")
    mesh.from_pydata(vertices.tolist(), [], (segments * corners[1] + corners[0] % segments).reshape(-1, 4).tolist())
    uvs = np.stack([corners[0] / segments, corners[1] / rings], axis=-1)
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", uvs.astype(np.float32).ravel())
    mesh.shade_smooth()
    mesh.materials.append(textured_material(checker_image()))
    item = bpy.data.objects.new("Tube", mesh)
    bpy.context.scene.collection.objects.link(item)
    return item


def add_bones() -> bpy.types.Object:
    bpy.ops.object.armature_add()
    rig = bpy.context.object
    bpy.ops.object.mode_set(mode="EDIT")
    lower = rig.data.edit_bones[0]
    lower.name, lower.tail = "Lower", (0, 0, HEIGHT / 2)
    upper = rig.data.edit_bones.new("Upper")
    upper.head, upper.tail, upper.parent = lower.tail, (0, 0, HEIGHT), lower
    bpy.ops.object.mode_set(mode="OBJECT")
    rig.select_set(False)
    return rig


def pose(rig: bpy.types.Object, angle: float) -> None:
    bone = rig.pose.bones["Upper"]
    bone.rotation_mode, bone.rotation_euler = "XYZ", (angle, 0.0, 0.0)
    bpy.context.view_layer.update()


def read_shown(item: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """World positions of the deformed vertices of an object, and its triangles."""
    item.hide_viewport = False
    bpy.context.view_layer.update()
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    evaluated.data.calc_loop_triangles()
    matrix = np.array(evaluated.matrix_world)
    triangles = np.array([triangle.vertices[:] for triangle in evaluated.data.loop_triangles])
    return read_positions(evaluated.data) @ matrix[:3, :3].T + matrix[:3, 3], triangles


def measure(level: bpy.types.Object, source: bpy.types.Object) -> float:
    """The largest distance of vertices of a level from its source, as both are shown."""
    vertices, triangles = read_shown(source)
    return float(TriangleTree(vertices[triangles]).find_closest(read_shown(level)[0])[0].max())


def make(**values) -> list[bpy.types.Object]:
    assert bpy.ops.farfield.texmesh_levels(**{**SMALL, **values}) == {"FINISHED"}
    (levels,) = level_sets_in(bpy.context.scene)
    return levels.levels


@pytest.mark.slow
@pytest.mark.parametrize("tube", ["modifier", pytest.param("parent", marks=pytest.mark.exhaustive)], indirect=True)
def test_levels_follow_their_armature(tube, capsys):
    rig = tube.parent
    pose(rig, 0.4)  # Levels do not depend on the pose in which they are made.
    levels = make(vertices="optimized", ratios="0.4")
    assert "current shape" not in capsys.readouterr().out
    rig.location.x += 1.0
    pose(rig, 0.0)
    at_rest = [measure(level, tube) for level in levels]
    pose(rig, 1.2)
    bent = [measure(level, tube) for level in levels]
    assert at_rest[0] < 1e-6 and bent[0] < 1e-6
    assert max(at_rest) < 0.1 * RADIUS
    assert all(posed < 1.1 * resting + 0.01 * RADIUS for posed, resting in zip(bent, at_rest, strict=True)), (bent, at_rest)


@pytest.mark.slow
def test_duplicates_with_armatures_of_their_own_have_the_same_meshes(tube):
    rig, other, second = tube.parent, tube.copy(), tube.parent.copy()
    for item in (other, second):
        bpy.context.scene.collection.objects.link(item)
    other.parent, second.location = second, (0.0, 9.0, 0.0)
    for modifier in other.modifiers:
        modifier.object = second
    other.select_set(True)
    bpy.context.view_layer.update()
    assert bpy.ops.farfield.texmesh_levels(**SMALL) == {"FINISHED"}
    first_set, second_set = level_sets_in(bpy.context.scene)
    assert [level.data for level in first_set.levels] == [level.data for level in second_set.levels]
    pose(second, 1.2)
    assert measure(first_set.levels[0], first_set.source) < 1e-6 and measure(second_set.levels[0], second_set.source) < 1e-6
    pose(rig, -1.2)
    assert measure(first_set.levels[0], first_set.source) < 1e-6 and measure(second_set.levels[0], second_set.source) < 1e-6


def test_instances_of_rigged_collections_keep_their_shape_and_say_so(tube, capsys):
    collection = bpy.data.collections.new("Character")
    for item in (tube, tube.parent):
        collection.objects.link(item)
        bpy.context.scene.collection.objects.unlink(item)
    empty = bpy.data.objects.new("Place", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    bpy.context.scene.collection.objects.link(empty)
    pose(tube.parent, 1.2)
    empty.select_set(True)
    assert len(make()) == 3
    assert 'The levels of "Place" have its current shape; they do not follow armatures and shape keys' in capsys.readouterr().out


@pytest.mark.slow
def test_normals_of_levels_turn_with_their_faces(tube):
    finest = make()[0]
    pose(tube.parent, 1.2)
    finest.hide_viewport = False
    bpy.context.view_layer.update()
    data = finest.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    faces = [(face.normal, data.corner_normals[index].vector) for face in data.polygons for index in face.loop_indices]
    assert np.quantile([face.dot(corner) for face, corner in faces], 0.1) > 0.9


def test_weights_sum_to_those_of_the_source(tube):
    tube.vertex_groups.new(name="Empty")
    for level in make():
        assert [group.name for group in level.vertex_groups] == ["Lower", "Upper", "Empty"]
        sums = [sum(found.weight for found in vertex.groups) for vertex in level.data.vertices]
        assert sums == pytest.approx([1.0] * len(sums), abs=1e-5)


@pytest.fixture
def face() -> bpy.types.Object:
    """A sphere with a subdivision modifier and two shape keys, the second of which is relative to the first."""
    item = textured_ball(8, "Face")
    item.modifiers.new("Subdivision", "SUBSURF").levels = 1
    item.shape_key_add(name="Basis")
    for name, scale, height in (("Wide", 1.5, 0.0), ("Wide and High", 1.5, 1.0)):
        block = item.shape_key_add(name=name, from_mix=False)
        block.points.foreach_set("co", (read_positions(item.data) * (scale, 1.0, 1.0) + (0.0, 0.0, height)).astype(np.float32).ravel())
    item.data.shape_keys.key_blocks["Wide and High"].relative_key = item.data.shape_keys.key_blocks["Wide"]
    item.data.shape_keys.key_blocks["Wide"].value = 0.7
    return item


def test_shape_keys_of_levels_follow_those_of_their_source(face, capsys):
    keys = face.data.shape_keys.key_blocks
    levels = make()
    assert "current shape" not in capsys.readouterr().out and not face.show_only_shape_key
    heights = {}
    for values in ((0.0, 0.0), (0.5, 0.0), (0.0, 1.0)):
        keys["Wide"].value, keys["Wide and High"].value = values
        bpy.context.view_layer.update()
        measured = [measure(level, face) for level in levels]
        assert measured[0] < 1e-6 and max(measured) < 0.1
        heights[values] = read_shown(levels[2])[0][:, 2].mean()
    assert heights[0.0, 1.0] - heights[0.0, 0.0] == pytest.approx(1.0, abs=1e-4)


@pytest.mark.slow
def test_shape_keys_that_are_not_relative_are_refused(face, capsys):
    face.data.shape_keys.use_relative = False
    levels = make()
    assert 'The levels of "Face" have its current shape; they do not follow its shape keys.' in capsys.readouterr().out
    assert all(level.data.shape_keys is None for level in levels)


@pytest.mark.slow
@pytest.mark.parametrize("one_file", [True, pytest.param(False, marks=pytest.mark.exhaustive)])
def test_files_have_the_skins_of_levels(tube, tmp_path, capsys, one_file):
    rig = tube.parent
    levels = make()
    rig.animation_data_create().action = bpy.data.actions.new("Walk")
    assert bpy.ops.farfield.texmesh_export(filepath=str(tmp_path / "tube.glb"), one_file=one_file) == {"FINISHED"}
    assert 'lacks animations of "Tube".' in capsys.readouterr().out and rig.name in bpy.data.objects
    pose(rig, 1.2)
    wanted = [read_shown(level) for level in levels]
    own, found = set(bpy.data.objects), {}
    for path in tmp_path.glob("*.glb"):
        before = set(bpy.data.objects)
        bpy.ops.import_scene.gltf(filepath=str(path))
        (skeleton,) = (item for item in set(bpy.data.objects) - before if item.type == "ARMATURE")
        pose(skeleton, 1.2)
        assert skeleton.name.startswith(rig.name)
        found |= {item.name: item for item in set(bpy.data.objects) - own if item.find_armature() == skeleton}
    assert sorted(found) == ["Tube_LOD0", "Tube_LOD1", "Tube_LOD2"] and not any("Export" in item.name for item in bpy.data.objects)
    for item in set(found.values()) - set(bpy.context.view_layer.objects):  # Blender hides nodes that only MSFT_lod refers to.
        bpy.context.scene.collection.objects.link(item)
    for number, (vertices, triangles) in enumerate(wanted):
        nearest, _ = TriangleTree(vertices[triangles]).find_closest(read_shown(found[f"Tube_LOD{number}"])[0])
        assert nearest.max() < 2e-3


@pytest.mark.slow
def test_files_have_the_shape_keys_of_levels(face, tmp_path):
    keys = face.data.shape_keys.key_blocks
    levels = make()
    assert bpy.ops.farfield.texmesh_export(filepath=str(tmp_path / "face.glb")) == {"FINISHED"}
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "face-L1.glb"))
    imported = bpy.context.object.data.shape_keys.key_blocks
    assert [block.name for block in imported[1:]] == ["Wide", "Wide and High"] and imported["Wide"].value == pytest.approx(0.7)
    keys["Wide"].value = imported["Wide"].value = 0.0
    keys["Wide and High"].value = imported["Wide and High"].value = 1.0
    vertices, triangles = read_shown(levels[1])
    assert TriangleTree(vertices[triangles]).find_closest(read_shown(bpy.context.object)[0])[0].max() < 1e-4
