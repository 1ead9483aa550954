"""Panel *Restore Image* in the sidebar tab *Farfield* of the Image Editor."""

import bpy

from ..bridge.restore.outline import outline
from ..core.restore.settings import MaskSettings, RestoreSettings
from ..core.settings import Description, describe
from ..operators import image_editors
from ..operators.restore.operators import (
    NO_IMAGE,
    FARFIELD_OT_restore_compare,
    FARFIELD_OT_restore_image,
    FARFIELD_OT_restore_mask,
    FARFIELD_OT_restore_outline,
    FARFIELD_OT_restore_variant,
    counterpart,
    edited_image,
    find_problem,
    find_target,
    list_variants,
)
from .sidebar import SettingsPanel, ToolPanel, draw_button, draw_message, draw_progress_bar, sub_panels

PANEL = "FARFIELD_PT_restore"
IMAGES = ("mask_image", "source_mask", "barriers")


class RestoreSettingsPanel(SettingsPanel):
    """Mixin of the panels that show settings of restorations."""

    bl_space_type = "IMAGE_EDITOR"
    settings, property_name = describe(RestoreSettings, MaskSettings), "farfield_restore"

    def draw_setting(self, layout: bpy.types.UILayout, context: bpy.types.Context, item: Description) -> None:
        """Draw one setting: a search field for an image, and the output folder for sequences only."""
        if item.name in IMAGES:
            layout.prop_search(context.scene.farfield_restore, item.name, bpy.data, "images", icon="IMAGE_DATA")
            if item.name == "mask_image":
                layout.operator(FARFIELD_OT_restore_mask.bl_idname, text="Create Mask", icon="ADD")
        elif item.name != "output_folder" or is_sequence(context):
            super().draw_setting(layout, context, item)


class FARFIELD_PT_restore(RestoreSettingsPanel, ToolPanel, bpy.types.Panel):
    """The mask, and the Restore button or the progress bar."""

    bl_idname = PANEL
    bl_label = "Restore Image"
    bl_description = "Fill the missing or unwanted parts of an image from the rest of it"
    page = "restore"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings of the mask. While a job runs they are disabled and the progress bar replaces the buttons."""
        layout, group, edited = self.layout, context.scene.farfield_restore, edited_image(context)
        self.draw_settings(context)
        if draw_progress_bar(layout, NO_IMAGE if edited is None else ""):
            return
        if edited is None:
            return
        image = find_target(edited, group)
        problem = find_problem(image, group)
        if problem:
            draw_message(layout, problem, "INFO")
        elif image != edited:
            draw_message(layout, f'Restores "{image.name}" again', "INFO")
        elif image != image_editors.shown_image(context):
            draw_message(layout, f'Restores "{image.name}", which this mask belongs to', "INFO")
        button = layout.column()
        button.enabled = not problem
        draw_button(button, FARFIELD_OT_restore_image, "Restore", "BRUSH_DATA")
        column = layout.column(align=True)
        column.operator(FARFIELD_OT_restore_outline.bl_idname, text="Outline", icon="OVERLAY", depress=not outline.is_hidden)
        if counterpart(context) is not None:
            column.operator(FARFIELD_OT_restore_compare.bl_idname, text="Before / After", icon="ARROW_LEFTRIGHT")
        variants, index = list_variants(context)
        if variants:
            row = layout.row(align=True)
            previous = row.row(align=True)
            previous.enabled = index > 0
            previous.operator(FARFIELD_OT_restore_variant.bl_idname, text="", icon="TRIA_LEFT").direction = "previous"
            label = f"Result {index + 2} of {len(variants)}" if index + 1 < len(variants) else "New Result"
            row.operator(FARFIELD_OT_restore_variant.bl_idname, text=label, icon="TRIA_RIGHT").direction = "next"


def is_sequence(context: bpy.types.Context) -> bool:
    """Return whether an image sequence is restored."""
    edited = edited_image(context)
    return edited is not None and find_target(edited, context.scene.farfield_restore).source == "SEQUENCE"


CLASSES = (FARFIELD_PT_restore, *sub_panels(RestoreSettingsPanel, PANEL))
register, unregister = bpy.utils.register_classes_factory(CLASSES)
