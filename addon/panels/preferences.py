"""The preferences of the extension."""

import bpy

from ..core.errors import FarfieldError
from ..core.files.file_access import convert_os_errors, folder_bytes
from ..core.messages import format_bytes
from ..operators.user_cache import CACHED_TOOLS, PACKAGE, FARFIELD_OT_clear_cache, cache_folder, cached_folders


class FarfieldPreferences(bpy.types.AddonPreferences):
    """Worker processes, and the cache."""

    bl_idname = PACKAGE
    __annotations__ = {
        "processes": bpy.props.IntProperty(
            name="Processes",
            description="Worker processes where Executor is processes; 0 for one per core, eight at most. Each holds the scene in memory",
            min=0,
            max=256,
        )
    }

    def draw(self, _context: bpy.types.Context) -> None:
        """Draw the number of processes, and the cache with its size."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "processes")
        row = layout.row()
        try:
            with convert_os_errors("Cannot read the cache"):
                size = sum(folder_bytes(folder) for folder in cached_folders())
            row.label(text=f"Cache: {format_bytes(size)} in {cache_folder(CACHED_TOOLS[0]).parent}", icon="FILE_CACHE")
        except FarfieldError as error:
            row.label(text=str(error), icon="ERROR")
        row.operator(FARFIELD_OT_clear_cache.bl_idname, text="Clear", icon="TRASH")


register, unregister = bpy.utils.register_classes_factory((FarfieldPreferences,))
