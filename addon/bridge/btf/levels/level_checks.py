"""Checks of a cloud's levels before a bake: files come from anyone, and meshes can be edited."""

import math
from numbers import Real

import bpy
import numpy as np

from ....core.billboards.atlas import MAX_SIDE
from ....core.billboards.texels import QuadPolygons
from ....core.errors import GeometryError
from ....core.geometry.distance import closest_on_mesh
from ...billboards import clouds
from ...billboards.cloud_materials import FRONT_COLOR, FRONT_NORMAL, FRONT_ROUGHNESS_METALLIC_DEPTH
from ...billboards.level_objects import built_center, find_atlas_size, first_faces, pbr_image, read_atlas_size, read_level_quads
from ...billboards.scene_clouds import SceneCloud
from ...geometry.meshes import Source

PBR_LABELS = (FRONT_COLOR, FRONT_NORMAL, FRONT_ROUGHNESS_METALLIC_DEPTH)
MAX_UV_EXCESS = 1e-3  # Beyond 0..1.
MAX_RESIDUAL = 0.1  # In errors, between the corners of a quad and an affine map of the texture; about 0 in a new cloud.
MAX_TEXEL_SHARING = 4.0  # Texels of all quads over those of the atlas; about 1 when quads do not overlap.
MAX_PLANE_DISTANCE = 1.5  # In errors, between a vertex and the plane of a quad that shows it; at most 1 in a new cloud.


def is_editable(cloud: SceneCloud) -> bool:
    """Whether materials of a cloud can be changed: not in data that is linked from another file, also if its objects have overrides."""
    return cloud.is_editable and all(level.data is None or level.data.is_editable for level in cloud.levels)


def check_editable(cloud: SceneCloud) -> None:
    """Raise GeometryError if materials of a cloud cannot be changed, or if a level is in Edit Mode."""
    if not is_editable(cloud):
        name = cloud.collection.name
        raise GeometryError(f'"{name}" is linked from another file, which keeps its materials; make the cloud and its meshes local first.')
    for level in cloud.levels:
        _check_mode(level)


def check_level(level_object: bpy.types.Object, source: Source) -> None:
    """Check that a level is as it was built from `source`.

    Raises:
        GeometryError: a number, UV map or material was changed so that it cannot be baked, the quads no longer lie on the source, or the
            level is in Edit Mode.
    """
    _check_mode(level_object)
    primitive_count = len(source.points.points) if source.mesh is None else len(source.mesh.triangles)
    problem = (
        _numbers_problem(level_object)
        or _mesh_problem(level_object.data)
        or _drawn_problem(level_object.data, primitive_count)
        or _atlas_problem(level_object)
    )
    if not problem:
        quads = read_level_quads(level_object, built_center(level_object, source.origin))
        problem = _quads_problem(quads, level_object) or _distance_problem(quads, level_object, source)
    _raise_problem(level_object, problem)


def check_quads(level_object: bpy.types.Object) -> None:
    """Check that the quads of a baked level and their texels can be read; they need not be where they were built.

    Raises:
        GeometryError: a number, UV map or material was changed so that they cannot, or the level is in Edit Mode.
    """
    _check_mode(level_object)
    problem = _numbers_problem(level_object) or _mesh_problem(level_object.data) or _atlas_problem(level_object)
    _raise_problem(level_object, problem or _corners_problem(read_level_quads(level_object), level_object))


def _raise_problem(level_object: bpy.types.Object, problem: str) -> None:
    if problem:
        raise GeometryError(f'The level "{level_object.name}" was changed after the cloud was built: {problem}. Rebuild the cloud.')


def is_unchanged(level_object: bpy.types.Object, quads: QuadPolygons, has_surface: bool) -> bool:
    """Whether a level still has the `quads`, up to a translation, and a material slot, and PBR maps if `has_surface`."""
    if _numbers_problem(level_object) or _mesh_problem(level_object.data):
        return False
    if has_surface and None in [pbr_image(level_object, label) for label in PBR_LABELS]:
        return False
    current = read_level_quads(level_object)
    moved = np.concatenate(quads.corners).mean(axis=0) - np.concatenate(current.corners).mean(axis=0)
    corners = [polygon + moved for polygon in current.corners]
    pairs = [*zip(corners, quads.corners, strict=False), *zip(current.texel_coordinates, quads.texel_coordinates, strict=False)]
    is_same = all(first.shape == second.shape and np.allclose(first, second, rtol=1e-5, atol=1e-5) for first, second in pairs)
    return is_same and len(current.corners) == len(quads.corners)


def _check_mode(level_object: bpy.types.Object) -> None:
    """Raise GeometryError if a level is in Edit Mode: Blender keeps its mesh elsewhere then, and its UV map is empty."""
    if isinstance(level_object.data, bpy.types.Mesh) and level_object.data.is_editmode:
        raise GeometryError(f'The level "{level_object.name}" is in Edit Mode; switch to Object Mode first.')


def _numbers_problem(level_object: bpy.types.Object) -> str:
    error = level_object.get("farfield_error")
    if not isinstance(error, Real) or not math.isfinite(error) or error <= 0.0:
        return "its error is not a positive number"
    if find_atlas_size(level_object) is None:
        return f"the size of its atlas is not two numbers up to {MAX_SIDE}"
    return ""


def _mesh_problem(mesh: bpy.types.ID | None) -> str:
    if not isinstance(mesh, bpy.types.Mesh) or not len(mesh.polygons):
        return "it has no quads"
    uv_map = mesh.attributes.get("UVMap")
    if uv_map is None or uv_map.domain != "CORNER" or uv_map.data_type != "FLOAT2":
        return 'it has no UV map "UVMap"'
    if not len(mesh.materials):
        return "its material slot was removed"
    return ""


def _drawn_problem(mesh: bpy.types.Mesh, primitive_count: int) -> str:
    """Check the primitives that the quads show, see `cloud.Quads`."""
    problem = "it does not tell which faces of the source its quads show"
    try:
        offsets, drawn = clouds.read_drawn_primitives(mesh)
    except (KeyError, TypeError, ValueError, OverflowError):
        return problem
    if offsets.shape != (len(first_faces(mesh)) + 1,) or drawn.ndim != 1 or not len(drawn):
        return problem
    if offsets[0] != 0 or offsets[-1] != len(drawn) or (np.diff(offsets) < 0).any():
        return problem
    return problem if drawn.min() < 0 or drawn.max() >= primitive_count else ""


def _atlas_problem(level_object: bpy.types.Object) -> str:
    size = read_atlas_size(level_object)
    images = [image for label in PBR_LABELS if (image := pbr_image(level_object, label)) is not None]
    unreadable = next((image.name for image in images if not all(image.size)), None)
    if unreadable is not None:
        return f'its image "{unreadable}" cannot be read'
    return "its images have another size than its atlas" if any(tuple(image.size) != size for image in images) else ""


def _corners_problem(quads: QuadPolygons, level_object: bpy.types.Object) -> str:
    """Check that the corners of the quads are somewhere in the scene and in the atlas."""
    if not all(np.isfinite(corners).all() for corners in quads.corners):
        return "its vertices are not finite"
    uvs = np.concatenate(quads.texel_coordinates) / read_atlas_size(level_object)
    return "" if (np.abs(uvs - 0.5) <= 0.5 + MAX_UV_EXCESS).all() else "its UV map leaves the atlas"


def _quads_problem(quads: QuadPolygons, level_object: bpy.types.Object) -> str:
    """Check the corners of the quads in the scene and in the atlas, and how the texture lies on the quads."""
    problem = _corners_problem(quads, level_object)
    if problem:
        return problem
    width, height = read_atlas_size(level_object)
    texel_count = sum(np.prod(np.ptp(np.concatenate(coordinates), axis=0) + 2.0) for _, coordinates in quads.by_quad())
    if texel_count > MAX_TEXEL_SHARING * width * height:
        return "its quads overlap in the UV map"
    pairs = zip(quads.corners, quads.texel_coordinates, strict=True)
    if any(_affine_residual(*pair) > MAX_RESIDUAL * level_object["farfield_error"] for pair in pairs):
        return "its vertices were edited"
    return ""


def _distance_problem(quads: QuadPolygons, level_object: bpy.types.Object, source: Source) -> str:
    """Check that the vertices that quads show are close to their planes; charts, that their own are close to what they show."""
    offsets, drawn = clouds.read_drawn_primitives(level_object.data)
    max_distance = MAX_PLANE_DISTANCE * level_object["farfield_error"]
    first = np.unique(quads.quad_indices, return_index=True)[1]
    centers = np.array([quads.corners[face].mean(axis=0) for face in first])
    normals = np.array([_normal(quads.corners[face]) for face in first])
    quad_of_drawn = np.repeat(np.arange(len(centers)), np.diff(offsets))
    vertices = source.points.points[drawn][:, None] if source.mesh is None else source.mesh.vertices[source.mesh.triangles[drawn]]
    distances = np.einsum("dki,di->dk", vertices - centers[quad_of_drawn, None], normals[quad_of_drawn])
    is_far = np.abs(distances).max(axis=1) > max_distance
    if quads.quads is not None and vertices.shape[1] == 3 and is_far.any():
        far_quads = np.unique(quad_of_drawn[is_far])
        charts = [quads.corners[face] for face in np.flatnonzero(np.isin(quads.quads, far_quads))]
        shown = vertices[np.isin(quad_of_drawn, far_quads)]
        is_far = closest_on_mesh(np.concatenate(charts), shown)[0] > max_distance
    return "its quads are not on the source" if is_far.any() else ""


def _affine_residual(corners: np.ndarray, texel_coordinates: np.ndarray) -> float:
    """Return the distance that remains between `corners` (C, 3) and the best affine map of `texel_coordinates` (C, 2) to them."""
    design = np.column_stack([texel_coordinates, np.ones(len(texel_coordinates))])
    affine, *_ = np.linalg.lstsq(design, corners, rcond=None)
    return float(np.abs(design @ affine - corners).max())


def _normal(corners: np.ndarray) -> np.ndarray:
    """Return the unit normal (3,) of a planar polygon (C, 3), by Newell's method; 0 if it has no area."""
    centered = corners - corners.mean(axis=0)
    normal = np.cross(centered, np.roll(centered, -1, axis=0)).sum(axis=0)
    length = np.linalg.norm(normal)
    return normal / length if length > 0.0 else normal
