"""Objects that show rows of instances with an attribute, made by Geometry Nodes."""

import bpy

from bridge import blender_scenes

STEP = 5.0  # Between instances.


def shining(name="Shining"):
    """Return a material that emits the attribute `tint` of instances."""
    material = blender_scenes.create_material(name)
    nodes = material.node_tree.nodes
    attribute, emission = nodes.new("ShaderNodeAttribute"), nodes.new("ShaderNodeEmission")
    attribute.attribute_type, attribute.attribute_name = "INSTANCER", "tint"
    blender_scenes.link(material, attribute.outputs["Color"], emission.inputs["Color"])
    blender_scenes.link(material, emission.outputs[0], nodes["Material Output"].inputs["Surface"])
    return material


def scatter(name, instanced, square_material=None):
    """Add an object with a row of four instances of the object or collection `instanced` along x.

    Their attribute `tint` has the color (index / 4, 0.5, 0.25). square_material: of a square that is instanced together with it.
    """
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    line, place, store = (tree.nodes.new(f"GeometryNode{kind}") for kind in ("MeshLine", "InstanceOnPoints", "StoreNamedAttribute"))
    line.inputs["Count"].default_value, line.inputs["Offset"].default_value = 4, (STEP, 0.0, 0.0)
    is_object = isinstance(instanced, bpy.types.Object)
    info = tree.nodes.new("GeometryNodeObjectInfo" if is_object else "GeometryNodeCollectionInfo")
    info.inputs["Object" if is_object else "Collection"].default_value = instanced
    if is_object:
        info.inputs["As Instance"].default_value = True
    geometry = next(item for item in info.outputs if item.type == "GEOMETRY")
    if square_material is not None:
        square, move, material, join, wrap = (
            tree.nodes.new(f"GeometryNode{kind}") for kind in ("MeshGrid", "Transform", "SetMaterial", "JoinGeometry", "GeometryToInstance")
        )
        move.inputs["Translation"].default_value = (0.0, 2.0, 0.0)
        material.inputs["Material"].default_value = square_material
        tree.links.new(square.outputs[0], move.inputs[0])
        tree.links.new(move.outputs[0], material.inputs[0])
        tree.links.new(material.outputs[0], join.inputs[0])
        tree.links.new(geometry, join.inputs[0])
        tree.links.new(join.outputs[0], wrap.inputs[0])
        geometry = wrap.outputs[0]
    store.data_type, store.domain = "FLOAT_COLOR", "INSTANCE"
    store.inputs["Name"].default_value = "tint"
    index, scale, color = (tree.nodes.new(kind) for kind in ("GeometryNodeInputIndex", "ShaderNodeMath", "ShaderNodeCombineXYZ"))
    scale.operation, scale.inputs[1].default_value = "DIVIDE", 4.0
    color.inputs["Y"].default_value, color.inputs["Z"].default_value = 0.5, 0.25
    tree.links.new(index.outputs[0], scale.inputs[0])
    tree.links.new(scale.outputs[0], color.inputs["X"])
    tree.links.new(line.outputs[0], place.inputs["Points"])
    tree.links.new(geometry, place.inputs["Instance"])
    tree.links.new(place.outputs[0], store.inputs["Geometry"])
    tree.links.new(color.outputs[0], store.inputs["Value"])
    tree.links.new(store.outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0])
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(0.0, 0.0, 0.0)], [], [])
    item = bpy.data.objects.new(name, mesh)
    item.modifiers.new("Scatter", "NODES").node_group = tree
    bpy.context.scene.collection.objects.link(item)
    return item
