"""The engines, with their voxels, of the terrains in the file, which are kept between moves."""

from dataclasses import replace

import bpy

from ...bridge.clipbox.objects import SceneTerrain
from ...bridge.clipbox.sources import READERS
from ...core.clipbox.engine import TerrainEngine
from ...core.clipbox.settings import ClipboxSettings


class EngineCache:
    """Engines by session UID of the terrain's root, which survives renaming. Engines of missing terrains are evicted."""

    def __init__(self) -> None:
        self._engines: dict[int, TerrainEngine] = {}
        self._names: dict[int, str] = {}  # of the roots, to find them quickly

    def __len__(self) -> int:
        return len(self._engines)

    def get(self, terrain: SceneTerrain) -> TerrainEngine:
        """Return the engine of a terrain; create it if there is none with the terrain's settings.

        Raises:
            SettingsError, FileError: the settings, the formula or the source file cannot be read.
        """
        settings = _with_absolute_paths(terrain.settings)
        engine = self._engines.get(terrain.root.session_uid)
        if engine is None or engine.settings != settings:
            engine = TerrainEngine(settings, READERS)
            self.store(terrain, engine)
        return engine

    def store(self, terrain: SceneTerrain, engine: TerrainEngine) -> None:
        """Use `engine`, which has built what is shown of a terrain, for its next moves."""
        self.evict_missing()
        self._engines[terrain.root.session_uid], self._names[terrain.root.session_uid] = engine, terrain.name

    def evict_missing(self) -> None:
        """Remove the engines of terrains that no longer exist."""
        for uid, name in list(self._names.items()):
            root = bpy.data.objects.get(name)
            if root is None or root.session_uid != uid:  # deleted or renamed
                root = next((item for item in bpy.data.objects if item.session_uid == uid), None)
            if root is None or not root.users_scene:
                del self._engines[uid], self._names[uid]
            else:
                self._names[uid] = root.name

    def invalidate(self) -> None:
        """Forget which blocks are shown: the next move of every terrain shows all of its blocks."""
        for engine in self._engines.values():
            engine.invalidate()

    def clear(self) -> None:
        """Remove all engines."""
        self._engines.clear()
        self._names.clear()


cache = EngineCache()


def create_engine(settings: ClipboxSettings, closed: bool = False) -> TerrainEngine:
    """Create an engine for a new terrain; `closed` adds walls at the boundary of the outermost box.

    Raises:
        SettingsError, FileError: the formula or the source file cannot be read.
    """
    return TerrainEngine(_with_absolute_paths(settings), READERS, closed)


def _with_absolute_paths(settings: ClipboxSettings) -> ClipboxSettings:
    """Resolve a source path that is relative to the .blend file ("//")."""
    return replace(settings, source=bpy.path.abspath(settings.source)) if settings.source else settings
