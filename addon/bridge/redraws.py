"""Redrawing of editors after something has changed that Blender does not know of."""

import bpy


def redraw_areas(*types: str) -> None:
    """Redraw all areas of some types in all windows, such as "VIEW_3D"; all areas if none is given."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if not types or area.type in types:
                area.tag_redraw()
