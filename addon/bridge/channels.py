"""Materials that shine with what they are made of: colour, normal, roughness and so on, read off with one render each.

The surface shader of a copy of the material is walked from the output back. Every shader becomes a set of values, premultiplied by
how much of the light it does not let through; mixed shaders mix their values, added ones add them. The result is an Emission of one of
the channels over a Transparent shader, so Cycles itself puts alpha-mapped leaves over each other in the right order.
"""

from dataclasses import dataclass

import bpy

from ..compat import give_nodes, uses_nodes
from .temporary import TemporaryScene
from .wiring import Operand, Wiring
from .world_nodes import OBJECT_AXES, QUAD_AXES, answer_for_the_scene, world_normal

CHANNELS = ("colour", "normal", "surface")
INSIDE = "farfield_inside"  # place in the slot, -1..1 across the rectangle and half its gutter


@dataclass(frozen=True)
class Bsdf:
    """Which inputs of a shader node say what. A number stands for itself."""

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
PLAIN = Bsdf()


@dataclass(frozen=True)
class Channels:
    """Vectors premultiplied by alpha: scene-linear colour; world normal moved to 0..1; (roughness, metallic, depth in 0..1)."""

    colour: Operand
    normal: Operand
    surface: Operand
    alpha: Operand


@dataclass(frozen=True)
class CaptureMaterial:
    """A material copy that shows one channel at a time: `emission` shines with it, `transparent` lets through what is behind."""

    material: bpy.types.Material
    emission: bpy.types.Node
    transparent: bpy.types.Node
    channels: Channels

    def show(self, channel: str) -> None:
        """Shine with `channel`, one of CHANNELS."""
        Wiring(self.material.node_tree).connect(getattr(self.channels, channel), self.emission.inputs["Color"])


def capture_material(
    original: bpy.types.Material | None, color_layer: str, error: float, clip: bool, work: TemporaryScene
) -> CaptureMaterial:
    """The copy of a material for captures of a level with this `error` (a length); without an `original`, Blender's grey.

    color_layer: colour attribute that a surface without material shows, or "". clip: cut away what leaves the rectangle of its quad.
    """
    material = work.keep(bpy.data.materials.new("Farfield") if original is None else original.copy())
    if original is None:
        material.roughness = 0.5
    if original is None or not uses_nodes(material):
        _plain_nodes(material, color_layer)
    tree = material.node_tree
    _own_groups(tree, work)
    answer_for_the_scene(tree)
    output = tree.get_output_node("CYCLES") or tree.nodes.new("ShaderNodeOutputMaterial")
    scope = _Scope(Wiring(tree), error)
    channels = scope.clipped(scope.of_input(output.inputs["Surface"])) if clip else scope.of_input(output.inputs["Surface"])
    emission, transparent = _shine(scope.wiring, output, channels.alpha)
    _remove_links(tree, output.inputs["Volume"])
    if material.displacement_method != "BUMP":
        _remove_links(tree, output.inputs["Displacement"])
    # Thousands of faces in the tree of lamps would cost time, and light nothing here.
    material.cycles.emission_sampling = "NONE"
    return CaptureMaterial(material, emission, transparent, channels)


def _plain_nodes(material: bpy.types.Material, color_layer: str) -> None:
    """What Blender shows without nodes: the colour of the viewport settings, or of the attribute `color_layer` when there is one."""
    give_nodes(material)
    wiring = Wiring(material.node_tree)
    material.node_tree.nodes.clear()
    shader = wiring.node("ShaderNodeBsdfPrincipled")
    wiring.connect(list(material.diffuse_color), shader.inputs["Base Color"])
    if color_layer:
        wiring.connect(wiring.attribute(color_layer), shader.inputs["Base Color"])
    wiring.connect(material.roughness, shader.inputs["Roughness"])
    wiring.connect(material.metallic, shader.inputs["Metallic"])
    wiring.connect(shader.outputs[0], wiring.node("ShaderNodeOutputMaterial").inputs["Surface"])


def _own_groups(tree: bpy.types.NodeTree, work: TemporaryScene) -> None:
    """Give every group node below `tree` a group of its own, answering for the scene."""
    for node in tree.nodes:
        if node.type == "GROUP" and node.node_tree is not None:
            node.node_tree = work.keep(node.node_tree.copy())
            _own_groups(node.node_tree, work)
            answer_for_the_scene(node.node_tree)


def _shine(wiring: Wiring, output: bpy.types.Node, alpha: Operand) -> tuple[bpy.types.Node, bpy.types.Node]:
    """Replace the surface of `output` by an Emission over what `alpha` lets through; returns the Emission and the Transparent node."""
    emission, transparent, added = (
        wiring.node(kind) for kind in ("ShaderNodeEmission", "ShaderNodeBsdfTransparent", "ShaderNodeAddShader")
    )
    wiring.connect(wiring.math("SUBTRACT", 1.0, alpha, clamp=True), transparent.inputs["Color"])
    wiring.connect(emission.outputs[0], added.inputs[0])
    wiring.connect(transparent.outputs[0], added.inputs[1])
    wiring.connect(added.outputs[0], output.inputs["Surface"])
    return emission, transparent


def _remove_links(tree: bpy.types.NodeTree, target: bpy.types.NodeSocket) -> None:
    for link in list(target.links):
        tree.links.remove(link)


class _Scope:
    """The walk through one node tree. A group's scope knows the scope and the node it stands in."""

    def __init__(self, wiring: Wiring, error: float, outer: "_Scope | None" = None, group: bpy.types.Node | None = None) -> None:
        self.wiring, self.error, self.outer, self.group = wiring, error, outer, group
        self.known: dict[tuple[str, str], Channels] = {}

    def of_input(self, target: bpy.types.NodeSocket) -> Channels:
        """The channels of what is linked to `target`; an empty shader input is black and opaque, as in Cycles."""
        source = _source(target)
        if source is None:
            return self.opaque((0.0, 0.0, 0.0), 1.0)
        if source.type != "SHADER":
            return self.opaque(source, 1.0)
        key = (source.node.name, source.identifier)
        if key not in self.known:
            self.known[key] = self.of_shader(source.node, source)
        return self.known[key]

    def of_shader(self, node: bpy.types.Node, source: bpy.types.NodeSocket) -> Channels:
        """The channels of the shader that leaves `node` by its output `source`."""
        if node.mute:
            inner = next((link.from_socket for link in node.internal_links if link.to_socket == source), None)
            return self.opaque((0.0, 0.0, 0.0), 1.0) if inner is None else self.of_input(inner)
        if node.type == "REROUTE":
            return self.of_input(node.inputs[0])
        if node.type == "MIX_SHADER":
            return self.mixed(_value(node, "Fac", 0), self.of_input(node.inputs[1]), self.of_input(node.inputs[2]))
        if node.type == "ADD_SHADER":
            return self.added(self.of_input(node.inputs[0]), self.of_input(node.inputs[1]))
        if node.type == "GROUP" and node.node_tree is not None:
            return self.of_group(node, source)
        if node.type == "GROUP_INPUT" and self.outer is not None:
            return self.of_group_input(node, source)
        if node.type in {"BSDF_TRANSPARENT", "HOLDOUT", "BSDF_RAY_PORTAL"}:
            return self.transparent(node)
        return self.of_bsdf(node)

    def of_bsdf(self, node: bpy.types.Node) -> Channels:
        """The channels of a shader that is neither mixed nor transparent."""
        bsdf = BSDFS.get(node.type, PLAIN)
        color = _value(node, bsdf.color, (0.8, 0.8, 0.8))
        if node.type == "EMISSION":
            color = self.wiring.vector("SCALE", color, self.wiring.math("MINIMUM", _value(node, "Strength", 1.0), 1.0))
        alpha = _value(node, bsdf.alpha, 1.0)
        if node.type == "EEVEE_SPECULAR":
            alpha = self.wiring.math("SUBTRACT", 1.0, _value(node, "Transparency", 0.0))
        if isinstance(alpha, bpy.types.NodeSocket):
            alpha = self.wiring.math("ADD", alpha, 0.0, clamp=True)
        roughness, metallic = _value(node, bsdf.roughness, 0.5), _value(node, bsdf.metallic, 0.0)
        return self.opaque(color, alpha, roughness, metallic, self.normal(node))

    def opaque(
        self, color: Operand, alpha: Operand, roughness: Operand = 1.0, metallic: Operand = 0.0, normal: Operand | None = None
    ) -> Channels:
        """Channels of these straight values, premultiplied."""
        wiring = self.wiring
        height = wiring.separate(wiring.node("ShaderNodeNewGeometry").outputs["Position"])[2]
        depth = wiring.math("ADD", wiring.math("MULTIPLY", height, 0.5 / self.error), 0.5, clamp=True)
        normal = wiring.vector("NORMALIZE", world_normal(wiring) if normal is None else normal)
        encoded = wiring.vector("ADD", wiring.vector("SCALE", normal, 0.5), (0.5, 0.5, 0.5))
        straight = (color, encoded, wiring.combine(roughness, metallic, depth))
        return Channels(*(wiring.vector("SCALE", value, alpha) for value in straight), alpha)

    def normal(self, node: bpy.types.Node) -> Operand | None:
        """The normal that `node` is given, in world space, or None when it is given none."""
        source = _source(node.inputs["Normal"]) if "Normal" in node.inputs else None
        if source is None:
            return None
        if source.node.type == "NORMAL_MAP" and source.node.space in {"WORLD", "BLENDER_WORLD"}:
            return source
        in_object = source.node.type == "NORMAL_MAP" and source.node.space in {"OBJECT", "BLENDER_OBJECT"}
        return self.wiring.along(source, OBJECT_AXES if in_object else QUAD_AXES)

    def transparent(self, node: bpy.types.Node) -> Channels:
        """Nothing, as far as the colour of a Transparent shader is white."""
        color = _value(node, "Color", (1.0, 1.0, 1.0)) if node.type == "BSDF_TRANSPARENT" else (1.0, 1.0, 1.0)
        mean = self.wiring.vector("DOT_PRODUCT", color, (1.0 / 3.0,) * 3)
        return self.opaque((0.0, 0.0, 0.0), self.wiring.math("SUBTRACT", 1.0, mean, clamp=True))

    def mixed(self, factor: Operand, first: Channels, second: Channels) -> Channels:
        """Mix Shader."""
        alpha = self.wiring.separate(self.wiring.mix(factor, _triple(self.wiring, first.alpha), _triple(self.wiring, second.alpha)))[0]
        return Channels(*(self.wiring.mix(factor, getattr(first, name), getattr(second, name)) for name in CHANNELS), alpha)

    def added(self, first: Channels, second: Channels) -> Channels:
        """Add Shader: colours add up; what describes the surface is the mean over both."""
        wiring = self.wiring
        both = wiring.math("ADD", first.alpha, second.alpha)
        # Together they let through the sum of what each lets through.
        alpha = wiring.math("SUBTRACT", both, 1.0, clamp=True)
        share = wiring.math("DIVIDE", alpha, wiring.math("MAXIMUM", both, 1e-6))
        sums = [wiring.vector("ADD", getattr(first, name), getattr(second, name)) for name in CHANNELS]
        return Channels(sums[0], wiring.vector("SCALE", sums[1], share), wiring.vector("SCALE", sums[2], share), alpha)

    def clipped(self, channels: Channels) -> Channels:
        """Nothing outside the rectangle of the quad."""
        wiring = self.wiring
        x, y, _ = wiring.separate(wiring.vector("ABSOLUTE", wiring.attribute(INSIDE)))
        inside = wiring.math("LESS_THAN", wiring.math("MAXIMUM", x, y), 1.0)
        values = (wiring.vector("SCALE", getattr(channels, name), inside) for name in CHANNELS)
        return Channels(*values, wiring.math("MULTIPLY", channels.alpha, inside))

    def of_group(self, node: bpy.types.Node, source: bpy.types.NodeSocket) -> Channels:
        """The channels inside the group `node`, led out through new sockets."""
        inner = _Scope(Wiring(node.node_tree), self.error, self, node)
        output = next((item for item in node.node_tree.nodes if item.type == "GROUP_OUTPUT" and item.is_active_output), None)
        if output is None:
            return self.opaque((0.0, 0.0, 0.0), 1.0)
        channels = inner.of_input(_socket(output.inputs, source.identifier))
        return Channels(*(_lead(inner.wiring, getattr(channels, name), output, node, "OUTPUT") for name in (*CHANNELS, "alpha")))

    def of_group_input(self, node: bpy.types.Node, source: bpy.types.NodeSocket) -> Channels:
        """The channels of a shader that is handed into this group, led in through new sockets."""
        channels = self.outer.of_input(_socket(self.group.inputs, source.identifier))
        return Channels(*(_lead(self.outer.wiring, getattr(channels, name), self.group, node, "INPUT") for name in (*CHANNELS, "alpha")))


def _lead(wiring: Wiring, operand: Operand, entrance: bpy.types.Node, leave: bpy.types.Node, direction: str) -> bpy.types.NodeSocket:
    """Lead `operand` over the border of a group: into `entrance` on this side, out of `leave` on the other; returns its socket there."""
    group = leave if direction == "OUTPUT" else entrance
    item = group.node_tree.interface.new_socket("Farfield", in_out=direction, socket_type="NodeSocketVector")
    wiring.connect(_triple(wiring, operand), _socket(entrance.inputs, item.identifier))
    return _socket(leave.outputs, item.identifier)


def _socket(sockets: bpy.types.bpy_prop_collection, identifier: str) -> bpy.types.NodeSocket:
    return next(socket for socket in sockets if socket.identifier == identifier)


def _triple(wiring: Wiring, operand: Operand) -> Operand:
    """A number as the vector of three times it; a vector stays."""
    is_number = isinstance(operand, float | int) or (isinstance(operand, bpy.types.NodeSocket) and operand.type == "VALUE")
    return wiring.combine(operand, operand, operand) if is_number else operand


def _source(target: bpy.types.NodeSocket) -> bpy.types.NodeSocket | None:
    """The output linked to `target`."""
    return next((link.from_socket for link in target.links if not link.is_muted), None)


def _value(node: bpy.types.Node, name: str | float, default: Operand) -> Operand:
    """What the input `name` of `node` is linked to or set to; a number is itself; `default` where there is no such input."""
    if not isinstance(name, str):
        return name
    target = node.inputs.get(name)
    if target is None:
        return default
    source = _source(target)
    if source is not None:
        return source
    value = target.default_value
    return float(value) if isinstance(value, float | int) else list(value)[:3]
