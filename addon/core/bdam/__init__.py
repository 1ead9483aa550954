"""Height-field terrain of any size: BDAM, batched dynamic adaptive meshes (Cignoni et al., Eurographics 2003).

`open_field` opens elevation models, `build_terrain` builds the store of a field, and `TerrainStore` opens it; `HeightQuery` finds
heights of the ground, and `extract_mesh` the mesh that a viewer needs.
"""

from .building.terrain_build import BuildReport, build_terrain
from .fields.terrain_field import FieldSettings, TerrainField, open_field
from .ground.heights import HeightQuery
from .settings import BdamSettings
from .store.terrain_store import TerrainStore
from .view.cut_files import ExtractedMesh, extract_mesh
from .view.projected_errors import CutSettings

__all__ = [
    "BdamSettings",
    "BuildReport",
    "CutSettings",
    "ExtractedMesh",
    "FieldSettings",
    "HeightQuery",
    "TerrainField",
    "TerrainStore",
    "build_terrain",
    "extract_mesh",
    "open_field",
]
