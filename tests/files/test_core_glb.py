"""Binary glTF files: what is written is read again, to the precision of its encoding, and damaged files end in one sentence."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shapes
from farfield.addon.core.errors import FileError, GeometryError
from farfield.addon.core.files.glb import (
    GlbMesh,
    GlbNode,
    GlbPrimitive,
    GlbScene,
    encode_glb,
)
from farfield.addon.core.files.glb_materials import GlbMaterial, GlbTexture
from farfield.addon.core.imaging.coded_images import encode
from glb_reader import read_glb

IMAGE = encode(np.arange(48, dtype=np.uint8).reshape(4, 4, 3), "png")


def primitive(rings: int = 6, material: int | None = 0, uv_scale: float = 1.0, offset: float = 0.0) -> GlbPrimitive:
    """A sphere at x = 5 with all attributes."""
    mesh = shapes.sphere(rings)
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    uvs = uv_scale * (0.5 + 0.5 * normals[:, :2]) + offset
    colors = np.clip(0.5 + 0.5 * normals, 0.0, 1.0)
    return GlbPrimitive(mesh.vertices * [1.0, 2.0, 0.5] + [5.0, 0.0, 0.0], mesh.triangles, normals, uvs, colors, material)


def scene(**options) -> GlbScene:
    parts = (primitive(**options), primitive(rings=5, material=1), primitive(rings=4, material=None))
    materials = (GlbMaterial("painted", (0.5, 0.25, 1.0, 1.0), GlbTexture(0)), GlbMaterial("plain", is_double_sided=True))
    return GlbScene((GlbNode("object", 0),), (GlbMesh("mesh", parts),), materials, (IMAGE,))


def world_positions(read: GlbScene, node: int = 0, part: int = 0) -> np.ndarray:
    matrix = read.nodes[node].matrix
    return read.meshes[read.nodes[node].mesh].primitives[part].positions @ matrix[:3, :3].T + matrix[:3, 3]


def test_a_plain_file_has_single_precision(tmp_path):
    written = scene(uv_scale=3.0, offset=-1.0)
    (tmp_path / "a.glb").write_bytes(encode_glb(written))
    read = read_glb(tmp_path / "a.glb")
    assert read.materials == written.materials and read.images == written.images and [node.name for node in read.nodes] == ["object"]
    for index, (first, second) in enumerate(zip(written.meshes[0].primitives, read.meshes[0].primitives, strict=True)):
        assert np.array_equal(first.positions.astype(np.float32), world_positions(read, part=index))
        assert np.array_equal(first.triangles, second.triangles) and first.material == second.material
        for name in ("normals", "uvs", "colors"):
            assert np.abs(getattr(first, name) - getattr(second, name)).max() < 1e-6


@pytest.mark.parametrize("uv_scale", [1.0, 3.0])
def test_a_quantized_file_is_smaller_and_nearly_the_same(tmp_path, uv_scale):
    written = scene(uv_scale=uv_scale, offset=1.0 - uv_scale)
    (tmp_path / "a.glb").write_bytes(encode_glb(written, is_quantized=True))
    read = read_glb(tmp_path / "a.glb")
    quantized, plain = (document_of(encode_glb(written, is_quantized))["buffers"][0]["byteLength"] for is_quantized in (True, False))
    assert quantized < 0.75 * plain
    for index, (first, second) in enumerate(zip(written.meshes[0].primitives, read.meshes[0].primitives, strict=True)):
        assert np.abs(first.positions - world_positions(read, part=index)).max() <= 2.0 / 65534.0 * 1.001  # half a step; half side 2
        assert np.array_equal(first.triangles, second.triangles)
        assert np.abs(first.normals - second.normals).max() <= 0.51 / 127.0
        assert np.abs(first.colors - second.colors).max() <= 0.51 / 65535.0
        assert np.abs(first.uvs - second.uvs).max() <= 0.51 / 65535.0 * uv_scale


def test_levels_with_the_same_bounds_have_equal_positions_and_are_found_again(tmp_path):
    fine = primitive(rings=8)
    bounds = np.stack([fine.positions.min(axis=0), fine.positions.max(axis=0)])
    coarse = GlbPrimitive(fine.positions[:40], np.array([[0, 1, 2]]))
    meshes = (GlbMesh("fine", (fine,), bounds), GlbMesh("coarse", (coarse,), bounds))
    nodes = (GlbNode("fine", 0, levels=(1,), coverages=(0.5, 0.01)), GlbNode("coarse", 1))
    (tmp_path / "a.glb").write_bytes(
        encode_glb(GlbScene(nodes, meshes, (GlbMaterial("m", texture=GlbTexture(0)),), (IMAGE,)), is_quantized=True)
    )
    read = read_glb(tmp_path / "a.glb")
    assert read.nodes[0].levels == (1,) and read.nodes[0].coverages == (0.5, 0.01)
    assert np.array_equal(world_positions(read, 0)[:40], world_positions(read, 1))
    document = document_of((tmp_path / "a.glb").read_bytes())
    assert document["scenes"] == [{"nodes": [0]}] and document["extensionsRequired"] == ["KHR_mesh_quantization"]


def test_matrices_of_nodes_are_kept(tmp_path):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = 2.0 * shapes.random_rotation(3), [1.0, -2.0, 3.0]
    written = scene()
    expected = written.meshes[0].primitives[0].positions @ matrix[:3, :3].T + matrix[:3, 3]
    for is_quantized in (False, True):
        (tmp_path / "a.glb").write_bytes(encode_glb(replace(written, nodes=(GlbNode("moved", 0, matrix),)), is_quantized))
        assert np.abs(world_positions(read_glb(tmp_path / "a.glb")) - expected).max() < 2e-4
        (tmp_path / "a.glb").unlink()


def test_the_same_scene_gives_the_same_bytes():
    assert encode_glb(scene(), True) == encode_glb(scene(), True)


def test_large_meshes_have_long_indices(tmp_path):
    mesh = shapes.sheet(260)
    for count, component in ((len(mesh.vertices), 5125), (60000, 5123)):
        triangles = mesh.triangles[(mesh.triangles < count).all(axis=1)]
        content = encode_glb(GlbScene((GlbNode("n", 0),), (GlbMesh("m", (GlbPrimitive(mesh.vertices[:count], triangles),)),)))
        document = document_of(content)
        assert document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]["componentType"] == component


def document_of(content: bytes) -> dict:
    return json.loads(content[20 : 20 + struct.unpack_from("<I", content, 12)[0]])


def with_document(content: bytes, document: dict) -> bytes:
    """Return a file with the binary chunk of `content` and another description."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + struct.unpack_from("<I", content, 12)[0] :]
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


def test_parents_are_applied(tmp_path):
    document = document_of(encode_glb(scene()))
    half = 0.5**0.5
    document["nodes"] += [{"children": [0], "rotation": [0.0, 0.0, half, half], "scale": [2.0, 2.0, 2.0]}]
    (tmp_path / "a.glb").write_bytes(with_document(encode_glb(scene()), document))
    x, y, z = scene().meshes[0].primitives[0].positions.T
    assert np.abs(world_positions(read_glb(tmp_path / "a.glb")) - 2.0 * np.stack([-y, x, z], axis=1)).max() < 1e-5


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda document: document["nodes"][0].update(children=[0]), "cycle"),
        (lambda document: document.update(extensionsRequired=["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
        (lambda document: document["bufferViews"][0].update(byteLength=10**12), "truncated"),
        (lambda document: document["accessors"][0].update(count=10**15), "truncated"),
        (lambda document: document["accessors"][0].update(componentType=7), "damaged"),
        (lambda document: document["meshes"][0]["primitives"][0].update(material=99), "materials 99"),
        (lambda document: document["images"][0].pop("bufferView"), "other files"),
        (lambda document: document.update(images=document["images"] * 20000), "too often"),
        (lambda document: document.update(nodes=[[]]), "damaged"),
        (lambda document: document["buffers"][0].update(uri="a.bin"), "other files"),
    ],
)
def test_damaged_descriptions_end_in_one_sentence(tmp_path, change, problem):
    document = document_of(encode_glb(scene()))
    change(document)
    path = tmp_path / "a.glb"
    path.write_bytes(with_document(encode_glb(scene()), document))
    with pytest.raises(FileError, match=problem) as caught:
        read_glb(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


CONTENT = encode_glb(scene(), is_quantized=True)


@given(st.lists(st.tuples(st.integers(0, len(CONTENT) - 1), st.integers(0, 255)), min_size=1, max_size=6), st.integers(0, len(CONTENT)))
@settings(max_examples=60)
def test_any_damage_is_read_or_refused(tmp_path_factory, changes, length):
    content = bytearray(CONTENT)
    for position, value in changes:
        content[position % (2000 if position % 2 else len(content))] = value
    path = tmp_path_factory.mktemp("damaged") / "a.glb"
    path.write_bytes(content[:length] if length % 3 == 0 else content)
    try:
        read_glb(path)
    except FileError as error:
        assert "\n" not in str(error)


def test_unusable_meshes_and_images_are_refused():
    triangle = np.array([[0, 1, 2]])
    points = np.eye(3)

    def encode_one(part: GlbPrimitive, images: tuple[bytes, ...] = ()) -> bytes:
        return encode_glb(GlbScene((GlbNode("n", 0),), (GlbMesh("m", (part,)),), images=images))

    with pytest.raises(GeometryError, match="no triangles"):
        encode_one(GlbPrimitive(points, triangle[:0]))
    with pytest.raises(GeometryError, match="do not exist"):
        encode_one(GlbPrimitive(points, triangle + 1))
    with pytest.raises(GeometryError, match="finite"):
        encode_one(GlbPrimitive(points * np.nan, triangle))
    with pytest.raises(GeometryError, match="material 3"):
        encode_one(GlbPrimitive(points, triangle, material=3))
    with pytest.raises(FileError, match="neither PNG nor JPEG"):
        encode_one(GlbPrimitive(points, triangle), (b"GIF89a",))


def test_a_transformation_that_is_not_finite_is_refused():
    triangle = GlbMesh("mesh", (GlbPrimitive(np.eye(3), np.array([[0, 1, 2]])),))
    with pytest.raises(GeometryError, match="not finite; reset transformations"):
        encode_glb(GlbScene((GlbNode("moved", 0, np.diag([np.inf, 1.0, 1.0, 1.0])),), (triangle,), (), ()), False)
