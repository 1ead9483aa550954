"""Levels of linked duplicates and of instances: made once per mesh, and shown wherever the mesh is."""

import bpy
import mathutils
import numpy as np
import pytest

from farfield.addon.bridge import lod_crossfade
from farfield.addon.bridge.geometry.mesh_arrays import read_positions
from farfield.addon.bridge.texmesh import placed_sources
from farfield.addon.bridge.texmesh.level_sets import LevelSet, level_sets_in
from farfield.addon.core.geometry.transforms import transform_points
from farfield.addon.operators.texmesh import job
from glb_reader import read_glb
from textured_scenes import textured_ball

pytestmark = pytest.mark.usefixtures("empty_scene", "few_samples")
SMALL = {"levels": "ratios", "ratios": "0.5,0.2", "views": 1, "max_image": 32, "vertices": "original"}


@pytest.fixture
def ball() -> bpy.types.Object:
    return textured_ball(8, "Ball")


@pytest.fixture
def made(monkeypatch) -> list[str]:
    """The meshes that levels are made of, with their triangles."""
    found, make_levels = [], job.make_levels

    def note(mesh, *arguments):
        found.append(len(mesh.triangles))
        return make_levels(mesh, *arguments)

    monkeypatch.setattr(job, "make_levels", note)
    return found


def make(*items: bpy.types.Object, **values) -> list[LevelSet]:
    bpy.ops.object.select_all(action="DESELECT")
    for item in items:
        item.select_set(True)
    bpy.context.view_layer.objects.active = items[0]
    assert bpy.ops.farfield.texmesh_levels(**{**SMALL, **values}) == {"FINISHED"}
    bpy.context.view_layer.update()
    return level_sets_in(bpy.context.scene)


def duplicate(item: bpy.types.Object, **values) -> bpy.types.Object:
    copy = item.copy()
    for name, value in values.items():
        setattr(copy, name, value)
    bpy.context.scene.collection.objects.link(copy)
    bpy.context.view_layer.update()
    return copy


def list_meshes(sets: list[LevelSet]) -> list[bpy.types.Mesh]:
    return list(dict.fromkeys(level.data for levels in sets for level in levels.levels))


def add_empty(collection: bpy.types.Collection, name: str, location: tuple[float, float, float]) -> bpy.types.Object:
    empty = bpy.data.objects.new(name, None)
    empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", collection, location
    bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    return empty


def scatter(item: bpy.types.Object, count: int) -> bpy.types.Object:
    """An object that instances `item` at points in a row, by geometry nodes."""
    tree = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    line, points, info, end = map(
        tree.nodes.new, ("GeometryNodeMeshLine", "GeometryNodeInstanceOnPoints", "GeometryNodeObjectInfo", "NodeGroupOutput")
    )
    line.inputs["Count"].default_value, line.inputs["Offset"].default_value = count, (0.0, 3.0, 0.0)
    info.inputs["Object"].default_value, info.inputs["As Instance"].default_value = item, True
    tree.links.new(line.outputs["Mesh"], points.inputs["Points"])
    tree.links.new(info.outputs["Geometry"], points.inputs["Instance"])
    tree.links.new(points.outputs["Instances"], end.inputs[0])
    result = bpy.data.objects.new("Row", bpy.data.meshes.new("Row"))
    result.location = (5.0, 0.0, 0.0)
    result.modifiers.new("Scatter", "NODES").node_group = tree
    bpy.context.scene.collection.objects.link(result)
    bpy.context.view_layer.update()
    return result


def test_levels_of_linked_duplicates_are_computed_once(ball, made, capsys):
    others = [duplicate(ball, location=(4, 0, 0)), duplicate(ball, location=(8, 0, 0), scale=(-1, 2, 1), name="Mirrored")]
    other = textured_ball(6, "Other")
    sets = make(ball, *others, other)
    assert len(made) == 2 and len(sets) == 4 and len(list_meshes(sets)) == 6
    assert '"Ball" has 3 levels with 224, 112, 44 triangles, shared by 3 objects or instances.' in capsys.readouterr().out
    assert {levels.source for levels in sets} == {ball, *others, other}
    for levels in sets:
        np.testing.assert_allclose([level.matrix_world for level in levels.levels], [levels.source.matrix_world] * 3, atol=1e-6)
    assert len({material for mesh in list_meshes(sets) for material in mesh.materials}) == 2


@pytest.mark.slow
def test_other_materials_or_shapes_are_levels_of_their_own(ball, made):
    other, wide = duplicate(ball), duplicate(ball)
    other.material_slots[0].link = "OBJECT"
    other.material_slots[0].material = bpy.data.materials.new("Other")
    wide.modifiers.new("Wide", "CAST")
    assert len(list_meshes(make(ball, other, wide))) == 9 and len(made) == 3


@pytest.mark.slow
def test_one_of_several_duplicates_stops_cross_fading(ball):
    other = duplicate(ball, location=(4, 0, 0))
    first, second = sorted(make(ball, other), key=lambda levels: levels.source.location.x)
    (material,) = {material for mesh in list_meshes([first]) for material in mesh.materials}
    first.show(1)
    nodes = [node for node in material.node_tree.nodes if lod_crossfade.is_crossfade(node)]
    assert second.has_crossfade and not first.has_crossfade and len(nodes) == 1
    assert tuple(first.levels[1][lod_crossfade.CROSSFADE])[:2] == pytest.approx(lod_crossfade.ALWAYS)
    second.show(0)
    assert not any(lod_crossfade.is_crossfade(node) for node in material.node_tree.nodes)
    second.add_crossfade(bpy.context.scene, 0.2)
    assert first.levels[1][lod_crossfade.CROSSFADE][0] < 0.0 and second.has_crossfade


def test_instances_of_collections_are_levels_of_their_meshes(ball, made):
    other = textured_ball(6, "Other")
    other.location.z = 3.0
    collection = bpy.data.collections.new("Pair")
    for item in (ball, other):
        collection.objects.link(item)
        bpy.context.scene.collection.objects.unlink(item)
    empties = [add_empty(collection, "Place A", (4, 0, 0)), add_empty(collection, "Place B", (8, 0, 0))]
    sets = make(*empties)
    assert len(made) == 2 and len(sets) == 4 and len(list_meshes(sets)) == 6
    places = {tuple(levels.levels[2].matrix_world.translation) for levels in sets}
    assert places == {(4, 0, 0), (4, 0, 3), (8, 0, 0), (8, 0, 3)}
    assert sorted(levels.label for levels in sets) == ["Place A Ball", "Place A Other", "Place B Ball", "Place B Other"]


def test_instances_of_geometry_nodes_are_levels_of_their_mesh(ball, made, tmp_path):
    row = scatter(ball, 5)
    sets = make(row)
    assert len(made) == 1 and len(sets) == 5 and len(list_meshes(sets)) == 3
    assert sorted(tuple(levels.levels[0].matrix_world.translation) for levels in sets) == [(5, 3 * step, 0) for step in range(5)]
    assert bpy.ops.farfield.texmesh_export(filepath=str(tmp_path / "row.glb"), one_file=True) == {"FINISHED"}
    file = read_glb(tmp_path / "row.glb")
    assert len(file.meshes) == 3 and len(file.nodes) == 15 and len({node.name for node in file.nodes}) == 15
    assert bpy.ops.farfield.texmesh_show(level=-1) == {"FINISHED"}
    assert not row.hide_render and all(level.hide_render for levels in sets for level in levels.levels)
    assert len(make(row)) == 5 and len(bpy.data.collections) == 6
    assert bpy.ops.farfield.texmesh_remove() == {"FINISHED"}
    assert not bpy.data.collections and len(bpy.data.meshes) == 2


@pytest.mark.slow
def test_many_instances_are_one_mesh(ball, made, monkeypatch, capsys):
    monkeypatch.setattr(placed_sources, "MAX_INSTANCES", 3)
    (levels,) = make(scatter(ball, 4))
    assert made == [4 * 224] and levels.source_name == "Row"
    assert 'The levels of "Row" are one mesh, joined from 4 instances.' in capsys.readouterr().out


def test_instances_that_are_sheared_have_a_mesh_of_their_own(ball, made):
    collection = bpy.data.collections.new("Turned")
    collection.objects.link(ball)
    bpy.context.scene.collection.objects.unlink(ball)
    inner = duplicate(ball)
    bpy.context.scene.collection.objects.unlink(inner)
    collection.objects.link(inner)
    inner.matrix_world = mathutils.Matrix.Rotation(0.5, 4, "Z")
    empty = add_empty(collection, "Wide", (0, 0, 0))
    empty.scale = (2.0, 1.0, 1.0)
    bpy.context.view_layer.update()
    instances = bpy.context.evaluated_depsgraph_get().object_instances
    matrices = [np.array(instance.matrix_world) for instance in instances if instance.is_instance]
    wanted = np.concatenate([transform_points(matrix, read_positions(ball.data)) for matrix in matrices])
    finest = [levels.levels[0] for levels in make(empty)]
    found = np.concatenate([transform_points(np.array(level.matrix_world), read_positions(level.data)) for level in finest])
    assert len(made) == 2
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(wanted, axis=0), atol=1e-5)
