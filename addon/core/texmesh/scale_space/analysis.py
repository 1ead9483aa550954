"""The analysis of a textured mesh in scale space (sections II and III.A of the TexMesh paper)."""

from collections.abc import Sequence

import numpy as np

from ...jobs.progress import Steps
from ..textured_mesh import TexturedMesh
from .paper_mode import analyze_range_image
from .scale_map import ScaleMap
from .settings import ScaleSpaceSettings
from .surface_mode import analyze_surface


def analyze_scale_space(mesh: TexturedMesh, textures: Sequence[np.ndarray | None], settings: ScaleSpaceSettings) -> Steps[ScaleMap]:
    """Find for each vertex of `mesh` the last of 21 scales at which it is a feature.

    textures: per material an image (H, W, 3) float32, scene-linear, row 0 at the bottom, or None. Mode `paper` looks at the shape alone.

    Raises:
        GeometryError: in mode `paper`, next to nothing of the surface faces the axis.
    """
    if settings.mode == "paper":
        return (yield from analyze_range_image(mesh, settings))
    return (yield from analyze_surface(mesh, textures, settings))
