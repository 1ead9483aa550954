"""Binary glTF files: what is written is read again, to the precision of its encoding, and levels are rounded alike."""

import numpy as np
import pytest

import shapes
from farfield.addon.core.errors import FileError, GeometryError
from farfield.addon.core.files.glb import GlbMesh, GlbPrimitive, GlbScene, encode_glb, flip_v
from farfield.addon.core.files.glb_levels import LevelNode, encode_levels
from farfield.addon.core.imaging.coded_images import encode
from glb_reader import parse_glb

IMAGE = encode(np.arange(48, dtype=np.uint8).reshape(4, 4, 3), "png")
PAINTED = {"name": "painted", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
TURNED = {"offset": [0.25, -0.5], "rotation": 0.5, "scale": [2.0, -3.0]}


def primitive(rings: int = 6, material: int | None = 0, uv_scale: float = 1.0, offset: float = 0.0) -> GlbPrimitive:
    """A sphere at x = 5 with all attributes."""
    mesh = shapes.sphere(rings)
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    uvs = uv_scale * (0.5 + 0.5 * normals[:, :2]) + offset
    return GlbPrimitive(mesh.vertices * [1.0, 2.0, 0.5] + [5.0, 0.0, 0.0], mesh.triangles, normals, uvs, material)


def scene(**options) -> GlbScene:
    parts = (primitive(**options), primitive(rings=5, material=1), primitive(rings=4, material=None))
    return GlbScene((GlbMesh("mesh", parts),), (PAINTED, {"name": "plain", "doubleSided": True}), (IMAGE,))


def bounds_of(part: GlbPrimitive) -> np.ndarray:
    return np.stack([part.positions.min(axis=0), part.positions.max(axis=0)])


def write(written: GlbScene, is_quantized: bool, matrix: np.ndarray | None = None, **options) -> bytes:
    node = LevelNode("mesh", "object", bounds_of(written.meshes[0].primitives[0]), matrix)
    return encode_levels(encode_glb(written), [node], is_quantized, {"painted": "Paint"}, **options)


@pytest.mark.parametrize("is_quantized", [False, True])
@pytest.mark.parametrize("uv_scale", [1.0, 3.0])
def test_a_file_is_read_again(uv_scale, is_quantized):
    written = scene(uv_scale=uv_scale, offset=1.0 - uv_scale)
    read = parse_glb(write(written, is_quantized))
    assert [node.name for node in read.nodes] == ["object"] and read.images == written.images
    assert [material["name"] for material in read.materials] == ["Paint", "plain"]
    for index, (first, second) in enumerate(zip(written.meshes[0].primitives, read.meshes[0].primitives, strict=True)):
        positions, normals, uvs = read.world_positions(part=index), second.attributes["NORMAL"], second.attributes["TEXCOORD_0"]
        if index == 0:
            matrix = read.materials[0]["pbrMetallicRoughness"]["baseColorTexture"]["matrix"]
            uvs = uvs @ matrix[:, :2].T + matrix[:, 2]
        steps = (2.0 / 65534.0, 1.0 / 254.0, uv_scale / 131070.0) if is_quantized else (1e-6, 1e-6, 1e-6)
        pairs = (first.positions, positions), (first.normals, normals), (flip_v(first.uvs), uvs)
        for (wanted, found), step in zip(pairs, steps, strict=True):
            assert np.abs(wanted - found).max() <= 1.01 * step + 1e-7
        assert np.array_equal(first.triangles, second.triangles) and first.material == second.material


def test_a_quantized_file_is_smaller():
    quantized, plain = (parse_glb(write(scene(), is_quantized)).document["buffers"][0]["byteLength"] for is_quantized in (True, False))
    assert quantized < 0.75 * plain


def test_textures_stay_in_place_where_they_are_turned():
    texture = {"index": 0, "extensions": {"KHR_texture_transform": TURNED}}
    material = {"name": "painted", "pbrMetallicRoughness": {"baseColorTexture": texture}, "normalTexture": {"index": 0}}
    written = GlbScene((GlbMesh("mesh", (primitive(uv_scale=5.0, offset=-2.0),)),), (material,), (IMAGE,))
    files = [parse_glb(write(written, is_quantized)) for is_quantized in (False, True)]
    placed = []
    for file in files:
        uvs = file.meshes[0].primitives[0].attributes["TEXCOORD_0"]
        found = file.materials[0]
        for used in (found["pbrMetallicRoughness"]["baseColorTexture"], found["normalTexture"]):
            placed.append(uvs @ used["matrix"][:, :2].T + used["matrix"][:, 2])
    assert np.abs(placed[0] - placed[2]).max() < 1e-3 and np.abs(placed[1] - placed[3]).max() < 1e-3
    assert files[1].document["extensionsRequired"] == ["KHR_mesh_quantization", "KHR_texture_transform"]


def test_levels_with_the_same_bounds_have_equal_positions_and_are_found_again():
    fine = primitive(rings=8)
    coarse = GlbPrimitive(fine.positions[:40], np.array([[0, 1, 2], [37, 38, 39]]))
    written = GlbScene((GlbMesh("fine", (fine,)), GlbMesh("coarse", (coarse,))), (PAINTED,), (IMAGE,))
    nodes = [LevelNode("fine", "A", bounds_of(fine), None, (1,), (0.5, 0.01)), LevelNode("coarse", "B", bounds_of(fine))]
    read = parse_glb(encode_levels(encode_glb(written), nodes, True, {}))
    assert read.nodes[0].levels == (1,) and read.nodes[0].coverages == (0.5, 0.01)
    assert [node.name for node in read.nodes] == [mesh.name for mesh in read.meshes] == ["A", "B"]
    assert np.array_equal(read.world_positions(0)[:40], read.world_positions(1))
    assert read.document["scenes"] == [{"nodes": [0]}] and read.document["extensionsRequired"] == ["KHR_mesh_quantization"]


def test_equal_vertices_are_one():
    part = primitive()
    corners = GlbPrimitive(*(values[part.triangles.ravel()] for values in (part.positions,)), np.arange(part.triangles.size).reshape(-1, 3))
    read = parse_glb(write(GlbScene((GlbMesh("mesh", (corners,)),)), False)).meshes[0].primitives[0]
    assert len(read.positions) == len(part.positions)
    assert np.array_equal(read.positions[read.triangles], part.positions[part.triangles].astype(np.float32))


def test_matrices_of_nodes_are_kept():
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = 2.0 * shapes.random_rotation(3), [1.0, -2.0, 3.0]
    matrix[0, 1] += 0.5  # shear
    written = scene()
    expected = written.meshes[0].primitives[0].positions @ matrix[:3, :3].T + matrix[:3, 3]
    for is_quantized in (False, True):
        assert np.abs(parse_glb(write(written, is_quantized, matrix)).world_positions() - expected).max() < 2e-4


def test_the_same_scene_gives_the_same_bytes():
    assert write(scene(), True) == write(scene(), True)


def test_materials_without_light_are_marked():
    read = parse_glb(write(scene(), True, unlit={"painted"}))
    assert read.materials[0]["extensions"] == {"KHR_materials_unlit": {}} and "extensions" not in read.materials[1]
    assert "KHR_materials_unlit" in read.document["extensionsUsed"]


def test_equal_materials_with_equal_names_are_one():
    materials = tuple({**PAINTED, "name": name} for name in "ab")
    others = {"name": "c", "doubleSided": True}, {"name": "d"}
    parts = tuple(primitive(material=index) for index in range(4))
    written = GlbScene((GlbMesh("mesh", parts),), (*materials, *others), (IMAGE,))
    names = {"a": "Wood", "b": "Wood", "c": "Paint", "d": "Paint"}
    read = parse_glb(encode_levels(encode_glb(written), [LevelNode("mesh", "A", bounds_of(parts[0]))], True, names))
    assert [material["name"] for material in read.materials] == ["Wood", "Paint", "Paint"]
    assert [part.material for part in read.meshes[0].primitives] == [0, 0, 1, 2]


def test_large_meshes_have_long_indices():
    mesh = shapes.sheet(260)
    for count, component in ((len(mesh.vertices), 5125), (60000, 5123)):
        triangles = mesh.triangles[(mesh.triangles < count).all(axis=1)]
        document = parse_glb(write(GlbScene((GlbMesh("mesh", (GlbPrimitive(mesh.vertices[:count], triangles),)),)), False)).document
        assert document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]["componentType"] == component


def test_unusable_meshes_images_and_numbers_are_refused():
    points, triangle = np.eye(3), np.array([[0, 1, 2]])
    one = GlbScene((GlbMesh("mesh", (GlbPrimitive(points, triangle),)),))
    with pytest.raises(GeometryError, match="finite"):
        write(GlbScene((GlbMesh("mesh", (GlbPrimitive(points * np.nan, triangle),)),)), False)
    with pytest.raises(GeometryError, match='"A" has no triangles'):
        encode_levels(encode_glb(one), [LevelNode("none", "A", np.zeros((2, 3)))], False, {})
    with pytest.raises(GeometryError, match="not finite; reset transformations"):
        write(one, False, np.diag([np.inf, 1.0, 1.0, 1.0]))
    with pytest.raises(FileError, match="neither PNG nor JPEG"):
        encode_glb(GlbScene(one.meshes, images=(b"GIF89a",)))
