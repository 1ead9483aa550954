"""Nested clip-boxes: unbounded volumetric terrain around a viewer.

`TerrainEngine` computes the blocks of a terrain around a viewer and what changes when the viewer moves; `weld` joins them to one mesh, and
`convert_to_meshes` makes meshes with UVs and a collider.
"""

from .blocks import BlockMesh
from .engine import TerrainEngine, Update, WeldedMesh, weld
from .settings import ClipboxSettings, ConvertSettings
from .to_mesh import ConvertedMesh, convert_to_meshes

__all__ = [
    "BlockMesh",
    "ClipboxSettings",
    "ConvertSettings",
    "ConvertedMesh",
    "TerrainEngine",
    "Update",
    "WeldedMesh",
    "convert_to_meshes",
    "weld",
]
