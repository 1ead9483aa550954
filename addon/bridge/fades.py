"""Levels of a cloud that fade into each other and into the original, for the pixels of the scene's camera: nodes and drivers alone.

All levels render at once, and every material lets through what another level shows. Which level that is depends on how large a pixel of the
camera is at the place that is shaded, and over a range on a number that is random from ray to ray but the same for all surfaces along it:
so a ray of the camera sees one whole level, never half of two. Other rays, which have no place in the picture, see a level change at the
middle of the range.
"""

from collections.abc import Sequence

import bpy

from ..compat import give_nodes
from .node_groups import shared_group
from .wiring import Operand, Wiring

GROUP_NAME, GROUP_VERSION = "Farfield Fade", 1
FADE = "farfield_fade"  # on what fades: pixel sizes (lengths of the object) from which and until which it shows, and the range
VIEW = "farfield_view"  # on the same: where the camera is, in world space
PIXEL = "farfield_pixel"  # on the same: by what the side of a pixel grows with every unit of distance, and what it is at the camera
ALWAYS, FOREVER = 0.0, 1e30
LEAST_RANGE = 1e-3
CELLS = 8192.0  # along a side of the picture: rays in one of them have the same number
# Pixels along the side that the camera's angle or scale spans.
PIXELS = "((x if f==1 or (f==0 and x*u>=y*v) else y)*p/100)"
GROWTH = f"0 if t==1 else 2*tan(a/2)/{PIXELS}"
CONSTANT = f"s/{PIXELS} if t==1 else 0"
SCENE_PATHS = {
    "t": "camera.data.type",
    "a": "camera.data.angle",
    "s": "camera.data.ortho_scale",
    "f": "camera.data.sensor_fit",
    "x": "render.resolution_x",
    "y": "render.resolution_y",
    "p": "render.resolution_percentage",
    "u": "render.pixel_aspect_x",
    "v": "render.pixel_aspect_y",
}


def fade(item: bpy.types.Object, start: float, end: float, span: float) -> None:
    """Let `item` show where a pixel of the scene's camera is larger than `start` and not larger than `end`, lengths of the object.

    It fades in from `start` to (1 + `span`) times that, and out likewise from `end` on.
    """
    item[FADE] = [float(start), float(end), max(float(span), LEAST_RANGE)]
    item[VIEW] = [0.0, 0.0, 0.0]
    for axis in range(3):
        _drive(item, VIEW, axis, "place", {"place": f"camera.matrix_world[3][{axis}]"})
    item[PIXEL] = [0.0, 0.0, 0.0]
    _drive(item, PIXEL, 0, GROWTH, SCENE_PATHS)
    _drive(item, PIXEL, 1, CONSTANT, SCENE_PATHS)
    wear_fade(item)


def wear_fade(item: bpy.types.Object) -> None:
    """Let the materials that `item` wears now do as `fade` said; nothing if it does not fade."""
    if FADE in item:
        for slot in item.material_slots:
            if slot.material is not None:
                _insert(slot.material)


def unfade(item: bpy.types.Object, materials: Sequence[bpy.types.Material | None]) -> None:
    """Let `item`, and the `materials` that it wears or may wear again, show always."""
    for name in (VIEW, PIXEL):
        item.driver_remove(f'["{name}"]')
    for name in (FADE, VIEW, PIXEL):
        if name in item:
            del item[name]
    for material in materials:
        if material is not None:
            _take_out(material)


def _insert(material: bpy.types.Material) -> None:
    """Put the group between the surface and every output of `material`; nothing where it is already."""
    give_nodes(material)
    tree = material.node_tree
    for output in [node for node in tree.nodes if node.type == "OUTPUT_MATERIAL"]:
        links = output.inputs["Surface"].links
        if not links or _is_fade(links[0].from_node):
            continue
        shader = links[0].from_socket
        wiring = Wiring(tree)
        group = shared_group(GROUP_NAME, GROUP_VERSION, [("Shader", "Shader")], [("Shader", "Shader")], _fill)
        node = wiring.node("ShaderNodeGroup", {"node_tree": group})
        node.location = output.location
        output.location.x += 260.0
        tree.links.new(shader, node.inputs[0])
        tree.links.new(node.outputs[0], output.inputs["Surface"])


def _take_out(material: bpy.types.Material) -> None:
    tree = material.node_tree
    for node in [node for node in tree.nodes if _is_fade(node)] if tree is not None else []:
        shader = node.inputs[0].links[0].from_socket if node.inputs[0].links else None
        for link in list(node.outputs[0].links):
            link.to_node.location.x -= 260.0
            if shader is not None:
                tree.links.new(shader, link.to_socket)
        tree.nodes.remove(node)


def _is_fade(node: bpy.types.Node) -> bool:
    return node.type == "GROUP" and node.node_tree is not None and node.node_tree.name.startswith(GROUP_NAME)


def _fill(wiring: Wiring) -> None:
    """The shader where the object shows, nothing where it does not."""
    start, end, span = wiring.separate(wiring.of_object(FADE))
    growth, constant, _ = wiring.separate(wiring.of_object(PIXEL))
    place = wiring.node("ShaderNodeNewGeometry").outputs["Position"]
    distance = wiring.vector("LENGTH", wiring.vector("SUBTRACT", place, wiring.of_object(VIEW)))
    third = 3.0**-0.5
    scale = wiring.vector("LENGTH", wiring.turned((third, third, third), "VECTOR", "OBJECT", "WORLD"))
    pixel = wiring.math("DIVIDE", wiring.math("ADD", wiring.math("MULTIPLY", distance, growth), constant), scale)

    def passed(size: Operand) -> Operand:
        """1 where the ray is beyond the change at a pixel of `size`; see `core.cameras.faded_share`."""
        width = wiring.math("MAXIMUM", wiring.math("MULTIPLY", size, span), 1e-20)
        share = wiring.math("DIVIDE", wiring.math("SUBTRACT", pixel, size), width, clamp=True)
        return wiring.math("LESS_THAN", number, share)

    number = _number_of_ray(wiring)
    shown = wiring.math("SUBTRACT", passed(start), passed(end))
    transparent, mixed = (wiring.node(kind) for kind in ("ShaderNodeBsdfTransparent", "ShaderNodeMixShader"))
    wiring.connect(shown, mixed.inputs[0])
    wiring.connect(transparent.outputs[0], mixed.inputs[1])
    wiring.connect(wiring.node("NodeGroupInput").outputs[0], mixed.inputs[2])
    wiring.connect(mixed.outputs[0], wiring.node("NodeGroupOutput").inputs[0])


def _number_of_ray(wiring: Wiring) -> Operand:
    """A random number in 0..1, of the place in the picture for rays of the camera, and one half for all others."""
    window = wiring.node("ShaderNodeTexCoord").outputs["Window"]
    noise = wiring.node("ShaderNodeTexWhiteNoise", {"noise_dimensions": "2D"})
    # In cells, since the place is worked out anew at every surface, and rounding would make another number of it.
    wiring.connect(wiring.vector("FLOOR", wiring.vector("SCALE", window, CELLS)), noise.inputs["Vector"])
    of_camera = wiring.node("ShaderNodeLightPath").outputs["Is Camera Ray"]
    above = wiring.math("SUBTRACT", noise.outputs["Value"], 0.5)
    return wiring.math("ADD", wiring.math("MULTIPLY", of_camera, above), 0.5)


def _drive(item: bpy.types.Object, name: str, place: int, expression: str, paths: dict[str, str]) -> None:
    """One number of a custom property as a formula of what `paths` of the scene that is drawn say."""
    driver = item.driver_add(f'["{name}"]', place).driver
    driver.type = "SCRIPTED"
    for key, path in paths.items():
        variable = driver.variables.new()
        variable.name, variable.type = key, "CONTEXT_PROP"
        variable.targets[0].context_property = "ACTIVE_SCENE"
        variable.targets[0].data_path = path
    driver.expression = expression
