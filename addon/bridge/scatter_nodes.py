"""The geometry nodes that put plants and rocks on terrains, around the active camera."""

import math

import bpy

from .active_camera import add_view
from .geometry.geometry_nodes import TREE, GeometryBuilder
from .shading.node_builder import NodeBuilder, ensure_shared_group

NAME, NAME_IN_WIND, VERSION = "Farfield Scatter", "Farfield Scatter in Wind", 2
WIND_SPEED, GUST_SIZE = 4.0, 12.0  # Meters per second; meters between gusts.
CALM, FLUTTER, FLUTTER_RATE = 0.3, 0.2, 9.0  # How far plants lean without a gust, and how far and how fast they swing, radians per second.
MAX_SIDE = 420  # Places along a side of the grid around the camera.
FADE_START = 0.6  # Fraction of the distance from which on there is less.
STEEPNESS_NOISE, FLAT_MARGIN = 0.12, 0.1  # How far noise moves z of normals, and what is added to its upper limit for it.
SOCKETS = (
    ("Geometry", "Geometry"), ("Ground", "Collection"), ("Near", "Collection"), ("Far", "Collection"), ("Far From", "Float"),
    ("Spacing", "Float"), ("Distance", "Float"), ("Density", "Float"), ("Lowest", "Float"), ("Highest", "Float"), ("Flattest", "Float"),
    ("Steepest", "Float"), ("Clump Size", "Float"), ("Clumps", "Float"), ("Align to Ground", "Float"), ("Size", "Float"),
    ("Size Variation", "Float"), ("Seed", "Int"), ("Clearance", "Float"), ("Sway", "Float"), ("Meter", "Float"),
)  # fmt: skip


def ensure_group(has_wind: bool) -> bpy.types.NodeTree:
    """Return the shared node group. With wind, it depends on time and is evaluated for every frame."""
    fill, name = (_fill_in_wind, NAME_IN_WIND) if has_wind else (_fill, NAME)
    return ensure_shared_group(name, VERSION, SOCKETS, (("Geometry", "Geometry"),), fill, tree_type=TREE)


def _fill_in_wind(builder: NodeBuilder) -> None:
    _fill(builder, has_wind=True)


def _fill(builder: NodeBuilder, has_wind: bool = False) -> None:
    builder = GeometryBuilder(builder.tree)
    given = builder.node("NodeGroupInput").outputs
    own = builder.call("GeometryNodeObjectInfo", {"Object": builder.node("GeometryNodeSelfObject").outputs[0]}).outputs["Transform"]
    to_local = builder.call("FunctionNodeInvertMatrix", {0: own}).outputs[0]
    camera = builder.transform_point(add_view(builder).position, to_local)
    ground = builder.call("GeometryNodeCollectionInfo", {0: given["Ground"]}, {"transform_space": "RELATIVE"}).outputs[0]
    ground = builder.call("GeometryNodeRealizeInstances", {0: ground}).outputs[0]
    side = builder.math("DIVIDE", builder.math("MULTIPLY", given["Distance"], 2.0), given["Spacing"])
    side = builder.math("MINIMUM", builder.math("CEIL", side, 0.0), float(MAX_SIDE))
    index = builder.node("GeometryNodeInputIndex").outputs[0]
    row = builder.math("FLOOR", builder.math("DIVIDE", builder.math("ADD", index, 0.5), side), 0.0)
    column = builder.math("SUBTRACT", index, builder.math("MULTIPLY", row, side))
    half = builder.math("FLOOR", builder.math("MULTIPLY", side, 0.5), 0.0)
    cells = []
    for place, axis in zip((column, row), builder.separate(camera)[:2], strict=True):
        center = builder.math("FLOOR", builder.math("DIVIDE", axis, given["Spacing"]), 0.0)
        cells.append(builder.math("ADD", builder.math("SUBTRACT", place, half), center))
    first, second = (_random(builder, cells, builder.math("ADD", given["Seed"], shift)) for shift in (0.25, 0.75))
    x, y = (
        builder.math("MULTIPLY", builder.math("ADD", cell, value), given["Spacing"])
        for cell, value in zip(cells, builder.separate(first)[:2], strict=True)
    )
    bounds = builder.call("GeometryNodeBoundBox", {0: ground}).outputs
    top, bottom = (builder.separate(bounds[name])[2] for name in ("Max", "Min"))
    start = builder.math("ADD", top, 1.0)
    count = builder.math("MULTIPLY", side, side)
    points = builder.call("GeometryNodePoints", {"Count": count, "Position": builder.combine(x, y, start), "Radius": 0.01}).outputs[0]
    length = builder.math("ADD", builder.math("SUBTRACT", start, bottom), 1.0)
    ray = builder.call(
        "GeometryNodeRaycast",
        {"Target Geometry": ground, "Source Position": builder.node("GeometryNodeInputPosition").outputs[0], "Ray Length": length},
    )
    ray.inputs["Ray Direction"].default_value = (0.0, 0.0, -1.0)
    # What is known of each place is stored before the points move to the ground, and some of them are left out.
    values = {"Is Hit": ray.outputs["Is Hit"], "Position": ray.outputs["Hit Position"], "Normal": ray.outputs["Hit Normal"]}
    hit = _capture(builder, points, values | {"First": first, "Second": second})
    first, second = (builder.separate(hit.outputs[name]) for name in ("First", "Second"))
    capture, position, normal = hit.outputs[0], hit.outputs["Position"], hit.outputs["Normal"]
    is_chosen = _choose(builder, given, hit, camera, second[0])
    moved = builder.call("GeometryNodeSetPosition", {"Geometry": capture, "Position": position}).outputs[0]
    kept = builder.call("GeometryNodeSeparateGeometry", {0: moved, 1: is_chosen}, {"domain": "POINT"}).outputs[0]
    up = builder.mix(given["Align to Ground"], (0.0, 0.0, 1.0), normal)
    turned = builder.call("FunctionNodeAlignRotationToVector", {"Vector": up}, {"axis": "Z"}).outputs[0]
    spin = builder.call("FunctionNodeAxisAngleToRotation", {"Angle": builder.math("MULTIPLY", second[1], math.tau)}).outputs[0]
    rotation = builder.call("FunctionNodeRotateRotation", {0: turned, 1: spin}, {"rotation_space": "LOCAL"}).outputs[0]
    if has_wind:
        lean = _add_wind(builder, given, position, second[1])
        rotation = builder.call("FunctionNodeRotateRotation", {0: rotation, 1: lean}, {"rotation_space": "GLOBAL"}).outputs[0]
    smaller = builder.math("MULTIPLY", builder.math("SUBTRACT", 1.0, builder.math("POWER", second[2], 1.7)), given["Size Variation"])
    size = builder.math("MULTIPLY", builder.math("SUBTRACT", 1.15, smaller), given["Size"])
    distance = builder.vector("LENGTH", builder.vector("SUBTRACT", position, camera))
    is_near = builder.less(distance, given["Far From"])
    join = builder.node("GeometryNodeJoinGeometry")
    variant = builder.math("FLOOR", builder.math("MULTIPLY", first[2], 997.0), 0.0)
    for name, selection in (("Near", is_near), ("Far", builder.boolean("NOT", is_near))):
        assets = builder.call("GeometryNodeCollectionInfo", {0: given[name], 1: True, 2: True}).outputs[0]
        inputs = {"Points": kept, "Selection": selection, "Instance": assets, "Pick Instance": True, "Instance Index": variant}
        instances = builder.call("GeometryNodeInstanceOnPoints", {**inputs, "Rotation": rotation, "Scale": size}).outputs[0]
        builder.tree.links.new(instances, join.inputs[0])
    builder.tree.links.new(join.outputs[0], builder.node("NodeGroupOutput").inputs[0])


def _add_wind(
    builder: GeometryBuilder, given: bpy.types.bpy_prop_collection, position: bpy.types.NodeSocket, random: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    """Return the rotation by which plants lean along +X: by gusts that travel with the wind, and a swing of each plant."""
    seconds = builder.node("GeometryNodeInputSceneTime").outputs["Seconds"]
    meters = builder.vector("SCALE", position, builder.math("DIVIDE", 1.0, given["Meter"]))
    traveled = builder.combine(builder.math("MULTIPLY", seconds, WIND_SPEED), 0.0, 0.0)
    noise = builder.node("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1.0 / GUST_SIZE, 2.0
    builder.tree.links.new(builder.vector("SUBTRACT", meters, traveled), noise.inputs["Vector"])
    gust = builder.math("MULTIPLY", builder.math("SUBTRACT", noise.outputs[0], 0.3), 2.0, True)
    phase = builder.math("ADD", builder.math("MULTIPLY", random, math.tau), builder.math("MULTIPLY", seconds, FLUTTER_RATE))
    swing = builder.math("MULTIPLY", builder.math("SINE", phase, 0.0), FLUTTER)
    strength = builder.math("ADD", builder.math("MULTIPLY", gust, builder.math("ADD", swing, 1.0 - CALM)), CALM)
    angle = builder.math("MULTIPLY", strength, given["Sway"])
    node = builder.call("FunctionNodeAxisAngleToRotation", {"Angle": angle})
    node.inputs["Axis"].default_value = (0.0, 1.0, 0.0)
    return node.outputs[0]


def _random(builder: GeometryBuilder, cells: list[bpy.types.NodeSocket], seed: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return a vector of three random numbers of each cell."""
    noise = builder.node("ShaderNodeTexWhiteNoise", {"noise_dimensions": "3D"})
    builder.tree.links.new(builder.combine(*cells, seed), noise.inputs["Vector"])
    return noise.outputs["Color"]


def _capture(builder: GeometryBuilder, geometry: bpy.types.NodeSocket, values: dict[str, bpy.types.NodeSocket]) -> bpy.types.Node:
    """Return a node with the geometry and with values of its points that stay when it changes."""
    node = builder.node("GeometryNodeCaptureAttribute", {"domain": "POINT"})
    builder.tree.links.new(geometry, node.inputs[0])
    for name, value in values.items():
        node.capture_items.new("BOOLEAN" if value.type == "BOOLEAN" else "VECTOR", name)
        builder.tree.links.new(value, node.inputs[name])
    return node


def _choose(
    builder: GeometryBuilder,
    given: bpy.types.bpy_prop_collection,
    hit: bpy.types.Node,
    camera: bpy.types.NodeSocket,
    random: bpy.types.NodeSocket,
) -> bpy.types.NodeSocket:
    """Return whether there is something at a place: by the ground there, noise, and the distance to the camera."""
    position = hit.outputs["Position"]
    height, steepness = builder.separate(position)[2], builder.separate(hit.outputs["Normal"])[2]
    is_chosen = hit.outputs["Is Hit"]
    noise = builder.node("ShaderNodeTexNoise")
    builder.tree.links.new(builder.vector("SCALE", position, builder.math("DIVIDE", 1.0, given["Clump Size"])), noise.inputs["Vector"])
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1.0, 3.0
    uneven = builder.math("SUBTRACT", noise.outputs[0], 0.5)
    steepness = builder.math("ADD", steepness, builder.math("MULTIPLY", uneven, STEEPNESS_NOISE))
    limits = ((given["Lowest"], height), (height, given["Highest"]), (given["Steepest"], steepness))
    for low, high in limits:
        is_chosen = builder.boolean("AND", is_chosen, builder.less(low, high))
    is_chosen = builder.boolean("AND", is_chosen, builder.less(steepness, builder.math("ADD", given["Flattest"], FLAT_MARGIN)))
    open_part = builder.math("MULTIPLY", builder.math("ADD", builder.math("MULTIPLY", uneven, 6.0), 0.5, True), given["Clumps"])
    weight = builder.math("ADD", builder.math("SUBTRACT", 1.0, given["Clumps"]), open_part)
    offset = builder.vector("MULTIPLY", builder.vector("SUBTRACT", position, camera), (1.0, 1.0, 0.0))
    length = builder.vector("LENGTH", offset)
    is_chosen = builder.boolean("AND", is_chosen, builder.less(given["Clearance"], length))
    reached = builder.math("DIVIDE", length, given["Distance"])
    fade = builder.math("DIVIDE", builder.math("SUBTRACT", 1.0, reached), 1.0 - FADE_START, True)
    probability = builder.math("MULTIPLY", builder.math("MULTIPLY", weight, fade), given["Density"])
    return builder.boolean("AND", is_chosen, builder.less(random, probability))
