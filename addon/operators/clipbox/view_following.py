"""*Follow View*: a timer keeps a terrain centered on a 3D Viewport. A modal operator would prevent Blender from autosaving."""

import sys

import bpy
import mathutils

from ...bridge.clipbox.objects import SceneTerrain
from ...core.errors import single_line
from .. import long_work
from ..error_reports import describe_error
from . import following
from .following import Following

TICK = 1.0 / 60.0  # seconds between two calls of the timer
BLOCKING_JOBS = ("RENDER", "OBJECT_BAKE")  # of Blender; they read the meshes in a thread


class ViewFollowing:
    """The terrain that follows a 3D Viewport, if there is one. Operators, panels and the timer share one instance.

    error: why it ended by itself the last time, an empty string otherwise.
    """

    def __init__(self) -> None:
        self.error = ""
        self._following: Following | None = None
        self._area_address = 0  # a reference to the area would not survive changes of the window layout
        self._max_seconds = 0.0
        self._timer = self._tick  # Blender identifies timers by the object

    @property
    def terrain(self) -> SceneTerrain | None:
        """The terrain that follows, None if there is none."""
        return self._following.terrain if self._following is not None else None

    def start(self, terrain: SceneTerrain, area: bpy.types.Area | None, max_seconds: float) -> None:
        """Let `terrain` follow the 3D Viewport `area`, using at most `max_seconds` of the main thread at a time.

        Raises:
            FarfieldError: the terrain is linked, or its settings or source file cannot be read.
        """
        self.stop()
        self._following = Following(terrain)
        self._area_address = area.as_pointer() if area is not None else 0
        self._max_seconds = max_seconds
        bpy.app.timers.register(self._timer, first_interval=TICK)

    def stop(self) -> int:
        """Stop following. Returns the number of moves that were shown."""
        self.error = ""
        if bpy.app.timers.is_registered(self._timer):
            bpy.app.timers.unregister(self._timer)
        ended, self._following = self._following, None
        if ended is None:
            return 0
        ended.close()
        return ended.moves

    def _tick(self) -> float | None:
        """Continue for a moment; return the seconds to the next call, None to end."""
        continues = False
        try:
            continues = self._advance()
        except Exception as error:  # noqa: BLE001 the last resort: nobody else catches the errors of a timer
            self._end(describe_error(error, "Follow View"))
        finally:
            if not continues and self._following is not None:
                self._end("")
        return TICK if continues else None

    def _advance(self) -> bool:
        terrain = self.terrain
        if self._following not in following.running():
            return False
        if terrain.root is None:
            self._end(f'The terrain "{terrain.name}" was removed or renamed; it no longer follows the view.')
            return False
        if not _is_scene_in_use():
            scene, region = _find_viewport(self._area_address)
            if self._following.tick(terrain.viewer_position(viewer_matrix(scene, region)), self._max_seconds):
                long_work.redraw_sidebars(bpy.context.window_manager)
        return True

    def _end(self, error: str) -> None:
        self.stop()
        self.error = single_line(error)
        if error:
            print(self.error, file=sys.stderr)
        long_work.redraw_sidebars(bpy.context.window_manager)


current = ViewFollowing()


def viewer_matrix(scene: bpy.types.Scene, region: bpy.types.RegionView3D | None) -> mathutils.Matrix:
    """Return the matrix of the viewer in world space.

    The viewer is the 3D Viewport `region`. Without it, or if it looks through the active camera, the viewer is that camera. Without a
    camera it is the 3D cursor.
    """
    if scene.camera is not None and (region is None or region.view_perspective == "CAMERA"):
        return scene.camera.matrix_world
    return region.view_matrix.inverted() if region is not None else scene.cursor.matrix


def _find_viewport(area_address: int) -> tuple[bpy.types.Scene, bpy.types.RegionView3D | None]:
    """Return the 3D Viewport at this address and the scene that it shows, or the first one if it was closed."""
    viewports = [
        (window.scene, area)
        for window in bpy.context.window_manager.windows
        for area in window.screen.areas
        if area.type == "VIEW_3D" and not bpy.app.background
    ]
    if not viewports:
        return bpy.context.scene, None
    scene, area = next((viewport for viewport in viewports if viewport[1].as_pointer() == area_address), viewports[0])
    return scene, area.spaces.active.region_3d


def _is_scene_in_use() -> bool:
    """Return whether meshes must not be exchanged now: something renders, a job of Farfield runs, or the user transforms objects."""
    if long_work.current_run() is not None or any(bpy.app.is_job_running(job) for job in BLOCKING_JOBS):
        return True
    windows = bpy.context.window_manager.windows
    return any(operator.bl_idname.startswith("TRANSFORM_OT_") for window in windows for operator in window.modal_operators)
