"""Objects, vertices and points that are put on a terrain: their positions in its space, and how they are moved.

A terrain may be moved, rotated and scaled; "up" is the Z axis of its root, along which everything is moved.
"""

from dataclasses import dataclass

import bpy
import mathutils
import numpy as np

from ..core.geometry.transforms import inverse_transform_points, is_invertible, transform_points
from .geometry.mesh_arrays import read_attribute
from .geometry.mesh_pool import is_local
from .terrain_roots import TerrainRoot

POINT_TYPES = ("MESH", "POINTCLOUD")
MAX_MISS = 1e-3  # by which an object may miss its position, relative to the distance that it is moved, before it counts as locked


@dataclass(frozen=True)
class TerrainSpace:
    """The space of a terrain in the world.

    matrix: (4, 4) float64 of the root, not singular. origin: (3,) float64, see `TerrainRoot.origin`.
    """

    matrix: np.ndarray
    origin: np.ndarray

    @classmethod
    def of(cls, terrain: TerrainRoot) -> "TerrainSpace":
        """Return the space of a terrain."""
        return cls(np.array(terrain.root.matrix_world, np.float64), terrain.origin)

    @property
    def up(self) -> np.ndarray:
        """The unit vector (3,) up, in world space."""
        return self.matrix[:3, 2] / np.linalg.norm(self.matrix[:3, 2])

    @property
    def height_scale(self) -> float:
        """The length in world space of a height of one in the space of the terrain."""
        return float(np.linalg.norm(self.matrix[:3, 2]))

    def to_terrain(self, points: np.ndarray) -> np.ndarray:
        """Return world positions (N, 3) in the space of the terrain, float64."""
        return inverse_transform_points(self.matrix, points) + self.origin

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Return positions (N, 3) of the terrain in world space, float64."""
        return transform_points(self.matrix, points - self.origin)

    def normals_to_world(self, normals: np.ndarray) -> np.ndarray:
        """Return unit normals (N, 3) of the terrain in world space."""
        turned = np.linalg.solve(self.matrix[:3, :3].T, normals.T).T
        return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def selected_objects(context: bpy.types.Context, terrain: TerrainRoot) -> list[bpy.types.Object]:
    """Return the selected objects without the terrain itself, parents before children."""
    excluded = {terrain.root, *terrain.shown_objects()}
    return sorted((item for item in context.selected_objects if item not in excluded), key=count_parents)


def find_base(item: bpy.types.Object, matrix: np.ndarray, up: np.ndarray, uses_bottom: bool) -> np.ndarray:
    """Return the point (3,) float64 in world space by which an object with the matrix (4, 4) stands on the ground.

    It is the origin, or for objects with geometry if `uses_bottom` the point below the center of the bounding box, along the unit vector
    `up`, at the height of its lowest corner.
    """
    corners = np.array(item.bound_box, np.float64)
    if not uses_bottom or item.data is None or not np.ptp(corners, axis=0).any():
        return matrix[:3, 3].copy()
    corners = transform_points(matrix, corners)
    center = corners.mean(axis=0)
    return center + up * ((corners @ up).min() - center @ up)


def place(item: bpy.types.Object, target: np.ndarray, up: np.ndarray, normal: np.ndarray | None, uses_bottom: bool) -> None:
    """Move an object until its base is at `target` (3,), world space. normal: (3,) unit vector, to which its Z axis is rotated; or None.

    Without rotation only its location changes. The view layer must be up to date.
    """
    matrix = np.array(item.matrix_world, np.float64)
    if normal is None:
        step = target - find_base(item, matrix, up, uses_bottom)
        parent = item.matrix_world @ item.matrix_basis.inverted_safe()
        item.location += parent.to_3x3().inverted_safe() @ mathutils.Vector(step)
        return
    axis = mathutils.Vector(matrix[:3, 2])
    rotation = np.array(axis.rotation_difference(mathutils.Vector(normal)).to_matrix(), np.float64) if axis.length else np.eye(3)
    matrix[:3, :3] = rotation @ matrix[:3, :3]
    matrix[:3, 3] += target - find_base(item, matrix, normal, uses_bottom)
    item.matrix_world = mathutils.Matrix(matrix)


def is_at(item: bpy.types.Object, target: np.ndarray, up: np.ndarray, uses_bottom: bool, distance: float) -> bool:
    """Return whether the base of an object that was moved by `distance` is at `target` (3,); constraints or animation may have kept it."""
    base = find_base(item, np.array(item.matrix_world, np.float64), up, uses_bottom)
    rounding = 1e-5 * float(np.abs(target).max()) + 1e-4
    return float(np.linalg.norm(base - target)) <= MAX_MISS * distance + rounding


def read_points(item: bpy.types.Object) -> np.ndarray:
    """Return the vertices of a mesh or the points of a point cloud, (N, 3) float64 in world space."""
    attribute = item.data.attributes.get("position")
    return transform_points(item.matrix_world, read_attribute(attribute) if attribute is not None else np.zeros((0, 3)))


def count_points(item: bpy.types.Object) -> int:
    """Return the number of vertices of a mesh or of points of a point cloud."""
    attribute = item.data.attributes.get("position")
    return 0 if attribute is None else len(attribute.data)


def write_points(item: bpy.types.Object, points: np.ndarray, is_moved: np.ndarray) -> None:
    """Set those vertices or points of an object, by their world positions (N, 3), that are moved, (N,) bool; the others stay exactly."""
    attribute = item.data.attributes["position"]
    positions = read_attribute(attribute)
    positions[is_moved] = inverse_transform_points(item.matrix_world, points[is_moved])
    attribute.data.foreach_set("vector", positions.ravel())
    item.data.update_tag()


def refusal_of_points(item: bpy.types.Object) -> str:
    """Return why the points of an object cannot be moved, an empty string if they can."""
    if item.type not in POINT_TYPES:
        return "neither mesh nor point cloud"
    if not is_local(item.data):
        return "linked data"
    if item.data.users > 1:
        return "data that other objects share"
    if item.type == "MESH" and item.data.shape_keys is not None:
        return "shape keys"
    return "" if is_invertible(np.array(item.matrix_world, np.float64)) else "a scale of zero, or a transform that is not finite"


def refusal_of_object(item: bpy.types.Object) -> str:
    """Return why an object cannot be moved, an empty string if it can."""
    return "" if is_local(item) else "linked"


def count_parents(item: bpy.types.Object) -> int:
    """Return the number of ancestors of an object."""
    count = 0
    while item.parent is not None:
        item, count = item.parent, count + 1
    return count
