"""What all panels in the sidebar tab *Farfield* have in common."""

import bpy

from ..operators import long_work


class SidebarPanel:
    """Where the panels stand."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Farfield"


def settings_rows(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """A column for settings: names to the left, values to the right, grey while a job runs."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    rows = layout.column()
    rows.enabled = long_work.current() is None
    return rows


def draw_bar(layout: bpy.types.UILayout) -> bool:
    """The bar of the job under way, if there is one: per cent, what is being done, the time left, how to stop. Whether there is."""
    run = long_work.current()
    if run is None:
        return False
    column = layout.column(align=True)
    column.progress(factor=run.progress.fraction, type="BAR", text=f"{run.progress.fraction:.0%}")
    column.label(text="Stopping" if run.stopping else run.progress.label)
    left = run.seconds_left
    column.label(text="Esc stops" if left is None else f"{long_work.duration(left)} left, Esc stops", icon="TIME")
    return True


def draw_button(layout: bpy.types.UILayout, operator: type[bpy.types.Operator], text: str, icon: str) -> None:
    """The button that starts a panel's job."""
    row = layout.row()
    row.scale_y = 1.4
    row.operator(operator.bl_idname, text=text, icon=icon)


def draw_table(layout: bpy.types.UILayout, head: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Rows of words, the first to the left and the rest to the right, below their titles."""
    columns = layout.box().row()
    for place, title in enumerate(head):
        column = columns.column(align=True)
        column.alignment = "LEFT" if place == 0 else "RIGHT"
        column.label(text=title)
        for row in rows:
            column.label(text=row[place])


def megabytes(count: float) -> str:
    """Bytes as megabytes, with two significant digits below ten."""
    return f"{count / 1e6:.2g}" if count < 1e7 else f"{count / 1e6:,.0f}"
