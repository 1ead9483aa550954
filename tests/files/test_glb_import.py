"""Blender's own importer opens the .glb files that Farfield writes."""

import numpy as np
import pytest

import shapes
from farfield.addon.core.files.glb import GlbMesh, GlbNode, GlbPrimitive, GlbScene, encode_glb
from farfield.addon.core.files.glb_materials import GlbMaterial, GlbTexture
from farfield.addon.core.imaging.coded_images import encode

GLTF = "io_scene_gltf2"


@pytest.mark.parametrize("is_quantized", [False, True])
def test_blender_opens_a_written_file(empty_scene, tmp_path, is_quantized):
    import addon_utils
    import bpy

    mesh = shapes.sheet(5)
    uvs = 3.0 * mesh.vertices[:, :2] - 1.0
    normals = np.tile([0.0, 0.0, 1.0], (len(mesh.vertices), 1))
    image = encode(np.random.default_rng(0).integers(0, 255, (8, 8, 3)).astype(np.uint8), "png")
    parts = (GlbPrimitive(mesh.vertices, mesh.triangles, normals, uvs, material=0),)
    nodes = (GlbNode("fine", 0, levels=(1,), coverages=(0.1, 0.0)), GlbNode("coarse", 0))
    scene = GlbScene(nodes, (GlbMesh("sheet", parts),), (GlbMaterial("paint", texture=GlbTexture(0)),), (image,))
    (tmp_path / "a.glb").write_bytes(encode_glb(scene, is_quantized))
    was_enabled = addon_utils.check(GLTF)[1]
    try:
        addon_utils.enable(GLTF)
        assert bpy.ops.import_scene.gltf(filepath=str(tmp_path / "a.glb")) == {"FINISHED"}
    finally:
        if not was_enabled:  # other tests of the same process export with it
            addon_utils.disable(GLTF)
    item = next(item for item in bpy.data.objects if item.name.startswith("fine"))
    read = item.data
    corners = np.array([read.vertices[loop.vertex_index].co for loop in read.loops])
    matrix = np.array(item.matrix_world)
    x, y, z = (corners @ matrix[:3, :3].T + matrix[:3, 3]).T
    positions = np.stack([x, z, -y], axis=1)  # Blender turns y up into z up
    assert len(read.polygons) == len(mesh.triangles)
    found = np.array([loop.uv for loop in read.uv_layers[0].data])
    node = next(node for node in read.materials[0].node_tree.nodes if node.type == "TEX_IMAGE")
    assert tuple(node.image.size) == (8, 8)
    if is_quantized:
        mapping = node.inputs["Vector"].links[0].from_node
        found = found * np.array(mapping.inputs["Scale"].default_value)[:2] + np.array(mapping.inputs["Location"].default_value)[:2]
    order = np.argmin(np.linalg.norm(positions[:, None] - mesh.vertices[None], axis=2), axis=1)
    assert np.abs(positions - mesh.vertices[order]).max() < 1e-4
    assert np.abs(found - uvs[order]).max() < 1e-3
