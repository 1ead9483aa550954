"""Material copies that emit one of their channels - color, normal, roughness and so on - so that one render reads it.

The surface shader of a copy of the material is traversed from the output backwards. Every shader becomes a set of values, premultiplied by
its opacity. Mix Shader nodes mix these values, Add Shader nodes add them. The result is an Emission of one of the channels combined with a
Transparent shader, so Cycles itself composites alpha-mapped leaves in the right order.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import bpy

from ...compat import enable_nodes, uses_nodes
from ..rendering.render_scene import RenderScene
from .node_builder import NodeBuilder, SocketOrValue
from .scene_space_nodes import OBJECT_AXES, QUAD_AXES, replace_scene_space_nodes, world_normal
from .socket_sources import input_value, linked_output
from .surface_layers import DEFAULT_VALUES, EMISSION, SUMMED_LAYERS, TRANSLUCENCY, TRANSMISSION, LayerValues

CHANNELS = ("color", "normal", "roughness_metallic_depth")
CELL_COORDINATES = "farfield_cell"  # attribute: position in the atlas cell, -1..1 across the rectangle of a quad


@dataclass(frozen=True)
class Bsdf:
    """The inputs of a shader node that hold its parameters, by name. A number is a constant."""

    color: str = "Color"
    roughness: str | float = "Roughness"
    metallic: str | float = 0.0
    alpha: str | float = 1.0


BSDFS = {
    "BSDF_PRINCIPLED": Bsdf("Base Color", metallic="Metallic", alpha="Alpha"),
    "BSDF_DIFFUSE": Bsdf(roughness=1.0),
    "BSDF_GLOSSY": Bsdf(metallic=1.0),
    "BSDF_METALLIC": Bsdf("Base Color", metallic=1.0),
    "BSDF_GLASS": Bsdf(),
    "BSDF_REFRACTION": Bsdf(),
    "BSDF_TRANSLUCENT": Bsdf(roughness=1.0),
    "SUBSURFACE_SCATTERING": Bsdf(roughness=1.0),
    "BSDF_TOON": Bsdf(roughness=1.0),
    "BSDF_SHEEN": Bsdf(),
    "BSDF_HAIR": Bsdf(roughness=0.5),
    "BSDF_HAIR_PRINCIPLED": Bsdf(),
    "EEVEE_SPECULAR": Bsdf("Base Color"),
    "EMISSION": Bsdf(roughness=1.0),
}
DEFAULT_BSDF = Bsdf()
SUMMED = {"color", *SUMMED_LAYERS}  # channels that an Add Shader node adds
SEEN_THROUGH_GLASS = {"color", EMISSION, TRANSLUCENCY}  # channels in which glass shows what is behind it


@dataclass(frozen=True)
class Channels:
    """Vectors premultiplied by alpha, by channel: scene-linear color; world normal encoded in 0..1; (roughness, metallic, depth in 0..1);
    and layers, see `surface_layers`."""

    values: dict[str, SocketOrValue]
    alpha: SocketOrValue


@dataclass(frozen=True)
class CaptureMaterial:
    """A material copy that shows one channel at a time.

    Attributes:
        material: The copy.
        emission: The node that emits the channel.
        transparent: The node that lets the background through.
        channels: What can be emitted.
        opaque: The color of `transparent` where glass counts as opaque.
        clear: The color of `transparent` where glass lets light through.
    """

    material: bpy.types.Material
    emission: bpy.types.Node
    transparent: bpy.types.Node
    channels: Channels
    opaque: SocketOrValue
    clear: SocketOrValue

    def emit(self, channel: str) -> None:
        """Emit `channel`, one of CHANNELS or of the layers that the material was built with."""
        builder = NodeBuilder(self.material.node_tree)
        builder.connect(self.channels.values[channel], self.emission.inputs["Color"])
        builder.connect(self.clear if channel in SEEN_THROUGH_GLASS else self.opaque, self.transparent.inputs["Color"])


def build_capture_material(
    original: bpy.types.Material | None, color_layer: str, error: float, clip: bool, work: RenderScene, layers: Sequence[str] = ()
) -> CaptureMaterial:
    """Copy a material for the capture of a level with this `error` (a length); without an `original`, use Blender's default gray.

    color_layer: color attribute shown by a surface without material, or "". clip: hide everything outside the rectangle of its quad.
    layers: channels in addition to CHANNELS, see `surface_layers`. What other layers show is part of the color, or is left out.
    """
    material = work.own(bpy.data.materials.new("Farfield") if original is None else original.copy())
    if original is None:
        material.roughness = 0.5
    if original is None or not uses_nodes(material):
        _build_viewport_nodes(material, color_layer)
    tree = material.node_tree
    _copy_groups(tree, work)
    replace_scene_space_nodes(tree)
    output = tree.get_output_node("CYCLES") or tree.nodes.new("ShaderNodeOutputMaterial")
    scope = _Scope(NodeBuilder(tree), error, layers)
    channels = scope.clip(scope.of_input(output.inputs["Surface"])) if clip else scope.of_input(output.inputs["Surface"])
    opaque = clear = scope.builder.math("SUBTRACT", 1.0, channels.alpha, clamp=True)
    if TRANSMISSION in layers:
        clear = scope.builder.vector("ADD", scope.builder.combine(opaque, opaque, opaque), channels.values[TRANSMISSION])
    emission, transparent = _emit_channel(scope.builder, output, opaque)
    _remove_links(tree, output.inputs["Volume"])
    if material.displacement_method != "BUMP":
        _remove_links(tree, output.inputs["Displacement"])
    # Thousands of emissive faces in the light tree would cost time, and they light nothing here.
    material.cycles.emission_sampling = "NONE"
    return CaptureMaterial(material, emission, transparent, channels, opaque, clear)


def _build_viewport_nodes(material: bpy.types.Material, color_layer: str) -> None:
    """Build the appearance without nodes: the color of the viewport settings, or the attribute `color_layer` if there is one."""
    enable_nodes(material)
    builder = NodeBuilder(material.node_tree)
    material.node_tree.nodes.clear()
    shader = builder.node("ShaderNodeBsdfPrincipled")
    builder.connect(list(material.diffuse_color), shader.inputs["Base Color"])
    if color_layer:
        builder.connect(builder.attribute(color_layer), shader.inputs["Base Color"])
    builder.connect(material.roughness, shader.inputs["Roughness"])
    builder.connect(material.metallic, shader.inputs["Metallic"])
    builder.connect(shader.outputs[0], builder.node("ShaderNodeOutputMaterial").inputs["Surface"])


def _copy_groups(tree: bpy.types.NodeTree, work: RenderScene) -> None:
    """Replace every node group below `tree` by a copy without scene-space nodes."""
    for node in tree.nodes:
        if node.type == "GROUP" and node.node_tree is not None:
            node.node_tree = work.own(node.node_tree.copy())
            _copy_groups(node.node_tree, work)
            replace_scene_space_nodes(node.node_tree)


def _emit_channel(builder: NodeBuilder, output: bpy.types.Node, transparency: SocketOrValue) -> tuple[bpy.types.Node, bpy.types.Node]:
    """Replace the surface of `output` by an Emission plus a Transparent shader of the color `transparency`; return both nodes."""
    emission, transparent, add = (
        builder.node(node_type) for node_type in ("ShaderNodeEmission", "ShaderNodeBsdfTransparent", "ShaderNodeAddShader")
    )
    builder.connect(transparency, transparent.inputs["Color"])
    builder.connect(emission.outputs[0], add.inputs[0])
    builder.connect(transparent.outputs[0], add.inputs[1])
    builder.connect(add.outputs[0], output.inputs["Surface"])
    return emission, transparent


def _remove_links(tree: bpy.types.NodeTree, target: bpy.types.NodeSocket) -> None:
    for link in list(target.links):
        tree.links.remove(link)


class _Scope:
    """The traversal of one node tree. The scope of a group has the `outer` scope and the `group` node that contains it."""

    def __init__(
        self,
        builder: NodeBuilder,
        error: float,
        layers: Sequence[str],
        outer: "_Scope | None" = None,
        group: bpy.types.Node | None = None,
    ) -> None:
        self.builder, self.error, self.layers, self.outer, self.group = builder, error, layers, outer, group
        self.cache: dict[tuple[str, str], Channels] = {}

    def of_input(self, target: bpy.types.NodeSocket) -> Channels:
        """Return the channels of the shader linked to `target`; an empty shader input is black and opaque, as in Cycles."""
        source = linked_output(target)
        if source is None:
            return self.opaque((0.0, 0.0, 0.0), 1.0)
        if source.type != "SHADER":
            return self.opaque(source, 1.0)
        key = (source.node.name, source.identifier)
        if key not in self.cache:
            self.cache[key] = self.of_shader(source.node, source)
        return self.cache[key]

    def of_shader(self, node: bpy.types.Node, source: bpy.types.NodeSocket) -> Channels:
        """Return the channels of the shader at the output `source` of `node`."""
        if node.mute:
            inner = next((link.from_socket for link in node.internal_links if link.to_socket == source), None)
            return self.opaque((0.0, 0.0, 0.0), 1.0) if inner is None else self.of_input(inner)
        if node.type == "REROUTE":
            return self.of_input(node.inputs[0])
        if node.type == "MIX_SHADER":
            return self.mix(input_value(node, "Fac", 0), self.of_input(node.inputs[1]), self.of_input(node.inputs[2]))
        if node.type == "ADD_SHADER":
            return self.add(self.of_input(node.inputs[0]), self.of_input(node.inputs[1]))
        if node.type == "GROUP" and node.node_tree is not None:
            return self.of_group(node, source)
        if node.type == "GROUP_INPUT" and self.outer is not None:
            return self.of_group_input(node, source)
        if node.type in {"BSDF_TRANSPARENT", "HOLDOUT", "BSDF_RAY_PORTAL"}:
            return self.transparent(node)
        return self.of_bsdf(node)

    def of_bsdf(self, node: bpy.types.Node) -> Channels:
        """Return the channels of a shader that is neither mixed nor transparent."""
        bsdf = BSDFS.get(node.type, DEFAULT_BSDF)
        color = input_value(node, bsdf.color, (0.8, 0.8, 0.8))
        values = LayerValues(self.builder, node, color, self.layers)
        layers = {layer: values.value(layer, color) for layer in self.layers}
        color = values.color(color)
        if node.type == "EMISSION" and EMISSION not in self.layers:
            color = self.builder.vector("SCALE", color, self.builder.math("MINIMUM", input_value(node, "Strength", 1.0), 1.0))
        alpha = input_value(node, bsdf.alpha, 1.0)
        if node.type == "EEVEE_SPECULAR":
            alpha = self.builder.math("SUBTRACT", 1.0, input_value(node, "Transparency", 0.0))
        if isinstance(alpha, bpy.types.NodeSocket):
            alpha = self.builder.math("ADD", alpha, 0.0, clamp=True)
        roughness, metallic = input_value(node, bsdf.roughness, 0.5), input_value(node, bsdf.metallic, 0.0)
        return self.opaque(color, alpha, roughness, metallic, self.normal(node), layers)

    def opaque(
        self,
        color: SocketOrValue,
        alpha: SocketOrValue,
        roughness: SocketOrValue = 1.0,
        metallic: SocketOrValue = 0.0,
        normal: SocketOrValue | None = None,
        layers: Mapping[str, SocketOrValue] = DEFAULT_VALUES,
    ) -> Channels:
        """Return the channels of these straight values, premultiplied by `alpha`."""
        builder = self.builder
        height = builder.separate(builder.node("ShaderNodeNewGeometry").outputs["Position"])[2]
        depth = builder.math("ADD", builder.math("MULTIPLY", height, 0.5 / self.error), 0.5, clamp=True)
        normal = builder.vector("NORMALIZE", world_normal(builder) if normal is None else normal)
        encoded = builder.vector("ADD", builder.vector("SCALE", normal, 0.5), (0.5, 0.5, 0.5))
        straight = dict(zip(CHANNELS, (color, encoded, builder.combine(roughness, metallic, depth)), strict=True))
        straight |= {layer: layers[layer] for layer in self.layers}
        return Channels({name: builder.vector("SCALE", value, alpha) for name, value in straight.items()}, alpha)

    def normal(self, node: bpy.types.Node) -> SocketOrValue | None:
        """Return the world-space normal linked to `node`, or None if there is no link."""
        source = linked_output(node.inputs["Normal"]) if "Normal" in node.inputs else None
        if source is None:
            return None
        if source.node.type == "NORMAL_MAP" and source.node.space in {"WORLD", "BLENDER_WORLD"}:
            return source
        in_object_space = source.node.type == "NORMAL_MAP" and source.node.space in {"OBJECT", "BLENDER_OBJECT"}
        return self.builder.from_frame(source, OBJECT_AXES if in_object_space else QUAD_AXES)

    def transparent(self, node: bpy.types.Node) -> Channels:
        """Return black with alpha 0 for a white Transparent shader; darker colors are more opaque."""
        color = input_value(node, "Color", (1.0, 1.0, 1.0)) if node.type == "BSDF_TRANSPARENT" else (1.0, 1.0, 1.0)
        mean = self.builder.vector("DOT_PRODUCT", color, (1.0 / 3.0,) * 3)
        return self.opaque((0.0, 0.0, 0.0), self.builder.math("SUBTRACT", 1.0, mean, clamp=True))

    def mix(self, factor: SocketOrValue, first: Channels, second: Channels) -> Channels:
        """Return the channels of a Mix Shader."""
        mixed = self.builder.mix(factor, _triple(self.builder, first.alpha), _triple(self.builder, second.alpha))
        alpha = self.builder.separate(mixed)[0]
        return Channels({name: self.builder.mix(factor, value, second.values[name]) for name, value in first.values.items()}, alpha)

    def add(self, first: Channels, second: Channels) -> Channels:
        """Return the channels of an Add Shader: the sum of colors and lights, and the mean of the other channels."""
        builder = self.builder
        total = builder.math("ADD", first.alpha, second.alpha)
        # The transparency of the sum is the sum of both transparencies.
        alpha = builder.math("SUBTRACT", total, 1.0, clamp=True)
        fraction = builder.math("DIVIDE", alpha, builder.math("MAXIMUM", total, 1e-6))
        sums = {name: builder.vector("ADD", value, second.values[name]) for name, value in first.values.items()}
        return Channels({name: sums[name] if name in SUMMED else builder.vector("SCALE", sums[name], fraction) for name in sums}, alpha)

    def clip(self, channels: Channels) -> Channels:
        """Return `channels`, zero outside the rectangle of the quad."""
        builder = self.builder
        x, y, _ = builder.separate(builder.vector("ABSOLUTE", builder.attribute(CELL_COORDINATES)))
        is_inside = builder.math("LESS_THAN", builder.math("MAXIMUM", x, y), 1.0)
        values = {name: builder.vector("SCALE", value, is_inside) for name, value in channels.values.items()}
        return Channels(values, builder.math("MULTIPLY", channels.alpha, is_inside))

    def of_group(self, node: bpy.types.Node, source: bpy.types.NodeSocket) -> Channels:
        """Return the channels inside the group `node`, passed out through new sockets."""
        inner = _Scope(NodeBuilder(node.node_tree), self.error, self.layers, self, node)
        output = next((item for item in node.node_tree.nodes if item.type == "GROUP_OUTPUT" and item.is_active_output), None)
        if output is None:
            return self.opaque((0.0, 0.0, 0.0), 1.0)
        channels = inner.of_input(_socket(output.inputs, source.identifier))
        return _pass_all_through(inner.builder, channels, output, node, "OUTPUT")

    def of_group_input(self, node: bpy.types.Node, source: bpy.types.NodeSocket) -> Channels:
        """Return the channels of a shader that enters this group, passed in through new sockets."""
        channels = self.outer.of_input(_socket(self.group.inputs, source.identifier))
        return _pass_all_through(self.outer.builder, channels, self.group, node, "INPUT")


def _pass_all_through(
    builder: NodeBuilder, channels: Channels, entry: bpy.types.Node, exit_node: bpy.types.Node, direction: str
) -> Channels:
    """Pass `channels` across the boundary of a group, see `_pass_through`."""
    values = {name: _pass_through(builder, value, entry, exit_node, direction) for name, value in channels.values.items()}
    return Channels(values, _pass_through(builder, channels.alpha, entry, exit_node, direction))


def _pass_through(
    builder: NodeBuilder, operand: SocketOrValue, entry: bpy.types.Node, exit_node: bpy.types.Node, direction: str
) -> bpy.types.NodeSocket:
    """Pass `operand` across the boundary of a group, into the node `entry` and out of `exit_node`; return its socket there."""
    group = exit_node if direction == "OUTPUT" else entry
    item = group.node_tree.interface.new_socket("Farfield", in_out=direction, socket_type="NodeSocketVector")
    builder.connect(_triple(builder, operand), _socket(entry.inputs, item.identifier))
    return _socket(exit_node.outputs, item.identifier)


def _socket(sockets: bpy.types.bpy_prop_collection, identifier: str) -> bpy.types.NodeSocket:
    return next(socket for socket in sockets if socket.identifier == identifier)


def _triple(builder: NodeBuilder, operand: SocketOrValue) -> SocketOrValue:
    """Return a number as a vector with three equal components; a vector is returned unchanged."""
    is_number = isinstance(operand, float | int) or (isinstance(operand, bpy.types.NodeSocket) and operand.type == "VALUE")
    return builder.combine(operand, operand, operand) if is_number else operand
