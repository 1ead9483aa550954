"""Everything that one object shows as one mesh: its own surface and its instances, from geometry nodes, collections or particles."""

from collections.abc import Sequence

import bpy
import numpy as np

from ...core.errors import GeometryError
from ...core.geometry.transforms import is_invertible, is_mirroring, normalize, transform_points
from .evaluated_mesh import EvaluatedMesh, MaterialKey, MeshAttribute
from .meshes import SourceInstance, explain_no_faces, read_instances

MAX_SHEAR = 1e-4  # Cosine between axes; below, it is rounding in single precision.
MAX_TRIANGLES = 50_000_000  # Triangles of all instances together; more do not fit into the memory of most machines.


@np.errstate(over="ignore", invalid="ignore")  # A later check reports coordinates that are not finite.
def find_frame(matrix: np.ndarray) -> np.ndarray:
    """Return the matrix (4, 4) of objects that stand for one with a world matrix (4, 4): this, or its translation if it shears, as within
    turned parents with different scales, because objects without such parents cannot."""
    axes = np.array(matrix, np.float64)[:3, :3]
    products, lengths = axes.T @ axes, np.linalg.norm(axes, axis=0)
    is_sheared = (np.abs(products - np.diag(lengths**2)) > MAX_SHEAR * np.outer(lengths, lengths)).any()
    frame = np.eye(4) if is_sheared else np.array(matrix, np.float64)
    frame[:3, 3] = np.array(matrix, np.float64)[:3, 3]
    return frame


def read_joined_mesh(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> tuple[EvaluatedMesh, int]:
    """Return the evaluated mesh of an object joined with all its instances, in the space of `find_frame`, and how many meshes these are.

    An object without instances keeps its mesh as it is.

    Raises:
        GeometryError: it has no faces; it has instances and a scale of 0, a transform that is not finite, or more than MAX_TRIANGLES
            triangles.
    """
    instances = read_instances([item], depsgraph)
    if not instances:
        raise GeometryError(f'"{item.name}" has {explain_no_faces(item)}; select a mesh with a UV map and a texture.')
    matrix = find_frame(np.array(item.evaluated_get(depsgraph).matrix_world))
    if len(instances) == 1 and np.array_equal(instances[0].matrix, matrix):
        return instances[0].mesh, 1
    count = sum(len(instance.mesh.triangles) for instance in instances)
    if count > MAX_TRIANGLES:
        raise GeometryError(f'The {len(instances):,} instances of "{item.name}" have {count:,} triangles; show fewer of them.')
    if not is_invertible(matrix):
        raise GeometryError(f'"{item.name}" has instances, and a scale of 0 or a transform that is not finite; give it another one.')
    return join_instances(instances, np.linalg.inv(matrix)), len(instances)


def join_instances(instances: Sequence[SourceInstance], to_object: np.ndarray) -> EvaluatedMesh:
    """Return one mesh of all `instances`, with the attributes of any of them; they are 0 where others lack them, as in renders.

    to_object: (4, 4), from the world to the space of the result. Mirrored instances keep their fronts outside.
    """
    matrices = [to_object @ instance.matrix for instance in instances]
    is_mirrored = [bool(is_mirroring(matrix)) for matrix in matrices]
    parts = [instance.mesh for instance in instances]
    materials: dict[MaterialKey | None, int] = {}
    slots = [np.array([materials.setdefault(key, len(materials)) for key in mesh.materials], np.int32) for mesh in parts]
    starts = np.cumsum([[0, 0, 0], *([len(mesh.vertices), len(mesh.normals), int(mesh.polygons.max()) + 1] for mesh in parts)], axis=0)
    uv_map = _name_uv_map(parts)
    names = dict.fromkeys([*([uv_map] if uv_map else []), *(name for mesh in parts for name in mesh.attributes)])

    def offset(name: str, column: int) -> np.ndarray:
        """Return indices of all parts, (T,) or those of corners (T, 3), which go around mirrored triangles in the other direction."""
        arrays = [getattr(mesh, name) for mesh in parts]
        turned = [array[:, ::-1] if flips and array.ndim == 2 else array for array, flips in zip(arrays, is_mirrored, strict=True)]
        return np.concatenate([array + start for array, start in zip(turned, starts[:-1, column].tolist(), strict=True)]).astype(np.int32)

    with np.errstate(over="ignore", invalid="ignore"):  # A later check reports coordinates that are not finite.
        vertices = [transform_points(matrix, mesh.vertices) for matrix, mesh in zip(matrices, parts, strict=True)]
        normals = [_transform_normals(matrix, mesh.normals) for matrix, mesh in zip(matrices, parts, strict=True)]
    return EvaluatedMesh(
        vertices=np.concatenate(vertices).astype(np.float32),
        triangles=offset("triangles", 0),
        loops=offset("loops", 1),
        polygons=offset("polygons", 2),
        normals=np.concatenate(normals).astype(np.float32),
        generated=np.concatenate([mesh.generated for mesh in parts]),
        material_indices=np.concatenate([slot[mesh.material_indices] for slot, mesh in zip(slots, parts, strict=True)]),
        materials=tuple(materials),
        attributes={name: _join_attribute(parts, name, name == uv_map) for name in names},
        uv_map=uv_map,
        color=next((mesh.color for mesh in parts if mesh.color), ""),
    )


def _transform_normals(matrix: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return unit normals (N, 3) of a surface that `matrix` (4, 4) transforms, zero where it flattens the surface."""
    rows = matrix[:3, :3]
    cofactors = np.cross(rows[[1, 2, 0]], rows[[2, 0, 1]])
    return normalize(np.sign(np.linalg.det(rows)) * (normals.astype(np.float64) @ cofactors.T))


def _name_uv_map(meshes: Sequence[EvaluatedMesh]) -> str:
    """Return a name for the UV maps that render, that of the first mesh with one, unless another mesh has a further UV map of this name."""
    name = next((mesh.uv_map for mesh in meshes if mesh.uv_map), "")
    while name and any(name != mesh.uv_map and name in mesh.attributes for mesh in meshes if mesh.uv_map):
        name += " joined"
    return name


def _join_attribute(meshes: Sequence[EvaluatedMesh], name: str, is_uv_map: bool) -> MeshAttribute:
    found = [mesh.attributes.get(mesh.uv_map if is_uv_map else name) for mesh in meshes]
    present = [attribute for attribute in found if attribute is not None]
    domains, width = {attribute.domain for attribute in present}, present[0].values.shape[1]
    domain = domains.pop() if len(domains) == 1 else "CORNER"
    values = []
    for mesh, attribute in zip(meshes, found, strict=True):
        rows = {"POINT": len(mesh.vertices), "CORNER": len(mesh.normals), "FACE": int(mesh.polygons.max()) + 1}[domain]
        part = np.zeros((rows, width), np.float32)
        if attribute is not None and attribute.values.shape[1] == width:
            if attribute.domain == domain:
                part[:] = attribute.values[:rows]
            else:
                part[mesh.loops] = mesh.at_corners(mesh.uv_map if is_uv_map else name, np.arange(len(mesh.triangles)))
        values.append(part)
    return MeshAttribute(domain, np.concatenate(values))
