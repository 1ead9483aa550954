"""Perceptual levels of detail of textured meshes, found in scale space (TexMesh: Cheng and Boulanger).

`make_levels` makes the levels of a mesh with textures, which `build_textured_mesh` makes from triangles and texture coordinates;
`analyze_scale_space` finds the features of one.
"""

from .level_chain import Level, LevelChain, make_levels
from .scale_space.analysis import analyze_scale_space
from .scale_space.features import ScaleMap
from .settings import AnalysisSettings, TexmeshSettings
from .textured_mesh import TexturedMesh, build_textured_mesh

__all__ = [
    "AnalysisSettings",
    "Level",
    "LevelChain",
    "ScaleMap",
    "TexmeshSettings",
    "TexturedMesh",
    "analyze_scale_space",
    "build_textured_mesh",
    "make_levels",
]
