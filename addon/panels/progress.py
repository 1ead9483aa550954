"""The bar of a job under way, drawn alike on every panel."""

import bpy

from ..operators import long_work


def draw_progress(layout: bpy.types.UILayout, run: long_work.Run) -> None:
    """Bar with per cent, what is being done, the time left, and how to stop."""
    column = layout.column(align=True)
    column.progress(factor=run.progress.fraction, type="BAR", text=f"{run.progress.fraction:.0%}")
    column.label(text="Stopping" if run.stopping else run.progress.label)
    left = run.seconds_left
    column.label(text="Esc stops" if left is None else f"{long_work.duration(left)} left, Esc stops", icon="TIME")
