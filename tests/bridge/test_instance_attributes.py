"""Attributes of instances, as Cycles shows them: instances in instances, in collections, and together with other geometry."""

import bpy
import numpy as np
import pytest

pytest.importorskip("bpy")

from bridge import blender_scenes
from bridge.instance_scenes import STEP, scatter, shining
from farfield.addon.bridge.geometry.instance_attributes import InstanceAttributes
from farfield.addon.bridge.geometry.meshes import read_source, visible_meshes
from lib.studio import open_studio

PIXEL = 0.25


@pytest.fixture(autouse=True)
def fresh_scene():
    blender_scenes.reset_scene()


def instance_of(collection, location):
    """Add an instance of a collection."""
    item = bpy.data.objects.new("Instance", None)
    item.instance_type, item.instance_collection, item.location = "COLLECTION", collection, location
    bpy.context.scene.collection.objects.link(item)
    return item


def render(objects, center):
    """Return a render from above, row 0 at the bottom, and a function from positions to its pixels."""
    size = 160
    with open_studio(objects, 1) as studio:
        direction = np.array([0.0, -1e-4, 1.0])
        image = studio.render(objects, direction / np.linalg.norm(direction), np.array([*center, 0.0]), PIXEL, size)
    return lambda position: image[tuple(np.rint((position[:2] - center) / PIXEL + 0.5 * size).astype(int)[::-1])]


def test_attributes_are_those_that_cycles_shows():
    card = blender_scenes.card(material=shining())
    card["tint"] = (1.0, 0.5, 0.125)  # Shown where no instance has one.
    rows = [scatter("Row", card), scatter("Joined Row", card, shining("Square"))]
    rows[1].location.y = 5.0
    collection = blender_scenes.collect(blender_scenes.box("Unrelated"), scatter("Inner Row", card))
    collection.objects["Unrelated"].location.z = -50.0
    rows += [instance_of(collection, (0.0, 10.0, 0.0)), scatter("Row of Collections", blender_scenes.collect(card))]
    rows[-1].location.y = -5.0
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    source = read_source(rows, depsgraph)
    pixel_at = render(rows, np.array([0.0, 2.5]) + [7.5, 0.0])
    cards = [item for item in source.instances if item.part != "Unrelated"]
    assert len(cards) == 4 + 8 + 4 + 4
    for item in cards:
        center = item.matrix[:3, 3] + ([0.0, 2.0, 0.0] if item.part == "Joined Row" else 0.0)
        assert item.attributes["tint"][:3] == pytest.approx([center[0] / STEP / 4.0, 0.5, 0.25])
        assert pixel_at(center)[:3] == pytest.approx(item.attributes["tint"][:3], abs=2e-3)


def test_inner_attributes_hide_those_around_them():
    inner = scatter("Inner", blender_scenes.card(material=shining()))
    outer = scatter("Outer", inner)
    outer.location.y = 8.0
    outer.modifiers[0].node_group.nodes["Mesh Line"].inputs["Offset"].default_value = (0.0, STEP, 0.0)
    bpy.context.view_layer.update()
    source = read_source([outer], bpy.context.evaluated_depsgraph_get())
    assert len(source.instances) == 16
    for item in source.instances:
        assert item.attributes["tint"][0] == pytest.approx(item.matrix[0, 3] / STEP / 4.0)


def test_other_instances_have_none():
    card = blender_scenes.card()
    faces = blender_scenes.box()
    faces.instance_type = "FACES"
    card.parent = faces
    owner = instance_of(blender_scenes.collect(blender_scenes.ball()), (9.0, 0.0, 0.0))
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    reader = InstanceAttributes()
    found = [
        reader.find(instance.parent, instance.persistent_id)
        for _, instance in visible_meshes({faces.name_full, owner.name_full}, depsgraph)
        if instance.is_instance
    ]
    assert found == [{}] * 7
