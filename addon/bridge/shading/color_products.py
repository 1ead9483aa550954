"""Colors and numbers of shader nodes as products: of a constant, images and color attributes."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import bpy

from .socket_sources import ScopedSocket, find_source
from .texture_uses import TextureUse, read_texture_use

MAX_DEPTH = 64  # nodes after each other
CHANNELS = ("Red", "Green", "Blue")
ONES = (1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class ColorProduct:
    """The factors of a color, or of a number, which then has three equal components.

    Attributes:
        factor: scene-linear RGB.
        textures: images.
        attributes: names and outputs ("Color" or "Alpha") of color attributes; the name "" is that of the one that renders.
        unread: labels of nodes that change the color in another way.
    """

    factor: tuple[float, float, float] = ONES
    textures: tuple[TextureUse, ...] = ()
    attributes: tuple[tuple[str, str], ...] = ()
    unread: tuple[str, ...] = ()

    @property
    def is_constant(self) -> bool:
        """Whether it is the same everywhere."""
        return not (self.textures or self.attributes or self.unread)

    def times(self, other: "ColorProduct") -> "ColorProduct":
        """Return the product of both."""
        factor = tuple(first * second for first, second in zip(self.factor, other.factor, strict=True))
        return ColorProduct(
            factor, self.textures + other.textures, self.attributes + other.attributes, tuple(dict.fromkeys(self.unread + other.unread))
        )


def read_product(target: bpy.types.NodeSocket, groups: tuple[bpy.types.Node, ...] = ()) -> ColorProduct:
    """Read the color or the number that reaches the input `target` of a node within `groups`."""
    return read_source_product(find_source(ScopedSocket(target, groups)))


def read_source_product(source: ScopedSocket, depth: int = 0) -> ColorProduct:
    """Read the color or the number of a `source`, see `find_source`."""
    if source.is_constant or source.node.type in ("RGB", "VALUE"):
        return _constant(source.socket)
    reader = READERS.get(source.node.type)
    found = None if reader is None or depth > MAX_DEPTH else reader(source, depth + 1)
    return _read_others(source, depth + 1) if found is None else found


def _constant(socket: bpy.types.NodeSocket) -> ColorProduct:
    """Return the value of a socket; what is no number in a damaged file counts as black."""
    value = getattr(socket, "default_value", 1.0)
    factor = (float(value),) * 3 if isinstance(value, int | float) else tuple(map(float, value[:3]))
    return ColorProduct(tuple(item if math.isfinite(item) else 0.0 for item in factor))


def _read_image(source: ScopedSocket, _depth: int) -> ColorProduct | None:
    if source.node.image is None:
        return None
    use = read_texture_use(source)
    return ColorProduct(textures=(use,), unread=use.unread)


def _read_attribute(source: ScopedSocket, _depth: int) -> ColorProduct | None:
    node, output = source.node, source.socket.name
    if node.type == "VERTEX_COLOR":
        return ColorProduct(attributes=((node.layer_name, output),))
    if node.attribute_type != "GEOMETRY" or output not in ("Color", "Alpha"):
        return None
    return ColorProduct(attributes=((node.attribute_name, output),))


def _read_mix(source: ScopedSocket, depth: int) -> ColorProduct | None:
    """Return what a node mixes with a constant factor, if it multiplies, or shows only one of its colors."""
    node = source.node
    if node.type == "MIX" and node.data_type != "RGBA":
        return None
    inputs = (0, 1, 2) if node.type == "MIX_RGB" else ("Factor_Float", "A_Color", "B_Color")
    amount, first, second = (source.input(key) for key in inputs)
    fraction = read_source_product(amount, depth)
    if not fraction.is_constant:
        return None
    fraction = min(max(fraction.factor[0], 0.0), 1.0)
    if fraction == 0.0 or (node.blend_type == "MIX" and fraction == 1.0):
        return read_source_product(second if fraction else first, depth)
    a, b = (read_source_product(item, depth) for item in (first, second))
    if node.blend_type == "MIX" and a.is_constant and b.is_constant:
        return ColorProduct(tuple((1.0 - fraction) * x + fraction * y for x, y in zip(a.factor, b.factor, strict=True)))
    if node.blend_type != "MULTIPLY":
        return None
    if fraction < 1.0 and not b.is_constant:
        return None
    faded = replace(b, factor=tuple(1.0 - fraction + fraction * value for value in b.factor)) if fraction < 1.0 else b
    return a.times(faded)


def _read_math(source: ScopedSocket, depth: int) -> ColorProduct | None:
    if source.node.operation != "MULTIPLY":
        return None
    return read_source_product(source.input(0), depth).times(read_source_product(source.input(1), depth))


def _read_channel(source: ScopedSocket, depth: int) -> ColorProduct | None:
    """Return one channel of a color."""
    node, name = source.node, source.socket.name
    if getattr(node, "mode", "RGB") != "RGB" or name not in CHANNELS:
        return None
    color = read_source_product(source.input(0), depth)
    if color.attributes or any(use.channel != "Color" for use in color.textures):
        return None
    factor = (color.factor[CHANNELS.index(name)],) * 3
    return replace(color, factor=factor, textures=tuple(replace(use, channel=name) for use in color.textures))


READERS: dict[str, Callable[[ScopedSocket, int], ColorProduct | None]] = {
    "TEX_IMAGE": _read_image,
    "VERTEX_COLOR": _read_attribute,
    "ATTRIBUTE": _read_attribute,
    "MIX": _read_mix,
    "MIX_RGB": _read_mix,
    "MATH": _read_math,
    "VECT_MATH": _read_math,
    "SEPARATE_COLOR": _read_channel,
}


def _read_others(source: ScopedSocket, depth: int) -> ColorProduct:
    """Return the image that is nearest to a node of another kind, without its color factors, and the label of the node."""
    node = source.node
    label = node.label or node.bl_label
    if depth <= MAX_DEPTH and not node.type.startswith("TEX_"):  # whose vectors are positions
        linked = [index for index, item in enumerate(node.inputs) if item.links and item.type in ("RGBA", "VALUE", "SHADER")]
        for index in sorted(linked, key=lambda index: node.inputs[index].type != "RGBA"):
            found = read_source_product(source.input(index), depth)
            if found.textures:
                return ColorProduct(textures=found.textures, unread=(label, *found.unread))
    return ColorProduct(unread=(label,))
