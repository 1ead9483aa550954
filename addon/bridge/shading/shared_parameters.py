"""Shader parameters that all materials of a source have in common, and that the PBR maps do not contain: coats, sheen, refractive index."""

from collections.abc import Sequence

import bpy

PARAMETERS = (
    *("Diffuse Roughness", "IOR", "Specular IOR Level", "Specular Tint"),
    *("Coat Weight", "Coat Roughness", "Coat IOR", "Coat Tint", "Sheen Weight", "Sheen Roughness", "Sheen Tint"),
)  # Inputs of the Principled shader.

Value = float | tuple[float, ...]


def read_shared_parameters(materials: Sequence[bpy.types.Material]) -> dict[str, Value]:
    """Return those of PARAMETERS that have the same constant value in all `materials`; none unless each is one Principled shader."""
    shaders = [_find_principled(material) for material in materials]
    if not shaders or None in shaders:
        return {}
    parameters = {}
    for name in PARAMETERS:
        sockets = [shader.inputs.get(name) for shader in shaders]
        if None in sockets or any(socket.is_linked for socket in sockets):
            continue
        values = {_read_value(socket) for socket in sockets}
        if len(values) == 1:
            (parameters[name],) = values
    return parameters


def write_parameters(shader: bpy.types.Node, parameters: dict[str, Value]) -> None:
    """Set `parameters` of a Principled shader; those that this version of Blender does not have are left out."""
    for name, value in parameters.items():
        if name in shader.inputs:
            shader.inputs[name].default_value = value


def _find_principled(material: bpy.types.Material) -> bpy.types.Node | None:
    """Return the Principled shader that is linked to the output of `material`."""
    output = material.node_tree.get_output_node("CYCLES") if material.node_tree is not None else None
    links = output.inputs["Surface"].links if output is not None else ()
    shader = links[0].from_node if links and not links[0].is_muted else None
    return shader if shader is not None and shader.type == "BSDF_PRINCIPLED" and not shader.mute else None


def _read_value(socket: bpy.types.NodeSocket) -> Value:
    value = socket.default_value
    return value if isinstance(value, float) else tuple(value)
