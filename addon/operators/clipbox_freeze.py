"""The operator that freezes a terrain: plain meshes that need nothing of Farfield, and a collider."""

from dataclasses import dataclass

import bpy
import numpy as np

from ..bridge import terrain_objects
from ..bridge.terrain_objects import StandingTerrain, terrain_at
from ..core.clipbox.freezing import Frozen, freeze
from ..core.clipbox.settings import FreezeSettings
from ..core.clipbox.terrain import Terrain
from ..core.errors import GeometryError
from ..core.progress import Progress, Steps
from . import clipbox, clipbox_engines, long_work, properties


@dataclass
class FreezeJob:
    """Freezes `standing`; `made` names the objects once the job is done."""

    core_share = 0.95

    standing: StandingTerrain
    engine: Terrain
    viewer: np.ndarray
    chosen: FreezeSettings
    made: tuple[str, ...] = ()

    def core_steps(self) -> Steps[list[Frozen]]:
        """Work the meshes out."""
        return freeze(self.engine, self.viewer, self.chosen)

    def scene_steps(self, core_result: list[Frozen]) -> Steps[str]:
        """Make their objects, and take the terrain away unless it is to be kept.

        Raises:
            GeometryError: when the terrain has gone meanwhile.
        """
        yield Progress(0.5, "Making objects")
        if self.standing.root is None:
            raise GeometryError(f'The terrain "{self.standing.name}" was removed meanwhile.')
        self.made = terrain_objects.add_frozen(bpy.context.scene, self.standing, core_result)
        if not self.chosen.keep_terrain:
            terrain_objects.remove(self.standing)
        triangles = sum(len(each.surface.triangles) for each in core_result)
        return f'Froze "{self.standing.name}" to {len(core_result)} meshes with {triangles:,} triangles.'


class FARFIELD_OT_clipbox_freeze(long_work.LongWork, bpy.types.Operator):
    """Make plain meshes of the active terrain as it lies now, which need nothing of Farfield"""

    bl_idname = "farfield.clipbox_freeze"
    bl_label = "Freeze"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = properties.annotations(FreezeSettings, {"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether a terrain is active, and nothing else under way."""
        return long_work.allowed(cls, clipbox.refusal(context) or clipbox.refusal_of_active(context))

    def prepare(self, context: bpy.types.Context) -> FreezeJob:
        """Take the terrain that is active."""
        properties.fill_unset(FreezeSettings, self, context.scene.farfield_clipbox_freeze)
        return prepare(terrain_at(context.active_object), properties.read(FreezeSettings, self))


def prepare(standing: StandingTerrain, chosen: FreezeSettings) -> FreezeJob:
    """The job that freezes a terrain as it lies now.

    Raises:
        SettingsError, FileError: when its settings, its formula or its file cannot be read.
    """
    engine = clipbox_engines.new_engine(standing.settings, chosen.closed)
    return FreezeJob(standing, engine, standing.viewer, chosen)


class FARFIELD_PG_clipbox_freeze(bpy.types.PropertyGroup):
    """What the panel holds of *Freeze*, kept with each scene."""

    __annotations__ = properties.annotations(FreezeSettings, set())


CLASSES = (FARFIELD_PG_clipbox_freeze, FARFIELD_OT_clipbox_freeze)
register_classes, unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the classes and hang the settings on scenes."""
    register_classes()
    bpy.types.Scene.farfield_clipbox_freeze = bpy.props.PointerProperty(type=FARFIELD_PG_clipbox_freeze)


def unregister() -> None:
    """The reverse."""
    del bpy.types.Scene.farfield_clipbox_freeze
    unregister_classes()
