"""A stand-in of a source whose every face shines with its own number, with holes where its materials are transparent."""

import bpy
import numpy as np

from .channels import capture_material
from .meshes import Source
from .slot_meshes import LAYER_TYPES
from .stand_ins import moved_as_a_whole, stand_ins
from .temporary import TemporaryScene
from .wiring import Wiring

NUMBER = "farfield_number"  # of a face, as (number // BASE, number % BASE, 1), so that single precision holds it exactly
BASE = 4096
OPAQUE = 0.5  # alpha from which on a face counts as seen


def add_stand_in(work: TemporaryScene, source: Source) -> None:
    """Add the faces of `source`, in their place in the world, to the scene of `work`; `faces_in` reads its render."""
    in_place = moved_as_a_whole(np.zeros(3))
    for mesh, drawn in stand_ins(work, source, in_place, lambda original, color_layer: _numbering(original, color_layer, work)):
        numbers = np.stack([drawn.primitives // BASE, drawn.primitives % BASE, np.ones(len(drawn.primitives))], axis=1)
        kind, key_name = LAYER_TYPES[3]
        mesh.attributes.new(NUMBER, kind, "FACE").data.foreach_set(key_name, numbers.astype(np.float32).ravel())


def faces_in(picture: np.ndarray) -> np.ndarray:
    """The number (H, W) int32 of the face seen in every pixel of a render (H, W, 4) of stand-ins, -1 where there is none."""
    high, low, seen = np.moveaxis(picture[..., :3], -1, 0)
    return np.where(seen > 0.5, np.rint(high).astype(np.int64) * BASE + np.rint(low).astype(np.int64), -1).astype(np.int32)


def _numbering(original: bpy.types.Material | None, color_layer: str, work: TemporaryScene) -> bpy.types.Material:
    """A copy of a material that shines with the number of the face where it is opaque, and lets everything through elsewhere."""
    made = capture_material(original, color_layer, 1.0, False, work)
    wiring = Wiring(made.material.node_tree)
    opaque = wiring.math("GREATER_THAN", made.channels.alpha, OPAQUE)
    wiring.connect(wiring.vector("SCALE", wiring.attribute(NUMBER), opaque), made.emission.inputs["Color"])
    wiring.connect(wiring.math("SUBTRACT", 1.0, opaque), made.transparent.inputs["Color"])
    return made.material
