"""Normal maps of levels: the normals of the original, with its normal map, in the tangent frames of a level."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...imaging.mipmaps import shrink_by_area
from .tangent_normals import TangentSurface, express_normals, find_normals
from .texture_uses import TextureUse
from .uv_layout import repeats_texture

OVERLAPPING = "The normals of these images stay those of the original, since UV maps use parts of them more than once"
WITHOUT_FRAMES = "The normals of these images stay those of the original, since they are placed or use another UV map than the active one"


@dataclass(eq=False)
class NormalMaps:
    """Makes the normal maps of levels from that of the original.

    Attributes:
        surface: of the original, None if levels keep the normals of the image.
        scale: of the components along the surface, as the original has it.
        reason: why levels keep the normals, "" if they do not.
        normals: (H, W, 3) of the last size, in object space.
    """

    surface: TangentSurface | None
    scale: float
    reason: str
    normals: np.ndarray | None = None

    @staticmethod
    def of(uses: Sequence[Sequence[TextureUse]], size: tuple[int, int]) -> "NormalMaps":
        """Return what makes the normal maps where `uses`, per level and the original first, show an image with `size`."""
        scales = {use.reference.get("scale", 1.0) for use in uses[0]}
        surfaces = [_join(found) for found in uses]
        if len(scales) != 1 or any(surface is None for surface, found in zip(surfaces, uses, strict=True) if found):
            return NormalMaps(None, 1.0, WITHOUT_FRAMES)
        if repeats_texture(surfaces[0].uvs, size):
            return NormalMaps(None, 1.0, OVERLAPPING)
        return NormalMaps(surfaces[0], scales.pop(), "")

    def express(self, vectors: np.ndarray, uses: Sequence[TextureUse]) -> np.ndarray:
        """Return the normal map (H, W, 3) of a level.

        Args:
            vectors: (H, W, 3), the normal map of the original with the size of that of the level; no larger than those before. uses: of
                the level.
        """
        size = vectors.shape[1::-1]
        if self.normals is None:
            self.normals = find_normals(self.surface, vectors * np.float32([self.scale, self.scale, 1.0]))
        self.normals = shrink_by_area(self.normals, size)
        return express_normals(_join(uses), self.normals)


def _join(uses: Sequence[TextureUse]) -> TangentSurface | None:
    """Return the surface of all parts of uses, None if they have no tangents for the UV map of the image."""
    surfaces = [use.list_surfaces() for use in uses]
    if not surfaces or any(found is None for found in surfaces):
        return None
    parts = [surface for found in surfaces for surface in found]
    arrays = ([getattr(part, name) for part in parts] for name in ("uvs", "normals", "tangents"))
    return TangentSurface(*(np.concatenate(values) for values in arrays))
