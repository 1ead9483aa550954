"""What the surface of a material is made of: the first of its shaders, its color and its opacity.

It reads what file formats can store, and names the rest.
"""

from dataclasses import dataclass

import bpy

from ...compat import uses_nodes
from .color_products import ColorProduct, read_product, read_source_product
from .socket_sources import ScopedSocket, find_source

COLOR_INPUTS = ("Base Color", "Color", "Emission Color")  # the first one that is linked counts
TRANSPARENT = {"BSDF_TRANSPARENT", "HOLDOUT"}
# Inputs of a Principled BSDF.
WEIGHTS = ("Metallic", "Subsurface Weight", "Transmission Weight", "Coat Weight", "Sheen Weight", "Thin Film Thickness")
MAX_SHADERS = 64  # mixed with each other
WHITE = ColorProduct()


@dataclass(frozen=True, eq=False)
class MaterialSurface:
    """The surface of a material.

    Attributes:
        shader: the node that colors it, None if there is none.
        color: its base color.
        alpha: its opacity.
        alpha_cutoff: the opacity from which it is opaque, and transparent below; None if it is blended.
        unread: labels of what else the look depends on.
    """

    shader: bpy.types.Node | None
    color: ColorProduct
    alpha: ColorProduct
    alpha_cutoff: float | None
    unread: tuple[str, ...]

    @property
    def is_opaque(self) -> bool:
        """Whether nothing is known to show through."""
        return not self.alpha.textures and not self.alpha.attributes and self.alpha.factor[0] >= 1.0


def read_surface(material: bpy.types.Material) -> MaterialSurface:
    """Read the surface of a material. Without nodes, it has its viewport color."""
    if not uses_nodes(material) or material.node_tree is None:
        return MaterialSurface(None, ColorProduct(tuple(material.diffuse_color)[:3]), WHITE, None, ())
    output = find_output(material.node_tree)
    if output is None:
        return MaterialSurface(None, WHITE, WHITE, None, ())
    shader, alpha, cutoff, unread = _find_shader(find_source(ScopedSocket(output.inputs["Surface"])))
    if shader is None:
        return MaterialSurface(None, WHITE, WHITE, None, unread)
    color_input = find_color_input(shader.node)
    color = WHITE if color_input is None else read_product(color_input, shader.groups)
    own = next((item for item in shader.node.inputs if item.name == "Alpha"), None)
    if own is not None:
        own_alpha, own_cutoff = _read_alpha(find_source(ScopedSocket(own, shader.groups)))
        alpha, cutoff = alpha.times(own_alpha), own_cutoff if cutoff is None else cutoff
    return MaterialSurface(shader.node, color, alpha, cutoff, (*unread, *_list_inputs(shader.node, color_input)))


def find_output(tree: bpy.types.NodeTree) -> bpy.types.Node | None:
    """Return the active output of a material, for all engines or, as in files from before Blender 5.0, for one; None if there is none."""
    return tree.get_output_node("ALL") or tree.get_output_node("CYCLES") or tree.get_output_node("EEVEE")


def list_color_inputs(node: bpy.types.Node) -> list[bpy.types.NodeSocket]:
    """Return the inputs of a node that can color it, in the order in which they count. An emission without strength cannot."""
    found = [item for name in COLOR_INPUTS for item in node.inputs if item.name == name and item.type == "RGBA"]
    strength = node.inputs.get("Emission Strength")
    is_dark = strength is not None and not strength.links and strength.default_value == 0.0
    return [item for item in found if not (is_dark and item.name == "Emission Color")]


def find_color_input(node: bpy.types.Node) -> bpy.types.NodeSocket | None:
    """Return the input of a shader that colors it: the first one that is linked, or the first one; None if it has none."""
    found = list_color_inputs(node)
    return next((item for item in found if item.links), found[0] if found else None)


def _find_shader(source: ScopedSocket) -> tuple[ScopedSocket | None, ColorProduct, float | None, tuple[str, ...]]:
    """Return the first shader with a color before `source`, its opacity against transparent shaders that it is mixed with, the cutoff of
    the opacity, and labels of what is left out."""
    alpha, cutoff, unread = WHITE, None, ()
    for _ in range(MAX_SHADERS):
        if source.is_constant:
            return None, alpha, cutoff, unread
        node = source.node
        if node.type == "MIX_SHADER":
            first, second = source.input(1), source.input(2)
            hidden = [not item.is_constant and item.node.type in TRANSPARENT for item in (first, second)]
            if hidden == [True, False] or hidden == [False, True]:
                opacity, edge = _read_opacity(source.input(0), hidden[1])
                alpha, cutoff = alpha.times(opacity), edge if cutoff is None else cutoff
                source = second if hidden[0] else first
                continue
            fraction = read_source_product(source.input(0))
            if fraction.is_constant and fraction.factor[0] in (0.0, 1.0):
                source = second if fraction.factor[0] else first
                continue
            unread, source = (*unread, node.bl_label), second if first.is_constant else first
        elif node.type == "ADD_SHADER":
            first, second = source.input(0), source.input(1)
            is_first = not first.is_constant and first.node.type not in TRANSPARENT
            unread, source = (*unread, node.bl_label), first if is_first else second
        else:
            return (source if find_color_input(node) is not None else None), alpha, cutoff, unread
    return None, alpha, cutoff, unread


def _read_opacity(source: ScopedSocket, is_inverted: bool) -> tuple[ColorProduct, float | None]:
    """Return the opacity that the factor of a Mix Shader node gives, and its cutoff. A factor that depends on the ray is full opacity, as
    for cameras."""
    if not source.is_constant and source.node.type == "LIGHT_PATH":
        return WHITE, None
    if not is_inverted:
        return _read_alpha(source)
    value = read_source_product(source)
    if value.is_constant:
        return ColorProduct((1.0 - value.factor[0],) * 3), None
    inverse = _read_inverse(source)
    return (inverse, None) if inverse is not None else (ColorProduct(textures=value.textures, unread=("Mix Shader", *value.unread)), None)


def _read_inverse(source: ScopedSocket) -> ColorProduct | None:
    """Return what a node subtracts from 1, None for other nodes."""
    if source.operation != "SUBTRACT":
        return None
    one = read_source_product(source.input(0))
    return read_source_product(source.input(1)) if one.is_constant and one.factor[0] == 1.0 else None


def _read_alpha(source: ScopedSocket) -> tuple[ColorProduct, float | None]:
    """Return an opacity without the comparison that makes it 0 or 1, and the value that it is compared with."""
    if source.operation == "ROUND":
        return read_source_product(source.input(0)), 0.5
    compared = source if source.operation == "GREATER_THAN" else None
    if source.operation == "SUBTRACT" and _read_number(source.input(0)) == 1.0 and source.input(1).operation == "LESS_THAN":
        compared = source.input(1)
    edge = None if compared is None else _read_number(compared.input(1))
    return (read_source_product(source), None) if edge is None else (read_source_product(compared.input(0)), edge)


def _read_number(source: ScopedSocket) -> float | None:
    value = read_source_product(source)
    return value.factor[0] if value.is_constant else None


def _list_inputs(shader: bpy.types.Node, color_input: bpy.types.NodeSocket | None) -> list[str]:
    """Return the names of the other inputs of a shader that something is linked to, or whose weight is above 0."""
    ignored = {"Alpha"} if any(item.name == "Emission Color" for item in list_color_inputs(shader)) else {"Alpha", "Emission Color"}
    linked = [item.name for item in shader.inputs if item.links and item != color_input and item.name not in ignored]
    if shader.type == "BSDF_PRINCIPLED":
        strength, emission = (shader.inputs[name] for name in ("Emission Strength", "Emission Color"))
        linked += [item.name for item in shader.inputs if item.name in WEIGHTS and not item.links and item.default_value > 0.0]
        replaced = shader.inputs["Base Color"] if color_input == emission else None
        linked += ["Base Color"] if replaced is not None and any(value > 0.0 for value in replaced.default_value[:3]) else []
        is_light = not strength.links and strength.default_value > 0.0 and any(value > 0.0 for value in emission.default_value[:3])
        linked += ["Emission Color"] if is_light and not emission.links and color_input != emission else []
    return list(dict.fromkeys(linked))
