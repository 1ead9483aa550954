"""What a tool provides so that its terrains follow a viewer, and the list of these tools.

An engine computes changes in a thread; a change fills meshes and shows them in the main thread. Keys, blocks, updates and the viewers that
engines take are the tool's own types.
"""

from collections.abc import Hashable, Iterable
from queue import SimpleQueue
from typing import Any, Protocol, runtime_checkable

import bpy

from ..bridge.terrain_roots import TerrainRoot
from ..core.geometry.viewers import Viewer
from ..core.jobs.progress import Steps


class Engine(Protocol):
    """Computes what is to be shown of one terrain, and knows what is shown. Only one thread at a time uses it.

    finished_blocks: (key, block) pairs that the current move has finished; every move starts with an empty queue.
    """

    finished_blocks: SimpleQueue[tuple[Hashable, Any]]

    def move(self, viewer: Any) -> Steps[Any]:
        """Compute the update for a viewer. Runs in a thread, without Blender data. If it is cancelled or fails, the engine stays valid."""

    def is_settled_at(self, viewer: Any) -> bool:
        """Return whether a move to `viewer` would change nothing. Asked for in every tick."""

    def invalidate(self) -> None:
        """Forget what is shown: the next update is complete."""


@runtime_checkable
class PrefetchingEngine(Protocol):
    """An engine that reads ahead between two moves."""

    def prefetch(self) -> Steps[None]:
        """Read what the next moves will probably need. Runs in a thread, and may be cancelled at any step."""


@runtime_checkable
class QuickEngine(Protocol):
    """An engine that leaves out fine detail around a fast viewer. Its viewers are positions (3,)."""

    def move_quickly(self, viewer: Any, travel: float) -> Steps[Any]:
        """Compute the update for a viewer who moves on by the length `travel` until the next update is shown. If detail is left out, the
        engine is not settled. Otherwise as `move`."""


class Change(Protocol):
    """One move of one terrain in the main thread: fills meshes that nobody sees yet, then shows them."""

    def fill(self, key: Hashable, block: Any) -> Iterable[None]:
        """Fill the mesh of a block. A generator that yields is continued in the next tick if time is over; otherwise return ()."""

    def show(self, update: Any) -> Iterable[None]:
        """Show the result of the move, after all of its blocks have been filled. Like `fill` it may take several ticks, but what the user
        sees must switch within its last step. If it is closed before that, the engine is invalidated."""


class FollowTool(Protocol):
    """A tool whose terrains follow. terrain_type: its terrains."""

    terrain_type: type[TerrainRoot]

    @property
    def identifier(self) -> str:
        """The identifier of the tool."""
        return self.terrain_type.tool

    def scene_terrains(self, scene: bpy.types.Scene) -> Iterable[TerrainRoot]:
        """Return all terrains of a scene, linked ones included."""
        return self.terrain_type.in_scene(scene)

    def create_engine(self, terrain: TerrainRoot) -> Engine:
        """Create an engine for a terrain.

        Raises:
            FarfieldError: its settings or files cannot be read.
        """

    def is_engine_of(self, engine: Engine, terrain: TerrainRoot) -> bool:
        """Return whether an engine has the current settings of its terrain."""

    def to_terrain(self, terrain: TerrainRoot, viewer: Viewer) -> Any:
        """Return a viewer in world space as engines take it, by default a viewer in terrain space."""
        return terrain.to_terrain_space(viewer)

    def is_shown_at(self, terrain: TerrainRoot, viewer: Any) -> bool:
        """Return whether the scene, which undo or another file may have changed, already shows what a move to `viewer` would show. False if
        that is known to an engine only."""
        return False

    def start_change(self, terrain: TerrainRoot, engine: Engine) -> Change:
        """Return the change of a new move."""


registered: dict[str, FollowTool] = {}  # The tools whose terrains follow, by identifier.


def tool_of(terrain: TerrainRoot) -> FollowTool:
    """Return the tool of a terrain."""
    return registered[terrain.tool]
