"""*Follow View*: viewports show levels for the place of the viewer, wherever the active camera is. Renders do not change."""

from typing import Any

import bpy
import numpy as np

from ...bridge.active_camera import follow_viewport
from ...bridge.distance.placing import has_levels
from ...bridge.viewers import viewport_camera
from ...core.geometry.cameras import Camera
from .. import follow_handlers, long_work
from ..error_reports import reports_errors
from ..view_following import find_viewport, is_job_running, is_transforming, viewport_address
from .operators import levels_reason

TICK = 0.1  # Seconds between two looks at the view. Levels change when it rests, since that evaluates all modifiers.


class LevelFollowing:
    """A timer that tells the levels where a 3D Viewport looks from."""

    def __init__(self) -> None:
        self.is_running = False
        self._area_address = 0
        self._seen: Camera | None = None
        self._shown: Camera | None = None
        self._timer = self._tick  # Blender identifies timers by the object.

    def start(self, area_address: int) -> None:
        """Follow the 3D Viewport with this address."""
        self.stop()
        self.is_running, self._area_address = True, area_address
        bpy.app.timers.register(self._timer, first_interval=0.0)

    def stop(self, *_: Any) -> None:
        """Let viewports show levels for the active camera again."""
        if bpy.app.timers.is_registered(self._timer):
            bpy.app.timers.unregister(self._timer)
        if self.is_running:
            self.is_running, self._seen, self._shown = False, None, None
            follow_viewport(None)

    def _tick(self) -> float | None:
        """Show levels for the view if it rests; return the seconds to the next call, None to end."""
        scene, area = find_viewport(self._area_address)
        if area is None or not has_levels(scene):
            self.stop()
            return None
        camera = self._find_view(area)
        is_resting = _is_same(camera, self._seen)
        self._seen = camera
        if is_resting and not _is_same(camera, self._shown) and not is_job_running() and not is_transforming():
            follow_viewport(camera)
            self._shown = camera
        return TICK

    @staticmethod
    def _find_view(area: bpy.types.Area) -> Camera | None:
        """Return the view of a 3D Viewport, None if it is that of the camera."""
        region = area.spaces.active.region_3d
        return None if region.view_perspective == "CAMERA" else viewport_camera(region, area.width)


def _is_same(first: Camera | None, second: Camera | None) -> bool:
    if first is None or second is None:
        return first is second
    numbers = [[*camera.position, camera.pixels, camera.field_of_view, camera.orthographic_scale] for camera in (first, second)]
    return np.allclose(*numbers, rtol=1e-4)


current = LevelFollowing()


class FARFIELD_OT_distance_follow_view(bpy.types.Operator):
    """Show levels in this viewport as its own distance requires while you look around, or as the active camera requires again. Renders do
    not change"""

    bl_idname = "farfield.distance_follow_view"
    bl_label = "Follow View with Levels by Distance"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether there are levels and a viewport."""
        viewport = "" if viewport_address(context) else "There is no 3D Viewport"
        return long_work.poll_with_reason(cls, levels_reason(context) or viewport)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start or stop."""
        if current.is_running:
            current.stop()
        else:
            current.start(viewport_address(context))
        long_work.redraw_sidebars(context.window_manager)
        return {"FINISHED"}


@bpy.app.handlers.persistent
def _before_other_file(*_: Any) -> None:
    """Files are stored without the view, since nothing follows it where the extension is missing."""
    current.stop()


HANDLERS = (("load_pre", _before_other_file), ("save_pre", _before_other_file))


def register() -> None:
    """Register the operator and the handlers."""
    bpy.utils.register_class(FARFIELD_OT_distance_follow_view)
    follow_handlers.add_handlers(HANDLERS)


def unregister() -> None:
    """Stop, and unregister them."""
    current.stop()
    follow_handlers.remove_handlers(HANDLERS)
    bpy.utils.unregister_class(FARFIELD_OT_distance_follow_view)
