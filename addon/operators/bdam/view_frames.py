"""3D Viewports that show a whole terrain."""

import bpy
import mathutils
import numpy as np

MIN_CLIP_END = 4.0  # relative to the size of the terrain
MIN_CLIP_START = 2e-6  # relative to the end of the clipping range: nearer surfaces of far terrain would flicker
VIEW_DISTANCE = 1.2  # relative to the size of the terrain
ROTATION = mathutils.Euler((1.05, 0.0, 0.0))  # from the south, and down


def frame_terrain(space: bpy.types.SpaceView3D, low: np.ndarray, high: np.ndarray, exaggeration: float) -> None:
    """Let a 3D Viewport show a terrain between two corners (3,) of its bounding box, and extend its clipping range.

    In Solid shading it no longer outlines objects, which would draw lines between tiles. A view through the camera stays as it is.
    """
    space.shading.show_object_outline = False
    scale = np.array([1.0, 1.0, exaggeration])
    center, size = 0.5 * (low + high) * scale, float(np.linalg.norm((high - low) * scale))
    space.clip_end = max(space.clip_end, MIN_CLIP_END * size)
    space.clip_start = max(space.clip_start, MIN_CLIP_START * space.clip_end)
    region = space.region_3d
    if region.view_perspective == "CAMERA":
        return
    region.view_location, region.view_distance = center.tolist(), VIEW_DISTANCE * float((high - low)[:2].max())
    region.view_rotation = ROTATION.to_quaternion()
    region.update()
