"""Operators that show levels for a while: the one that the viewport's distance calls for, and a flicker between neighboring levels."""

import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import bpy

from ...bridge.blender import redraw_areas
from ...bridge.texmesh.level_sets import LevelSet, find_level_set, level_sets_in
from ...bridge.texmesh.ring_overlay import overlay as rings
from ...bridge.texmesh.temporary_visibility import STATE, restore, resume_crossfades, show_temporarily
from ...bridge.viewers import viewport_camera
from ...core.geometry.cameras import Camera
from ...core.texmesh.settings import InspectionSettings
from .. import long_work, properties
from ..error_reports import reports_errors
from ..follow_handlers import add_handlers, remove_handlers
from ..view_following import context_viewport, find_viewport, is_job_running, is_transforming

TICK = 0.1  # seconds between two calls of the timer
NO_LEVELS = "Make levels first"


class LevelPreview:
    """Which levels all 3D Viewports show for a while. Operators, panels, handlers and the timer share one instance.

    follows_view: whether they are those that the distance of a 3D Viewport calls for. follows_all: whether also levels that do not
    cross-fade, because one of them or the original is shown at any distance. flickers: whether every other moment the next finer level
    shows. shown: the number of the level that shows, by the name of its collection.
    """

    def __init__(self) -> None:
        self.follows_view = self.follows_all = self.flickers = False
        self.shown: dict[str, int] = {}
        self._fixed: dict[str, int] = {}
        self._selections: dict[str, _Selection] = {}  # by the name of the collection
        self._area_address = 0
        self._flicker_seconds, self._started = 0.5, 0.0
        self._timer = self._tick  # Blender identifies timers by the object

    @property
    def is_running(self) -> bool:
        """Whether levels are shown for a while."""
        return self.follows_view or self.flickers

    def follows(self, levels: LevelSet) -> bool:
        """Whether the one of `levels` shows that the distance of a 3D Viewport calls for."""
        return self.follows_view and (self.follows_all or levels.has_crossfade)

    def follow_view(self, area: bpy.types.Area | None, follows_all: bool = True) -> None:
        """Show the levels that the distance of the 3D Viewport `area` calls for, and the switch rings."""
        self._area_address = 0 if area is None else area.as_pointer()
        self.follows_all = follows_all or (self.follows_view and self.follows_all)
        self.follows_view = True
        rings.show()
        self._start()

    def flicker(self, area: bpy.types.Area | None, seconds: float, scene: bpy.types.Scene) -> None:
        """Alternate between the levels that show and the next finer ones."""
        if not self.follows_view:
            self._area_address = 0 if area is None else area.as_pointer()
        visible = {levels.collection.name: _visible_level(levels) for levels in level_sets_in(scene)}
        self._fixed = {name: number for name, number in visible.items() if number is not None}
        self.flickers, self._flicker_seconds, self._started = True, seconds, time.monotonic()
        self._start()

    def stop(self, follows_view: bool = False, flickers: bool = False) -> None:
        """Show the objects as before the preview, unless one of the two continues."""
        self.follows_view, self.flickers = self.follows_view and follows_view, self.flickers and flickers
        if not self.follows_view:
            rings.hide()
        if not self.is_running:
            if bpy.app.timers.is_registered(self._timer):
                bpy.app.timers.unregister(self._timer)
            self.suspend()
        redraw_areas("VIEW_3D")

    def suspend(self) -> None:
        """Show and select the objects as before the preview, until the next tick."""
        self.show_again()
        selections, self._selections = self._selections, {}
        _reselect(selections.values())

    def show_again(self) -> None:
        """Show the objects as before the preview, and let the next tick show the levels again."""
        self.shown.clear()
        restore(bpy.data.objects)

    def update(self, camera: Camera, scene: bpy.types.Scene, now: float) -> None:
        """Show the levels of `scene` for a view at a time in seconds."""
        is_finer = self.flickers and int((now - self._started) / self._flicker_seconds) % 2 == 1
        shown = {}
        for levels in level_sets_in(scene):
            name, follows = levels.collection.name, self.follows(levels)
            if not levels.is_editable:
                continue
            if not follows and not self.flickers:
                self._leave(levels)
                continue
            fixed = None if follows else self._fixed.get(name)
            number = levels.choose_level(camera) if fixed is None else min(fixed, len(levels.levels) - 1)
            shown[name] = max(number - is_finer, 0)
            level = levels.levels[shown[name]]
            if shown[name] == self.shown.get(name) and STATE in level:
                continue
            selected = _find_selected([*levels.levels, levels.source])
            show_temporarily(levels.levels, shown[name], levels.source if self.follows_all or not follows else None)
            if selected:  # what is hidden is neither selected nor active any more
                _select(level, any(selected.values()))
                self._selections.setdefault(name, _Selection(selected)).instead.add(level.session_uid)
        if shown != self.shown:
            self.shown = shown
            redraw_areas("VIEW_3D")

    def _leave(self, levels: LevelSet) -> None:
        """Show `levels`, which do not follow the view any more, as before the preview."""
        selection = self._selections.pop(levels.collection.name, None)
        if restore([*levels.levels, levels.source]) and selection is not None:
            _reselect([selection])

    def _start(self) -> None:
        if not bpy.app.timers.is_registered(self._timer):
            bpy.app.timers.register(self._timer, first_interval=0.0)
        redraw_areas("VIEW_3D")

    def _tick(self) -> float | None:
        continues = False
        try:
            continues = self._advance()
        finally:
            if not continues:
                self.stop()
        return TICK if continues else None

    def _advance(self) -> bool:
        """Show the levels for the current view; return whether to continue."""
        if is_job_running():
            self.suspend()  # a job creates levels or reads what is visible
            return True
        if is_transforming():
            return True
        scene, area = find_viewport(self._area_address)
        if area is not None:
            window_region = [region for region in area.regions if region.type == "WINDOW"][-1]  # The last of four is that of region_3d.
            self.update(viewport_camera(area.spaces.active.region_3d, window_region.width), scene, time.monotonic())
        return True


@dataclass
class _Selection:
    """The selection among the levels of an object and the object itself.

    before: session UIDs of those that were selected, and whether they were active. instead: of the levels that have been selected instead.
    """

    before: dict[int, bool]
    instead: set[int] = field(default_factory=set)


def start_for_crossfades(area_address: int) -> None:
    """Let levels that cross-fade follow the 3D Viewport at this address: its Solid view, without materials, would show all at once."""
    current.follow_view(find_viewport(area_address)[1], follows_all=False)


current = LevelPreview()


class FARFIELD_OT_texmesh_preview(bpy.types.Operator):
    """Show the levels that the distance of this 3D Viewport calls for, and the distances at which they switch"""

    bl_idname = "farfield.texmesh_preview"
    bl_label = "Preview Perceptual Levels"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the scene has levels."""
        return current.follows_view or long_work.poll_with_reason(cls, "" if level_sets_in(context.scene) else NO_LEVELS)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start or end the preview. Nothing of it is an undo step."""
        if is_followed(context):
            current.stop(flickers=True)
        else:
            current.follow_view(context_viewport(context))
        return {"FINISHED"}


class FARFIELD_OT_texmesh_flicker(bpy.types.Operator):
    """Alternate between the level that is shown and the next finer one. Press again, or Esc, to end"""

    bl_idname = "farfield.texmesh_flicker"
    bl_label = "Flicker Between Perceptual Levels"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the scene has levels."""
        return current.flickers or long_work.poll_with_reason(cls, "" if level_sets_in(context.scene) else NO_LEVELS)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start or end the flicker. Nothing of it is an undo step."""
        if current.flickers:
            current.stop(follows_view=True)
        else:
            settings = properties.read(InspectionSettings, context.scene.farfield_texmesh_inspection)
            current.flicker(context_viewport(context), settings.flicker_time, context.scene)
        return {"FINISHED"}

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start or end the flicker, and wait for Esc."""
        self.execute(context)
        if not current.flickers or context.window is None:
            return {"FINISHED"}
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    @reports_errors
    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """End with Esc; all other events have their usual meaning."""
        if not current.flickers:
            return {"FINISHED", "PASS_THROUGH"}
        if event.type == "ESC" and event.value == "PRESS":
            current.stop(follows_view=True)
            return {"FINISHED"}
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context) -> None:
        """End the flicker: the window is closed or Blender quits."""
        current.stop(follows_view=True)


def is_followed(context: bpy.types.Context) -> bool:
    """Return whether the levels of the active object follow a 3D Viewport, or any if it has none."""
    levels = find_level_set(context.scene, context.active_object)
    return current.follows_view if levels is None else current.follows(levels)


def selected_number(context: bpy.types.Context) -> int | None:
    """Return the number of the level of the active object that the preview shows, None if it does not."""
    levels = find_level_set(context.scene, context.active_object) if current.is_running else None
    return None if levels is None else current.shown.get(levels.collection.name)


def _visible_level(levels: LevelSet) -> int | None:
    """Return the number of the only level that is visible, None if several or none are."""
    visible = [number for number, item in enumerate(levels.levels) if not item.hide_viewport]
    return visible[0] if len(visible) == 1 else None


def _find_selected(items: Sequence[bpy.types.Object | None]) -> dict[int, bool]:
    """Return the session UIDs of those that are selected or active in the view layer, and whether they are active."""
    objects = bpy.context.view_layer.objects
    present = [item for item in items if item is not None and item.name in objects]
    return {item.session_uid: item == objects.active for item in present if item == objects.active or item.select_get()}


def _reselect(selections: Collection[_Selection]) -> None:
    """Select the same objects as before, where those selected instead still are: the user may have selected others meanwhile."""
    present = bpy.context.view_layer.objects
    objects = {item.session_uid: item for item in bpy.data.objects if item.name in present} if selections else {}
    for selection in selections:
        now = _find_selected([objects[uid] for uid in objects.keys() & selection.instead])
        before = [uid for uid in selection.before if uid in objects]
        for uid in now.keys() - selection.before.keys():
            objects[uid].select_set(False)
        for uid in sorted(before, key=selection.before.__getitem__) if now else ():  # the active one last
            _select(objects[uid], any(now.values()))


def _select(item: bpy.types.Object, is_active: bool) -> None:
    """Select an object of the view layer if it is visible, and let it be active."""
    view_layer = bpy.context.view_layer
    view_layer.update()
    if item.name in view_layer.objects and item.visible_get():
        item.select_set(True)
        if is_active:
            view_layer.objects.active = item


@bpy.app.handlers.persistent
def _before_load(*_: Any) -> None:
    current.stop()


@bpy.app.handlers.persistent
def _before_save(*_: Any) -> None:
    """A saved file holds the state before the preview; the next tick goes on."""
    current.suspend()


@bpy.app.handlers.persistent
def _before_render(*_: Any) -> None:
    resume_crossfades(bpy.data.objects)


@bpy.app.handlers.persistent
def _after_change(*_: Any) -> None:
    """An undo step or a file may hold a state that was shown for a while, at another distance."""
    current.show_again()


HANDLERS: tuple[tuple[str, Any], ...] = (
    ("load_pre", _before_load),
    ("save_pre", _before_save),
    ("render_init", _before_render),
    ("undo_post", _after_change),
    ("redo_post", _after_change),
    ("load_post", _after_change),
)
register_classes, unregister_classes = bpy.utils.register_classes_factory((FARFIELD_OT_texmesh_preview, FARFIELD_OT_texmesh_flicker))


def register() -> None:
    """Register the operators and the handlers."""
    register_classes()
    add_handlers(HANDLERS)


def unregister() -> None:
    """End the preview, and unregister the handlers and the operators."""
    current.stop()
    remove_handlers(HANDLERS)
    unregister_classes()
