"""The operators *Scatter* and *Remove Scatter*, for the terrains of both tools."""

import bpy

from ..bridge import scatter
from ..bridge.terrain_roots import TerrainRoot
from ..core.errors import GeometryError
from ..core.messages import list_first
from ..core.scatter import ScatterSettings
from . import follow_tools, properties
from .error_reports import report_message, reports_errors


def active_terrain(context: bpy.types.Context) -> TerrainRoot | None:
    """Return the active terrain, of any tool; None if there is none."""
    found = (tool.terrain_type.of_object(context.active_object) for tool in follow_tools.registered.values())
    return next((terrain for terrain in found if terrain is not None), None)


class ScatterOperator:
    """What both operators have in common: they need a terrain that can be changed."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether a terrain is active."""
        terrain = active_terrain(context)
        reason = "Select a terrain" if terrain is None else terrain.read_only_reason
        if reason:
            cls.poll_message_set(reason)
        return not reason


class FARFIELD_OT_scatter_add(ScatterOperator, bpy.types.Operator):
    """Let plants grow and rocks lie on the active terrain, around the active camera. Each kind is an object with a Geometry Nodes modifier,
    whose assets can be replaced by yours"""

    bl_idname = "farfield.scatter_add"
    bl_label = "Scatter Plants and Rocks"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = properties.build_annotations(ScatterSettings, set())

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Scatter what the settings name."""
        terrain, settings = active_terrain(context), properties.read(ScatterSettings, self)
        if not terrain.ground_objects():
            raise GeometryError(f'The terrain "{terrain.name}" shows nothing; press Update first.')
        created = scatter.add_scatter(context.scene, terrain, settings, terrain.meter)
        names = list_first([item[scatter.SCATTER_KEY] for item in created])
        note = "" if context.scene.camera is not None else " The scene has no camera; they are around the center of the world."
        report_message(self, f'Scattered on "{terrain.name}": {names}.{note}')
        return {"FINISHED"}


class FARFIELD_OT_scatter_remove(ScatterOperator, bpy.types.Operator):
    """Remove all plants and rocks that were scattered on the active terrain"""

    bl_idname = "farfield.scatter_remove"
    bl_label = "Remove Scatter"
    bl_options = {"REGISTER", "UNDO"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove it."""
        scatter.remove_scatter(active_terrain(context))
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((FARFIELD_OT_scatter_add, FARFIELD_OT_scatter_remove))
