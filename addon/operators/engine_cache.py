"""The engines of the terrains in the file, with what they have computed, which are kept between moves."""

import bpy

from ..bridge.objects import find_by_uid
from ..bridge.terrain_roots import TerrainRoot
from . import follow_tools
from .follow_tools import Engine

Key = tuple[str, int]  # tool and session UID of the root


class EngineCache:
    """Engines by tool and session UID of the terrain's root, which survives renaming. Engines of missing terrains are evicted."""

    def __init__(self) -> None:
        self._engines: dict[Key, Engine] = {}
        self._names: dict[Key, str] = {}  # Names of the roots, to find them quickly.

    def __len__(self) -> int:
        return len(self._engines)

    def get(self, terrain: TerrainRoot) -> Engine:
        """Return the engine of a terrain; create it if there is none with the terrain's settings.

        Raises:
            FarfieldError: its settings or files cannot be read.
        """
        tool = follow_tools.tool_of(terrain)
        engine = self._engines.get(_key(terrain))
        if engine is None or not tool.is_engine_of(engine, terrain):
            engine = tool.create_engine(terrain)
            self.store(terrain, engine)
        return engine

    def store(self, terrain: TerrainRoot, engine: Engine) -> None:
        """Use `engine`, which has computed what is shown of a terrain, for its next moves."""
        self.evict_missing()
        discard_finished_blocks(engine)
        self._engines[_key(terrain)], self._names[_key(terrain)] = engine, terrain.name

    def __contains__(self, terrain: TerrainRoot) -> bool:
        """Return whether there is an engine of a terrain, which may have changed it since the last undo step."""
        return _key(terrain) in self._engines

    def evict_missing(self) -> None:
        """Remove the engines of terrains that no longer exist."""
        for key, name in list(self._names.items()):
            root = bpy.data.objects.get((name, None))
            if root is None or root.session_uid != key[1]:  # deleted or renamed
                root = find_by_uid(bpy.data.objects, key[1])
            if root is None or not root.users_scene:
                del self._engines[key], self._names[key]
            else:
                self._names[key] = root.name

    def invalidate(self) -> None:
        """Forget what is shown: the next move of every terrain shows all of it."""
        for engine in self._engines.values():
            engine.invalidate()

    def clear(self, tool: str = "") -> None:
        """Remove all engines, or those of a tool."""
        for key in [key for key in self._engines if tool in ("", key[0])]:
            del self._engines[key], self._names[key]


cache = EngineCache()


def discard_finished_blocks(engine: Engine) -> None:
    """Remove the finished blocks of an engine whose update was shown without them."""
    while not engine.finished_blocks.empty():
        engine.finished_blocks.get_nowait()


def _key(terrain: TerrainRoot) -> Key:
    return terrain.tool, terrain.root.session_uid
