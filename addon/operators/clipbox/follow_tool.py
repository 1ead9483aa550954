"""How clip-box terrains follow a viewer. Their engines take the terrain position (3,) of the viewer."""

import bpy
import numpy as np

from ...bridge.clipbox import objects as terrain_objects
from ...bridge.clipbox.objects import PendingBlocks, SceneTerrain
from ...core.clipbox.blocks import BlockMesh
from ...core.clipbox.engine import BlockKey, TerrainEngine, Update
from ...core.geometry.viewers import Viewer
from . import engines


class TerrainChange:
    """One move of one terrain."""

    def __init__(self, terrain: SceneTerrain, engine: TerrainEngine) -> None:
        self._terrain = terrain
        self._pending = PendingBlocks(terrain.origin, engine.settings)

    def fill(self, key: BlockKey, block: BlockMesh) -> tuple[()]:
        """Fill the mesh of a block, at once: blocks are small."""
        self._pending.fill(key, block)
        return ()

    def show(self, update: Update) -> tuple[()]:
        """Show all meshes."""
        terrain_objects.show_meshes(self._terrain, self._pending.names, update, self._terrain.material)
        return ()


class ClipboxFollowTool:
    """The tool `clipbox` among those whose terrains follow; see `FollowTool`."""

    identifier = SceneTerrain.tool

    def scene_terrains(self, scene: bpy.types.Scene) -> list[SceneTerrain]:
        """Return all terrains of a scene, linked ones included."""
        return terrain_objects.scene_terrains(scene)

    def create_engine(self, terrain: SceneTerrain) -> TerrainEngine:
        """Create an engine for a terrain.

        Raises:
            SettingsError, FileError: the settings, the formula or the source file cannot be read.
        """
        return engines.create_engine(terrain.settings)

    def is_engine_of(self, engine: TerrainEngine, terrain: SceneTerrain) -> bool:
        """Return whether an engine has the current settings of its terrain."""
        return engine.settings == engines.resolve_paths(terrain.settings)

    def to_terrain(self, terrain: SceneTerrain, viewer: Viewer) -> np.ndarray:
        """Return the terrain position (3,) float64 of a viewer in world space."""
        return terrain.viewer_position(viewer.matrix)

    def is_shown_at(self, terrain: SceneTerrain, viewer: np.ndarray) -> bool:
        """Return whether the boxes already lie as they would around `viewer` (3,)."""
        return TerrainEngine.has_same_layout(terrain.settings, terrain.viewer, viewer)

    def start_change(self, terrain: SceneTerrain, engine: TerrainEngine) -> TerrainChange:
        """Return the change of a new move."""
        return TerrainChange(terrain, engine)


TOOL = ClipboxFollowTool()
