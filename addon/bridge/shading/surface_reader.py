"""What the surface of a material is made of: the first of its shaders, its color and its opacity.

It reads what file formats can store, and names the rest.
"""

from dataclasses import dataclass, replace

import bpy

from ...compat import uses_nodes
from .color_products import ColorProduct, read_product, read_source_product
from .socket_sources import ScopedSocket, find_source
from .texture_uses import TextureUse

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
        unread: labels of what else the look depends on: `mixed` and inputs of the shader.
        mixed: labels of nodes that mix the shader with others.
        groups: the node groups around the shader, the outermost first.
        emission: a node that emits light in addition to the shader, None if there is none.
        is_shadeless: whether it shows its color without light, and to cameras only.
    """

    shader: bpy.types.Node | None
    color: ColorProduct
    alpha: ColorProduct
    alpha_cutoff: float | None
    unread: tuple[str, ...]
    mixed: tuple[str, ...] = ()
    groups: tuple[bpy.types.Node, ...] = ()
    emission: ScopedSocket | None = None
    is_shadeless: bool = False

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
    found = _find_shader(find_source(ScopedSocket(output.inputs["Surface"])))
    if found.shader is None:
        return replace(found, alpha=WHITE, alpha_cutoff=None, unread=found.mixed)
    color_input = find_color_input(found.shader)
    color = WHITE if color_input is None else read_product(color_input, found.groups)
    alpha, cutoff = found.alpha, found.alpha_cutoff
    own = next((item for item in found.shader.inputs if item.name == "Alpha"), None)
    if own is not None:
        own_alpha, own_cutoff = _read_alpha(find_source(ScopedSocket(own, found.groups)))
        alpha, cutoff = alpha.times(own_alpha), own_cutoff if cutoff is None else cutoff
    unread = (*found.mixed, *_list_inputs(found.shader, color_input))
    is_shadeless = found.is_shadeless and found.shader.type == "EMISSION"
    return replace(found, color=color, alpha=alpha, alpha_cutoff=cutoff, unread=unread, is_shadeless=is_shadeless)


def choose_textures(color: ColorProduct, alpha: ColorProduct) -> tuple[TextureUse | None, TextureUse | None, tuple[str, ...]]:
    """Return the textures of a color and an opacity that one image can hold, and labels of what else both depend on."""
    first, *further = color.textures or (None,)
    opacity, *further_alphas = alpha.textures or (None,)
    if first is not None and opacity is not None and not opacity.is_placed_like(first):
        further_alphas, opacity = [opacity, *further_alphas], None
    unread = [*color.unread, *alpha.unread, *(f'the image "{use.image.name}"' for use in (*further, *further_alphas))]
    return first, opacity, tuple(dict.fromkeys(unread))


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


def _find_shader(source: ScopedSocket) -> MaterialSurface:
    """Return the first shader with a color before `source`, its opacity against transparent shaders, and what it is mixed with."""
    found = MaterialSurface(None, WHITE, WHITE, None, ())
    for _ in range(MAX_SHADERS):
        if source.is_constant:
            return found
        node = source.node
        if node.type == "MIX_SHADER":
            factor, first, second = (source.input(index) for index in range(3))
            hidden = [not item.is_constant and item.node.type in TRANSPARENT for item in (first, second)]
            fraction = read_source_product(factor)
            if hidden in ([True, False], [False, True]):
                is_for_cameras = not factor.is_constant and factor.node.type == "LIGHT_PATH"
                opacity, edge = _read_opacity(factor, hidden[1])
                cutoff = edge if found.alpha_cutoff is None else found.alpha_cutoff
                alpha, is_shadeless = found.alpha.times(opacity), found.is_shadeless or is_for_cameras
                found = replace(found, alpha=alpha, alpha_cutoff=cutoff, is_shadeless=is_shadeless)
                source = second if hidden[0] else first
            elif fraction.is_constant and fraction.factor[0] in (0.0, 1.0):
                source = second if fraction.factor[0] else first
            else:
                found, source = replace(found, mixed=(*found.mixed, node.bl_label)), second if first.is_constant else first
        elif node.type == "ADD_SHADER":
            shown = [item for item in (source.input(0), source.input(1)) if not item.is_constant and item.node.type not in TRANSPARENT]
            lights = [item for item in shown if item.node.type == "EMISSION"]
            if len(shown) == 2 and len(lights) == 1 and found.emission is None:
                found, shown = replace(found, emission=lights[0]), [item for item in shown if item != lights[0]]
            found, source = replace(found, mixed=(*found.mixed, node.bl_label)), shown[0] if shown else source.input(1)
        else:
            is_colored = find_color_input(node) is not None
            return replace(found, shader=node, groups=source.groups) if is_colored else found
    return found


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
