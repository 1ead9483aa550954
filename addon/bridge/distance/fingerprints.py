"""Fingerprints of assets, by which finished levels are found again."""

import hashlib
from dataclasses import fields

import bpy
import numpy as np

from ...core.distance.settings import DistanceSettings
from ..geometry.meshes import read_mesh
from ..objects import world_matrix
from ..shading.node_builder import nodes_in
from .assets import Asset

VERSION = 3  # Of the levels that are made; a change makes all levels again.
# Settings that concern which objects get levels, and where these show, not the levels.
OF_PLACES = {"min_triangles", "max_error", "triangle_budget", "texture_budget"}


def fingerprint(asset: Asset, depsgraph: bpy.types.Depsgraph, settings: DistanceSettings) -> str:
    """Return a digest that is equal for assets whose levels are equal: evaluated meshes, their places in the asset, materials, settings."""
    result = hashlib.blake2b(digest_size=16)
    values = [getattr(settings, item.name) for item in fields(settings) if item.name not in OF_PLACES]
    result.update(repr((VERSION, asset.name, values)).encode())
    inverse = asset.frame.inverted_safe()
    for item in asset.objects:
        mesh = read_mesh(item.evaluated_get(depsgraph), depsgraph)
        matrix = np.round(np.array(inverse @ world_matrix(item)), 5) + 0.0
        arrays = [matrix, mesh.vertices, mesh.triangles, mesh.normals, mesh.material_indices]
        arrays += [attribute.values for attribute in mesh.attributes.values()]
        result.update(repr((mesh.materials, list(mesh.attributes), item.pass_index, list(item.color))).encode())
        for array in arrays:
            result.update(np.ascontiguousarray(array).data)
        for slot in item.material_slots:
            if slot.material is not None:
                result.update(describe_material(slot.material).encode())
    return result.hexdigest()


def describe_material(material: bpy.types.Material) -> str:
    """Return the nodes of a material, also in groups, with the values of their inputs, properties, images and links."""
    if material.node_tree is None:
        return repr((material.name, list(material.diffuse_color)))
    nodes = sorted(map(_describe_node, nodes_in(material.node_tree, muted=True)))
    links = sorted(
        f"{link.from_node.name}.{link.from_socket.identifier}>{link.to_node.name}.{link.to_socket.identifier}"
        for link in material.node_tree.links
    )
    return repr((material.name, nodes, links))


def _describe_node(node: bpy.types.Node) -> str:
    inputs = [_describe_value(socket.default_value) for socket in node.inputs if hasattr(socket, "default_value")]
    names = [item.identifier for item in node.bl_rna.properties if item.type in {"BOOLEAN", "INT", "FLOAT", "ENUM", "STRING"}]
    settings = [
        (name, _describe_value(getattr(node, name))) for name in names if not name.startswith(("location", "width", "height", "select"))
    ]
    image = getattr(node, "image", None)
    pixels = (
        None
        if image is None
        else (image.name, *image.size, image.filepath, image.is_dirty, [file.packed_file.size for file in image.packed_files])
    )
    return repr((node.name, inputs, settings, pixels))


def _describe_value(value: object) -> str:
    if isinstance(value, bpy.types.ID):
        return value.name
    return repr(list(value)) if hasattr(value, "__len__") and not isinstance(value, str | set) else repr(value)
