"""Layout shared by all panels in the sidebar tab *Farfield*."""

import textwrap
from collections.abc import Sequence

import bpy

from ..core.settings import Description
from ..operators import documentation, job_run, long_work

MESSAGE_WIDTH = 36  # characters per line at the default width of the sidebar


class SidebarPanel:
    """Mixin of the panels: the sidebar tab that contains them."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Farfield"


class ToolPanel(SidebarPanel):
    """Mixin of the top-level panel of a tool: a button in its header opens the page of the tool in the documentation.

    page: name of the page, the identifier of the tool.
    """

    page = ""

    def draw_header_preset(self, _context: bpy.types.Context) -> None:
        """Draw the help button."""
        self.layout.operator("wm.url_open", text="", icon="HELP", emboss=False).url = documentation.find_page(self.page)


class SettingsSubPanel(SidebarPanel):
    """Mixin of a panel with the settings of one group.

    settings: all settings of the tool. property_name: the property of the scene that holds them. group_name: of the settings to draw, by
    default the label of the panel.
    """

    settings: Sequence[Description] = ()
    property_name = ""
    group_name: str | None = None

    @staticmethod
    def is_used(_name: str, _group: bpy.types.PropertyGroup) -> bool:
        """Return whether the setting of that name belongs to what the other settings choose; others are not drawn."""
        return True

    @staticmethod
    def is_active(_name: str, _group: bpy.types.PropertyGroup) -> bool:
        """Return whether the setting of that name has an effect with the other settings; others are grayed out."""
        return True

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings."""
        self.draw_settings(context)

    def draw_settings(self, context: bpy.types.Context) -> None:
        """Draw the settings of the group that are used."""
        group = getattr(context.scene, self.property_name)
        group_name = self.bl_label if self.group_name is None else self.group_name
        column = settings_column(self.layout)
        for setting in self.settings:
            if setting.group == group_name and self.is_used(setting.name, group):
                item = column.column()
                item.active = self.is_active(setting.name, group)
                draw_setting(item, group, setting)


def settings_column(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """Return a column for settings: labels on the left, values on the right, disabled while a job runs."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    column = layout.column()
    column.enabled = long_work.current_run() is None
    return column


def draw_setting(layout: bpy.types.UILayout, group: bpy.types.PropertyGroup, setting: Description) -> None:
    """Draw one setting of the property group `group` with its panel label."""
    layout.prop(group, setting.name, text=setting.panel_label)


def draw_message(layout: bpy.types.UILayout, message: str, icon: str) -> None:
    """Draw a message with its icon, in as many lines as a sidebar of the default width needs."""
    column = layout.column(align=True)
    for index, line in enumerate(textwrap.wrap(message, MESSAGE_WIDTH)):
        column.label(text=line, icon="BLANK1" if index else icon)


def draw_progress_bar(layout: bpy.types.UILayout) -> bool:
    """Draw the progress of the running job - percentage, label, time left, how to cancel - and return whether there is one.

    The Cancel button is disabled in the half of the job that uses the scene: only its modal operator receives events then, and Esc cancels.
    """
    run = long_work.current_run()
    if run is None:
        return False
    column = layout.column(align=True)
    row = column.row(align=True)
    row.progress(factor=run.progress.fraction, type="BAR", text=f"{run.progress.fraction:.0%}")
    button = row.row(align=True)
    button.enabled = not run.uses_scene and not run.cancel_requested
    button.operator(long_work.FARFIELD_OT_cancel_job.bl_idname, text="", icon="X")
    column.label(text="Cancelling" if run.cancel_requested else run.progress.label)
    seconds = run.seconds_left
    column.label(text="Esc to cancel" if seconds is None else f"{job_run.format_duration(seconds)} left, Esc to cancel", icon="TIME")
    return True


def draw_button(layout: bpy.types.UILayout, operator: type[bpy.types.Operator], text: str, icon: str) -> None:
    """Draw the large button that starts a panel's job."""
    row = layout.row()
    row.scale_y = 1.4
    row.operator(operator.bl_idname, text=text, icon=icon)


def draw_table(layout: bpy.types.UILayout, titles: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Draw a table below its `titles`: the first column left-aligned, the others right-aligned."""
    columns = layout.box().row()
    for index, title in enumerate(titles):
        column = columns.column(align=True)
        column.alignment = "LEFT" if index == 0 else "RIGHT"
        column.label(text=title)
        for row in rows:
            column.label(text=row[index])


def format_megabytes(count: float) -> str:
    """Return a number of bytes in megabytes, with two significant digits below ten."""
    return f"{count / 1e6:.2g}" if count < 1e7 else f"{count / 1e6:,.0f}"
