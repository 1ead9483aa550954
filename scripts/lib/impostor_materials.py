"""The shaders of an octahedral impostor for Cycles and EEVEE, made of built-in nodes and images. See `impostors` for the meshes.

The quads evaluate the node group "Ray" of `impostor_rays` for every camera ray and pass color, normal and roughness to a Principled shader.
The shell evaluates it for every other ray. A ray from outside hits the silhouette that is visible from its direction. A ray from a point on
a quad starts at the visible surface instead, and is blocked if the frames of its direction show something farther out, as in a shadow map.
"""

from collections.abc import Mapping

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.billboards.cloud_materials import create_two_sided_material
from farfield.addon.bridge.shading.node_builder import NodeBuilder, SocketOrValue
from lib.impostor_rays import RaySockets, sample_ray

FACING = "farfield_facing"  # attribute of all vertices: unit direction to the viewer, object space
RIGHT = "farfield_right"  # the same for the x axis of the viewer's image
QUAD_NORMAL = "farfield_quad_normal"  # attribute of the quads: one of QUAD_NORMALS
TILTS = ((0.0, 1), (28.0, 5), (58.0, 9))  # degrees from the viewer, and number of quads with that tilt, evenly distributed
# Normals of the quads as seen by the viewer: x to the right, y up, z to the viewer.
QUAD_NORMALS = np.array(
    [
        (np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), np.cos(tilt))
        for tilt, count in ((np.radians(degrees), count) for degrees, count in TILTS)
        for angle in 2.0 * np.pi * np.arange(count) / count
    ]
)
SHELL_RADIUS = 2.1  # in half sides of a frame; all quads are inside
MAX_QUAD_DISTANCE = 2.0  # in half sides from the center: a ray that starts within it starts on a quad
MIN_RAY_DISTANCE = -16.0  # in half sides along a ray: nearer than anything that it can hit from a point in the shell


def quad_material(name: str, ray_groups: Mapping[str, bpy.types.NodeTree], half_side: float) -> bpy.types.Material:
    """Create the material for camera rays. It is visible on the quad whose normal is nearest to the visible normal."""
    material, builder = create_two_sided_material(name)
    for renderer, ray_group in ray_groups.items():
        ray = sample_ray(builder, ray_group, _ray_hit(builder, half_side), _direction_to_origin(builder), MIN_RAY_DISTANCE)
        alpha = builder.math("MULTIPLY", ray.alpha, _is_best_quad(builder, ray.normal))
        _add_principled_output(builder, ray, alpha, renderer)
    return material


def _is_best_quad(builder: NodeBuilder, normal: SocketOrValue) -> bpy.types.NodeSocket:
    """Return 1 on the quad whose own normal is nearest to `normal`, else 0."""
    facing, right = builder.attribute(FACING), builder.attribute(RIGHT)
    axes = (right, builder.vector("CROSS_PRODUCT", facing, right), facing)
    view_normal = builder.combine(*(builder.vector("DOT_PRODUCT", normal, axis) for axis in axes))
    max_cosine: SocketOrValue = -1.0
    for quad_normal in QUAD_NORMALS:
        max_cosine = builder.math("MAXIMUM", builder.vector("DOT_PRODUCT", view_normal, quad_normal.tolist()), max_cosine)
    cosine = builder.vector("DOT_PRODUCT", view_normal, builder.attribute(QUAD_NORMAL))
    return builder.math("GREATER_THAN", cosine, builder.math("SUBTRACT", max_cosine, 1e-4))


def shell_material(name: str, ray_groups: Mapping[str, bpy.types.NodeTree], half_side: float, bias: float) -> bpy.types.Material:
    """Create the material for light rays. They hit it where they leave the shell.

    EEVEE's light rays never start on a quad, so it has a simpler graph of its own. bias: in half sides; a surface that is closer in front
    of a point does not shade it.
    """
    material, builder = create_two_sided_material(name)
    light_path = builder.node("ShaderNodeLightPath")
    is_leaving = builder.node("ShaderNodeNewGeometry").outputs["Backfacing"]
    backward = _direction_to_origin(builder)
    forward = builder.vector("SCALE", backward, -1.0)
    hit = _ray_hit(builder, half_side)
    outside_ray = sample_ray(builder, ray_groups["EEVEE"], hit, forward, MIN_RAY_DISTANCE)
    _add_principled_output(builder, outside_ray, builder.math("MULTIPLY", outside_ray.alpha, is_leaving), "EEVEE")
    length = builder.math("DIVIDE", _to_object_length(builder, light_path.outputs["Ray Length"]), half_side)
    origin = builder.vector("ADD", hit, builder.vector("SCALE", backward, length))
    is_from_quad = builder.math("LESS_THAN", builder.vector("DOT_PRODUCT", origin, origin), MAX_QUAD_DISTANCE**2)
    facing = builder.attribute(FACING)
    visible = sample_ray(builder, ray_groups["CYCLES"], origin, facing, MIN_RAY_DISTANCE)
    surface = builder.vector("ADD", origin, builder.vector("SCALE", facing, visible.distance))
    start = builder.mix(is_from_quad, hit, builder.vector("ADD", surface, builder.vector("SCALE", visible.normal, bias)))
    min_distance = builder.math("ADD", builder.math("MULTIPLY", is_from_quad, bias - MIN_RAY_DISTANCE), MIN_RAY_DISTANCE)
    is_seen_from_outside = builder.math(
        "MULTIPLY",
        builder.math("SUBTRACT", 1.0, is_from_quad),
        builder.math("SUBTRACT", 1.0, light_path.outputs["Is Shadow Ray"]),
    )
    ray = sample_ray(builder, ray_groups["CYCLES"], start, builder.mix(is_seen_from_outside, forward, backward), min_distance)
    _add_principled_output(builder, ray, builder.math("MULTIPLY", ray.alpha, is_leaving), "CYCLES")
    return material


def _ray_hit(builder: NodeBuilder, half_side: float) -> bpy.types.NodeSocket:
    """Return the point where the ray hits the mesh, in object space and half sides."""
    return builder.vector("SCALE", builder.node("ShaderNodeTexCoord").outputs["Object"], 1.0 / half_side)


def _direction_to_origin(builder: NodeBuilder) -> bpy.types.NodeSocket:
    """Return the unit direction to the origin of the ray, in object space."""
    return builder.vector("NORMALIZE", _incoming(builder))


def _to_object_length(builder: NodeBuilder, length: SocketOrValue) -> bpy.types.NodeSocket:
    """Convert a world-space length to object space, for any scale of the instance."""
    return builder.math("MULTIPLY", length, builder.vector("LENGTH", _incoming(builder)))


def _incoming(builder: NodeBuilder) -> bpy.types.NodeSocket:
    """Return the direction to the origin of the ray in object space. Its length is that of one world unit."""
    return builder.vector_transform(builder.node("ShaderNodeNewGeometry").outputs["Incoming"], "VECTOR", "WORLD", "OBJECT")


def _add_principled_output(builder: NodeBuilder, ray: RaySockets, alpha: SocketOrValue, renderer: str) -> None:
    """Add a Principled shader with what a ray hits as the material output for `renderer`, CYCLES or EEVEE."""
    shader = builder.node("ShaderNodeBsdfPrincipled")
    builder.connect(ray.color, shader.inputs["Base Color"])
    builder.connect(ray.roughness, shader.inputs["Roughness"])
    builder.connect(ray.metallic, shader.inputs["Metallic"])
    builder.connect(alpha, shader.inputs["Alpha"])
    builder.connect(builder.vector_transform(ray.normal, "NORMAL", "OBJECT", "WORLD"), shader.inputs["Normal"])
    builder.connect(shader.outputs[0], builder.node("ShaderNodeOutputMaterial", {"target": renderer}).inputs["Surface"])
    builder.arrange()
