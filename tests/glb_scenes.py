"""Materials of a square and files with them, for tests of exported levels."""

import bpy
import numpy as np
import pytest

from bridge.blender_scenes import shader_of
from farfield.addon.bridge.texmesh.glb_levels import export_collection
from farfield.addon.bridge.texmesh.glb_objects import GlbObjects
from farfield.addon.core.files.glb import save_glb
from farfield.addon.core.files.glb_levels import FULL, LevelNode, arrange_levels
from farfield.addon.core.imaging.coded_images import decode
from glb_reader import ReadGlb, parse_glb, read_document
from textured_scenes import textured_material

BOUNDS = np.array([[-2.0] * 3, [2.0] * 3])


class Nodes:
    """The nodes of the material of a square with an image in the base color."""

    def __init__(self, name: str = "Leaf") -> None:
        self.material = textured_material(leaf_image(), name)
        self.tree = self.material.node_tree
        self.shader, self.image = shader_of(self.material), self.tree.nodes["Image Texture"]
        self.output = self.tree.nodes["Material Output"]
        self.item = square(name, self.material)

    def add(self, kind: str, *inputs, **properties) -> bpy.types.NodeSocket:
        """Add a node with values or links at its first enabled inputs, and return its first enabled output."""
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for name, value in properties.items():
            setattr(node, name, value)
        enabled = [item for item in node.inputs if item.enabled]
        for socket, value in zip(enabled, inputs, strict=False):
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, socket)
            elif value is not None:
                socket.default_value = value
        return next((item for item in node.outputs if item.enabled), None)

    def add_image(self, name: str, output: str = "Color", size: int = 8) -> bpy.types.NodeSocket:
        """Add a random image with data."""
        node = self.tree.nodes.new("ShaderNodeTexImage")
        node.image = random_image(name, size)
        return node.outputs[output]

    def set(self, **values) -> None:
        """Set or link inputs of the shader, with underscores for spaces."""
        for name, value in values.items():
            target = self.shader.inputs[name.replace("_", " ")]
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, target)
            else:
                target.default_value = value

    def multiply(self, first, second, factor: float = 1.0) -> bpy.types.NodeSocket:
        """The product of two colors."""
        return self.add("Mix", factor, first, second, data_type="RGBA", blend_type="MULTIPLY")

    def add_gltf_output(self, **inputs: bpy.types.NodeSocket | float) -> None:
        """Add the node that has what the exporter reads in addition to a shader."""
        group = bpy.data.node_groups.new("glTF Material Output", "ShaderNodeTree")
        node = self.tree.nodes.new("ShaderNodeGroup")
        for name in ("Occlusion", "Thickness"):
            group.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
        node.node_tree = group
        for name, value in inputs.items():
            if isinstance(value, float):
                node.inputs[name].default_value = value
            else:
                self.tree.links.new(value, node.inputs[name])

    def place(self, coordinates: bpy.types.NodeSocket) -> None:
        """Let the image lie where coordinates say."""
        self.tree.links.new(coordinates, self.image.inputs["Vector"])

    def show(self, shader: bpy.types.NodeSocket) -> None:
        """Let the material have another shader."""
        self.tree.links.new(shader, self.output.inputs["Surface"])


def leaf_image(name: str = "Leaf", size: int = 8) -> bpy.types.Image:
    """A packed orange image that is opaque at the left half only."""
    image = bpy.data.images.new(name, size, size, alpha=True)
    pixels = np.full((size, size, 4), (0.8, 0.4, 0.2, 1.0), np.float32)
    pixels[:, size // 2 :, 3] = 0.0
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return image


def random_image(name: str, size: int = 8, is_data: bool = True) -> bpy.types.Image:
    """A packed opaque image."""
    image = bpy.data.images.new(name, size, size)
    image.colorspace_settings.name = "Non-Color" if is_data else "sRGB"
    pixels = np.ones((size, size, 4), np.float32)
    pixels[..., :3] = np.random.default_rng(len(name)).random((size, size, 3))
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return image


def square(name: str, *materials: bpy.types.Material) -> bpy.types.Object:
    """Two triangles with two UV maps and two color attributes; with several materials, the second triangle has the second one."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.5)], [], [(0, 1, 2), (0, 2, 3)])
    rng = np.random.default_rng(7)
    for layer in ("First", "Second"):
        mesh.uv_layers.new(name=layer).uv.foreach_set("vector", rng.random(12).astype(np.float32))
    for layer in ("Shown", "Paint"):
        mesh.color_attributes.new(layer, "FLOAT_COLOR", "CORNER").data.foreach_set("color", rng.random(24).astype(np.float32))
    for index, material in enumerate(materials):
        mesh.materials.append(material)
        mesh.polygons[min(index, 1)].material_index = index
    item = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(item)
    return item


def encode(*items: bpy.types.Object, is_quantized: bool = False) -> tuple[bytes, dict[str, tuple[str, ...]]]:
    """Return a file of objects as levels have it, and what it lacks."""
    with GlbObjects() as objects:
        nodes = [LevelNode(objects.add(item, "Level"), item.name, BOUNDS, np.eye(4)) for item in items]
        document = export_collection(objects.collection)
        objects.note_document(document)
        encoded = save_glb(arrange_levels(document, nodes, FULL if is_quantized else None, objects.material_names, objects.unlit))
        return encoded, {name: labels for name, labels in objects.lacking.items() if name != "Level"}


def write(*items: bpy.types.Object, is_quantized: bool = False) -> tuple[ReadGlb, dict[str, tuple[str, ...]]]:
    """Return the content of a file of objects as levels have it, and what it lacks."""
    content, lacking = encode(*items, is_quantized=is_quantized)
    return parse_glb(content), lacking


def write_with_blender(*items: bpy.types.Object) -> ReadGlb:
    """Return a file of objects as Blender's exporter writes it."""
    collection = bpy.data.collections.new("All")
    for item in items:
        for other in item.users_collection:
            other.objects.unlink(item)
        collection.objects.link(item)
    return read_document(export_collection(collection))


def check_equal(found: object, expected: object, path: str = "") -> None:
    """Check that two materials are the same, whatever order their parts have."""
    if isinstance(expected, dict):
        assert set(found) == set(expected), path
        for key, value in expected.items():
            check_equal(found[key], value, f"{path}/{key}")
    elif isinstance(expected, np.ndarray):
        np.testing.assert_allclose(found, expected, atol=1e-6, err_msg=path)
    elif isinstance(expected, bytes) and found != expected:
        np.testing.assert_allclose(decode(found).astype(int), decode(expected), atol=1, err_msg=path)
    else:
        assert found == (expected if isinstance(expected, str | bytes) else pytest.approx(expected, abs=1e-6)), path
