"""Cross-fading of a cloud's levels and its source for the active camera, with shader nodes and drivers only.

All levels render at once, and the material of each is transparent where another level shows. Which level shows depends on the size of a
camera pixel at the shaded position, and within the fade range also on a random number that differs between camera rays but is the same for
all surfaces along one ray. So each camera ray sees exactly one level, and coverage is preserved. Other rays have no position in the image;
for them levels switch at the middle of the range.
"""

from collections.abc import Sequence

import bpy

from ..compat import enable_nodes
from .objects import add_scene_driver
from .shading.node_builder import NodeBuilder, SocketOrValue, ensure_shared_group

GROUP_NAME, GROUP_VERSION = "Farfield Cross-Fade", 3
# Custom properties of a cross-fading object. Lengths are in the object's units.
CROSSFADE = "farfield_crossfade"  # the pixel size above which it shows, the pixel size up to which it shows, and the relative range
CAMERA_POSITION = "farfield_camera_position"  # in world space
PIXEL_SIZE = "farfield_pixel_size"  # the growth of a pixel's side per unit of distance, its side at the camera, and 0
# Attributes of instances, which stand for the two properties above: Blender does not evaluate the drivers of objects that are in no scene.
INSTANCE_CAMERA = "farfield_instance_camera"  # camera position in world space
INSTANCE_PIXEL = "farfield_instance_pixel"  # growth and constant part of the pixel size, in units of the instance, and 1
MIN_PIXEL, MAX_PIXEL = 0.0, 1e30  # limits of objects that show from the camera on, or up to any distance
MIN_RANGE = 1e-3
ALWAYS = (-1.0, MAX_PIXEL)  # limits of objects that always show; 0 as start would need an active camera
NOISE_CELLS = 8192.0  # per side of the image: all rays within one cell get the same random number
NODE_WIDTH = 260.0
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


def add_crossfade(item: bpy.types.Object, start: float, end: float, fade_range: float) -> None:
    """Let `item` show where a pixel of the active camera is larger than `start` and at most `end`, in units of the object.

    It fades in from `start` to (1 + `fade_range`) * `start`, and fades out from `end` on in the same way.
    """
    set_limits(item, start, end, fade_range)
    item[CAMERA_POSITION] = [0.0, 0.0, 0.0]
    for axis in range(3):
        add_scene_driver(item, CAMERA_POSITION, axis, "position", {"position": f"camera.matrix_world[3][{axis}]"})
    item[PIXEL_SIZE] = [0.0, 0.0, 0.0]
    add_scene_driver(item, PIXEL_SIZE, 0, GROWTH, SCENE_PATHS)
    add_scene_driver(item, PIXEL_SIZE, 1, CONSTANT, SCENE_PATHS)


def set_limits(item: bpy.types.Object, start: float, end: float, fade_range: float) -> None:
    """Do as `add_crossfade` does where `item` shows as instances with the attributes `INSTANCE_CAMERA` and `INSTANCE_PIXEL` only."""
    item[CROSSFADE] = [float(start), float(end), max(float(fade_range), MIN_RANGE)]
    apply_to_materials(item)


def apply_to_materials(item: bpy.types.Object) -> None:
    """Add the cross-fade node group to all current materials of `item`, if it has a cross-fade."""
    if CROSSFADE in item:
        for slot in item.material_slots:
            if slot.material is not None:
                _insert_group(slot.material)


def is_fading(item: bpy.types.Object) -> bool:
    """Return whether `item` cross-fades for the active camera."""
    return CAMERA_POSITION in item


def show_always(item: bpy.types.Object) -> None:
    """Let `item` show at any distance, also with the materials of objects that cross-fade."""
    remove_crossfade(item, ())
    item[CROSSFADE] = [*ALWAYS, MIN_RANGE]


def remove_crossfade(item: bpy.types.Object, materials: Sequence[bpy.types.Material | None]) -> None:
    """Let `item` show at any distance again: remove its properties, and the node group from `materials`, all that it may use."""
    for name in (CAMERA_POSITION, PIXEL_SIZE):
        item.driver_remove(f'["{name}"]')
    for name in (CROSSFADE, CAMERA_POSITION, PIXEL_SIZE):
        if name in item:
            del item[name]
    for material in materials:
        if material is not None:
            remove_from_material(material)


def _insert_group(material: bpy.types.Material) -> None:
    """Insert the group between the surface shader and every output of `material`, unless it is there already."""
    enable_nodes(material)
    tree = material.node_tree
    for output in [node for node in tree.nodes if node.type == "OUTPUT_MATERIAL"]:
        links = output.inputs["Surface"].links
        if not links or is_crossfade(links[0].from_node):
            continue
        shader = links[0].from_socket
        builder = NodeBuilder(tree)
        group = ensure_shared_group(GROUP_NAME, GROUP_VERSION, [("Shader", "Shader")], [("Shader", "Shader")], _fill_group)
        node = builder.node("ShaderNodeGroup", {"node_tree": group})
        node.location = output.location
        output.location.x += NODE_WIDTH
        tree.links.new(shader, node.inputs[0])
        tree.links.new(node.outputs[0], output.inputs["Surface"])


def remove_from_material(material: bpy.types.Material) -> None:
    """Remove the cross-fade node group from a material, if it has one."""
    tree = material.node_tree
    for node in [node for node in tree.nodes if is_crossfade(node)] if tree is not None else []:
        shader = node.inputs[0].links[0].from_socket if node.inputs[0].links else None
        for link in list(node.outputs[0].links):
            link.to_node.location.x -= NODE_WIDTH
            if shader is not None:
                tree.links.new(shader, link.to_socket)
        tree.nodes.remove(node)


def is_crossfade(node: bpy.types.Node) -> bool:
    """Return whether a node is the group that cross-fades a material."""
    return node.type == "GROUP" and node.node_tree is not None and node.node_tree.name.startswith(GROUP_NAME)


def _fill_group(builder: NodeBuilder) -> None:
    """Return the input shader where the object shows, a transparent shader elsewhere."""
    start, end, fade_range = builder.separate(builder.object_attribute(CROSSFADE))
    growth, constant, _ = builder.separate(builder.object_attribute(PIXEL_SIZE))
    position = builder.node("ShaderNodeNewGeometry").outputs["Position"]
    distance, distance_of_instance = (
        builder.vector("LENGTH", builder.vector("SUBTRACT", position, camera))
        for camera in (builder.object_attribute(CAMERA_POSITION), builder.instance_attribute(INSTANCE_CAMERA))
    )
    component = 3.0**-0.5
    scale = builder.vector("LENGTH", builder.vector_transform((component, component, component), "VECTOR", "OBJECT", "WORLD"))
    pixel_size = builder.math("DIVIDE", builder.math("ADD", builder.math("MULTIPLY", distance, growth), constant), scale)
    growth, constant, is_given = builder.separate(builder.instance_attribute(INSTANCE_PIXEL))
    of_instance = builder.math("ADD", builder.math("MULTIPLY", distance_of_instance, growth), constant)
    pixel_size = builder.math("ADD", pixel_size, builder.math("MULTIPLY", is_given, builder.math("SUBTRACT", of_instance, pixel_size)))

    def has_passed(switch_size: SocketOrValue) -> SocketOrValue:
        """1 where the ray is beyond the switch at a pixel of `switch_size`, as `crossfade_fraction` in the tests computes it."""
        width = builder.math("MAXIMUM", builder.math("MULTIPLY", switch_size, fade_range), 1e-20)
        fraction = builder.math("DIVIDE", builder.math("SUBTRACT", pixel_size, switch_size), width, clamp=True)
        return builder.math("LESS_THAN", random, fraction)

    random = _random_of_ray(builder)
    is_shown = builder.math("SUBTRACT", has_passed(start), has_passed(end))
    transparent, mix = (builder.node(node_type) for node_type in ("ShaderNodeBsdfTransparent", "ShaderNodeMixShader"))
    builder.connect(is_shown, mix.inputs[0])
    builder.connect(transparent.outputs[0], mix.inputs[1])
    builder.connect(builder.node("NodeGroupInput").outputs[0], mix.inputs[2])
    builder.connect(mix.outputs[0], builder.node("NodeGroupOutput").inputs[0])


def _random_of_ray(builder: NodeBuilder) -> SocketOrValue:
    """Return a random number in 0..1 per image position for camera rays, and 0.5 for all other rays."""
    window = builder.node("ShaderNodeTexCoord").outputs["Window"]
    noise = builder.node("ShaderNodeTexWhiteNoise", {"noise_dimensions": "2D"})
    # Cells: the coordinate is recomputed at every surface along the ray, and rounding errors would change the random number.
    builder.connect(builder.vector("FLOOR", builder.vector("SCALE", window, NOISE_CELLS)), noise.inputs["Vector"])
    is_camera_ray = builder.node("ShaderNodeLightPath").outputs["Is Camera Ray"]
    offset = builder.math("SUBTRACT", noise.outputs["Value"], 0.5)
    return builder.math("ADD", builder.math("MULTIPLY", is_camera_ray, offset), 0.5)
