"""How large terrains follow a viewer. Their engines take viewers in the local frame of the store."""

import bpy

from ...bridge.bdam.objects import SceneTerrain, TerrainChange
from ...core.bdam.view.engine import BdamEngine
from ...core.geometry.viewers import Viewer


class BdamFollowTool:
    """The tool `bdam` among those whose terrains follow; see `FollowTool`."""

    identifier = SceneTerrain.tool

    def scene_terrains(self, scene: bpy.types.Scene) -> list[SceneTerrain]:
        """Return all terrains of a scene, linked ones included."""
        return SceneTerrain.in_scene(scene)

    def create_engine(self, terrain: SceneTerrain) -> BdamEngine:
        """Create an engine for a terrain.

        Raises:
            SettingsError, FileError: the settings or the store cannot be read.
        """
        return BdamEngine(terrain.folder, terrain.settings)

    def is_engine_of(self, engine: BdamEngine, terrain: SceneTerrain) -> bool:
        """Return whether an engine has the current settings and the current store of its terrain."""
        return engine.settings == terrain.settings and engine.folder == terrain.folder

    def to_terrain(self, terrain: SceneTerrain, viewer: Viewer) -> Viewer:
        """Return a viewer in world space as a viewer in the local frame of the store."""
        return terrain.to_terrain_space(viewer)

    def is_shown_at(self, terrain: SceneTerrain, viewer: Viewer) -> bool:
        """Return False: only the engine knows."""
        return False

    def start_change(self, terrain: SceneTerrain, engine: BdamEngine) -> TerrainChange:
        """Return the change of a new move."""
        return TerrainChange(terrain, engine)


TOOL = BdamFollowTool()
