"""Objects with a texture as textured meshes, with everything that their levels carry."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.geometry.edges import find_edges
from ...core.geometry.local_origin import describe_coarseness, find_local_origin
from ...core.geometry.mesh import TriangleMesh, face_areas_and_normals
from ...core.geometry.transforms import signed_areas
from ...core.messages import format_count, quote_names
from ...core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from ..geometry.evaluated_mesh import EvaluatedMesh
from ..geometry.joined_meshes import find_frame, read_joined_mesh
from ..geometry.meshes import find_material
from .color_images import find_color_images, read_color_image, read_plain_color
from .rigs import Rig, at_rest, describe_frozen, has_rig, read_rig


@dataclass(frozen=True)
class TexturedSource:
    """One object that levels are made from.

    Attributes:
        name, object_uid: of the object.
        mesh: in object space, relative to `origin`.
        origin: (3,), zero unless the mesh is far from the origin of the object.
        evaluated: what `mesh.sources` refers to: row 3 t + c is corner c of its triangle t.
        uv_map: the UV map that the levels get.
        attributes: names and widths of those of the mesh, in their order: normals of smooth faces, and color attributes at corners.
        textures: (H, W, 3) float32 scene-linear by material, None where there is none.
        remarks: sentences about what was read in another way than a user may expect.
        rig: what deforms the mesh, which is at rest; None for a mesh with its current shape.
    """

    name: str
    object_uid: int
    mesh: TexturedMesh
    origin: np.ndarray
    evaluated: EvaluatedMesh
    uv_map: str
    attributes: tuple[tuple[str, int], ...]
    textures: tuple[np.ndarray | None, ...]
    remarks: tuple[str, ...]
    rig: Rig | None = None


NORMALS = "custom_normal"  # the attribute with the normals of smooth faces


def read_textured_source(
    item: bpy.types.Object,
    depsgraph: bpy.types.Depsgraph,
    has_attributes: bool = True,
    read_image: Callable[[bpy.types.Image], tuple[np.ndarray, bool]] = read_color_image,
) -> TexturedSource:
    """Read the evaluated mesh of an object, with modifiers, shape keys and all instances that the object makes, in object space, and the
    images that color its materials.

    has_attributes: whether normals and color attributes are read, too. read_image: see `read_color_image`.

    Raises:
        GeometryError: it has no faces or no area, or values that are not finite; see also `read_joined_mesh`.
        FileError: an image is missing.
    """
    evaluated, mesh_count = read_joined_mesh(item, depsgraph)
    source = build_textured_source(item, evaluated, item.name, has_attributes, read_image)
    remark = f'The levels of "{item.name}" are one mesh, joined from {mesh_count:,} instances.'
    return replace(source, remarks=(remark, *source.remarks)) if mesh_count > 1 else source


def build_textured_source(
    item: bpy.types.Object,
    evaluated: EvaluatedMesh,
    name: str,
    has_attributes: bool = True,
    read_image: Callable[[bpy.types.Image], tuple[np.ndarray, bool]] = read_color_image,
) -> TexturedSource:
    """Return a mesh that `item` shows as a source with a name. Raises the errors of `read_textured_source`."""
    uv_map, textures, remarks = _read_textures(name, evaluated, read_image)
    count = len(evaluated.triangles)
    corner_uvs = evaluated.at_corners(uv_map, np.arange(count)) if uv_map else np.zeros((count, 3, 2), np.float32)
    values, attributes = _read_corner_values(evaluated) if has_attributes else (None, ())
    origin = find_local_origin(evaluated.vertices)
    origin = np.zeros(3) if origin is None else origin
    mesh = TriangleMesh(evaluated.vertices - origin, evaluated.triangles, evaluated.material_indices)
    textured = build_textured_mesh(mesh, corner_uvs, values, name, (NORMALS, 3) in attributes)
    remarks = [
        *remarks,
        *filter(None, [describe_coarseness(evaluated.vertices, f'"{name}"', "it")]),
        *_describe_edges(name, textured),
        *_describe_uvs(name, textured, bool(uv_map)),
    ]
    return TexturedSource(name, item.session_uid, textured, origin, evaluated, uv_map, attributes, textures, tuple(remarks))


def read_source_at_rest(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> TexturedSource:
    """Read an object as `read_textured_source` does, but without the deformation by its armatures and shape keys, and with its rig. Objects
    that make instances, and those whose shape keys change the number of vertices, have their current shape and no rig."""
    if has_rig(item):
        with at_rest(item, depsgraph):
            source = read_textured_source(item, depsgraph)
            evaluated = item.evaluated_get(depsgraph)
            if len(evaluated.data.vertices) == len(source.evaluated.vertices):
                matrix = np.array(evaluated.matrix_world)
                to_object = np.linalg.solve(find_frame(matrix), matrix)[:3, :3]
                rig = read_rig(item, depsgraph, to_object)
                if rig is not None:
                    return replace(source, rig=rig, remarks=(*source.remarks, *describe_frozen(item, rig)))
    source = read_textured_source(item, depsgraph)
    return replace(source, remarks=(*source.remarks, *describe_frozen(item)))


def _read_textures(
    owner: str, mesh: EvaluatedMesh, read_image: Callable[[bpy.types.Image], tuple[np.ndarray, bool]]
) -> tuple[str, tuple[np.ndarray | None, ...], list[str]]:
    """Return the UV map of the textures, the texture of each material, and remarks."""
    all_found = [find_color_images(None if key is None else find_material(key)) for key in mesh.materials]
    found = [images[0] if images else (None, "") for images in all_found]
    names = dict.fromkeys(name or mesh.uv_map for image, name in found if image is not None)
    uv_maps = [name for name in names if name in mesh.attributes and mesh.attributes[name].domain == "CORNER"]
    uv_map = uv_maps[0] if uv_maps else mesh.uv_map
    remarks, textures, read = [], [], {}
    if len(uv_maps) > 1:
        remarks.append(f'The images of "{owner}" use several UV maps; only "{uv_map}" counts, the others are carried.')
    for image, name in found:
        if image is None or (name or mesh.uv_map) != uv_map:
            textures.append(None)
            continue
        if image.source == "TILED":
            remarks.append(f'Of the UDIM image "{image.name}" only the first tile counts.')
        if image.name not in read:
            read[image.name], is_scaled = read_image(image)
            if is_scaled:
                height, width = read[image.name].shape[:2]
                remarks.append(f'The image "{image.name}" is analyzed at {width} by {height} pixels.')
        textures.append(read[image.name])
    textures, has_colors = _add_plain_colors(textures, mesh, [image is not None for image, _ in found])
    if not read:
        remarks.append(f'"{owner}" has no image texture; only its geometry{" and plain colors count" if has_colors else " counts"}.')
    mixed = [images[0][0].name for images in all_found if len(images) > 1]
    if mixed:
        remarks.append(f'Materials of "{owner}" mix images; only {quote_names(dict.fromkeys(mixed))} counts, bake them to count all.')
    return uv_map, tuple(textures), remarks


def _add_plain_colors(
    textures: Sequence[np.ndarray | None], mesh: EvaluatedMesh, has_image: Sequence[bool]
) -> tuple[list[np.ndarray | None], bool]:
    """Return `textures`, with images of one pixel for the materials that have a constant color and no image, and whether there are such
    images. An object in a single color has none."""
    keys = [None if is_found else key for key, is_found in zip(mesh.materials, has_image, strict=True)]
    colors = [None if key is None else read_plain_color(find_material(key)) for key in keys]
    distinct = {texture.tobytes() for texture in (*textures, *colors) if texture is not None}
    if len(distinct) < 2:
        return list(textures), False
    return [color if texture is None else texture for texture, color in zip(textures, colors, strict=True)], True


def _read_corner_values(mesh: EvaluatedMesh) -> tuple[np.ndarray, tuple[tuple[str, int], ...]]:
    """Return the values (T, 3, A) float32 that divide vertices into wedges, and the names and widths of the attributes in them."""
    triangles = np.arange(len(mesh.triangles))
    parts, attributes = [], []
    is_flat = _find_flat(mesh)
    if not is_flat.all():
        parts.append(np.where(is_flat[:, None, None], np.float32(0.0), mesh.normals[mesh.loops]))
        attributes.append((NORMALS, 3))
    for name, attribute in mesh.attributes.items():
        if attribute.domain == "CORNER" and attribute.values.shape[1] == 4:
            parts.append(mesh.at_corners(name, triangles))
            attributes.append((name, 4))
    return np.concatenate(parts, axis=2) if parts else np.zeros((len(triangles), 3, 0), np.float32), tuple(attributes)


@np.errstate(over="ignore", invalid="ignore")  # A later check reports coordinates that are not finite.
def _find_flat(mesh: EvaluatedMesh) -> np.ndarray:
    """Return which triangles (T,) bool are shaded flat: their corners have the same normal, and it is that of the triangle."""
    normals = mesh.normals[mesh.loops]
    _, directions = face_areas_and_normals(mesh.vertices[mesh.triangles].astype(np.float64))
    cosines = np.einsum("tci,ti->tc", normals, directions)
    return (np.ptp(normals, axis=1).max(axis=1) == 0.0) & (cosines.min(axis=1) > 0.99)


def _describe_edges(name: str, mesh: TexturedMesh) -> list[str]:
    """Return a sentence if edges belong to more than two triangles."""
    count = int((find_edges(mesh.triangles).face_counts > 2).sum())
    return [f'"{name}" has {format_count(count, "edge")} with more than two faces; its levels may be open there.'] if count else []


def _describe_uvs(name: str, mesh: TexturedMesh, has_uv_map: bool) -> list[str]:
    """Return sentences about texture coordinates that levels can keep only in part."""
    if not has_uv_map:
        return [f'"{name}" has no UV map; only its geometry counts.']
    remarks = []
    if mesh.uvs.min() < 0.0 or mesh.uvs.max() > 1.0:
        remarks.append(f'The UV map of "{name}" leaves the image; the analysis repeats the image there.')
    areas = signed_areas(mesh.corner_uvs)
    if (areas == 0.0).any():
        remarks.append(f'"{name}" has {format_count(int((areas == 0.0).sum()), "triangle")} without area in its UV map.')
    if (areas < 0.0).any():
        remarks.append(f'"{name}" has {format_count(int((areas < 0.0).sum()), "triangle")} mirrored in its UV map, as its levels have.')
    return remarks
