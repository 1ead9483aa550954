"""Face-ID pass: proxies of a source whose faces emit their own index, with holes where their materials are transparent."""

import bpy
import numpy as np

from ..geometry.mesh_arrays import write_attribute
from ..geometry.meshes import Source
from ..rendering.render_scene import RenderScene
from ..shading.material_channels import build_capture_material
from ..shading.node_builder import NodeBuilder
from .proxies import add_proxies, single_placement

FACE_ID = "farfield_face_id"  # face attribute (id // BASE, id % BASE, 1): single precision holds each component exactly
BASE = 4096
MIN_OPAQUE_ALPHA = 0.5  # a face with less alpha is transparent


def add_face_id_proxies(work: RenderScene, source: Source) -> None:
    """Add proxies of all faces of `source`, at their world-space positions, to the scene of `work`; see `decode_face_ids`."""
    placement = single_placement(np.zeros(3))
    for mesh, drawn in add_proxies(work, source, placement, lambda original, color_layer: _face_id_material(original, color_layer, work)):
        digits = np.stack([drawn.primitives // BASE, drawn.primitives % BASE, np.ones(len(drawn.primitives))], axis=1)
        write_attribute(mesh, FACE_ID, "FACE", digits)


def decode_face_ids(render: np.ndarray) -> np.ndarray:
    """Return the face ID (H, W) int32 in every pixel of a render (H, W, 4) of the proxies, -1 for none."""
    high, low, mask = np.moveaxis(render[..., :3], -1, 0)
    return np.where(mask > 0.5, np.rint(high).astype(np.int64) * BASE + np.rint(low).astype(np.int64), -1).astype(np.int32)


def _face_id_material(original: bpy.types.Material | None, color_layer: str, work: RenderScene) -> bpy.types.Material:
    """Return a copy of a material that emits the face ID where it is opaque and is transparent elsewhere."""
    capture = build_capture_material(original, color_layer, 1.0, False, work)
    builder = NodeBuilder(capture.material.node_tree)
    is_opaque = builder.math("GREATER_THAN", capture.channels.alpha, MIN_OPAQUE_ALPHA)
    builder.connect(builder.vector("SCALE", builder.attribute(FACE_ID), is_opaque), capture.emission.inputs["Color"])
    builder.connect(builder.math("SUBTRACT", 1.0, is_opaque), capture.transparent.inputs["Color"])
    return capture.material
