"""Layout shared by all panels in the sidebar tab *Farfield*."""

import textwrap
from collections.abc import Sequence
from typing import ClassVar

import bpy

from ..bridge.terrain_roots import TerrainRoot
from ..core.settings import Description, is_used
from ..operators import documentation, follow_handlers, following, job_run, long_work, view_following
from .presets import menu_name

RED, YELLOW, GREEN, BLUE, WHITE = (*(f"COLLECTION_COLOR_0{number}" for number in (1, 3, 4, 5)), "OUTLINER_COLLECTION")  # For legends.
MESSAGE_WIDTH = 36  # characters per line at the default width of the sidebar


class SidebarPanel:
    """Mixin of the panels: the sidebar tab that contains them."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Farfield"


class ToolPanel(SidebarPanel):
    """Mixin of the top-level panel of a tool: buttons in its header open the presets and the page of the tool in the documentation.

    page: name of the page, the identifier of the tool. has_presets: whether the panel shows settings of which there are presets.
    """

    page, has_presets = "", True

    def draw_header_preset(self, _context: bpy.types.Context) -> None:
        """Draw the buttons."""
        row = self.layout.row(align=True)
        row.emboss = "NONE"
        if self.has_presets:
            row.popover(menu_name(self.page), text="", icon="PRESET")
        row.operator("wm.url_open", text="", icon="HELP").url = documentation.find_page(self.page)


class TerrainPanel(ToolPanel):
    """Mixin of the top-level panel of a tool whose terrains follow the view.

    terrain_type: of its terrains. start_button: operator, text and icon of the button that adds a terrain to the scene.
    """

    terrain_type: type[TerrainRoot]
    start_button: tuple[type[bpy.types.Operator], str, str]

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the buttons. While a job runs, the progress bar replaces them."""
        layout, tool = self.layout, self.terrain_type.tool
        if draw_progress_bar(layout, following.disabled_reason(context)):
            return
        if view_following.current.error:
            draw_message(layout, view_following.current.error, "ERROR")
        draw_button(layout, *self.start_button)
        terrain, is_following = self.terrain_type.of_object(context.active_object), view_following.current.terrain is not None
        if terrain is None and not is_following:
            return
        if terrain is not None and terrain.read_only_reason:
            draw_message(layout, terrain.read_only_reason, "INFO")
        column = layout.column(align=True)
        column.operator(f"farfield.{tool}_update", text="Update", icon="FILE_REFRESH")
        text, icon = ("Stop Following", "CANCEL") if is_following else ("Follow View", "VIEW_PERSPECTIVE")
        column.operator(f"farfield.{tool}_follow_view", text=text, icon=icon, depress=is_following)
        if terrain is not None:
            column.prop(terrain.root, follow_handlers.camera_property(tool))
            row = layout.row(align=True)
            row.operator("farfield.add_sky", text="Sky and Haze", icon="LIGHT_SUN")
            row.operator_menu_enum("farfield.add_sky", "light", text="", icon="DOWNARROW_HLT")
            layout.operator_menu_enum("farfield.scatter_add", "kind", text="Plants and Rocks", icon="OUTLINER_OB_POINTCLOUD")
            self.draw_terrain(terrain)

    def draw_terrain(self, terrain: TerrainRoot) -> None:
        """Draw what else can be done with the active terrain."""


class SettingsPanel(SidebarPanel):
    """Mixin of a panel with the settings of one group, of which it shows those that count.

    Attributes:
        settings: all settings of the tool.
        property_name: the property of the scene that holds them.
        group_name: of the settings to draw.
        buttons: operator, text and icon of each large button below them.
    """

    settings: Sequence[Description] = ()
    property_name = ""
    group_name = ""
    buttons: ClassVar[Sequence[tuple[type[bpy.types.Operator], str, str]]] = ()

    @classmethod
    def shown_settings(cls, context: bpy.types.Context) -> list[Description]:
        """Return the settings of the group that count."""
        group = getattr(context.scene, cls.property_name)
        return [item for item in cls.settings if item.group == cls.group_name and is_used(item, group)]

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings and the buttons."""
        self.draw_settings(context)
        for button in self.buttons:
            draw_button(self.layout, *button)

    def draw_settings(self, context: bpy.types.Context) -> None:
        """Draw the settings of the group that count."""
        column = settings_column(self.layout)
        for item in self.shown_settings(context):
            self.draw_setting(column, context, item)

    def draw_setting(self, layout: bpy.types.UILayout, context: bpy.types.Context, item: Description) -> None:
        """Draw one setting with its panel label."""
        layout.prop(getattr(context.scene, self.property_name), item.name, text=item.panel_label)


def sub_panels(mixin: type[SettingsPanel], parent: str, open_groups: Sequence[str] = ()) -> tuple[type[bpy.types.Panel], ...]:
    """Return a sub-panel for each group of the settings of `mixin`, named after it, below the panel with the identifier `parent`.

    They are closed except for `open_groups`, and hidden where no setting counts.
    """

    @classmethod
    def poll(cls: type[SettingsPanel], context: bpy.types.Context) -> bool:
        return bool(cls.shown_settings(context))

    classes = []
    for group in dict.fromkeys(item.group for item in mixin.settings if item.group):
        name = f"{parent}_{group.lower().replace(' ', '_')}"
        members = {"__doc__": f"The settings of the group *{group}*.", "__module__": mixin.__module__, "poll": poll}
        members |= {"bl_idname": name, "bl_label": group, "bl_parent_id": parent, "group_name": group}
        members["bl_options"] = set() if group in open_groups else {"DEFAULT_CLOSED"}
        classes.append(type(name, (mixin, bpy.types.Panel), members))
    return tuple(classes)


def settings_column(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """Return a column for settings: labels on the left, values on the right, disabled while a job runs."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    column = layout.column()
    column.enabled = long_work.current_run() is None
    return column


def draw_message(layout: bpy.types.UILayout, message: str, icon: str, width: int = MESSAGE_WIDTH) -> None:
    """Draw a message with its icon, in as many lines as a sidebar of the default width needs, or lines of `width` characters."""
    column = layout.column(align=True)
    for index, line in enumerate(textwrap.wrap(message, width)):
        column.label(text=line, icon="BLANK1" if index else icon)


def draw_progress_bar(layout: bpy.types.UILayout, disabled_reason: str = "") -> bool:
    """Draw the progress of the running job - percentage, label, time left, how to cancel - and return whether there is one.

    If there is none, draw why the tool cannot start one, if it is given.

    There is no Cancel button in the half of the job that uses the scene: only its modal operator receives events then, and Esc cancels.
    """
    run = long_work.current_run()
    if run is None:
        if disabled_reason:
            draw_message(layout, disabled_reason, "INFO")
        return False
    column = layout.column(align=True)
    row = column.row(align=True)
    row.progress(factor=run.progress.fraction, type="BAR", text=f"{run.progress.fraction:.0%}")
    if not run.uses_scene and not run.cancel_requested:
        row.operator(long_work.FARFIELD_OT_cancel_job.bl_idname, text="", icon="X")
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


def draw_legend(layout: bpy.types.UILayout, rows: Sequence[tuple[str, str]]) -> None:
    """Draw what the colors of an overlay mean: an icon with each color, and its meaning."""
    column = layout.box().column(align=True)
    for icon, meaning in rows:
        column.label(text=meaning, icon=icon)


def format_megabytes(count: float) -> str:
    """Return a number of bytes in megabytes, with two significant digits below ten."""
    return f"{count / 1e6:.2g}" if count < 1e7 else f"{count / 1e6:,.0f}"
