"""The material of terrain: ordinary nodes that tell ground by slope and height, broken by noise, with a picture mapped from three sides."""

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..compat import give_nodes
from ..core.errors import FileError
from .images import data_image
from .node_groups import shared_group
from .wiring import Wiring

GROUP_NAME = "Farfield Ground"
GROUP_VERSION = 1
GRAIN = "Farfield Grain"
GRAIN_SIDE = 256
LEAST_SIZE = 1e-3  # scene units: of a plain
INPUTS = (
    ("Position", "Vector"), ("Grain", "Color"), ("Rock", "Color"), ("Grass", "Color"), ("Sand", "Color"), ("Snow", "Color"),
    ("Steep", "Float"), ("Snow Height", "Float"), ("Sand Height", "Float"), ("Size", "Float"),
)  # fmt: skip
DEFAULTS = {
    "Rock": (0.17, 0.14, 0.115, 1.0), "Grass": (0.075, 0.11, 0.03, 1.0), "Sand": (0.36, 0.27, 0.16, 1.0), "Snow": (0.8, 0.83, 0.88, 1.0),
    "Steep": 0.72,
}  # fmt: skip
WOODED = {"Rock": (0.045, 0.075, 0.018, 1.0), "Snow": (0.06, 0.09, 0.025, 1.0), "Sand": (0.12, 0.105, 0.05, 1.0)}  # leaves are steep


@dataclass(frozen=True)
class Cover:
    """A picture of the ground from above: the file, the longest side that it reaches along in scene units, and the place of the terrain
    (3,) that lies at the root; its middle lies at x = y = 0 of the terrain."""

    path: Path
    side: float
    origin: np.ndarray


def terrain_material(
    name: str, root: bpy.types.Object, low: float, high: float, cover: Cover | None = None, wooded: bool = False
) -> bpy.types.Material:
    """A material for terrain under `root`, most of which lies between the heights `low` and `high`, scene units from the root.

    Every colour and height is an input of its group; a `cover` is the colour of all ground. Where it is `wooded`, steep is green.

    Raises:
        FileError: when the cover cannot be read.
    """
    size = max(0.5 * (high - low), LEAST_SIZE)
    material = bpy.data.materials.new(name)
    give_nodes(material)
    tree = material.node_tree
    tree.nodes.clear()
    wiring = Wiring(tree)
    place = wiring.node("ShaderNodeTexCoord", {"object": root}).outputs["Object"]
    scaled = wiring.vector("SCALE", place, 1.0 / (0.12 * size))
    grain = wiring.node(
        "ShaderNodeTexImage", {"image": _grain(), "projection": "BOX", "projection_blend": 0.35, "extension": "REPEAT", "label": "Grain"}
    )
    wiring.connect(scaled, grain.inputs["Vector"])
    group = wiring.node("ShaderNodeGroup", {"node_tree": _group(), "width": 200.0})
    for socket, value in (DEFAULTS | (WOODED if wooded else {})).items():
        group.inputs[socket].default_value = value
    group.inputs["Size"].default_value = size
    group.inputs["Snow Height"].default_value, group.inputs["Sand Height"].default_value = high + 0.3 * size, low
    if cover is not None:
        color = _covering(wiring, place, cover)
        for socket in ("Rock", "Grass", "Sand", "Snow"):
            wiring.connect(color, group.inputs[socket])
    wiring.connect(place, group.inputs["Position"])
    wiring.connect(grain.outputs["Color"], group.inputs["Grain"])
    surface = wiring.node("ShaderNodeBsdfPrincipled")
    wiring.connect(group.outputs["Color"], surface.inputs["Base Color"])
    wiring.connect(group.outputs["Roughness"], surface.inputs["Roughness"])
    wiring.connect(surface.outputs[0], wiring.node("ShaderNodeOutputMaterial").inputs["Surface"])
    wiring.arrange()
    return material


def _covering(wiring: Wiring, place: bpy.types.NodeSocket, cover: Cover) -> bpy.types.NodeSocket:
    """The colour of a cover at a `place` from the root."""
    try:
        image = bpy.data.images.load(str(cover.path), check_existing=True)
    except RuntimeError as error:
        raise FileError(f'The picture "{cover.path}" cannot be read; check the path.') from error
    width, height = image.size
    if not (width and height):
        raise FileError(f'The picture "{cover.path}" is none that Blender reads.')
    sides = np.array([width, height]) * cover.side / max(width, height)
    shares = wiring.vector("MULTIPLY", wiring.vector("ADD", place, cover.origin.tolist()), (*(1.0 / sides).tolist(), 0.0))
    node = wiring.node("ShaderNodeTexImage", {"image": image, "extension": "EXTEND", "label": "Cover"})
    wiring.connect(wiring.vector("ADD", shares, (0.5, 0.5, 0.0)), node.inputs["Vector"])
    return node.outputs["Color"]


def _group() -> bpy.types.NodeTree:
    return shared_group(GROUP_NAME, GROUP_VERSION, INPUTS, (("Color", "Color"), ("Roughness", "Float")), _fill)


def _fill(wiring: Wiring) -> None:
    given = wiring.node("NodeGroupInput").outputs
    noise = wiring.node("ShaderNodeTexNoise")
    wiring.connect(wiring.vector("SCALE", given["Position"], wiring.math("DIVIDE", 6.0, given["Size"])), noise.inputs["Vector"])
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1.0, 4.0
    uneven = wiring.math("SUBTRACT", noise.outputs[0], 0.5)
    up = wiring.separate(wiring.node("ShaderNodeNewGeometry").outputs["Normal"])[2]
    height = wiring.separate(given["Position"])[2]
    raised = wiring.math("ADD", height, wiring.math("MULTIPLY", uneven, wiring.math("MULTIPLY", given["Size"], 0.6)))
    flat = wiring.math("ADD", up, wiring.math("MULTIPLY", uneven, 0.35))
    low = _ramp(wiring, raised, given["Sand Height"], wiring.math("MULTIPLY", given["Size"], 0.12))
    ground = wiring.mix(low, given["Sand"], given["Grass"])
    high = _ramp(wiring, raised, given["Snow Height"], wiring.math("MULTIPLY", given["Size"], 0.12))
    ground = wiring.mix(high, ground, given["Snow"])
    color = wiring.mix(_ramp(wiring, flat, given["Steep"], 0.07), given["Rock"], ground)
    shade = wiring.vector("ADD", wiring.vector("SCALE", given["Grain"], 0.7), (0.65, 0.65, 0.65))
    shade = wiring.vector("SCALE", shade, wiring.math("ADD", wiring.math("MULTIPLY", uneven, 0.8), 1.0))
    output = wiring.node("NodeGroupOutput")
    wiring.connect(wiring.vector("MULTIPLY", color, shade), output.inputs["Color"])
    wiring.connect(0.9, output.inputs["Roughness"])


def _ramp(wiring: Wiring, value: bpy.types.NodeSocket, middle: bpy.types.NodeSocket, width: bpy.types.NodeSocket | float):
    """0 below `middle` less `width`, 1 above it plus `width`, straight between."""
    return wiring.math("ADD", wiring.math("DIVIDE", wiring.math("SUBTRACT", value, middle), wiring.math("MULTIPLY", width, 2.0)), 0.5, True)


def _grain() -> bpy.types.Image:
    """A grey picture of grains of all sizes that repeats; shared by all terrains of the file."""
    for image in bpy.data.images:
        if image.name.startswith(GRAIN) and image.library is None and image.size[0] == GRAIN_SIDE:
            return image
    spectrum = np.fft.rfft2(np.random.default_rng(1).normal(size=(GRAIN_SIDE, GRAIN_SIDE)))
    distance = np.hypot(np.fft.fftfreq(GRAIN_SIDE)[:, None], np.fft.rfftfreq(GRAIN_SIDE)) * GRAIN_SIDE
    grey = np.fft.irfft2(spectrum / np.maximum(distance, 3.0) ** 0.9)
    grey = np.clip(0.5 + 0.22 * (grey - grey.mean()) / grey.std(), 0.0, 1.0)
    pixels = np.ones((GRAIN_SIDE, GRAIN_SIDE, 4), np.float32)
    pixels[..., :3] = grey[..., None]
    return data_image(GRAIN, pixels, is_data=True)
