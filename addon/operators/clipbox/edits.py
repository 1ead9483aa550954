"""The operator *Edit Terrain*, which adds objects of the scene to terrains and subtracts them."""

import bpy

from ...bridge.clipbox.edits import ADD, SUBTRACT, can_edit, mark
from ...core.messages import format_count
from .. import long_work
from ..error_reports import report_message, reports_errors

MODES = (
    (ADD, "Add", "Add the selected objects to terrains"),
    (SUBTRACT, "Subtract", "Subtract the selected objects from terrains"),
    ("NONE", "Neither", "Show the selected objects as they are, and leave them out of terrains"),
)


class FARFIELD_OT_clipbox_edit(bpy.types.Operator):
    """Add the selected objects to clip-box terrains, or subtract them: Empties as spheres, curves as tunnels or walls, others as solids"""

    bl_idname = "farfield.clipbox_edit"
    bl_label = "Edit Terrain with Selected Objects"
    bl_options = {"REGISTER", "UNDO"}
    mode: bpy.props.EnumProperty(name="Mode", items=MODES, description="What the objects do")

    @classmethod
    def description(cls, _context: bpy.types.Context, chosen: bpy.types.OperatorProperties) -> str:
        """Return what the chosen button does."""
        return {identifier: text for identifier, _, text in MODES}[chosen.mode] + ". Press Update to see it"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether an object is selected that can be added or subtracted."""
        reason = long_work.running_job_message()
        if not reason and not any(can_edit(item) and item.is_editable for item in context.selected_objects):
            reason = "Select Empties, curves or objects with faces that are no part of a terrain"
        return long_work.poll_with_reason(cls, reason)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Mark the objects."""
        objects = [item for item in context.selected_objects if can_edit(item) and item.is_editable]
        for item in objects:
            mark(item, "" if self.mode == "NONE" else self.mode)
        done = {ADD: "added to terrains", SUBTRACT: "subtracted from terrains"}.get(self.mode, "left out of terrains")
        report_message(self, f"{format_count(len(objects), 'object')} {done}; press Update on the terrain.")
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((FARFIELD_OT_clipbox_edit,))
