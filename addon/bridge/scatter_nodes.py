"""The geometry nodes that put plants and rocks on terrains, around the active camera."""

import math

import bpy

from .active_camera import add_view
from .geometry.geometry_nodes import TREE, GeometryBuilder
from .shading.node_builder import NodeBuilder, ensure_shared_group

NAME, NAME_IN_WIND, VERSION = "Farfield Scatter", "Farfield Scatter in Wind", 3
WIND_SPEED, GUST_SIZE = 4.0, 12.0  # Meters per second; meters between gusts.
CALM, FLUTTER, FLUTTER_RATE = 0.3, 0.2, 9.0  # How far plants lean without a gust, and how far and how fast they swing, radians per second.
MAX_SIDE = 420  # Places along a side of the grid around the camera.
FADE_START = 0.6  # Fraction of the distance from which on there is less.
CONTRAST, GAPS = 14.0, 0.08  # Of clumps: how fast noise turns into density, and by how much clumps are rarer than gaps.
SMALLER_AT_EDGES = 0.45  # By how much everything is smaller at the edge of a clump, a fraction.
CLIFF, HILLSIDE = (0.6, 1.3), (0.35, 0.8)  # Rises of the ground, relative to the distance: of cliffs, and of hillsides with debris.
ON_HILLSIDES = 0.35  # How much debris lies on hillsides, relative to the ground below cliffs.
HOLLOW = 0.12  # Mean rise around a place that is all hollow.
AROUND = ((1.0, 0.0), (0.7, 0.7), (0.0, 1.0), (-0.7, 0.7), (-1.0, 0.0), (-0.7, -0.7), (0.0, -1.0), (0.7, -0.7))  # Directions.
STEEPNESS_NOISE, FLAT_MARGIN = 0.12, 0.1  # How far noise moves z of normals, and what is added to its upper limit for it.
SOCKETS = (
    ("Geometry", "Geometry"), ("Ground", "Collection"), ("Near", "Collection"), ("Far", "Collection"), ("Far From", "Float"),
    ("Spacing", "Float"), ("Distance", "Float"), ("Density", "Float"), ("Lowest", "Float"), ("Highest", "Float"), ("Flattest", "Float"),
    ("Steepest", "Float"), ("Clump Size", "Float"), ("Clumps", "Float"), ("Align to Ground", "Float"), ("Size", "Float"),
    ("Size Variation", "Float"), ("Seed", "Int"), ("Clearance", "Float"), ("Sway", "Float"), ("Meter", "Float"),
    ("Tilt", "Float"), ("Reach", "Float"), ("Debris", "Float"), ("Hollows", "Float"),
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
    clump = _add_clumps(builder, given, position)
    shape = _add_shape_of_ground(builder, given, position, side, index)
    is_chosen = _choose(builder, given, hit, camera, clump, shape, second[0])
    moved = builder.call("GeometryNodeSetPosition", {"Geometry": capture, "Position": position}).outputs[0]
    kept = builder.call("GeometryNodeSeparateGeometry", {0: moved, 1: is_chosen}, {"domain": "POINT"}).outputs[0]
    up = builder.mix(given["Align to Ground"], (0.0, 0.0, 1.0), normal)
    turned = builder.call("FunctionNodeAlignRotationToVector", {"Vector": up}, {"axis": "Z"}).outputs[0]
    spin = builder.call("FunctionNodeAxisAngleToRotation", {"Angle": builder.math("MULTIPLY", second[1], math.tau)}).outputs[0]
    rotation = builder.call("FunctionNodeRotateRotation", {0: turned, 1: spin}, {"rotation_space": "LOCAL"}).outputs[0]
    tilt = builder.math("SUBTRACT", builder.math("FRACT", builder.math("MULTIPLY", second[1], 61.0)), 0.5)
    tilted = builder.call("FunctionNodeAxisAngleToRotation", {"Angle": builder.math("MULTIPLY", tilt, given["Tilt"])})
    tilted.inputs["Axis"].default_value = (1.0, 0.0, 0.0)
    rotation = builder.call("FunctionNodeRotateRotation", {0: rotation, 1: tilted.outputs[0]}, {"rotation_space": "LOCAL"}).outputs[0]
    if has_wind:
        lean = _add_wind(builder, given, position, second[1])
        rotation = builder.call("FunctionNodeRotateRotation", {0: rotation, 1: lean}, {"rotation_space": "GLOBAL"}).outputs[0]
    size = _add_size(builder, given, clump[1], second[2])
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


def _add_clumps(
    builder: GeometryBuilder, given: bpy.types.bpy_prop_collection, position: bpy.types.NodeSocket
) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """Return noise around 0 that each seed has of its own, and how dense clumps are: from 0, a gap between them, to 1."""
    noise = builder.node("ShaderNodeTexNoise")
    scaled = builder.vector("SCALE", position, builder.math("DIVIDE", 1.0, given["Clump Size"]))
    shift = builder.math("MULTIPLY", given["Seed"], 3.7)
    builder.tree.links.new(builder.vector("ADD", scaled, builder.combine(shift, shift, 0.0)), noise.inputs["Vector"])
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1.0, 3.0
    uneven = builder.math("SUBTRACT", noise.outputs[0], 0.5)
    above = builder.math("SUBTRACT", uneven, builder.math("MULTIPLY", given["Clumps"], GAPS))
    return uneven, builder.math("ADD", builder.math("MULTIPLY", above, CONTRAST), 0.5, True)


def _add_size(
    builder: GeometryBuilder, given: bpy.types.bpy_prop_collection, density: bpy.types.NodeSocket, random: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    """Return sizes of which most are small: their number falls with the square of the size, see `core.plants.sample_sizes`."""
    smallest = builder.math("POWER", builder.math("SUBTRACT", 1.0, given["Size Variation"]), -2.0)
    powers = builder.math("ADD", smallest, builder.math("MULTIPLY", random, builder.math("SUBTRACT", 1.0, smallest)))
    at_edge = builder.math("MULTIPLY", builder.math("SUBTRACT", 1.0, density), given["Clumps"])
    factor = builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", at_edge, SMALLER_AT_EDGES))
    return builder.math("MULTIPLY", builder.math("MULTIPLY", builder.math("POWER", powers, -0.5), factor), given["Size"])


def _add_shape_of_ground(
    builder: GeometryBuilder,
    given: bpy.types.bpy_prop_collection,
    position: bpy.types.NodeSocket,
    side: bpy.types.NodeSocket,
    index: bpy.types.NodeSocket,
) -> bpy.types.NodeSocket:
    """Return how well the ground within *Reach* suits: *Debris* lies below cliffs and, less of it, on hillsides; plants grow in *Hollows*.

    Places of the same grid at that distance show how the ground rises, unless they are beyond its border or have no ground.
    """
    steps = builder.math("MAXIMUM", builder.math("ROUND", builder.math("DIVIDE", given["Reach"], given["Spacing"])), 1.0)
    farthest = builder.math("MULTIPLY", given["Reach"], 2.0)
    highest = total = None
    for x, y in AROUND:
        column, row = (builder.math("ROUND", builder.math("MULTIPLY", steps, value)) for value in (x, y))
        other = builder.math("ADD", builder.math("ADD", index, column), builder.math("MULTIPLY", row, side))
        properties = {"data_type": "FLOAT_VECTOR", "domain": "POINT"}
        neighbor = builder.call("GeometryNodeFieldAtIndex", {"Value": position, "Index": other}, properties).outputs[0]
        offset = builder.vector("SUBTRACT", neighbor, position)
        length = builder.math("MAXIMUM", builder.vector("LENGTH", builder.vector("MULTIPLY", offset, (1.0, 1.0, 0.0))), 1e-6)
        rise = builder.math("DIVIDE", builder.separate(offset)[2], length)
        rise = builder.math("MULTIPLY", rise, builder.math("LESS_THAN", length, farthest))
        highest = rise if highest is None else builder.math("MAXIMUM", highest, rise)
        total = rise if total is None else builder.math("ADD", total, rise)
    cliff, hillside = (builder.math("DIVIDE", builder.math("SUBTRACT", highest, low), high - low, True) for low, high in (CLIFF, HILLSIDE))
    scree = builder.math("MAXIMUM", cliff, builder.math("MULTIPLY", hillside, ON_HILLSIDES))
    hollow = builder.math("DIVIDE", total, HOLLOW * len(AROUND), True)
    parts = [
        builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", given[name], builder.math("SUBTRACT", 1.0, part)))
        for name, part in (("Debris", scree), ("Hollows", hollow))
    ]
    return builder.switch(builder.less(0.0, given["Reach"]), 1.0, builder.math("MULTIPLY", *parts), "FLOAT")


def _choose(
    builder: GeometryBuilder,
    given: bpy.types.bpy_prop_collection,
    hit: bpy.types.Node,
    camera: bpy.types.NodeSocket,
    clump: tuple[bpy.types.NodeSocket, bpy.types.NodeSocket],
    shape: bpy.types.NodeSocket,
    random: bpy.types.NodeSocket,
) -> bpy.types.NodeSocket:
    """Return whether there is something at a place: by the ground there and around it, clumps, and the distance to the camera."""
    position = hit.outputs["Position"]
    height, steepness = builder.separate(position)[2], builder.separate(hit.outputs["Normal"])[2]
    is_chosen = hit.outputs["Is Hit"]
    steepness = builder.math("ADD", steepness, builder.math("MULTIPLY", clump[0], STEEPNESS_NOISE))
    limits = ((given["Lowest"], height), (height, given["Highest"]), (given["Steepest"], steepness))
    for low, high in limits:
        is_chosen = builder.boolean("AND", is_chosen, builder.less(low, high))
    is_chosen = builder.boolean("AND", is_chosen, builder.less(steepness, builder.math("ADD", given["Flattest"], FLAT_MARGIN)))
    open_part = builder.math("MULTIPLY", clump[1], given["Clumps"])
    weight = builder.math("MULTIPLY", builder.math("ADD", builder.math("SUBTRACT", 1.0, given["Clumps"]), open_part), shape)
    offset = builder.vector("MULTIPLY", builder.vector("SUBTRACT", position, camera), (1.0, 1.0, 0.0))
    length = builder.vector("LENGTH", offset)
    is_chosen = builder.boolean("AND", is_chosen, builder.less(given["Clearance"], length))
    reached = builder.math("DIVIDE", length, given["Distance"])
    fade = builder.math("DIVIDE", builder.math("SUBTRACT", 1.0, reached), 1.0 - FADE_START, True)
    probability = builder.math("MULTIPLY", builder.math("MULTIPLY", weight, fade), given["Density"])
    return builder.boolean("AND", is_chosen, builder.less(random, probability))
