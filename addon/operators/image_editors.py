"""Image Editors: the image in one, and showing another one there."""

import bpy

NO_EDITOR = 0


def shown_image(context: bpy.types.Context) -> bpy.types.Image | None:
    """Return the image of the Image Editor that `context` belongs to, None if there is no editor or no image."""
    return context.space_data.image if is_image_editor(context) else None


def is_image_editor(context: bpy.types.Context) -> bool:
    """Return whether `context` belongs to an Image Editor."""
    return context.space_data is not None and context.space_data.type == "IMAGE_EDITOR"


def remember_editor(context: bpy.types.Context) -> int:
    """Return a number that stands for the Image Editor of `context` as long as it exists, NO_EDITOR if there is none."""
    return context.area.as_pointer() if is_image_editor(context) and context.area is not None else NO_EDITOR


def show_image(editor: int, image: bpy.types.Image, mode: str = "VIEW") -> None:
    """Show `image` in a remembered editor in View or Paint mode; do nothing if the editor was closed."""
    if editor == NO_EDITOR:
        return
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.as_pointer() == editor and area.type == "IMAGE_EDITOR":
                if mode == "PAINT":
                    area.ui_type = "IMAGE_EDITOR"  # images cannot be painted in a UV Editor
                space = area.spaces.active
                space.image = image
                if area.ui_type == "IMAGE_EDITOR":
                    space.ui_mode = mode
                if image.source == "SEQUENCE":
                    _set_frames(space.image_user, image)
                area.tag_redraw()


def _set_frames(user: bpy.types.ImageUser, image: bpy.types.Image) -> None:
    """Follow the frame of the scene, if the editor did not show a sequence before."""
    user.frame_duration = max(user.frame_duration, image.frame_duration)
    user.use_auto_refresh = True
