"""What a capture of a material leaves out, one sentence per material."""

from collections.abc import Container, Iterator, Mapping

import bpy

from .node_builder import nodes_in
from .surface_layers import PRINCIPLED, REFRACTIVE, find_layers, lost_coat_inputs
from .surface_reader import find_output

# Nodes that need the scene around the shaded point, or the camera, and their outputs, "" for any.
NODES: Mapping[str, tuple[tuple[str, str], ...]] = {
    "AMBIENT_OCCLUSION": (("", "ambient occlusion"),),
    "BEVEL": (("", "bevel"),),
    "TEX_COORD": (("Camera", "camera coordinates"), ("Window", "window coordinates"), ("Reflection", "reflection coordinates")),
    "VECT_TRANSFORM": (("", "vector transform"),),
    "NEW_GEOMETRY": (("Tangent", "tangent"), ("Pointiness", "pointiness")),
    "CAMERA": (("", "dependence on the camera"),),
}
# Inputs of a Principled shader above zero, or linked.
WEIGHTS = {"Subsurface Weight": "subsurface scattering", "Anisotropic": "anisotropy", "Thin Film Thickness": "thin film"}
SHADERS = {
    "SUBSURFACE_SCATTERING": "subsurface scattering",
    "BSDF_SHEEN": "sheen",
    "BSDF_HAIR": "hair shading",
    "BSDF_HAIR_PRINCIPLED": "hair shading",
    "BSDF_TOON": "toon shading",
}


def describe_losses(materials: Mapping[bpy.types.Material, str], thick: Container[bpy.types.Material] = ()) -> list[str]:
    """Return sentences about what a capture of `materials` leaves out. Their values are the names of objects that have them.

    thick: those with glass on solid bodies.
    """
    sentences, (_, shared) = [], find_layers(list(materials))
    for material, owner in materials.items():
        losses = list(dict.fromkeys(_find_losses(material, shared)))
        if material in thick and is_glass(material):
            losses.append("refraction")
        if losses:
            listed = losses[0] if len(losses) == 1 else f"{', '.join(losses[:-1])} and {losses[-1]}"
            sentences.append(f'"{material.name}" of "{owner}": its {listed} {"is" if len(losses) == 1 else "are"} left out.')
    return sentences


def _find_losses(material: bpy.types.Material, shared: Container[str]) -> Iterator[str]:
    tree = material.node_tree
    output = None if tree is None else find_output(tree)
    if output is None:
        return
    if output.inputs["Volume"].is_linked:
        yield "volume"
    if output.inputs["Displacement"].is_linked and material.displacement_method != "BUMP":
        yield "displacement"
    for node in nodes_in(tree, muted=False):
        if not any(item.is_linked for item in node.outputs):
            continue
        yield from (label for name, label in NODES.get(node.type, ()) if not name or node.outputs[name].is_linked)
        if node.type in SHADERS:
            yield SHADERS[node.type]
        if node.type == "TEX_IMAGE" and node.projection != "FLAT":
            yield f"{node.projection.lower()} projection"
        if node.type == PRINCIPLED:
            yield from (label for name, label in WEIGHTS.items() if _is_set(node, name))
            if _is_set(node, "Coat Weight"):
                yield from (name.replace("Coat", "coat").replace("Tint", "tint") for name in lost_coat_inputs(node) if name not in shared)


def _is_set(node: bpy.types.Node, name: str) -> bool:
    item = node.inputs.get(name)
    return item is not None and (item.is_linked or item.default_value > 0.0)


def is_glass(material: bpy.types.Material) -> bool:
    """Return whether a material has a node that lets light through without scattering it."""
    nodes = nodes_in(material.node_tree, muted=False) if material.node_tree is not None else ()
    return any(node.type in REFRACTIVE or (node.type == PRINCIPLED and _is_set(node, "Transmission Weight")) for node in nodes)
