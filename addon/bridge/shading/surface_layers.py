"""What a shader does beyond color, normal, roughness and metallic: light that it emits or lets through, a coat, sheen, other highlights.

Each of these layers is a channel of its own, see `material_channels`. Most materials have none of them.
"""

from collections.abc import Sequence

import bpy

from .node_builder import NodeBuilder, SocketOrValue, has_emission, nodes_in
from .shared_parameters import Value, read_shared_parameters
from .socket_sources import input_value

EMISSION, TRANSLUCENCY, TRANSMISSION = "emission", "translucency", "transmission"
SPECULAR, COAT, SHEEN = "specular", "coat", "sheen"
LAYERS = (EMISSION, TRANSLUCENCY, TRANSMISSION, SPECULAR, COAT, SHEEN)
HDR_LAYERS = (EMISSION, SPECULAR)  # Their values may exceed 1.
DATA_LAYERS = (COAT,)  # The others are colors.
SUMMED_LAYERS = (EMISSION, TRANSLUCENCY, TRANSMISSION, SHEEN)  # An Add Shader node adds them; of the others it shows the mean.

BLACK = (0.0, 0.0, 0.0)
PRINCIPLED, REFRACTIVE = "BSDF_PRINCIPLED", {"BSDF_GLASS", "BSDF_REFRACTION"}
DEFAULT_LEVEL = 0.5  # Specular IOR Level of a surface with the refractive index 1.5.
DEFAULT_VALUES = {
    EMISSION: BLACK,
    TRANSLUCENCY: BLACK,
    TRANSMISSION: BLACK,
    SPECULAR: (DEFAULT_LEVEL,) * 3,
    COAT: (0.0, 0.03, 0.5),
    SHEEN: BLACK,
}
# Inputs of a Principled shader by layer, with the values at which they have no effect; None where that depends on the first one.
INPUTS = {
    SPECULAR: {"IOR": 1.5, "Specular IOR Level": DEFAULT_LEVEL, "Specular Tint": 1.0},
    COAT: {"Coat Weight": 0.0, "Coat Roughness": None, "Sheen Roughness": 0.5},
    SHEEN: {"Sheen Weight": 0.0, "Sheen Tint": None},
}
COAT_CONSTANTS = {"Coat IOR": 1.5, "Coat Tint": 1.0}  # Inputs of the coat that no layer has, with their usual values.
MIN_REFLECTANCE = 0.04  # At normal incidence, for the refractive index 1.5.
CLEAR_ROUGHNESS, FROSTED_ROUGHNESS = 0.1, 0.5  # Glass shows what is behind it up to the first one, and only its light from the second on.


def find_layers(materials: Sequence[bpy.types.Material]) -> tuple[tuple[str, ...], dict[str, Value]]:
    """Return those of LAYERS that `materials` may have and that differ, and inputs of a Principled shader that they have in common.

    The layers are read from the nodes, also of those that nothing is linked to.
    """
    nodes = [node for material in materials if material.node_tree is not None for node in nodes_in(material.node_tree, muted=False)]
    found = {EMISSION} if has_emission(materials) else set()
    if any(node.type == "BSDF_TRANSLUCENT" for node in nodes):
        found.add(TRANSLUCENCY)
    for node in nodes:
        if _transmits(node):
            found |= _transmitted_layers(node)
    shared = read_shared_parameters(materials)
    principled = [node for node in nodes if node.type == PRINCIPLED]
    constants = {name: shared[name] for name in ("Diffuse Roughness",) if shared.get(name)}
    for layer, inputs in INPUTS.items():
        if any(_has_layer(node, layer) for node in principled):
            if all(name in shared for name in inputs):
                constants |= {name: shared[name] for name in inputs}
            else:
                found.add(layer)
    if _are_set(principled, "Coat Weight"):
        constants |= {name: shared[name] for name, usual in COAT_CONSTANTS.items() if name in shared and not _is_close(shared[name], usual)}
    return tuple(layer for layer in LAYERS if layer in found), constants


def lost_coat_inputs(node: bpy.types.Node) -> list[str]:
    """Return the names of the inputs of a Principled shader that change its coat, and that no layer has."""
    inputs = {name: node.inputs.get(name) for name in COAT_CONSTANTS}
    return [
        name
        for name, item in inputs.items()
        if item is not None and (item.is_linked or not _is_close(item.default_value, COAT_CONSTANTS[name]))
    ]


def _are_set(nodes: Sequence[bpy.types.Node], name: str) -> bool:
    return any(node.inputs[name].is_linked or node.inputs[name].default_value > 0.0 for node in nodes if name in node.inputs)


def _has_layer(node: bpy.types.Node, layer: str) -> bool:
    """Return whether an input of a Principled shader may make it have `layer`."""
    inputs = {name: node.inputs.get(name) for name, usual in INPUTS[layer].items() if usual is not None}
    if layer == COAT and not _are_set([node], "Sheen Weight"):
        del inputs["Sheen Roughness"]
    present = {name: item for name, item in inputs.items() if item is not None}
    return any(item.is_linked or not _is_close(item.default_value, INPUTS[layer][name]) for name, item in present.items())


def _is_close(value: float | Sequence[float], usual: float) -> bool:
    values = [value] if isinstance(value, float) else list(value)[:3]
    return all(abs(item - usual) < 1e-4 for item in values)


def _transmits(node: bpy.types.Node) -> bool:
    weight = node.inputs.get("Transmission Weight") if node.type == PRINCIPLED else None
    return node.type in REFRACTIVE or (weight is not None and (weight.is_linked or weight.default_value > 0.0))


def _transmitted_layers(node: bpy.types.Node) -> set[str]:
    """Return the layers by which a shader lets light through."""
    roughness = node.inputs.get("Roughness")
    if roughness is None or roughness.is_linked:
        return {TRANSLUCENCY, TRANSMISSION}
    clear, frosted = roughness.default_value < FROSTED_ROUGHNESS, roughness.default_value > CLEAR_ROUGHNESS
    return ({TRANSMISSION} if clear else set()) | ({TRANSLUCENCY} if frosted else set())


class LayerValues:
    """The values of the layers of one shader node, and the fraction of its color that is left."""

    def __init__(self, builder: NodeBuilder, node: bpy.types.Node, color: SocketOrValue, layers: Sequence[str]) -> None:
        self.builder, self.node, self.layers = builder, node, layers
        self._through = self._read_transmission(color)

    def color(self, color: SocketOrValue) -> SocketOrValue:
        """Return the part of the `color` that the shader reflects diffusely: without what the layers show."""
        kind, builder = self.node.type, self.builder
        if (kind == "EMISSION" and EMISSION in self.layers) or (kind == "BSDF_TRANSLUCENT" and TRANSLUCENCY in self.layers):
            return BLACK
        for layer in (TRANSLUCENCY, TRANSMISSION):
            if layer in self._through and layer in self.layers:
                color = builder.vector("SUBTRACT", color, self._through[layer][0])
        return color

    def value(self, layer: str, color: SocketOrValue) -> SocketOrValue:
        """Return the value of one of LAYERS, not yet multiplied by alpha."""
        node, builder = self.node, self.builder
        if layer in self._through:
            return self._through[layer][1]
        if layer == EMISSION and node.type == "EMISSION":
            return builder.vector("SCALE", color, input_value(node, "Strength", 1.0))
        if layer == SPECULAR and node.type == "EMISSION":
            return BLACK
        if layer == TRANSLUCENCY and node.type == "BSDF_TRANSLUCENT":
            return color
        if node.type != PRINCIPLED:
            return DEFAULT_VALUES[layer]
        read = {EMISSION: self._read_emission, SPECULAR: self._read_specular, COAT: self._read_coat, SHEEN: self._read_sheen}
        return read[layer]() if layer in read else DEFAULT_VALUES[layer]

    def _read_transmission(self, color: SocketOrValue) -> dict[str, tuple[SocketOrValue, SocketOrValue]]:
        """Return by layer the part of `color` that the shader lets through instead of reflecting it, and what it lets through."""
        node, builder = self.node, self.builder
        if not _transmits(node) or not {TRANSLUCENCY, TRANSMISSION} & set(self.layers):
            return {}
        weight = input_value(node, "Transmission Weight", 1.0)
        if node.type == PRINCIPLED:
            weight = builder.math("MULTIPLY", weight, builder.math("SUBTRACT", 1.0, input_value(node, "Metallic", 0.0)))
        roughness = input_value(node, "Roughness", 0.0)
        scaled = builder.math("DIVIDE", builder.math("SUBTRACT", roughness, CLEAR_ROUGHNESS), FROSTED_ROUGHNESS - CLEAR_ROUGHNESS)
        frosted = builder.math("MULTIPLY", weight, builder.math("ADD", scaled, 0.0, clamp=True))
        clear = builder.math("SUBTRACT", weight, frosted)
        # A pane has two sides, which color the light by their product.
        pane_color = builder.vector("POWER", builder.vector("MAXIMUM", color, BLACK), (0.5, 0.5, 0.5))
        diffuse = builder.vector("SCALE", color, frosted)
        return {
            TRANSLUCENCY: (diffuse, diffuse),
            TRANSMISSION: (builder.vector("SCALE", color, clear), builder.vector("SCALE", pane_color, clear)),
        }

    def _read_emission(self) -> SocketOrValue:
        color, strength = (input_value(self.node, name, BLACK) for name in ("Emission Color", "Emission Strength"))
        return self.builder.vector("SCALE", color, strength)

    def _read_specular(self) -> SocketOrValue:
        """Return the tinted level of highlights, for the refractive index 1.5; metals have no level."""
        node, builder = self.node, self.builder
        index, level = input_value(node, "IOR", 1.5), input_value(node, "Specular IOR Level", DEFAULT_LEVEL)
        ratio = builder.math("DIVIDE", builder.math("SUBTRACT", index, 1.0), builder.math("ADD", index, 1.0))
        reflectance = builder.math("MULTIPLY", builder.math("MULTIPLY", ratio, ratio), 1.0 / MIN_REFLECTANCE)
        level = builder.math("MULTIPLY", level, reflectance)
        missing = builder.math("MAXIMUM", builder.math("SUBTRACT", DEFAULT_LEVEL, level), 0.0)
        level = builder.math("ADD", level, builder.math("MULTIPLY", missing, input_value(node, "Metallic", 0.0)))
        return builder.vector("SCALE", input_value(node, "Specular Tint", (1.0, 1.0, 1.0)), level)

    def _read_coat(self) -> SocketOrValue:
        names = zip(("Coat Weight", "Coat Roughness", "Sheen Roughness"), DEFAULT_VALUES[COAT], strict=True)
        return self.builder.combine(*(input_value(self.node, name, usual) for name, usual in names))

    def _read_sheen(self) -> SocketOrValue:
        color, weight = input_value(self.node, "Sheen Tint", (1.0, 1.0, 1.0)), input_value(self.node, "Sheen Weight", 0.0)
        return self.builder.vector("SCALE", color, weight)
