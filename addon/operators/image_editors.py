"""Image Editors: the image in one, showing another one there, and showing the right one after undo and redo.

Undo and redo leave editors as they are. One that shows an image which an undo step does not have would become empty.
"""

from typing import Any, NamedTuple

import bpy

from .follow_handlers import add_handlers, remove_handlers

NO_EDITOR = 0
NO_IMAGE = 0  # Session UIDs of images are larger.


class _Shown(NamedTuple):
    """What an Image Editor shows: the session UID of the image or NO_IMAGE, and the mode other than that of UV Editors."""

    uid: int
    mode: str


_EditorKey = tuple[str, int]  # the name of the screen, and the index of the area in it


class _UndoState:
    """What is known until another file is opened.

    Attributes:
        formers: what editors showed before they showed an image that Farfield created, by its session UID.
        shown: what the editors showed before the current undo or redo.
        existing: session UIDs of the images before it.
        undone: what an editor showed before undo, by the editor and by the session UID that it showed afterwards.
    """

    def __init__(self) -> None:
        self.formers: dict[int, _Shown] = {}
        self.shown: dict[_EditorKey, _Shown] = {}
        self.existing: set[int] = set()
        self.undone: dict[tuple[_EditorKey, int], _Shown] = {}

    def clear(self) -> None:
        """Forget all."""
        for each in (self.formers, self.shown, self.existing, self.undone):
            each.clear()


_state = _UndoState()


def shown_image(context: bpy.types.Context) -> bpy.types.Image | None:
    """Return the image of the Image Editor that `context` belongs to, None if there is no editor or no image."""
    return context.space_data.image if is_image_editor(context) else None


def is_image_editor(context: bpy.types.Context) -> bool:
    """Return whether `context` belongs to an Image Editor."""
    return context.space_data is not None and context.space_data.type == "IMAGE_EDITOR"


def find_zoom(area: bpy.types.Area, image: bpy.types.Image) -> float:
    """Return how many pixels on screen are a pixel of `image` in an Image Editor."""
    view = next(region for region in area.regions if region.type == "WINDOW").view2d
    (left, _), (right, _) = (view.view_to_region(u, 0.0, clip=False) for u in (0.0, 1.0))
    return abs(right - left) / max(image.size[0], 1)


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
                former = _read_editor(area.spaces.active)
                if former.uid < image.session_uid:  # Otherwise an earlier image is shown again, which undo would not remove first.
                    _state.formers[image.session_uid] = former
                if mode == "PAINT":
                    area.ui_type = "IMAGE_EDITOR"  # images cannot be painted in a UV Editor
                _show_in_editor(area.spaces.active, image, mode)
                area.tag_redraw()


def remember_former(image: bpy.types.Image, former: bpy.types.Image | None) -> None:
    """Let editors show `former`, or nothing, when undo removes the new `image` from them."""
    _state.formers[image.session_uid] = _Shown(NO_IMAGE if former is None else former.session_uid, "VIEW")


def _show_in_editor(space: bpy.types.SpaceImageEditor, image: bpy.types.Image, mode: str) -> None:
    """Show `image`; UV Editors keep their mode."""
    space.image = image
    if space.mode != "UV":
        space.ui_mode = mode
    if image.source == "SEQUENCE":
        _set_frames(space.image_user, image)


def _set_frames(user: bpy.types.ImageUser, image: bpy.types.Image) -> None:
    """Follow the frame of the scene, if the editor did not show a sequence before."""
    user.frame_duration = max(user.frame_duration, image.frame_duration)
    user.use_auto_refresh = True


def _read_editor(space: bpy.types.SpaceImageEditor) -> _Shown:
    return _Shown(NO_IMAGE if space.image is None else space.image.session_uid, "VIEW" if space.mode == "UV" else space.ui_mode)


def _all_editors() -> dict[_EditorKey, bpy.types.SpaceImageEditor]:
    """Return the Image Editors of all workspaces, also those of areas that have become other editors."""
    return {
        (screen.name, index): space
        for screen in bpy.data.screens
        for index, area in enumerate(screen.areas)
        for space in area.spaces
        if space.type == "IMAGE_EDITOR"
    }


@bpy.app.handlers.persistent
def _before_step(*_: Any) -> None:
    _state.shown = {key: _read_editor(space) for key, space in _all_editors().items()}
    _state.existing = {image.session_uid for image in bpy.data.images}


@bpy.app.handlers.persistent
def _after_undo(*_: Any) -> None:
    """Let editors whose image was removed show what they showed before it."""
    images = {image.session_uid: image for image in bpy.data.images}
    for key, space in _all_editors().items():
        former = shown = _state.shown.get(key)
        if shown is None or space.image is not None:
            continue
        while former.uid in _state.formers and former.uid not in images:
            former = _state.formers[former.uid]
        if former != shown:
            if former.uid in images:
                _show_in_editor(space, images[former.uid], former.mode)
            _state.undone[key, _read_editor(space).uid] = shown


@bpy.app.handlers.persistent
def _after_redo(*_: Any) -> None:
    """Let editors show the images again that undo had removed from them, unless they show others by now."""
    images = {image.session_uid: image for image in bpy.data.images}
    for key, space in _all_editors().items():
        again = _state.shown.get(key)
        while again is not None:
            again = _state.undone.get((key, again.uid))
            if again is None or again.uid not in images or again.uid in _state.existing:
                break
            _show_in_editor(space, images[again.uid], again.mode)


@bpy.app.handlers.persistent
def _before_load(*_: Any) -> None:
    """Another file has no undo steps of this one."""
    _state.clear()


HANDLERS: tuple[tuple[str, Any], ...] = (
    ("undo_pre", _before_step),
    ("redo_pre", _before_step),
    ("undo_post", _after_undo),
    ("redo_post", _after_redo),
    ("load_pre", _before_load),
)


def register() -> None:
    """Register the handlers."""
    add_handlers(HANDLERS)


def unregister() -> None:
    """Unregister the handlers, and forget what editors showed."""
    remove_handlers(HANDLERS)
    _before_load()
