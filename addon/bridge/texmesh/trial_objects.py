"""The temporary objects of the calibration: the original, a level, and a backdrop that hides the scene."""

from dataclasses import dataclass

import bpy
import mathutils
import numpy as np

from ..lod_crossfade import CAMERA_POSITION, CROSSFADE, MAX_PIXEL, MIN_RANGE, PIXEL_SIZE
from ..objects import find_by_uid

MARK = "farfield_texmesh_calibration"  # custom property of the temporary collection
NAME = "Farfield Calibration"
BACKDROP_DEPTH = 4.0  # in depths of the objects
BACKDROP_COLOR = (0.35, 0.35, 0.35, 1.0)


@dataclass(frozen=True)
class TrialObjects:
    """Session UIDs of the objects, which undo or the user may remove."""

    original_uid: int
    level_uid: int
    backdrop_uid: int

    def show_level(self, mesh: bpy.types.Mesh) -> bool:
        """Show another mesh at the right. Returns False if the objects were removed."""
        item = find_by_uid(bpy.data.objects, self.level_uid)
        if item is not None:
            item.data = mesh
        return item is not None

    def place(self, view: mathutils.Matrix, original: np.ndarray, level: np.ndarray, depth: float, width: float) -> bool:
        """Place the objects by matrices (4, 4) in the camera space of `view`, the matrix of the viewer in world space.

        depth: of the objects. width: of what the viewer sees at depth 1. Returns False if they were removed.
        """
        backdrop = np.diag([width, width, 1.0, 1.0]) * BACKDROP_DEPTH * depth
        backdrop[2:, 2:] = [[1.0, -BACKDROP_DEPTH * depth], [0.0, 1.0]]
        for uid, matrix in ((self.original_uid, original), (self.level_uid, level), (self.backdrop_uid, backdrop)):
            item = find_by_uid(bpy.data.objects, uid)
            if item is None:
                return False
            item.matrix_world = view @ mathutils.Matrix(matrix.tolist())
        return True


def create_trial_objects(scene: bpy.types.Scene, original: bpy.types.Object, level: bpy.types.Object) -> TrialObjects:
    """Create objects that share the meshes of two levels, in a temporary collection of `scene`."""
    remove_trial_objects()
    collection = bpy.data.collections.new(NAME)
    collection[MARK] = True
    scene.collection.children.link(collection)
    mesh = bpy.data.meshes.new(NAME)
    mesh.from_pydata([(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)], [], [(0, 1, 2, 3)])
    uids = []
    for name, data in ((original.name, original.data), (level.name, level.data), (NAME, mesh)):
        item = bpy.data.objects.new(f"{NAME} {name}", data)
        item.hide_render = item.hide_select = True
        item.color = BACKDROP_COLOR
        item[CROSSFADE], item[CAMERA_POSITION], item[PIXEL_SIZE] = [0.0, MAX_PIXEL, MIN_RANGE], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]
        collection.objects.link(item)
        uids.append(item.session_uid)
    return TrialObjects(*uids)


def remove_trial_objects() -> None:
    """Remove what `create_trial_objects` created, also what an earlier session or an undo step left."""
    for collection in [collection for collection in bpy.data.collections if collection.get(MARK) and collection.library is None]:
        objects = list(collection.objects)
        meshes = [item.data for item in objects if item.data is not None]
        bpy.data.batch_remove(objects)
        bpy.data.batch_remove([mesh for mesh in dict.fromkeys(meshes) if mesh.users == 0 and mesh.name.startswith(NAME)])
        bpy.data.collections.remove(collection)
