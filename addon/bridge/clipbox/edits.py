"""Objects of the scene that the user adds to its terrains or subtracts from them: Empties, curves, and all that have faces."""

import bpy
import mathutils
import numpy as np

from ...core.clipbox.terrains.edits import NO_EDITS, Capsules, Edits, Ellipsoid, MeshSolid, Solid
from ...core.geometry.mesh import fingerprint
from ...core.geometry.transforms import is_invertible, mean_scale, transform_points
from ..geometry.meshes import concatenate_in_world_space, may_have_surface, read_instances
from .objects import SceneTerrain

EDIT_KEY = "farfield_clipbox_edit"  # A custom property, one of the following.
ADD, SUBTRACT = "ADD", "SUBTRACT"
SAMPLES_PER_SEGMENT = 8  # Of Bézier curves.


def can_edit(item: bpy.types.Object) -> bool:
    """Return whether an object can be added or subtracted."""
    return (item.type in ("EMPTY", "CURVE") or may_have_surface(item)) and SceneTerrain.of_object(item) is None


def mark(item: bpy.types.Object, mode: str) -> None:
    """Add an object to terrains or subtract it, shown as wires and not rendered, or neither again if `mode` is empty."""
    if mode:
        item[EDIT_KEY] = mode
    elif EDIT_KEY in item:
        del item[EDIT_KEY]
    item.display_type, item.hide_render = ("WIRE", True) if mode else ("TEXTURED", False)


def marked_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the objects of a scene that are visible and to be added or subtracted, by name."""
    found = [item for item in scene.objects if item.get(EDIT_KEY) in (ADD, SUBTRACT) and can_edit(item) and item.visible_get()]
    return sorted(found, key=lambda item: item.name_full)


def read_edits(scene: bpy.types.Scene, blend: float, terrain: SceneTerrain | None = None) -> Edits:
    """Return the edits of a terrain of the scene, or of a new one, in terrain space. blend: see `Edits`."""
    objects = marked_objects(scene)
    if not objects:
        return NO_EDITS
    depsgraph = bpy.context.evaluated_depsgraph_get()
    to_terrain = np.eye(4) if terrain is None else terrain.matrix_to_terrain()
    solids: dict[str, list[Solid]] = {ADD: [], SUBTRACT: []}
    for item in objects:
        solids[item[EDIT_KEY]] += _read_solids(item, to_terrain, depsgraph)
    return Edits(tuple(solids[ADD]), tuple(solids[SUBTRACT]), blend)


def _read_solids(item: bpy.types.Object, to_terrain: np.ndarray, depsgraph: bpy.types.Depsgraph) -> list[Solid]:
    """Return the solids of an object; none if it has no volume."""
    matrix = to_terrain @ np.array(item.evaluated_get(depsgraph).matrix_world, np.float64)
    if item.type == "EMPTY" and item.instance_collection is None:
        matrix[:3, :3] *= item.empty_display_size
        return [Ellipsoid(tuple(map(tuple, matrix[:3].tolist())))] if is_invertible(matrix) else []
    if item.type == "CURVE" and item.data.dimensions == "3D":
        return _read_capsules(item.data, matrix)
    instances = read_instances([item], depsgraph)
    if not instances:
        return []
    mesh = concatenate_in_world_space(instances)
    vertices = transform_points(to_terrain, mesh.vertices)
    corners = vertices[mesh.triangles]
    return [MeshSolid(fingerprint(vertices, corners), corners)]


def _read_capsules(curve: bpy.types.Curve, matrix: np.ndarray) -> list[Solid]:
    """Return the capsules along the splines of a curve: as thick as its bevel and the radii of its points."""
    scale = float(mean_scale(matrix)) * curve.bevel_depth
    chains = []
    for spline in curve.splines:
        points = _sample_bezier(spline) if spline.type == "BEZIER" else [(point.co.xyz, point.radius) for point in spline.points]
        if spline.use_cyclic_u:
            points.append(points[0])
        positions = transform_points(matrix, np.array([position for position, _ in points], np.float64))
        radii = scale * np.array([radius for _, radius in points])
        if (radii > 0.0).any():
            chains.append(Capsules(tuple(map(tuple, np.column_stack([positions, radii]).tolist()))))
    return chains


def _sample_bezier(spline: bpy.types.Spline) -> list[tuple[mathutils.Vector, float]]:
    """Return positions along a Bézier spline, and the radii there."""
    knots = list(spline.bezier_points)
    points = []
    for first, second in zip(knots, knots[1:] + knots[:1] if spline.use_cyclic_u else knots[1:], strict=False):
        segment = mathutils.geometry.interpolate_bezier(
            first.co, first.handle_right, second.handle_left, second.co, SAMPLES_PER_SEGMENT + 1
        )
        fractions = np.arange(SAMPLES_PER_SEGMENT) / SAMPLES_PER_SEGMENT
        points += [
            (co, first.radius + fraction * (second.radius - first.radius)) for co, fraction in zip(segment[:-1], fractions, strict=True)
        ]
    return points if spline.use_cyclic_u else [*points, (knots[-1].co, knots[-1].radius)]
