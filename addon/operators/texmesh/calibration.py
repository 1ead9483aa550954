"""Operators of the paper's experiment: which differences between levels a judge notices, and the threshold that follows."""

import time
from dataclasses import dataclass
from typing import Any

import bpy

from ...bridge.texmesh.level_sets import find_level_set
from ...bridge.texmesh.trial_objects import remove_trial_objects
from ...bridge.viewers import viewport_camera
from ...core.errors import GeometryError, SettingsError
from ...core.messages import format_count
from ...core.texmesh.perception.answer_settings import estimate_settings
from .. import long_work
from ..error_reports import report_message, reports_errors
from ..follow_handlers import add_handlers, remove_handlers
from .calibration_run import ANSWERS, CalibrationRun, clear_answers, stored_answers
from .preview import NO_LEVELS
from .preview import current as preview

TICK = 1.0 / 30.0  # seconds
HELP = "Do both look the same? Wheel or Up/Down: Move Nearer/Farther until You See a Difference, Enter: Accept, Esc: End"
NEARER, FARTHER = {"WHEELUPMOUSE", "UP_ARROW", "NUMPAD_PLUS"}, {"WHEELDOWNMOUSE", "DOWN_ARROW", "NUMPAD_MINUS"}

_run: CalibrationRun | None = None  # handlers of Blender end the one that runs


@dataclass(frozen=True)
class _ViewportState:
    """What the calibration changes in a 3D Viewport.

    Attributes:
        has_overlays, has_gizmos: whether they are shown.
        shading: of the 3D Viewport.
        color: how objects are colored.
        perspective: of the region.
    """

    has_overlays: bool
    has_gizmos: bool
    shading: str
    color: str
    perspective: str

    @classmethod
    def prepare(cls, space: bpy.types.SpaceView3D) -> "_ViewportState":
        """Show textures and nothing but objects, in perspective and not through a camera; return what was shown before."""
        region, shading = space.region_3d, space.shading
        state = cls(space.overlay.show_overlays, space.show_gizmo, shading.type, shading.color_type, region.view_perspective)
        space.overlay.show_overlays = space.show_gizmo = False
        if state.shading in ("WIREFRAME", "SOLID"):
            space.shading.type = "SOLID"
            space.shading.color_type = "TEXTURE"
        if state.perspective != "PERSP":  # an orthographic view has no distances, a camera may have other shifts and borders
            region.view_perspective = "PERSP"
            region.update()  # the matrices, which would change with the next redraw only
        return state

    def restore(self, space: bpy.types.SpaceView3D) -> None:
        """Show what was shown before."""
        space.overlay.show_overlays, space.show_gizmo = self.has_overlays, self.has_gizmos
        if self.shading in ("WIREFRAME", "SOLID"):
            space.shading.type = "SOLID"
            space.shading.color_type = self.color
            space.shading.type = self.shading
        if space.region_3d.view_perspective != self.perspective:
            space.region_3d.view_perspective = self.perspective


class FARFIELD_OT_texmesh_calibrate(bpy.types.Operator):
    """Judge when levels look like the original, in this 3D Viewport: the original turns at the left, a level at the right"""

    bl_idname = "farfield.texmesh_calibrate"
    bl_label = "Calibrate Perceptual Threshold"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the active object has levels."""
        levels = find_level_set(context.scene, context.active_object)
        reason = long_work.running_job_message() or ("" if levels is not None else NO_LEVELS)
        if not reason and _run is not None:
            reason = "The calibration is running"
        if not reason and not context.scene.is_editable:
            reason = "The scene is linked from a library"
        return long_work.poll_with_reason(cls, reason)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Refuse: there is nobody to judge without a window.

        Raises:
            SettingsError: always.
        """
        raise SettingsError("The calibration needs a judge; press its button in a 3D Viewport.")

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Create the temporary objects and wait for answers."""
        global _run
        if context.window is None or context.area is None or context.area.type != "VIEW_3D":
            return self.execute(context)
        self._followed_view, self._followed_all = preview.follows_view, preview.follows_all
        preview.stop()
        if context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        levels = find_level_set(context.scene, context.active_object)
        _run = self._run = CalibrationRun(context.scene, levels, context.scene.farfield_texmesh.pixels_per_degree)
        self._area_address, self._started = context.area.as_pointer(), time.monotonic()
        self._viewport = _ViewportState.prepare(context.space_data)
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(HELP)
        return {"RUNNING_MODAL"}

    @reports_errors
    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Turn the objects, move them, or record an answer. Other events are ignored, so that the view stays."""
        continues = False
        try:
            result = self._handle(event)
            continues = result == {"RUNNING_MODAL"}
            return result
        finally:
            if not continues:
                self.cancel(context)

    def _handle(self, event: bpy.types.Event) -> set[str]:
        if _run is not self._run:  # undo, saving, or another file
            return {"CANCELLED"}
        result = handle_event(self._run, event.type, event.value)
        if result == {"RUNNING_MODAL"} and event.type == "TIMER":
            area = find_area(self._area_address)
            if area is None:
                raise GeometryError("The 3D Viewport of the calibration was closed; start it again.")
            space = area.spaces.active
            region = [region for region in area.regions if region.type == "WINDOW"][-1]
            camera, size = viewport_camera(space.region_3d, region.width), (region.width, region.height)
            view = space.region_3d.view_matrix.inverted()
            self._run.place(view, camera, size, space.clip_start, time.monotonic() - self._started)
            area.header_text_set(f"{HELP} ({format_count(len(self._run.answers), 'answer')})")
        elif result != {"RUNNING_MODAL"}:
            report_message(self, f"Recorded {format_count(len(self._run.answers), 'answer')}.")
        return result

    def cancel(self, context: bpy.types.Context) -> None:
        """Remove everything temporary: the calibration has ended, the window is closed or Blender quits."""
        ended_by_user = _run is self._run
        end_calibration()
        context.window_manager.event_timer_remove(self._timer)
        area = find_area(self._area_address)
        if area is not None:
            self._viewport.restore(area.spaces.active)
            area.header_text_set(None)
            area.tag_redraw()
        if ended_by_user and self._followed_view:
            preview.follow_view(area, self._followed_all)
        context.workspace.status_text_set(None)


class FARFIELD_OT_texmesh_use_threshold(bpy.types.Operator):
    """Take what was estimated from the answers as the settings *Weber Threshold* and *Distance Factor*"""

    bl_idname = "farfield.texmesh_use_threshold"
    bl_label = "Use Answers of Calibration"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether there are answers."""
        reason = "" if context.scene.get(ANSWERS) else "Calibrate first"
        return long_work.poll_with_reason(cls, reason or ("" if context.scene.is_editable else "The scene is linked from a library"))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Set the threshold and the factor of distances, within the limits of the settings."""
        values, message = estimate_settings(stored_answers(context.scene))
        for name, value in values.items():
            setattr(context.scene.farfield_texmesh, name, value)
        report_message(self, message)
        return {"FINISHED"}


class FARFIELD_OT_texmesh_clear_answers(bpy.types.Operator):
    """Remove all recorded answers from the scene"""

    bl_idname = "farfield.texmesh_clear_answers"
    bl_label = "Clear Answers of Calibration"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether there are answers."""
        reason = "" if context.scene.get(ANSWERS) is not None else "There are no answers"
        return long_work.poll_with_reason(cls, reason or ("" if context.scene.is_editable else "The scene is linked from a library"))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove the answers."""
        report_message(self, f"Removed {format_count(clear_answers(context.scene), 'answer')}.")
        return {"FINISHED"}


def handle_event(run: CalibrationRun, event_type: str, value: str) -> set[str]:
    """Let a key or the mouse wheel act on `run`; return the result of the modal operator: it runs, or it has ended with or without answers.

    Raises:
        GeometryError: the levels were removed.
    """
    if value == "PRESS":
        if event_type == "ESC":
            return {"FINISHED"} if run.answers else {"CANCELLED"}
        if event_type in {"RET", "NUMPAD_ENTER"}:
            run.accept()
        elif event_type in NEARER | FARTHER:
            run.move(-1 if event_type in NEARER else 1)
    return {"RUNNING_MODAL"}


def find_area(address: int) -> bpy.types.Area | None:
    """Return the 3D Viewport at an address, None if it was closed."""
    areas = (area for window in bpy.context.window_manager.windows for area in window.screen.areas)
    return next((area for area in areas if area.as_pointer() == address and area.type == "VIEW_3D"), None)


def end_calibration() -> None:
    """End the calibration that runs, and remove everything temporary."""
    global _run
    run, _run = _run, None
    if run is not None:
        run.close()


@bpy.app.handlers.persistent
def _before_change(*_: Any) -> None:
    end_calibration()


@bpy.app.handlers.persistent
def _after_change(*_: Any) -> None:
    """A file that was saved meanwhile by Blender itself holds the temporary objects."""
    if _run is None:
        remove_trial_objects()


HANDLERS: tuple[tuple[str, Any], ...] = (
    *((name, _before_change) for name in ("load_pre", "save_pre", "undo_pre", "redo_pre")),
    *((name, _after_change) for name in ("load_post", "undo_post", "redo_post")),
)
CLASSES = (FARFIELD_OT_texmesh_calibrate, FARFIELD_OT_texmesh_use_threshold, FARFIELD_OT_texmesh_clear_answers)
register_classes, unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the operators and the handlers."""
    register_classes()
    add_handlers(HANDLERS)


def unregister() -> None:
    """End the calibration, and unregister the handlers and the operators."""
    end_calibration()
    remove_handlers(HANDLERS)
    unregister_classes()
