"""Opacity maps of materials, and the same materials without them."""

from dataclasses import dataclass

import bpy
import numpy as np

from ...core.imaging.images import sample_bilinear
from ..geometry.evaluated_mesh import EvaluatedMesh
from ..imaging.images import read_pixels
from ..lod_sets import KIND
from ..shading.surface_reader import TRANSPARENT, find_output, read_surface
from ..shading.texture_uses import TextureUse
from .chains import CHAIN

CHANNELS = ("Red", "Green", "Blue", "Alpha")
MAX_SHADERS = 64  # Mixed with each other.
SUFFIX = "Opaque"  # Of the names of materials.


@dataclass(frozen=True)
class OpacityMap:
    """The image that cuts leaves out of the faces with a material.

    Attributes:
        use: the image, and how it lies on the surface.
        values: (H, W, 1), opacities in 0..1, row 0 at the bottom.
    """

    use: TextureUse
    values: np.ndarray

    def find_uv_map(self, evaluated: EvaluatedMesh) -> str:
        """Return the name of the UV map of a mesh on which the image lies."""
        return self.use.uv_map or evaluated.uv_map

    def read_uvs(self, evaluated: EvaluatedMesh, triangles: np.ndarray) -> np.ndarray:
        """Return the texture coordinates (N, 3, 2) at the corners of `triangles` (N,)."""
        return evaluated.at_corners(self.find_uv_map(evaluated), triangles)[..., :2].astype(np.float64)

    def sample(self, uvs: np.ndarray) -> np.ndarray:
        """Return the opacities (N,) at texture coordinates (N, 2)."""
        placed = uvs @ self.use.matrix[:, :2].T + self.use.matrix[:, 2]
        is_outside = ((placed < 0.0) | (placed > 1.0)).any(axis=1)
        for axis, wrap in enumerate(self.use.wrap):
            if wrap == "repeat":
                placed[:, axis] %= 1.0
            elif wrap == "mirror":
                placed[:, axis] = 1.0 - np.abs(placed[:, axis] % 2.0 - 1.0)
        height, width = self.values.shape[:2]
        found = sample_bilinear(self.values, placed * [width, height])[:, 0]
        return np.where(is_outside & self.use.is_cut, 0.0, found)


def read_opacity_map(material: bpy.types.Material) -> OpacityMap | None:
    """Return the map of a material whose opacity is an image and nothing else, None for others."""
    surface = read_surface(material)
    alpha = surface.alpha
    if len(alpha.textures) != 1 or alpha.attributes or alpha.unread or alpha.factor[0] < 1.0:
        return None
    use = alpha.textures[0]
    if not all(use.image.size) or use.image.source == "TILED":
        return None
    pixels = read_pixels(use.image)
    values = pixels[..., CHANNELS.index(use.channel)] if use.channel in CHANNELS else pixels[..., :3].mean(axis=2)
    if surface.alpha_cutoff is not None:
        values = values > surface.alpha_cutoff
    return OpacityMap(use, values[..., None].astype(np.float32))


def create_opaque(material: bpy.types.Material) -> bpy.types.Material | None:
    """Return a copy of a material without its opacity, None if that is part of something else."""
    copy = material.copy()
    copy.name, copy[KIND] = f"{material.name} {SUFFIX}", CHAIN
    copy.surface_render_method = "DITHERED"  # EEVEE draws faces of blended materials in the order of the mesh, and without raytracing.
    target = find_output(copy.node_tree).inputs["Surface"]
    for _ in range(MAX_SHADERS):
        shown = [] if not target.links or target.links[0].from_node.type != "MIX_SHADER" else _find_opaque(target.links[0].from_node)
        if not shown:
            break
        copy.node_tree.links.new(shown[0], target)
    alpha = target.links[0].from_node.inputs.get("Alpha") if target.links else None
    if alpha is not None:
        for link in list(alpha.links):
            copy.node_tree.links.remove(link)
        alpha.default_value = 1.0
    if read_surface(copy).is_opaque:
        return copy
    bpy.data.materials.remove(copy)
    return None


def _find_opaque(mix: bpy.types.Node) -> list[bpy.types.NodeSocket]:
    """Return the shader that a Mix Shader node mixes with a transparent one, nothing for other mixtures."""
    sources = [item.links[0].from_socket for item in mix.inputs if item.type == "SHADER" and item.links]
    shown = [source for source in sources if source.node.type not in TRANSPARENT]
    return shown if len(sources) == 2 and len(shown) == 1 else []
