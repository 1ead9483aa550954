"""Node groups that show each object, and each instance, as the level of detail that its distance to the active camera requires.

They need no extension: geometry nodes read the active camera, and drivers its lens and the resolution. A level is instanced only where it
shows, so renders load only levels that are needed. While two levels fade into each other, both are instanced, with materials that
cross-fade for each camera ray, see `lod_crossfade`. What the camera does not see is coarser, for its shadow and reflections, and never the
original, which would take the most memory.
"""

from dataclasses import replace
from enum import Enum

import bpy

from ...core.distance.forecasts import MARGIN, UNSEEN_EXCESS, UNSEEN_FACTOR
from ..active_camera import View, add_view
from ..geometry.geometry_nodes import TREE, GeometryBuilder
from ..lod_crossfade import INSTANCE_CAMERA, INSTANCE_PIXEL
from ..shading.node_builder import NodeBuilder, SocketOrValue, ensure_shared_group

NAME, VERSION = "Farfield Levels by Distance", 6
MAX_ERROR = "Max Error"  # Input of the modifiers: what a level may leave out, in pixels.
SEPARATION = 1e-5  # Of the distance, by which levels that fade are moved apart: where surfaces coincide, Cycles misses one of them.
TINY_BOX = 1e-20  # Size of the bounding box of an instance that has only other instances.
MAX_NESTING = 4  # Levels of instances of instances, such as of a collection with collections.


class Places(Enum):
    """Where an asset is: OBJECT where the modified object is, which it replaces; MATCHING at those instances in its geometry whose bounding
    box is that of the asset, others stay as they are; ALL at all of its instances."""

    OBJECT = "Object"
    MATCHING = "Instances"
    ALL = "Places"


def ensure_level_switch(count: int, places: Places) -> bpy.types.NodeTree:
    """Return the node group that shows one of `count` levels, each a collection, at the `places` of an asset."""
    sockets = [("Geometry", "Geometry"), ("Center", "Vector"), ("Half Size", "Vector"), (MAX_ERROR, "Float"), ("Fade Range", "Float")]
    sockets += [("Low", "Vector"), ("High", "Vector"), ("Tolerance", "Float")] if places is Places.MATCHING else []
    for number in range(count):
        sockets += [(f"Level {number}", "Collection"), (f"Fading Level {number}", "Collection"), (f"Pixel Size {number}", "Float")]

    def fill(builder: NodeBuilder) -> None:
        _fill(GeometryBuilder(builder.tree), count, places)

    name = f"{NAME}: {count} of {places.value}"
    return ensure_shared_group(name, VERSION, sockets, [("Geometry", "Geometry")], fill, f"{places.value} {count}", TREE)


def _fill(builder: GeometryBuilder, count: int, places: Places) -> None:
    given, result = builder.node("NodeGroupInput").outputs, builder.node("NodeGroupOutput").inputs[0]
    geometry = given["Geometry"]
    seen = add_view(builder)
    growth, constant = (builder.math("MULTIPLY", size, given[MAX_ERROR]) for size in (seen.growth, seen.constant))
    view = replace(seen, growth=growth, constant=constant)
    own = builder.call("GeometryNodeObjectInfo", {"Object": builder.node("GeometryNodeSelfObject").outputs[0]})
    to_world, local, rest = own.outputs["Transform"], None, None
    if places is Places.OBJECT:
        points = builder.call("GeometryNodePoints", {0: 1}).outputs[0]
    else:
        if places is Places.MATCHING:
            geometry = _flatten(builder, geometry)
            is_asset = _has_bounds(builder, given)
            separated = builder.call("GeometryNodeSeparateGeometry", {0: geometry, 1: is_asset}, {"domain": "INSTANCE"})
            geometry, rest = separated.outputs
        captured, local = builder.capture_transforms(geometry)
        points = builder.call("GeometryNodeInstancesToPoints", {0: captured}).outputs[0]
        to_world = builder.call("FunctionNodeMatrixMultiply", {0: to_world, 1: local}).outputs[0]
    pixel, shift, conditions = _choose(builder, given, view, to_world, count)
    to_local = builder.call("FunctionNodeInvertMatrix", {0: own.outputs["Transform"]}).outputs[0]
    shift = builder.call("FunctionNodeTransformDirection", {0: shift, 1: to_local}).outputs[0]
    join = builder.node("GeometryNodeJoinGeometry")
    for number, (is_plain, is_fading) in enumerate(conditions):
        plain = _instance(builder, points, is_plain, given[f"Level {number}"], local)
        builder.tree.links.new(plain, join.inputs[0])
        fading = _instance(builder, points, is_fading, given[f"Fading Level {number}"], local)
        if number:
            inputs = {0: fading, "Translation": builder.vector("SCALE", shift, float(number)), "Local Space": False}
            fading = builder.call("GeometryNodeTranslateInstances", inputs).outputs[0]
        for name, value in ((INSTANCE_CAMERA, view.position), (INSTANCE_PIXEL, pixel)):
            properties = {"domain": "INSTANCE", "data_type": "FLOAT_VECTOR"}
            fading = builder.call("GeometryNodeStoreNamedAttribute", {0: fading, "Name": name, "Value": value}, properties).outputs[0]
        builder.tree.links.new(fading, join.inputs[0])
    if rest is not None:
        builder.tree.links.new(rest, join.inputs[0])
    builder.tree.links.new(join.outputs[0], result)


def _instance(
    builder: GeometryBuilder,
    points: bpy.types.NodeSocket,
    selection: SocketOrValue,
    collection: bpy.types.NodeSocket,
    local: bpy.types.NodeSocket | None,
) -> bpy.types.NodeSocket:
    """Return instances of a collection at the selected points, with the matrix `local` that these have."""
    level = builder.call("GeometryNodeCollectionInfo", {0: collection}).outputs[0]
    part = builder.call("GeometryNodeInstanceOnPoints", {0: points, 1: selection, 2: level}).outputs[0]
    return part if local is None else builder.call("GeometryNodeSetInstanceTransform", {0: part, 2: local}).outputs[0]


def _flatten(builder: GeometryBuilder, geometry: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return the geometry with the instances in its nested instances, in place of these, which are those without a bounding box."""
    for _ in range(MAX_NESTING):
        bounds = builder.node("GeometryNodeInputInstanceBounds")
        size = builder.vector("LENGTH", builder.vector("SUBTRACT", *(bounds.outputs[index] for index in (1, 0))))
        inputs = {0: geometry, "Selection": builder.less(size, TINY_BOX), "Realize All": False, "Depth": 1}
        geometry = builder.call("GeometryNodeRealizeInstances", inputs).outputs[0]
    return geometry


def _has_bounds(builder: GeometryBuilder, given: bpy.types.bpy_prop_collection) -> bpy.types.NodeSocket:
    """Return whether an instance has the bounding box of the asset: geometry nodes of Blender before 5.2 cannot tell what it refers to."""
    bounds = builder.node("GeometryNodeInputInstanceBounds").outputs
    offsets = [builder.vector("SUBTRACT", bounds[index], given[name]) for index, name in enumerate(("Low", "High"))]
    return builder.less(builder.math("ADD", *(builder.vector("LENGTH", offset) for offset in offsets)), given["Tolerance"])


def _choose(
    builder: GeometryBuilder, given: bpy.types.bpy_prop_collection, view: View, to_world: bpy.types.NodeSocket, count: int
) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket, list[tuple[SocketOrValue, SocketOrValue]]]:
    """Return the attribute `INSTANCE_PIXEL` of each place, how far each level that fades is moved in world space with respect to the one
    before, and for each level where it is instanced without and with a fade."""
    axes = builder.vector("ABSOLUTE", builder.call("FunctionNodeSeparateTransform", {0: to_world}).outputs[2])
    scale = builder.math("MULTIPLY", builder.vector("LENGTH", axes), 3.0**-0.5)
    center = builder.transform_point(given["Center"], to_world)
    largest = builder.math("MAXIMUM", builder.math("MAXIMUM", *(builder.separate(axes)[:2])), builder.separate(axes)[2])
    radius = builder.math("MULTIPLY", builder.vector("LENGTH", given["Half Size"]), largest)
    offset = builder.vector("SUBTRACT", center, view.position)
    distance = builder.vector("LENGTH", offset)
    own_position = builder.transform_point(view.position, builder.call("FunctionNodeInvertMatrix", {0: to_world}).outputs[0])
    local_offset = builder.vector("ABSOLUTE", builder.vector("SUBTRACT", own_position, given["Center"]))
    outside = builder.vector("MAXIMUM", builder.vector("SUBTRACT", local_offset, given["Half Size"]), (0.0, 0.0, 0.0))
    to_box = builder.vector("LENGTH", builder.vector("MULTIPLY", outside, axes))

    def pixel_size(at: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
        size = builder.math("MULTIPLY_ADD", at, view.growth)
        builder.tree.links.new(view.constant, size.node.inputs[2])
        return builder.math("DIVIDE", size, builder.math("MAXIMUM", scale, 1e-20))

    nearest, farthest = pixel_size(to_box), pixel_size(builder.math("ADD", distance, radius))
    is_seen = _is_seen(builder, view, offset, distance, radius)
    is_exact = builder.boolean("OR", view.is_viewport, builder.less(given["Fade Range"], 1e-6))
    is_exact = builder.boolean("OR", is_exact, builder.boolean("NOT", is_seen))
    if count > 1:
        unseen = builder.math("MULTIPLY", nearest, UNSEEN_FACTOR)
        unseen = builder.math("MAXIMUM", unseen, builder.math("MULTIPLY", given["Pixel Size 1"], UNSEEN_EXCESS))
        nearest = builder.switch(is_seen, unseen, nearest, "FLOAT")
    factor = builder.math("ADD", given["Fade Range"], 1.0)
    may_fade = builder.boolean("NOT", is_exact)
    safe_scale = builder.math("MAXIMUM", scale, 1e-20)
    pixel = builder.combine(builder.math("DIVIDE", view.growth, safe_scale), builder.math("DIVIDE", view.constant, safe_scale), 1.0)
    found = []
    for number in range(count):
        is_shown: SocketOrValue = True
        is_partial: SocketOrValue = False
        if number:
            start = given[f"Pixel Size {number}"]
            is_shown = builder.less(start, builder.switch(is_exact, farthest, nearest, "FLOAT"))
            is_partial = builder.less(nearest, builder.math("MULTIPLY", start, factor))
        if number < count - 1:
            end = given[f"Pixel Size {number + 1}"]
            is_partial = builder.boolean("OR", builder.less(end, farthest), is_partial)
            end = builder.switch(is_exact, builder.math("MULTIPLY", end, factor), end, "FLOAT")
            is_shown = builder.boolean("AND", builder.boolean("NOT", builder.less(end, nearest)), is_shown)
        fades = builder.boolean("AND", may_fade, is_partial)
        found.append((builder.boolean("AND", is_shown, builder.boolean("NOT", fades)), builder.boolean("AND", is_shown, fades)))
    return pixel, builder.vector("SCALE", offset, SEPARATION), found


def _is_seen(
    builder: GeometryBuilder,
    view: View,
    offset: bpy.types.NodeSocket,
    distance: bpy.types.NodeSocket,
    radius: bpy.types.NodeSocket,
) -> bpy.types.NodeSocket:
    """Return whether a bounding sphere is within a cone around the image of the camera, or the camera within the sphere."""
    along = builder.vector("DOT_PRODUCT", offset, view.direction)
    safe = builder.math("MAXIMUM", distance, 1e-20)
    angle = builder.math("ARCCOSINE", builder.math("DIVIDE", along, safe))
    half = builder.math("ARCSINE", builder.math("MINIMUM", builder.math("DIVIDE", radius, safe), 1.0))
    limit = builder.math("ADD", builder.math("ADD", builder.math("ARCTANGENT", view.diagonal), half), MARGIN)
    is_all_seen = builder.boolean("OR", builder.less(1e5, view.diagonal), builder.less(view.diagonal, 1e-9))  # It is 0 without a camera.
    is_inside = builder.less(distance, radius)
    return builder.boolean("OR", builder.boolean("OR", builder.less(angle, limit), is_inside), is_all_seen)


def level_modifiers(item: bpy.types.Object) -> list[bpy.types.NodesModifier]:
    """Return the modifiers of an object that show levels by distance."""
    return [
        modifier
        for modifier in item.modifiers
        if modifier.type == "NODES" and modifier.node_group is not None and modifier.node_group.name.startswith(NAME)
    ]
