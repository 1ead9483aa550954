"""Materials of levels for glTF files: what they can store of a material, and names of the rest."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...core.files.glb_materials import BLEND, MASK, OPAQUE, GlbMaterial, GlbTexture, is_placement
from ...core.messages import quote_names
from ..geometry.evaluated_mesh import EvaluatedMesh
from ..shading.surface_reader import MaterialSurface, read_surface
from ..shading.texture_uses import TextureUse
from .glb_images import read_used_image

IDENTITY = np.eye(2, 3)
Key = tuple[str, str] | None  # name and channel of an image


@dataclass(frozen=True)
class VertexUse:
    """What a material reads from vertices: the name of the UV map, "" for the one that renders, and the names of the color attributes
    that its color and its opacity are multiplied with."""

    uv_map: str = ""
    colors: tuple[tuple[str, str], ...] = ()
    alphas: tuple[tuple[str, str], ...] = ()

    def read_uvs(self, mesh: EvaluatedMesh, triangles: np.ndarray) -> np.ndarray | None:
        """Return the texture coordinates (N, 3, 2) float64 at the corners of `triangles` (N,) of a mesh, None without a UV map."""
        name = self.uv_map if self.uv_map in mesh.attributes else mesh.uv_map
        return mesh.at_corners(name, triangles).astype(np.float64) if name else None

    def read_colors(self, mesh: EvaluatedMesh, triangles: np.ndarray) -> np.ndarray | None:
        """Return the scene-linear colors (N, 3, 3 or 4) float64 at the corners of `triangles` (N,) of a mesh, None if they do not count."""
        if not self.colors and not self.alphas:
            return None
        result = np.ones((len(triangles), 3, 4))
        for attributes, components in ((self.colors, slice(0, 3)), (self.alphas, slice(3, 4))):
            for name, output in attributes:
                result[..., components] *= _read_attribute(mesh, triangles, name, output)
        return result if self.alphas else result[..., :3]


def _read_attribute(mesh: EvaluatedMesh, triangles: np.ndarray, name: str, output: str) -> np.ndarray:
    """Return what an attribute node shows at the corners of `triangles` (N,), (N, 3, 1 or 3); 0 without the attribute, as in renders."""
    attribute = mesh.attributes.get(name or mesh.color)
    if attribute is None:
        return np.zeros((len(triangles), 3, 1))
    values = mesh.at_corners(name or mesh.color, triangles)
    if output == "Alpha":
        return values[..., 3:4] if values.shape[2] == 4 else np.ones((len(values), 3, 1))
    return values[..., :3] if values.shape[2] >= 3 else values[..., :1]


@dataclass
class GlbMaterials:
    """Materials and images of a file, each once, in the order in which they are added.

    Attributes:
        materials, images: the content of the file.
        unread: by material, what the file lacks of it.
    """

    materials: list[GlbMaterial] = field(default_factory=list)
    images: list[bytes] = field(default_factory=list)
    unread: dict[str, tuple[str, ...]] = field(default_factory=dict)
    _found: dict[bpy.types.Material, tuple[int, VertexUse]] = field(default_factory=dict)
    _image_indices: dict[tuple[Key, Key, bool], int] = field(default_factory=dict)
    _cuts: dict[int, np.ndarray] = field(default_factory=dict)

    def add(self, material: bpy.types.Material | None) -> tuple[int | None, VertexUse]:
        """Return the index of a material, None for none, and what it reads from vertices.

        Raises:
            FileError: its image is missing or cannot be read.
        """
        if material is None:
            return None, VertexUse()
        if material not in self._found:
            self._found[material] = self._read(material)
        return self._found[material]

    def _read(self, material: bpy.types.Material) -> tuple[int, VertexUse]:
        surface = read_surface(material)
        color, alpha, unread = choose_textures(surface)
        mode = OPAQUE if surface.is_opaque else BLEND if surface.alpha_cutoff is None else MASK
        used = color or alpha
        texture = None
        if used is not None:
            matrix = used.matrix if is_placement(used.matrix) else IDENTITY
            unread += () if is_placement(used.matrix) else ("Mapping",)
            placement = None if np.array_equal(matrix, IDENTITY) else tuple(map(tuple, matrix.tolist()))
            texture = GlbTexture(self._add_image(color, alpha, mode == OPAQUE), used.wrap, used.is_nearest, placement)
            if used.is_cut:
                self._cuts[len(self.materials)] = used.matrix
        factors = np.array([*surface.color.factor, 1.0 if mode == OPAQUE else surface.alpha.factor[0]])
        unread += ("a color above 1",) if (factors > 1.0).any() else ()
        self.materials.append(
            GlbMaterial(
                name=material.name,
                base_color=tuple(np.clip(factors, 0.0, 1.0).tolist()),
                texture=texture,
                is_double_sided=not material.use_backface_culling,
                alpha_mode=mode,
                alpha_cutoff=0.5 if surface.alpha_cutoff is None else surface.alpha_cutoff,
                is_unlit=surface.shader is not None and surface.shader.type == "EMISSION",
            )
        )
        self._note(material.name, unread)
        use = VertexUse("" if used is None else used.uv_map, surface.color.attributes, surface.alpha.attributes)
        return len(self.materials) - 1, use

    def note_attributes(self, name: str, mesh: bpy.types.Mesh, uses: Iterable[VertexUse]) -> None:
        """Note UV maps and color attributes of a mesh, of the object `name`, that no material uses."""
        render = next((layer.name for layer in mesh.uv_layers if layer.active_render), "")
        uv_maps = {use.uv_map if use.uv_map in mesh.uv_layers else render for use in uses}
        colors = {color or mesh.attributes.default_color_name for use in uses for color, _ in (*use.colors, *use.alphas)}
        labels = [f'the UV map "{layer.name}"' for layer in mesh.uv_layers if layer.name not in uv_maps]
        labels += [f'the color attribute "{item.name}"' for item in mesh.color_attributes if item.name not in colors]
        self._note(name, labels)

    def note_uvs(self, index: int | None, uvs: np.ndarray | None) -> None:
        """Note if texture coordinates (..., 2) leave the image of a material that shows nothing there."""
        if uvs is not None and index in self._cuts:
            placed = uvs @ self._cuts[index][:, :2].T + self._cuts[index][:, 2]
            if placed.min() < 0.0 or placed.max() > 1.0:
                self._note(self.materials[index].name, ("the border of its image",))

    def _note(self, name: str, labels: Sequence[str]) -> None:
        if labels:
            self.unread[name] = tuple(dict.fromkeys((*self.unread.get(name, ()), *labels)))

    def _add_image(self, color: TextureUse | None, alpha: TextureUse | None, is_opaque: bool) -> int:
        key = _image_key(color), _image_key(alpha), is_opaque
        if key not in self._image_indices:
            self.images.append(read_used_image(color, alpha, is_opaque))
            self._image_indices[key] = len(self.images) - 1
        return self._image_indices[key]


def choose_textures(surface: MaterialSurface) -> tuple[TextureUse | None, TextureUse | None, tuple[str, ...]]:
    """Return the textures of color and opacity of a surface that one image can hold, and labels of what else it depends on."""
    color, *further = surface.color.textures or (None,)
    alpha, *further_alphas = surface.alpha.textures or (None,)
    unread = [*surface.color.unread, *surface.alpha.unread, *surface.unread]
    if color is not None and alpha is not None and not alpha.is_placed_like(color):
        further_alphas, alpha = [alpha, *further_alphas], None
    unread += [f'the image "{use.image.name}"' for use in (*further, *further_alphas)]
    return color, alpha, tuple(unread)


def describe_unread(unread: dict[str, tuple[str, ...]], place: str) -> list[str]:
    """Return sentences about what `place`, such as "The file", lacks of materials."""
    by_content: dict[tuple[str, ...], list[str]] = {}
    for name, labels in unread.items():
        by_content.setdefault(labels, []).append(name)
    return [f"{place} lacks {', '.join(labels)} of {quote_names(names)}." for labels, names in by_content.items() if labels]


def _image_key(use: TextureUse | None) -> Key:
    return None if use is None else (use.image.name_full, use.channel)
