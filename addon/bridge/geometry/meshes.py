"""Read evaluated objects and point clouds from Blender as one source in world space."""

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...core.errors import GeometryError
from ...core.geometry.mesh import MAX_COORDINATE, PointCloud, TriangleMesh, check_points, fingerprint
from ...core.geometry.points import estimate_normals, splat_radii
from ...core.geometry.transforms import frames_from_normals, is_invertible, is_mirroring, normalize, transform_points
from ...core.messages import format_count
from .evaluated_mesh import EvaluatedMesh, MaterialKey, MeshAttribute, read_evaluated_mesh
from .instance_attributes import NO_NUMBER, InstanceAttributes
from .object_random import compute_object_random, read_random_id

SURFACE_TYPES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}
NORMAL_ATTRIBUTES = ("normal", "Normal", "normals", "N")  # A point cloud's normals: the first one found counts.
DISC_CORNERS = 6


@dataclass(frozen=True)
class SourceInstance:
    """One object, or one instance made by an object, and its primitives in the source.

    Attributes:
        name: the selected object.
        mesh: its mesh in object space.
        matrix: (4, 4) float64, object to world.
        first_primitive: index of its first primitive in the source; it has `len(mesh.triangles) / triangles_per_primitive` of them.
        random: the value of Object Info > Random, 0..1.
        object_uid: session UID of the selected object, which stays when it is renamed.
        part: the name of the object that is instanced, "" for the selected object itself.
        attributes: those that Geometry Nodes give to the instance, by name; one to four numbers each.
    """

    name: str
    mesh: EvaluatedMesh
    matrix: np.ndarray
    first_primitive: int
    random: float = 0.0
    object_uid: int = 0
    part: str = ""
    attributes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def is_mirrored(self) -> bool:
        """Whether the matrix mirrors the mesh; its triangles then have the opposite winding in the source."""
        return bool(is_mirroring(self.matrix))


@dataclass(frozen=True)
class Source:
    """The source of one cloud, in world space. A triangle keeps its index in `mesh`, `instances` and the cloud's `Quads.drawn`.

    Attributes:
        mesh, points: the surface; one of them is set.
        instances: the objects that it consists of.
        name: that of the cloud.
        skipped: names of skipped objects, with the reason.
        origin: (3,), that of the first object.
    """

    mesh: TriangleMesh | None
    instances: list[SourceInstance]
    name: str
    skipped: list[str]
    origin: np.ndarray
    points: PointCloud | None = None

    @property
    def geometry(self) -> TriangleMesh | PointCloud:
        """The input of the core."""
        return self.points if self.mesh is None else self.mesh

    @property
    def bounding_sphere(self) -> tuple[np.ndarray, float]:
        """The center (3,) of the bounding box, and the distance of the farthest point from it."""
        points = self.points.points if self.mesh is None else self.mesh.vertices
        center = 0.5 * (points.min(axis=0) + points.max(axis=0))
        return center, float(np.linalg.norm(points - center, axis=1).max())

    @property
    def fingerprint(self) -> str:
        """Digest that shows whether a geometry is the one that a cloud was built from."""
        if self.mesh is None:
            return fingerprint(self.points.points, np.arange(len(self.points.points)))
        return fingerprint(self.mesh.vertices, self.mesh.triangles)

    @property
    def triangles_per_primitive(self) -> int:
        """Number of triangles in the instances' meshes per primitive of the source."""
        return DISC_CORNERS - 2 if self.mesh is None else 1

    @property
    def materials(self) -> list[bpy.types.Material]:
        """Every material of the instances, once.

        Raises:
            GeometryError: a material was renamed or removed after the source was read.
        """
        keys = dict.fromkeys(key for instance in self.instances for key in instance.mesh.materials if key is not None)
        return [find_material(key) for key in keys]


def find_material(key: MaterialKey) -> bpy.types.Material:
    """Return the material with the name and library of `key`.

    Raises:
        GeometryError: it was renamed or removed after `key` was read.
    """
    material = bpy.data.materials.get(key)
    if material is None:
        raise GeometryError(f'The material "{key[0]}" was renamed or removed before its appearance was captured; start again.')
    return material


def read_source(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> Source:
    """Read the evaluated surfaces of `objects` and of their instances as one soup in world space.

    Includes modifiers, shape keys, transforms and the state of Edit Mode; mirrored objects are turned right side out. Objects without
    faces and hidden objects are skipped and listed in `skipped`; objects that are only disabled in renders are read.

    Raises:
        GeometryError: no object has a face.
    """
    reasons = {candidate: _skip_reason(candidate) for candidate in objects}
    skipped = [f"{candidate.name} ({reason})" for candidate, reason in reasons.items() if reason]
    accepted = [candidate for candidate, reason in reasons.items() if not reason]
    _flush_edit_mode(accepted, depsgraph)
    instances = read_instances(accepted, depsgraph)
    with_faces = {instance.name for instance in instances}
    skipped += [f"{candidate.name} ({explain_no_faces(candidate)})" for candidate in accepted if candidate.name not in with_faces]
    if not instances:
        raise GeometryError(f"Nothing to work on: {'; '.join(skipped) or 'no object was given'}. Choose a visible object with faces.")
    first = next(candidate for candidate in accepted if candidate.name in with_faces)
    origin = np.array(first.evaluated_get(depsgraph).matrix_world.translation)
    return Source(concatenate_in_world_space(instances), instances, first.name, skipped, origin)


def read_point_cloud(point_object: bpy.types.Object) -> Source:
    """Read a mesh object with vertices but no faces as oriented discs in world space.

    Normals come from a point attribute called normal (or N), radii from one called radius, colors from the default color attribute;
    missing normals and radii are estimated from the neighbors.

    Raises:
        GeometryError: the object is not a mesh, has no vertices, or has faces; coordinates or radii are not finite or too large.
    """
    if point_object.type != "MESH":
        raise GeometryError(f'"{point_object.name}" is not a mesh; a point cloud is a mesh object with vertices and no faces.')
    depsgraph = bpy.context.evaluated_depsgraph_get()
    _flush_edit_mode([point_object], depsgraph)
    evaluated = point_object.evaluated_get(depsgraph)
    try:
        data = evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
        if len(data.polygons):
            raise GeometryError(f'"{point_object.name}" has faces; it is a mesh, not a point cloud.')
        mesh, matrix = read_evaluated_mesh(data, evaluated), np.array(evaluated.matrix_world, np.float64)
    finally:
        evaluated.to_mesh_clear()
    with np.errstate(over="ignore", invalid="ignore"):  # the check reports coordinates that are not finite
        points = transform_points(matrix, mesh.vertices)
    check_points(points, point_object.name)
    cloud = PointCloud(points, _point_normals(mesh, matrix, points), _point_radii(mesh, matrix, points), _point_colors(mesh))
    is_too_large = np.isfinite(cloud.radii) & (np.abs(cloud.radii) > MAX_COORDINATE)
    if is_too_large.any():
        count = format_count(int(is_too_large.sum()), "point")
        raise GeometryError(f'"{point_object.name}" has {count} with a radius above {MAX_COORDINATE:g}; correct them.')
    instance = SourceInstance(point_object.name, _build_discs(cloud, mesh.materials), np.eye(4), 0, object_uid=point_object.session_uid)
    return Source(None, [instance], point_object.name, [], matrix[:3, 3].copy(), cloud)


def describe_type(item: bpy.types.Object) -> str:
    """Return the type of an object with its article: "a camera", "an empty"."""
    kind = item.type.replace("_", " ").lower()
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def is_collection_instance(item: bpy.types.Object) -> bool:
    """Return whether an object is an Empty that shows a collection."""
    return item.type == "EMPTY" and item.instance_type == "COLLECTION"


def may_have_surface(item: bpy.types.Object) -> bool:
    """Return whether the type of `item` can have faces or points: a mesh, a curve and the like, or a collection instance."""
    return item.type in SURFACE_TYPES or is_collection_instance(item)


def explain_no_faces(item: bpy.types.Object) -> str:
    """Return that an object shows no faces, and why if something is missing."""
    collection = item.instance_collection if is_collection_instance(item) else None
    if collection is not None and collection.is_missing:
        return f'no faces, because the library "{collection.library.filepath}" is missing'
    return "no faces"


def is_in_view_layer(item: bpy.types.Object, view_layer: bpy.types.ViewLayer) -> bool:
    """Return whether `item` is in `view_layer`: neither only in excluded collections nor only in other scenes."""
    found = view_layer.objects.get(item.name)
    return found == item or (found is not None and item in set(view_layer.objects))  # a linked and a local object may share a name


def visible_meshes(
    owners: Container[str], depsgraph: bpy.types.Depsgraph
) -> Iterator[tuple[bpy.types.Object, bpy.types.DepsgraphObjectInstance]]:
    """Yield the visible surfaces of the objects with names (`name_full`) in `owners`: themselves or their instances.

    Yields the original of the owner, and the instance, which is valid only until the next one is requested. Curves, texts and metaballs
    show their surface as an instance of a mesh.
    """
    for instance in depsgraph.object_instances:
        owner = (instance.parent if instance.is_instance else instance.object).original
        if owner.name_full in owners and instance.object.type == "MESH" and (instance.is_instance or instance.show_self):
            yield owner, instance


@np.errstate(over="ignore", invalid="ignore")  # infinite coordinates pass: a later check reports them
def concatenate_in_world_space(instances: list[SourceInstance]) -> TriangleMesh:
    """Return one soup of all `instances`; material indices refer to the distinct materials in order of first use, -1 for none.

    Raises:
        GeometryError: there are none.
    """
    if not instances:
        raise GeometryError("No object with faces can be seen; show it in the viewport and in its collections.")
    vertices, triangles, materials = [], [], []
    material_indices: dict[MaterialKey, int] = {}
    offset = 0
    for instance in instances:
        mesh = instance.mesh
        vertices.append(transform_points(instance.matrix, mesh.vertices))
        triangles.append((mesh.triangles[:, ::-1] if instance.is_mirrored else mesh.triangles) + offset)
        indices = [-1 if key is None else material_indices.setdefault(key, len(material_indices)) for key in mesh.materials]
        materials.append(np.array(indices, np.int32)[mesh.material_indices])
        offset += len(mesh.vertices)
    return TriangleMesh(np.concatenate(vertices), np.concatenate(triangles).astype(np.int32), np.concatenate(materials))


def _skip_reason(candidate: bpy.types.Object) -> str:
    """Return why this object is skipped, or an empty string."""
    if not may_have_surface(candidate):
        return f"{describe_type(candidate)} has no faces"
    if not is_in_view_layer(candidate, bpy.context.view_layer):
        return "not in the view layer"
    return "" if candidate.visible_get() else "hidden"


def _flush_edit_mode(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> None:
    """Write Edit Mode changes to the meshes, without leaving Edit Mode, and update `depsgraph`."""
    for edited in objects:
        if edited.mode == "EDIT" and edited.type == "MESH":
            edited.update_from_editmode()
            edited.data.update_tag()
    depsgraph.update()


def read_instances(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> list[SourceInstance]:
    """Read the evaluated surfaces of `objects` and of their instances, grouped by object in the order of `objects`."""
    meshes: dict[int, EvaluatedMesh] = {}
    found_by_owner, instance_attributes = {candidate.name_full: [] for candidate in objects}, InstanceAttributes()
    for owner, instance in visible_meshes(found_by_owner, depsgraph):
        key = instance.object.data.as_pointer() if instance.is_instance else instance.object.as_pointer()
        if key not in meshes:
            meshes[key] = read_mesh(instance.object, depsgraph)
        if len(meshes[key].triangles):
            matrix = np.array(instance.matrix_world, np.float64)
            part = "" if _is_own_surface(owner, instance) else instance.object.name
            values = instance_attributes.find(instance.parent, instance.persistent_id) if instance.is_instance else {}
            random = read_random_id(instance.random_id) if instance.is_instance else compute_object_random(owner.name)
            found_by_owner[owner.name_full].append((owner, meshes[key], matrix, random, part, values))
    instances, first_primitive = [], 0
    for owner, mesh, matrix, random, part, values in (item for items in found_by_owner.values() for item in items):
        instances.append(SourceInstance(owner.name, mesh, matrix, first_primitive, random, owner.session_uid, part, values))
        first_primitive += len(mesh.triangles)
    return instances


def _is_own_surface(owner: bpy.types.Object, instance: bpy.types.DepsgraphObjectInstance) -> bool:
    """Return whether an instance is the surface of its owner itself: curves, texts and metaballs have a mesh as an instance."""
    is_converted = owner.type != "MESH" and instance.object.original == owner and instance.persistent_id[1] == NO_NUMBER
    return not instance.is_instance or is_converted


def read_mesh(evaluated: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> EvaluatedMesh:
    """Read the surface of an evaluated object itself, without its instances."""
    if isinstance(evaluated.data, bpy.types.Mesh) and evaluated.mode != "EDIT":
        return read_evaluated_mesh(evaluated.data, evaluated)
    try:
        return read_evaluated_mesh(evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph), evaluated)
    finally:
        evaluated.to_mesh_clear()


def _point_normals(mesh: EvaluatedMesh, matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    name = next((name for name in NORMAL_ATTRIBUTES if name in mesh.attributes), None)
    if name is None or mesh.attributes[name].values.shape != points.shape or not is_invertible(matrix):
        return estimate_normals(points)
    normals = mesh.attributes[name].values.astype(np.float64) @ np.linalg.inv(matrix[:3, :3])
    is_known = np.linalg.norm(normals, axis=1) > 0.0
    return normalize(normals) if is_known.all() else np.where(is_known[:, None], normalize(normals), estimate_normals(points))


def _point_radii(mesh: EvaluatedMesh, matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    radius = mesh.attributes.get("radius")
    if radius is None or radius.domain != "POINT" or not is_invertible(matrix):
        return splat_radii(points)
    return radius.values[:, 0].astype(np.float64) * abs(np.linalg.det(matrix[:3, :3])) ** (1.0 / 3.0)


def _point_colors(mesh: EvaluatedMesh) -> np.ndarray | None:
    color = mesh.attributes.get(mesh.color)
    return None if color is None or color.domain != "POINT" or color.values.shape[1] != 4 else color.values


def _build_discs(cloud: PointCloud, materials: tuple[MaterialKey | None, ...]) -> EvaluatedMesh:
    """Return a hexagon with the area of its disc for every point, as triangle fans in the order of the points."""
    helpers = np.where(np.abs(cloud.normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u, v, _ = np.moveaxis(frames_from_normals(cloud.normals, helpers), 1, 0)
    angles = np.arange(DISC_CORNERS) * 2.0 * np.pi / DISC_CORNERS
    radii = cloud.radii * np.sqrt(np.pi / (0.5 * DISC_CORNERS * np.sin(2.0 * np.pi / DISC_CORNERS)))
    ring = np.cos(angles)[None, :, None] * u[:, None] + np.sin(angles)[None, :, None] * v[:, None]
    with np.errstate(over="ignore", invalid="ignore"):  # points whose radius is not finite are left out later
        vertices = (cloud.points[:, None] + radii[:, None, None] * ring).reshape(-1, 3).astype(np.float32)
    fan = np.array([[0, corner, corner + 1] for corner in range(1, DISC_CORNERS - 1)])
    triangles = (fan[None] + DISC_CORNERS * np.arange(len(cloud.points))[:, None, None]).reshape(-1, 3).astype(np.int32)
    attributes, color = {}, ""
    if cloud.colors is not None:
        color = "Color"
        attributes[color] = MeshAttribute("POINT", np.repeat(cloud.colors, DISC_CORNERS, axis=0).astype(np.float32))
    return EvaluatedMesh(
        vertices=vertices,
        triangles=triangles,
        loops=triangles,
        polygons=np.arange(len(triangles), dtype=np.int32),
        normals=np.repeat(cloud.normals, DISC_CORNERS, axis=0).astype(np.float32),
        generated=vertices,
        material_indices=np.zeros(len(triangles), np.int32),
        materials=materials,
        attributes=attributes,
        uv_map="",
        color=color,
    )
