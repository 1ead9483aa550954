"""*Follow View*: a timer keeps a terrain centered on a 3D Viewport. A modal operator would prevent Blender from autosaving."""

import sys
from dataclasses import replace

import bpy

from ..bridge.terrain_roots import TerrainRoot
from ..bridge.viewers import build_viewer, viewer_matrix, viewer_projection
from ..core.geometry.viewers import Viewer
from ..core.messages import single_line
from . import follow_tools, following, long_work
from .error_reports import describe_error, reports_errors
from .following import MAX_TICK_SECONDS, Following

TICK = 1.0 / 60.0  # seconds between two calls of the timer
BLOCKING_JOBS = ("RENDER", "OBJECT_BAKE")  # Blender's jobs that read the meshes in a thread.


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
    def terrain(self) -> TerrainRoot | None:
        """The terrain that follows, None if there is none."""
        return self._following.terrain if self._following is not None else None

    def start(self, terrain: TerrainRoot, area: bpy.types.Area | None, max_seconds: float) -> None:
        """Let `terrain` follow the 3D Viewport `area`, using at most `max_seconds` of the main thread at a time.

        Raises:
            FarfieldError: the terrain is linked, or its settings or files cannot be read.
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

    def complete(self) -> None:
        """Show what is left out for a fast viewer, and wait for that.

        Raises:
            FarfieldError: the terrain was removed, or its engine failed.
        """
        if self._following is not None:
            self._following.complete()

    def _tick(self) -> float | None:
        """Continue for a moment; return the seconds to the next call, None to end."""
        continues = False
        try:
            continues = self._advance()
        except Exception as error:  # noqa: BLE001 catch-all: nobody else catches the errors of a timer
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
        if not is_job_running() and not is_transforming():
            viewer = replace(view_of_area(*find_viewport(self._area_address)), is_interactive=True)
            if self._following.tick(follow_tools.tool_of(terrain).to_terrain(terrain, viewer), self._max_seconds):
                long_work.redraw_sidebars(bpy.context.window_manager)
        return True

    def _end(self, error: str) -> None:
        self.stop()
        self.error = single_line(error)
        if error:
            print(self.error, file=sys.stderr)
        long_work.redraw_sidebars(bpy.context.window_manager)


current = ViewFollowing()


class ActiveTerrainOperator:
    """Base of operators of the active terrain of a tool.

    terrain_type: terrains of the tool. changes_terrain: whether terrains that are linked or overridden are refused.
    """

    terrain_type: type[TerrainRoot]
    changes_terrain = True

    @classmethod
    def active_terrain(cls, context: bpy.types.Context) -> TerrainRoot | None:
        """Return the tool's terrain that the active object belongs to."""
        return cls.terrain_type.of_object(context.active_object)

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why the operator cannot run now, or an empty string."""
        reason, terrain = following.disabled_reason(context), cls.active_terrain(context)
        if reason or terrain is None:
            return reason or f"Select a {cls.terrain_type.label}"
        return terrain.read_only_reason if cls.changes_terrain else ""


class FollowViewOperator(ActiveTerrainOperator):
    """Base of the operator *Follow View* of a tool: starts and stops `current`, or recenters the terrain once without a window.

    A tool adds `bpy.types.Operator`, the identifier, the label and the type of its terrains.
    """

    bl_options = {"REGISTER"}
    budget: bpy.props.FloatProperty(
        name="Budget",
        description="Maximum time per update on Blender's main thread, in milliseconds",
        default=1000.0 * MAX_TICK_SECONDS,
        min=1.0,
        max=100.0,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a terrain follows the view, or a terrain that can is active and nothing else runs."""
        return current.terrain is not None or long_work.poll_with_reason(cls, cls.disabled_reason(context))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window: recenter the terrain once."""
        terrain = current.terrain or self.active_terrain(context)
        viewer = view_of_area(context.scene, context_viewport(context))
        following.recenter(terrain, follow_tools.tool_of(terrain).to_terrain(terrain, viewer))
        return {"FINISHED"}

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start following, or stop. Everything that was shown until then is one undo step."""
        if context.window is None:
            return self.execute(context)
        if current.terrain is None:
            current.start(self.active_terrain(context), context.area, self.budget / 1000.0)
        else:
            try:
                current.complete()
            finally:
                if current.stop():
                    bpy.ops.ed.undo_push(message=self.bl_label)
        long_work.redraw_sidebars(context.window_manager)
        return {"FINISHED"}


def view_of_area(scene: bpy.types.Scene, area: bpy.types.Area | None) -> Viewer:
    """Return the viewer in world space who looks at the 3D Viewport `area`; see `viewer_matrix`."""
    region = area.spaces.active.region_3d if area is not None else None
    return build_viewer(viewer_matrix(scene, region), viewer_projection(scene, area))


def context_viewport(context: bpy.types.Context) -> bpy.types.Area | None:
    """Return the 3D Viewport under the pointer, or the first one of the screen. None without a window."""
    if context.screen is None or bpy.app.background:
        return None
    if context.area is not None and context.area.type == "VIEW_3D":
        return context.area
    return next((area for area in context.screen.areas if area.type == "VIEW_3D"), None)


def viewport_address(context: bpy.types.Context) -> int:
    """Return the address of `context_viewport`, for `find_viewport`; 0 without a window."""
    area = context_viewport(context)
    return 0 if area is None else area.as_pointer()


def find_viewport(area_address: int) -> tuple[bpy.types.Scene, bpy.types.Area | None]:
    """Return the 3D Viewport at this address and the scene that it shows, or the first one if it was closed."""
    viewports = [
        (window.scene, area)
        for window in bpy.context.window_manager.windows
        for area in window.screen.areas
        if area.type == "VIEW_3D" and not bpy.app.background
    ]
    if not viewports:
        return bpy.context.scene, None
    return next((viewport for viewport in viewports if viewport[1].as_pointer() == area_address), viewports[0])


def is_job_running() -> bool:
    """Return whether something renders or bakes, or a job of Farfield runs: visibility and meshes must not change now."""
    return long_work.current_run() is not None or any(bpy.app.is_job_running(job) for job in BLOCKING_JOBS)


def is_transforming() -> bool:
    """Return whether the user transforms objects: they must not be exchanged now."""
    windows = bpy.context.window_manager.windows
    return any(operator.bl_idname.startswith("TRANSFORM_OT_") for window in windows for operator in window.modal_operators)


def show_textures(area_address: int) -> None:
    """Let the 3D Viewport at this address show images in Solid shading, with their alpha, if it shows the colors of materials there."""
    _, area = find_viewport(area_address)
    shading = None if area is None else area.spaces.active.shading
    if shading is not None and shading.type == "SOLID" and shading.color_type == "MATERIAL":
        shading.color_type = "TEXTURE"
