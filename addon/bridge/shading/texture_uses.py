"""How image texture nodes place their images on a surface: UV map, Mapping, and what shows beyond the sides."""

from dataclasses import dataclass, replace

import bpy
import mathutils
import numpy as np

from .socket_sources import ScopedSocket

EXTENSIONS = {"REPEAT": "repeat", "MIRROR": "mirror", "EXTEND": "clamp", "CLIP": "clamp"}
MAX_NODES = 32  # between a UV map and an image


@dataclass(frozen=True, eq=False)
class TextureUse:
    """An image as a material uses it.

    Attributes:
        image: the image.
        channel: "Color", "Alpha", "Red", "Green" or "Blue".
        uv_map: name of the UV map, "" for the active one.
        matrix: (2, 3) float64, from the texture coordinates to those of the image.
        wrap: what shows beyond the sides, along u and v: "repeat", "mirror" or "clamp".
        is_cut: whether nothing shows beyond the sides.
        is_nearest: whether pixels are squares.
        unread: what places the image otherwise and is not in `matrix`.
    """

    image: bpy.types.Image
    channel: str
    uv_map: str
    matrix: np.ndarray
    wrap: tuple[str, str]
    is_cut: bool
    is_nearest: bool
    unread: tuple[str, ...]

    @property
    def is_moved(self) -> bool:
        """Whether the image lies elsewhere than the UV map says."""
        return not np.array_equal(self.matrix, np.eye(2, 3))

    def is_placed_like(self, other: "TextureUse") -> bool:
        """Return whether both images cover a surface in the same way."""
        return (self.uv_map, self.wrap) == (other.uv_map, other.wrap) and np.allclose(self.matrix, other.matrix, atol=1e-6)


def read_texture_use(output: ScopedSocket) -> TextureUse:
    """Read the use of an image by `output`, an output of an image texture node with an image."""
    node = output.node
    extension = EXTENSIONS[node.extension]
    start = TextureUse(
        image=node.image,
        channel=output.socket.name,
        uv_map="",
        matrix=np.eye(2, 3),
        wrap=(extension, extension),
        is_cut=node.extension == "CLIP",
        is_nearest=node.interpolation == "Closest",
        unread=() if node.projection == "FLAT" else (f"{node.projection.title()} projection",),
    )
    return _read_coordinates(output.input("Vector"), start)


def _read_coordinates(coordinates: ScopedSocket, start: TextureUse) -> TextureUse:
    """Return `start` with the UV map, the matrix and the wrapping of `coordinates`."""
    use, matrix = start, np.eye(4)
    for _ in range(MAX_NODES):
        node = coordinates.node
        if coordinates.is_constant or (node.type == "TEX_COORD" and coordinates.socket.name == "UV"):
            break
        if node.type == "UVMAP":
            use = replace(use, uv_map=node.uv_map)
            break
        wrap = _read_wrap(coordinates) if node.type == "COMBXYZ" and use.wrap == ("clamp", "clamp") else None
        step = _read_step(coordinates)
        if wrap is not None:
            use, coordinates = replace(use, wrap=wrap[0]), wrap[1]
        elif step is not None:
            matrix, coordinates = matrix @ step[0], step[1]
        else:
            use = replace(use, unread=(*use.unread, _describe(coordinates)))
            break
    return replace(use, matrix=matrix[:2][:, [0, 1, 3]])


def _describe(coordinates: ScopedSocket) -> str:
    is_choice = coordinates.node.type == "TEX_COORD"
    return f"{coordinates.socket.name} coordinates" if is_choice else coordinates.node.bl_label


def _read_step(output: ScopedSocket) -> tuple[np.ndarray, ScopedSocket] | None:
    """Return the matrix (4, 4) by which a node transforms coordinates, and what it transforms; None for other nodes."""
    node = output.node
    if node.type == "MAPPING" and node.vector_type != "NORMAL":
        names = ["Location", "Rotation", "Scale"]
        values = [_read_vector(output.input(name)) for name in names]
        if any(value is None for value in values):
            return None
        location = mathutils.Vector((0.0, 0.0, 0.0)) if node.vector_type == "VECTOR" else values[0]
        matrix = np.array(mathutils.Matrix.LocRotScale(location, mathutils.Euler(values[1], "XYZ"), values[2]), np.float64)
        if node.vector_type == "TEXTURE":
            if not np.abs(np.linalg.det(matrix)) > 0.0:
                return None
            matrix = np.linalg.inv(matrix)
        return matrix, output.input("Vector")
    if node.type == "VECT_MATH" and node.operation in ("ADD", "SUBTRACT", "MULTIPLY"):
        value = _read_vector(output.input(1))
        if value is None:
            return None
        matrix = np.eye(4)
        if node.operation == "MULTIPLY":
            matrix[:3, :3] = np.diag(value)
        else:
            matrix[:3, 3] = np.array(value) * (1.0 if node.operation == "ADD" else -1.0)
        return matrix, output.input(0)
    return None


def _read_vector(source: ScopedSocket) -> mathutils.Vector | None:
    """Return the value of an input without a link, None if it is linked."""
    return mathutils.Vector(source.socket.default_value) if source.is_constant and source.socket.type == "VECTOR" else None


def _read_wrap(output: ScopedSocket) -> tuple[tuple[str, str], ScopedSocket] | None:
    """Return how math nodes before a Combine XYZ node wrap u and v, as Blender's glTF importer adds them, and the coordinates that they
    wrap; None if they do something else."""
    wraps, sources = [], []
    for axis in ("X", "Y"):
        component, wrap = output.input(axis), "clamp"
        if component.operation:
            constants = [component.input(index) for index in (1, 2)]
            values = [item.socket.default_value if item.is_constant else None for item in constants]
            if component.operation == "WRAP" and values == [0.0, 1.0]:
                wrap = "repeat"
            elif component.operation == "PINGPONG" and values[0] == 1.0:
                wrap = "mirror"
            else:
                return None
            component = component.input(0)
        if component.is_constant or component.node.type != "SEPXYZ" or component.socket.identifier != axis:
            return None
        wraps.append(wrap)
        sources.append(component.input("Vector"))
    return ((wraps[0], wraps[1]), sources[0]) if sources[0] == sources[1] else None
