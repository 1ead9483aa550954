"""Out of Blender: evaluated objects and point clouds as one source in world space."""

from collections.abc import Container, Iterator
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.errors import GeometryError
from ..core.mesh import PointCloud, TriangleMesh, check_points, fingerprint
from ..core.points import estimate_normals, splat_radii
from .surfaces import MaterialKey, MeshAttribute, Surface, read_surface

SURFACE_TYPES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}
POINT_NORMALS = ("normal", "Normal", "normals", "N")
DISC_CORNERS = 6


@dataclass(frozen=True)
class SourcePart:
    """One object, or one instance that an object makes, and the primitives of the source that it owns.

    name: the selected object. matrix (4, 4) float64: object to world. first: index of its first primitive in the source; it owns
    `len(surface.triangles) / triangles_per_primitive` of them. random: what Object Info > Random says, 0..1.
    """

    name: str
    surface: Surface
    matrix: np.ndarray
    first: int
    random: float = 0.0

    @property
    def mirrored(self) -> bool:
        """Whether the matrix turns the surface inside out, so that its triangles are wound the other way in the source."""
        return bool(np.linalg.det(self.matrix[:3, :3]) < 0.0)


@dataclass(frozen=True)
class Source:
    """What one cloud is made of, in world space. Either `mesh` or `points` is there.

    A triangle keeps its number through `mesh`, `parts` and the cloud's `Quads.drawn`. skipped: names of objects that were left out and why.
    origin (3,): the first object's. triangles_per_primitive: 1, or the triangles of the disc that is drawn for a point.
    """

    mesh: TriangleMesh | None
    parts: list[SourcePart]
    name: str
    skipped: list[str]
    origin: np.ndarray
    points: PointCloud | None = None

    @property
    def geometry(self) -> TriangleMesh | PointCloud:
        """What the core works on."""
        return self.points if self.mesh is None else self.mesh

    @property
    def fingerprint(self) -> str:
        """Tells whether a geometry is the one that a cloud was built from."""
        if self.mesh is None:
            return fingerprint(self.points.points, np.arange(len(self.points.points)))
        return fingerprint(self.mesh.vertices, self.mesh.triangles)

    @property
    def triangles_per_primitive(self) -> int:
        """Triangles of the parts' surfaces that one primitive of the source is drawn with."""
        return DISC_CORNERS - 2 if self.mesh is None else 1

    @property
    def materials(self) -> list[bpy.types.Material]:
        """Every material of the parts, once."""
        keys = dict.fromkeys(key for part in self.parts for key in part.surface.materials if key is not None)
        return [bpy.data.materials[key] for key in keys]


def take(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> Source:
    """The evaluated surfaces of `objects` and of the instances they make, as one soup in world space.

    Modifiers, shape keys, transforms and the state of Edit Mode are in it; a mirrored object is turned right side out. Objects without a
    surface and hidden ones are left out and named in `skipped`; one that is only disabled in renders is taken.

    Raises:
        GeometryError: when no object has a face.
    """
    reasons = {candidate: _refusal(candidate) for candidate in objects}
    skipped = [f"{candidate.name} ({reason})" for candidate, reason in reasons.items() if reason]
    accepted = [candidate for candidate, reason in reasons.items() if not reason]
    _leave_edit_data(accepted, depsgraph)
    parts = parts_of(accepted, depsgraph)
    with_faces = {part.name for part in parts}
    skipped += [f"{candidate.name} (no faces)" for candidate in accepted if candidate.name not in with_faces]
    if not parts:
        raise GeometryError(f"Nothing to work on: {'; '.join(skipped) or 'no object was given'}. Choose a visible object with faces.")
    first = next(candidate for candidate in accepted if candidate.name in with_faces)
    origin = np.array(first.evaluated_get(depsgraph).matrix_world.translation)
    return Source(world_mesh(parts), parts, first.name, skipped, origin)


def take_points(point_object: bpy.types.Object) -> Source:
    """A mesh object with vertices but no faces, as oriented discs in world space.

    Normals come from a point attribute called normal (or N), radii from one called radius, colours from the default colour
    attribute; missing normals and radii are estimated from the neighbours.

    Raises:
        GeometryError: when the object is no mesh, has no vertices or has faces.
    """
    if point_object.type != "MESH":
        raise GeometryError(f'"{point_object.name}" is not a mesh; a point cloud is a mesh object with vertices and no faces.')
    depsgraph = bpy.context.evaluated_depsgraph_get()
    _leave_edit_data([point_object], depsgraph)
    evaluated = point_object.evaluated_get(depsgraph)
    try:
        mesh = evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
        if len(mesh.polygons):
            raise GeometryError(f'"{point_object.name}" has faces; it is a mesh, not a point cloud.')
        surface, matrix = read_surface(mesh, evaluated), np.array(evaluated.matrix_world, np.float64)
    finally:
        evaluated.to_mesh_clear()
    points = surface.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    check_points(points, point_object.name)
    cloud = PointCloud(points, _point_normals(surface, matrix, points), _point_radii(surface, matrix, points), _point_colors(surface))
    part = SourcePart(point_object.name, _discs(cloud, surface.materials), np.eye(4), 0)
    return Source(None, [part], point_object.name, [], matrix[:3, 3].copy(), cloud)


def shown_surfaces(
    owners: Container[str], depsgraph: bpy.types.Depsgraph
) -> Iterator[tuple[bpy.types.Object, bpy.types.DepsgraphObjectInstance]]:
    """What objects with names (`name_full`) in `owners` show, themselves or as instances that they make: the original of the owner, and
    the instance, which is only good until the next one comes."""
    for instance in depsgraph.object_instances:
        owner = (instance.parent if instance.is_instance else instance.object).original
        if owner.name_full in owners and instance.object.type in SURFACE_TYPES and (instance.is_instance or instance.show_self):
            yield owner, instance


@np.errstate(invalid="ignore")  # infinite coordinates pass: there is a sentence for them later
def world_mesh(parts: list[SourcePart]) -> TriangleMesh:
    """One soup of all `parts`; a material's index is its place among the distinct materials of the parts, -1 for none."""
    vertices, triangles, materials = [], [], []
    known: dict[MaterialKey, int] = {}
    offset = 0
    for part in parts:
        surface = part.surface
        vertices.append(surface.vertices.astype(np.float64) @ part.matrix[:3, :3].T + part.matrix[:3, 3])
        triangles.append((surface.triangles[:, ::-1] if part.mirrored else surface.triangles) + offset)
        numbers = [-1 if key is None else known.setdefault(key, len(known)) for key in surface.materials]
        materials.append(np.array(numbers, np.int32)[surface.material_indices])
        offset += len(surface.vertices)
    return TriangleMesh(np.concatenate(vertices), np.concatenate(triangles).astype(np.int32), np.concatenate(materials))


def _refusal(candidate: bpy.types.Object) -> str:
    """Why this object is left out, or nothing."""
    makes_instances = candidate.type == "EMPTY" and candidate.instance_type == "COLLECTION"
    if candidate.type not in SURFACE_TYPES and not makes_instances:
        return f"a {candidate.type.replace('_', ' ').lower()} has no faces"
    return "" if candidate.visible_get() else "hidden"


def _leave_edit_data(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> None:
    """Write what is being edited into the meshes, without leaving Edit Mode, and bring `depsgraph` up to date."""
    for edited in objects:
        if edited.mode == "EDIT" and edited.type == "MESH":
            edited.update_from_editmode()
            edited.data.update_tag()
    depsgraph.update()


def parts_of(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> list[SourcePart]:
    """What `objects` and the instances that they make show, evaluated: those of each object together, in the order of `objects`."""
    surfaces: dict[int, Surface] = {}
    wanted = {candidate.name_full: [] for candidate in objects}
    for owner, instance in shown_surfaces(wanted, depsgraph):
        key = instance.object.data.as_pointer() if instance.is_instance else instance.object.as_pointer()
        if key not in surfaces:
            surfaces[key] = _surface(instance.object, depsgraph)
        if len(surfaces[key].triangles):
            matrix = np.array(instance.matrix_world, np.float64)
            wanted[owner.name_full].append((owner.name, surfaces[key], matrix, instance.random_id / 0xFFFFFFFF))
    parts, first = [], 0
    for name, surface, matrix, random in (made for owned in wanted.values() for made in owned):
        parts.append(SourcePart(name, surface, matrix, first, random))
        first += len(surface.triangles)
    return parts


def _surface(instance_object: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Surface:
    if isinstance(instance_object.data, bpy.types.Mesh) and instance_object.mode != "EDIT":
        return read_surface(instance_object.data, instance_object)
    try:
        return read_surface(instance_object.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph), instance_object)
    finally:
        instance_object.to_mesh_clear()


def _point_normals(surface: Surface, matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    name = next((name for name in POINT_NORMALS if name in surface.attributes), None)
    if name is None or surface.attributes[name].values.shape != points.shape:
        return estimate_normals(points)
    normals = surface.attributes[name].values.astype(np.float64) @ np.linalg.inv(matrix[:3, :3])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    if (lengths > 0.0).all():
        return normals / lengths
    return np.where(lengths > 0.0, normals / np.where(lengths > 0.0, lengths, 1.0), estimate_normals(points))


def _point_radii(surface: Surface, matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    if "radius" not in surface.attributes:
        return splat_radii(points)
    return surface.attributes["radius"].values[:, 0].astype(np.float64) * abs(np.linalg.det(matrix[:3, :3])) ** (1.0 / 3.0)


def _point_colors(surface: Surface) -> np.ndarray | None:
    if surface.color == "" or surface.attributes[surface.color].domain != "POINT":
        return None
    return surface.attributes[surface.color].values


def _discs(cloud: PointCloud, materials: tuple[MaterialKey | None, ...]) -> Surface:
    """A hexagon of the same area as its disc for every point, as fans of triangles in the order of the points."""
    helper = np.where(np.abs(cloud.normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    across = np.cross(helper, cloud.normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(cloud.normals, across)
    angles = np.arange(DISC_CORNERS) * 2.0 * np.pi / DISC_CORNERS
    reach = cloud.radii * np.sqrt(np.pi / (0.5 * DISC_CORNERS * np.sin(2.0 * np.pi / DISC_CORNERS)))
    ring = np.cos(angles)[None, :, None] * across[:, None] + np.sin(angles)[None, :, None] * along[:, None]
    vertices = (cloud.points[:, None] + reach[:, None, None] * ring).reshape(-1, 3).astype(np.float32)
    fan = np.array([[0, corner, corner + 1] for corner in range(1, DISC_CORNERS - 1)])
    triangles = (fan[None] + DISC_CORNERS * np.arange(len(cloud.points))[:, None, None]).reshape(-1, 3).astype(np.int32)
    attributes, color = {}, ""
    if cloud.colors is not None:
        color = "Color"
        attributes[color] = MeshAttribute("POINT", np.repeat(cloud.colors, DISC_CORNERS, axis=0).astype(np.float32))
    return Surface(
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
