"""Binary glTF files: what is written is read again, to the precision of its encoding, and levels are rounded alike."""

import json
import struct

import meshopt
import numpy as np
import pytest

import shapes
from farfield.addon.core.errors import FileError, GeometryError
from farfield.addon.core.files.glb import Document, save_glb
from farfield.addon.core.files.glb_levels import COMPRESSIBLE, FULL, LevelNode, arrange_levels
from farfield.addon.core.imaging.coded_images import encode
from glb_reader import ReadGlb, parse_glb

IMAGE = encode(np.arange(48, dtype=np.uint8).reshape(4, 4, 3), "png")
TURNED = {"offset": [0.25, -0.5], "rotation": 0.5, "scale": [2.0, -3.0]}


def primitive(rings: int = 6, material: int | None = 0, uv_scale: float = 1.0, offset: float = 0.0) -> Document:
    """A sphere at x = 5 with all attributes."""
    mesh = shapes.sphere(rings)
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    uvs = uv_scale * (0.5 + 0.5 * normals[:, :2]) + offset
    attributes = {"POSITION": mesh.vertices * [1.0, 2.0, 0.5] + [5.0, 0.0, 0.0], "NORMAL": normals, "TEXCOORD_0": uvs}
    return {"attributes": attributes, "indices": mesh.triangles.ravel(), **({} if material is None else {"material": material})}


def plain(positions: np.ndarray, triangles: np.ndarray) -> Document:
    return {"attributes": {"POSITION": positions}, "indices": triangles.ravel()}


def scene(*parts: Document, materials: tuple[Document, ...] | None = None, **options) -> Document:
    """A document with one mesh."""
    painted = {"name": "painted", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    return {
        "nodes": [{"name": "mesh", "mesh": 0}],
        "meshes": [{"name": "mesh", "primitives": list(parts) or [primitive(**options), primitive(5, 1), primitive(4, None)]}],
        "materials": list(materials or (painted, {"name": "plain", "doubleSided": True})),
        "textures": [{"source": 0}],
        "images": [{"content": IMAGE}],
    }


def bounds_of(part: Document) -> np.ndarray:
    positions = part["attributes"]["POSITION"]
    return np.stack([positions.min(axis=0), positions.max(axis=0)])


def write(document: Document, is_quantized: bool = True, matrix: np.ndarray | None = None, names=None, **options) -> bytes:
    bounds = bounds_of(document["meshes"][0]["primitives"][0])
    node = LevelNode("mesh", "object", bounds, np.eye(4) if matrix is None else matrix)
    return save_glb(
        arrange_levels(document, [node], FULL if is_quantized else None, {"painted": "Paint"} if names is None else names, **options)
    )


def read(*arguments, **options) -> ReadGlb:
    return parse_glb(write(*arguments, **options))


@pytest.mark.parametrize("is_quantized", [False, True])
@pytest.mark.parametrize("uv_scale", [1.0, 3.0])
def test_a_file_is_read_again(uv_scale, is_quantized):
    options = {"uv_scale": uv_scale, "offset": 1.0 - uv_scale}
    found = read(scene(**options), is_quantized)
    assert [node.name for node in found.nodes] == ["object"] and found.images == (IMAGE,)
    assert [material["name"] for material in found.materials] == ["Paint", "plain"]
    for index, (first, second) in enumerate(zip(scene(**options)["meshes"][0]["primitives"], found.meshes[0].primitives, strict=True)):
        uvs = second.attributes["TEXCOORD_0"]
        if index == 0:
            matrix = found.materials[0]["pbrMetallicRoughness"]["baseColorTexture"]["matrix"]
            uvs = uvs @ matrix[:, :2].T + matrix[:, 2]
        steps = (2.0 / 65534.0, 1.0 / 254.0, uv_scale / 131070.0) if is_quantized else (1e-6, 1e-6, 1e-6)
        for wanted, values, step in zip(
            first["attributes"].values(), (found.world_positions(part=index), second.attributes["NORMAL"], uvs), steps, strict=True
        ):
            assert np.abs(wanted - values).max() <= 1.01 * step + 1e-7
        assert np.array_equal(first["indices"], second.triangles.ravel()) and first.get("material") == second.material


def test_a_quantized_file_is_smaller():
    assert len(write(scene(rings=20))) < 0.75 * len(write(scene(rings=20), False))


def test_textures_stay_in_place_where_they_are_turned():
    texture = {"index": 0, "extensions": {"KHR_texture_transform": TURNED}}
    material = {"name": "m", "pbrMetallicRoughness": {"baseColorTexture": texture}, "normalTexture": {"index": 0}}
    placed = []
    for is_quantized in (False, True):
        found = read(scene(primitive(uv_scale=5.0, offset=-2.0), materials=(material,)), is_quantized)
        uvs = found.meshes[0].primitives[0].attributes["TEXCOORD_0"]
        for used in (found.materials[0]["pbrMetallicRoughness"]["baseColorTexture"], found.materials[0]["normalTexture"]):
            placed.append(uvs @ used["matrix"][:, :2].T + used["matrix"][:, 2])
    assert np.abs(placed[0] - placed[2]).max() < 1e-3 and np.abs(placed[1] - placed[3]).max() < 1e-3
    assert found.document["extensionsRequired"] == ["KHR_mesh_quantization", "KHR_texture_transform"]


def test_levels_with_the_same_bounds_have_equal_positions_and_are_found_again():
    fine = primitive(8)
    coarse = plain(fine["attributes"]["POSITION"][:40], np.array([[0, 1, 2], [37, 38, 39]]))
    document = scene(fine)
    document["nodes"].append({"name": "coarse", "mesh": 1})
    document["meshes"].append({"name": "coarse", "primitives": [coarse]})
    nodes = [LevelNode("mesh", "A", bounds_of(fine), np.eye(4), (1,), (0.5, 0.01)), LevelNode("coarse", "B", bounds_of(fine), np.eye(4))]
    found = parse_glb(save_glb(arrange_levels(document, nodes, FULL, {})))
    assert found.nodes[0].levels == (1,) and found.nodes[0].coverages == (0.5, 0.01)
    assert [node.name for node in found.nodes] == [mesh.name for mesh in found.meshes] == ["A", "B"]
    assert np.array_equal(found.world_positions(0)[:40], found.world_positions(1))
    assert found.document["scenes"] == [{"nodes": [0]}] and found.document["extensionsRequired"] == ["KHR_mesh_quantization"]


def test_equal_vertices_are_one():
    mesh = shapes.sphere(6)
    part = read(scene(plain(mesh.vertices[mesh.triangles.ravel()], np.arange(mesh.triangles.size))), False).meshes[0].primitives[0]
    assert len(part.positions) == len(mesh.vertices)
    assert np.array_equal(part.positions[part.triangles], mesh.vertices[mesh.triangles].astype(np.float32))


def test_matrices_of_nodes_are_kept():
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = 2.0 * shapes.random_rotation(3), [1.0, -2.0, 3.0]
    matrix[0, 1] += 0.5  # shear
    expected = primitive()["attributes"]["POSITION"] @ matrix[:3, :3].T + matrix[:3, 3]
    for is_quantized in (False, True):
        assert np.abs(read(scene(), is_quantized, matrix).world_positions() - expected).max() < 2e-4


def test_the_same_scene_gives_the_same_bytes():
    assert write(scene()) == write(scene())


def test_materials_without_light_are_marked():
    found = read(scene(), unlit={"painted"})
    assert found.materials[0]["extensions"] == {"KHR_materials_unlit": {}} and "extensions" not in found.materials[1]
    assert "KHR_materials_unlit" in found.document["extensionsUsed"]


def test_equal_materials_with_equal_names_are_one():
    materials = [{"name": "a"}, {"name": "b"}, {"name": "c", "doubleSided": True}, {"name": "d"}]
    names = {"a": "Wood", "b": "Wood", "c": "Paint", "d": "Paint"}
    found = read(scene(*(primitive(material=index) for index in range(4)), materials=materials), names=names)
    assert [material["name"] for material in found.materials] == ["Wood", "Paint", "Paint"]
    assert [part.material for part in found.meshes[0].primitives] == [0, 0, 1, 2]


def test_large_meshes_have_long_indices():
    mesh = shapes.sheet(260)
    for count, component in ((len(mesh.vertices), b'"componentType":5125'), (60000, b'"componentType":5123')):
        triangles = mesh.triangles[(mesh.triangles < count).all(axis=1)]
        assert component in write(scene(plain(mesh.vertices[:count], triangles)), False)


def test_unusable_meshes_images_and_numbers_are_refused():
    triangle = plain(np.eye(3), np.arange(3))
    with pytest.raises(GeometryError, match=r'"object" has coordinates .* finite'):
        write(scene(plain(np.eye(3) * np.nan, np.arange(3))), False)
    with pytest.raises(GeometryError, match='"A" has no triangles'):
        arrange_levels(scene(triangle), [LevelNode("none", "A", np.zeros((2, 3)), np.eye(4))], None, {})
    with pytest.raises(GeometryError, match="not finite; reset transformations"):
        write(scene(triangle), False, np.diag([np.inf, 1.0, 1.0, 1.0]))
    with pytest.raises(FileError, match="neither PNG, JPEG nor WebP"):
        save_glb({**scene(triangle), "images": [{"content": b"GIF89a"}]})


def test_equal_meshes_are_one_and_others_are_not():
    parts = [primitive(6), primitive(6), primitive(7)]
    document = scene(parts[0])
    for index in (1, 2):
        document["nodes"].append({"name": f"mesh{index}", "mesh": index})
        document["meshes"].append({"name": f"mesh{index}", "primitives": [parts[index]]})
    bounds = bounds_of(parts[2])
    nodes = [LevelNode(name, name, bounds, np.eye(4)) for name in ("mesh", "mesh1", "mesh2")]
    found = parse_glb(save_glb(arrange_levels(document, nodes, FULL, {})))
    assert [node.mesh for node in found.nodes] == [0, 0, 1] and len(found.meshes) == 2
    assert found.nodes[1].name == "mesh1" and np.ptp(found.world_positions(2), axis=0) == pytest.approx(np.ptp(bounds, axis=0), abs=1e-3)


def corner_values(found: ReadGlb) -> list[dict[str, np.ndarray]]:
    """The attributes of the corners of triangles (T, 3, C) per primitive, in an order of triangles and corners that files do not determine:
    UVs as the first texture shows them."""
    values = []
    for mesh, node in zip(found.meshes, found.nodes, strict=True):
        for part in mesh.primitives:
            arrays = {**part.attributes, "POSITION": part.positions @ node.matrix[:3, :3].T + node.matrix[:3, 3]}
            if part.material == 0:
                placed = found.materials[0]["pbrMetallicRoughness"]["baseColorTexture"]["matrix"]
                arrays["TEXCOORD_0"] = arrays["TEXCOORD_0"] @ placed[:, :2].T + placed[:, 2]
            corners = {name: array[part.triangles] for name, array in arrays.items()}
            keys = np.rint(500.0 * corners["POSITION"]) @ [1e8, 1e4, 1.0]
            turned = (keys.argmin(axis=1)[:, None] + np.arange(3)) % 3
            order = np.lexsort(np.take_along_axis(keys, turned, axis=1).T)
            values.append({name: np.take_along_axis(array, turned[..., None], axis=1)[order] for name, array in corners.items()})
    return values


@pytest.mark.parametrize("precision", [None, COMPRESSIBLE])
def test_a_compressed_file_holds_the_same_triangles_in_less_bytes(precision):
    nodes = [LevelNode("mesh", "object", bounds_of(primitive(24)), np.eye(4))]
    files = []
    for is_compressed in (False, True):
        document = arrange_levels(scene(primitive(24), primitive(5, 1)), nodes, precision, {})
        files.append(save_glb(document, is_compressed))
    plain_file, compressed = files
    assert len(compressed) < (0.8 if precision is None else 0.65) * len(plain_file)
    document = read_json(compressed)
    assert "EXT_meshopt_compression" in document["extensionsRequired"] and len(document["buffers"]) == 2
    for found, expected in zip(corner_values(parse_glb(decompress(compressed))), corner_values(parse_glb(plain_file)), strict=True):
        for name, values in expected.items():
            np.testing.assert_allclose(found[name], values, atol=0.02 if name == "NORMAL" else 1e-6)


def read_json(file: bytes) -> Document:
    return json.loads(file[20 : 20 + struct.unpack_from("<I", file, 12)[0]])


def decompress(file: bytes) -> bytes:
    """Return a file without EXT_meshopt_compression: views are decoded by meshoptimizer."""
    document, start = read_json(file), 28 + struct.unpack_from("<I", file, 12)[0]
    binary, parts = file[start:], []
    for view in document["bufferViews"]:
        coded = view.pop("extensions", {}).get("EXT_meshopt_compression", {**view, "mode": ""})
        content = binary[coded.get("byteOffset", 0) :][: coded["byteLength"]]
        if coded["mode"]:
            content = meshopt.decode_gltf_buffer(content, coded["count"], coded["byteStride"], coded["mode"], coded.get("filter")).tobytes()
            assert len(content) == view["byteLength"] and view["buffer"] == 1
        view |= {"buffer": 0, "byteOffset": sum(map(len, parts))}
        parts += [content, bytes(-len(content) % 4)]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunk = b"".join(parts)
    length = 28 + len(text) + len(chunk)
    return struct.pack("<4sIIII", b"glTF", 2, length, len(text), 0x4E4F534A) + text + struct.pack("<II", len(chunk), 0x004E4942) + chunk
