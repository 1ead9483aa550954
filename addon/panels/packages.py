"""Panel *Packages* in the sidebar tab *Farfield*."""

import bpy

from ..core.packages.settings import PackageSettings
from ..core.settings import describe
from ..operators.packages.operators import FARFIELD_OT_packages_export, default_folder
from ..operators.packages.viewing import FARFIELD_OT_packages_view
from .sidebar import SettingsPanel, ToolPanel, draw_button, draw_message, draw_progress_bar, settings_column


class FARFIELD_PT_packages(SettingsPanel, ToolPanel, bpy.types.Panel):
    """Where packages for a web page go, what they are made for, and the button or the progress bar."""

    bl_idname = "FARFIELD_PT_packages"
    bl_label = "Packages"
    bl_description = "For web pages: files of a model that loads progressively"
    bl_options = {"DEFAULT_CLOSED"}
    page = "packages"
    settings, property_name = describe(PackageSettings), "farfield_packages"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the folder, the settings and the buttons. While a job runs, they are disabled and the progress bar replaces the buttons."""
        settings_column(self.layout).prop(context.scene.farfield_packages, "folder", placeholder=str(default_folder(context)))
        self.draw_settings(context)
        if draw_progress_bar(self.layout):
            return
        reason = FARFIELD_OT_packages_export.disabled_reason(context)
        draw_message(self.layout, reason or "Levels have the settings of Perceptual Levels", "INFO")
        draw_button(self.layout, FARFIELD_OT_packages_export, "Export Package", "EXPORT")
        self.layout.operator(FARFIELD_OT_packages_view.bl_idname, text="View in Browser", icon="URL")


CLASSES = (FARFIELD_PT_packages,)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
