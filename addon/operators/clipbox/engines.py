"""The engines, with their voxels, of the terrains in the file, which are kept between moves."""

from dataclasses import replace

import bpy

from ...bridge.clipbox.objects import SceneTerrain
from ...bridge.clipbox.sources import READERS, absolute_path
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
        settings = resolve_paths(terrain.settings)
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
            root = bpy.data.objects.get((name, None))
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


def create_engine(settings: ClipboxSettings, closed: bool = False, library: bpy.types.Library | None = None) -> TerrainEngine:
    """Create an engine for a new terrain; `closed` adds walls at the boundary of the outermost box.

    library: the file that the settings are linked from, None for this file.

    Raises:
        SettingsError, FileError: the formula or the source file cannot be read.
    """
    return TerrainEngine(resolve_paths(settings, library), READERS, closed)


def resolve_paths(settings: ClipboxSettings, library: bpy.types.Library | None = None) -> ClipboxSettings:
    """Return settings whose source path does not depend on the .blend file ("//") or on the current folder."""
    return replace(settings, source=absolute_path(settings.source, library)) if settings.source else settings
