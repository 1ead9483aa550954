"""Panel *Restore Image* in the sidebar tab *Farfield* of the Image Editor."""

import bpy

from ..bridge.restore.outline import outline
from ..core.restore.settings import MaskSettings, RestoreSettings
from ..core.settings import describe
from ..operators import image_editors
from ..operators.restore.operators import (
    NO_IMAGE,
    FARFIELD_OT_restore_compare,
    FARFIELD_OT_restore_image,
    FARFIELD_OT_restore_mask,
    FARFIELD_OT_restore_outline,
    counterpart,
    edited_image,
    find_problem,
    find_target,
)
from .sidebar import SidebarPanel, ToolPanel, draw_button, draw_message, draw_progress_bar, draw_setting, settings_column

MASK_SETTINGS = {item.name: item for item in describe(MaskSettings)}
RESTORE_SETTINGS = {item.name: item for item in describe(RestoreSettings)}
USED_BY_MASK = {"image": ("mask_image", "threshold"), "alpha": ("threshold",), "color": ("mask_color", "tolerance")}
OPTIONAL_IMAGES = ("source_mask", "barriers")
OF_PIXELS = {"levels", "order", "coherence"}  # shown for synthesis by pixels


class FARFIELD_PT_restore(ToolPanel, bpy.types.Panel):
    """The mask, and the Restore button or the progress bar."""

    bl_idname = "FARFIELD_PT_restore"
    bl_label = "Restore Image"
    bl_space_type = "IMAGE_EDITOR"
    page = "restore"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings of the mask. While a job runs they are disabled and the progress bar replaces the buttons."""
        layout, group, edited = self.layout, context.scene.farfield_restore, edited_image(context)
        image = None if edited is None else find_target(edited, group)
        column = settings_column(layout)
        draw_setting(column, group, MASK_SETTINGS["mask"])
        for name in USED_BY_MASK[group.mask]:
            if name == "mask_image":
                column.prop_search(group, name, bpy.data, "images", icon="IMAGE_DATA")
                column.operator(FARFIELD_OT_restore_mask.bl_idname, text="Create Mask", icon="ADD")
            else:
                draw_setting(column, group, MASK_SETTINGS[name])
        if image is not None and image.source == "SEQUENCE":
            draw_setting(column, group, MASK_SETTINGS["output_folder"])
        draw_setting(column, group, MASK_SETTINGS["replace"])
        if draw_progress_bar(layout):
            return
        if image is None:
            draw_message(layout, NO_IMAGE, "INFO")
            return
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


class SubPanel(SidebarPanel):
    """A closed sub-panel of settings."""

    bl_parent_id = "FARFIELD_PT_restore"
    bl_space_type = "IMAGE_EDITOR"
    bl_options = {"DEFAULT_CLOSED"}


class FARFIELD_PT_restore_texture(SubPanel, bpy.types.Panel):
    """How structure and texture are separated and synthesized."""

    bl_idname = "FARFIELD_PT_restore_texture"
    bl_label = "Structure and Texture"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings; those of texture are grayed out if there is none."""
        group = context.scene.farfield_restore
        column = settings_column(self.layout)
        for name, setting in RESTORE_SETTINGS.items():
            if (name != "kappa" or group.split == "manual") and (name not in OF_PIXELS or group.method == "pixels"):
                item = column.column()
                item.active = name in {"split", "tileable"} or group.split != "diffusion"
                draw_setting(item, group, setting)


class FARFIELD_PT_restore_guides(SubPanel, bpy.types.Panel):
    """Further masks, and what the image contains."""

    bl_idname = "FARFIELD_PT_restore_guides"
    bl_label = "Guides"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw search fields for the masks and the option for normal maps."""
        group = context.scene.farfield_restore
        column = settings_column(self.layout)
        for name in OPTIONAL_IMAGES:
            column.prop_search(group, name, bpy.data, "images", icon="IMAGE_DATA")
        draw_setting(column, group, MASK_SETTINGS["normal_map"])


CLASSES = (FARFIELD_PT_restore, FARFIELD_PT_restore_texture, FARFIELD_PT_restore_guides)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
