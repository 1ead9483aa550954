"""Which materials emit light."""

import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes
from farfield.addon.bridge.shading.node_builder import has_emission


@pytest.fixture(autouse=True)
def fresh_scene(extension):
    blender_scenes.reset_scene()


def emissive(strength: float, color=(1.0, 1.0, 1.0)) -> bpy.types.Material:
    """Return a Principled material that emits light."""
    material = blender_scenes.create_material("Light")
    shader = blender_scenes.shader_of(material)
    shader.inputs["Emission Color"].default_value = (*color, 1.0)
    shader.inputs["Emission Strength"].default_value = strength
    return material


def test_emission_has_strength_and_a_color():
    assert not has_emission([])
    assert not has_emission([emissive(0.0), emissive(2.0, (0.0, 0.0, 0.0))])
    assert has_emission([emissive(0.0), emissive(2.0)])


def test_a_linked_strength_counts_as_emission():
    material = emissive(0.0)
    value = material.node_tree.nodes.new("ShaderNodeValue")
    blender_scenes.link(material, value.outputs[0], blender_scenes.shader_of(material).inputs["Emission Strength"])
    assert has_emission([material])


def test_emission_is_found_in_groups_but_not_in_muted_nodes():
    group = bpy.data.node_groups.new("Lights", "ShaderNodeTree")
    emission = group.nodes.new("ShaderNodeEmission")
    inner = group.nodes.new("ShaderNodeGroup")
    inner.node_tree = bpy.data.node_groups.new("Empty", "ShaderNodeTree")
    material = blender_scenes.create_material("Grouped")
    material.node_tree.nodes.new("ShaderNodeGroup").node_tree = group
    assert has_emission([material])
    emission.mute = True
    assert not has_emission([material])
