"""Which materials shine by themselves."""

import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes
from farfield.addon.bridge.emission import may_shine


@pytest.fixture(autouse=True)
def fresh_scene(extension):
    blender_scenes.fresh()


def shining(strength: float, colour=(1.0, 1.0, 1.0)) -> bpy.types.Material:
    """A Principled material that emits."""
    made = blender_scenes.material("Lamp")
    shader = blender_scenes.shader_of(made)
    shader.inputs["Emission Color"].default_value = (*colour, 1.0)
    shader.inputs["Emission Strength"].default_value = strength
    return made


def test_emission_has_strength_and_a_colour():
    assert not may_shine([])
    assert not may_shine([shining(0.0), shining(2.0, (0.0, 0.0, 0.0))])
    assert may_shine([shining(0.0), shining(2.0)])


def test_a_strength_that_is_linked_may_be_anything():
    made = shining(0.0)
    value = made.node_tree.nodes.new("ShaderNodeValue")
    blender_scenes.link(made, value.outputs[0], blender_scenes.shader_of(made).inputs["Emission Strength"])
    assert may_shine([made])


def test_emission_is_found_in_groups_but_not_in_muted_nodes():
    group = bpy.data.node_groups.new("Lamps", "ShaderNodeTree")
    emission = group.nodes.new("ShaderNodeEmission")
    inner = group.nodes.new("ShaderNodeGroup")
    inner.node_tree = bpy.data.node_groups.new("Nothing", "ShaderNodeTree")
    made = blender_scenes.material("Grouped")
    made.node_tree.nodes.new("ShaderNodeGroup").node_tree = group
    assert may_shine([made])
    emission.mute = True
    assert not may_shine([made])
