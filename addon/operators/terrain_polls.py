"""When operators of terrains that follow a viewer can be used."""

import bpy

from . import following, long_work


def disabled_reason(context: bpy.types.Context) -> str:
    """Return why no terrain can be created or changed now, or an empty string."""
    if context.mode != "OBJECT":
        return "Switch to Object Mode"
    if not context.scene.is_editable:
        return "The scene is linked from another file"
    is_following = bool(following.running())
    return long_work.running_job_message() or ("A terrain is following the view; press Stop Following first" if is_following else "")
