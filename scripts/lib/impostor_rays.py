"""Node groups that evaluate an octahedral atlas for a ray: "Ray" blends three frames, each intersected by the group "Frame"."""

from dataclasses import dataclass

import bpy

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.btf.materials.nodes.table_nodes import fold_below_horizon, to_octahedral
from farfield.addon.bridge.shading.node_builder import NodeBuilder, SocketOrValue, create_group
from farfield.addon.core.btf.octahedral import FrameGrid, OctahedralAtlas
from farfield.addon.core.imaging.images import MIN_ALPHA

PARALLAX_STEPS = 2  # The search for the surface along a ray starts at the plane through the center and is repeated so often.
MIN_COSINE = 0.1  # Smaller cosines between a ray and the direction of a frame are clamped.
# Filtered images have smaller mipmaps in EEVEE where UVs are discontinuous, as behind heights, so frames would blend into each other.
INTERPOLATION = {"CYCLES": "Linear", "EEVEE": "Closest"}


@dataclass(frozen=True)
class FrameImages:
    """The images of an atlas and its layout. roughness_metallic (2,): where both are uniform and need no image, else None."""

    grid: FrameGrid
    frame_resolution: int
    images: dict[str, bpy.types.Image]
    roughness_metallic: tuple[float, float] | None

    @classmethod
    def from_atlas(cls, atlas: OctahedralAtlas, images: dict[str, bpy.types.Image]) -> "FrameImages":
        """Return the frames of `atlas`, whose maps as of `encode` are in `images`."""
        uniform = atlas.uniform_roughness_metallic
        roughness_metallic = None if uniform is None else (float(uniform[0]), float(uniform[1]))
        return cls(atlas.grid, atlas.frame_resolution, images, roughness_metallic)


@dataclass(frozen=True)
class RaySockets:
    """Sockets with what a ray hits. color: scene-linear. normal: unit, object space. distance: along the ray, in half sides."""

    color: bpy.types.NodeSocket
    alpha: bpy.types.NodeSocket
    normal: bpy.types.NodeSocket
    roughness: bpy.types.NodeSocket
    metallic: bpy.types.NodeSocket
    distance: bpy.types.NodeSocket


RAY_OUTPUTS = (
    ("Color", "Color"),
    ("Alpha", "Float"),
    ("Normal", "Vector"),
    ("Roughness", "Float"),
    ("Metallic", "Float"),
    ("Distance", "Float"),
)


def build_ray_groups(name: str, frames: FrameImages) -> dict[str, bpy.types.NodeTree]:
    """Create the group "Ray" for each renderer."""
    return {
        renderer: _build_ray_group(f"{name} {renderer.title()}", frames, interpolation) for renderer, interpolation in INTERPOLATION.items()
    }


def _build_ray_group(name: str, frames: FrameImages, interpolation: str) -> bpy.types.NodeTree:
    """Create the group "Ray" for the ray through Point along Direction.

    Point: object space, in half sides from the center. Direction: unit vector to the viewer. Min Distance: surfaces closer than this along
    the ray, in half sides from Point, are ignored.
    """
    group = create_group(f"{name} Ray", (("Point", "Vector"), ("Direction", "Vector"), ("Min Distance", "Float")), RAY_OUTPUTS)
    builder = NodeBuilder(group)
    frame_group = _build_frame_group(name, frames, interpolation)
    point, direction, min_distance = list(builder.node("NodeGroupInput").outputs)[:3]
    totals: list[SocketOrValue] = [(0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0]
    for column, row, weight in _surrounding_frames(builder, direction, frames.grid):
        node = builder.node("ShaderNodeGroup", {"node_tree": frame_group})
        for operand, target in zip((point, direction, min_distance, column, row), node.inputs, strict=True):
            builder.connect(operand, target)
        weight_alpha = builder.math("MULTIPLY", weight, node.outputs["Alpha"])
        totals[1] = builder.math("ADD", totals[1], weight_alpha)
        for index in (0, 2):
            totals[index] = builder.vector("ADD", totals[index], builder.vector("SCALE", node.outputs[index], weight_alpha))
        for index in (3, 4, 5):
            totals[index] = builder.math("ADD", totals[index], builder.math("MULTIPLY", node.outputs[index], weight_alpha))
    inverse_alpha = builder.math("DIVIDE", 1.0, builder.math("MAXIMUM", totals[1], MIN_ALPHA))
    # Where normals differ, their mean is shorter, and the faces receive less light in proportion: not all of them can face it.
    normal_length = builder.vector("LENGTH", builder.vector("SCALE", totals[2], inverse_alpha))
    results = [
        builder.vector("SCALE", totals[0], builder.math("MULTIPLY", inverse_alpha, normal_length)),
        totals[1],
        builder.vector("NORMALIZE", totals[2]),
        *(builder.math("MULTIPLY", totals[index], inverse_alpha) for index in (3, 4, 5)),
    ]
    for result, target in zip(results, builder.node("NodeGroupOutput").inputs, strict=False):
        builder.connect(result, target)
    builder.arrange()
    return group


def _surrounding_frames(
    builder: NodeBuilder, direction: SocketOrValue, grid: FrameGrid
) -> list[tuple[SocketOrValue, SocketOrValue, SocketOrValue]]:
    """Return column, row and weight of the three frames around `direction`; see `surrounding_frames` in the tests of impostors."""
    cells = float(grid.frames_per_side - 1)
    uv = builder.vector("ADD", builder.vector("SCALE", to_octahedral(builder, direction, grid.upper), 0.5), (0.5, 0.5, 0.0))
    positions = builder.vector("SCALE", uv, cells)
    low = builder.vector("MAXIMUM", builder.vector("MINIMUM", builder.vector("FLOOR", positions), (cells - 1.0,) * 3), (0.0, 0.0, 0.0))
    t_x, y, _ = builder.separate(builder.vector("SUBTRACT", positions, low))
    low_x, low_y, _ = builder.separate(low)
    from_center_x, from_center_y = (builder.math("ADD", value, 0.5 - 0.5 * cells) for value in (low_x, low_y))
    is_mirrored = builder.math("GREATER_THAN", builder.math("MULTIPLY", from_center_x, from_center_y), 0.0)
    step = builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", is_mirrored, 2.0))  # along the columns: 1, or -1 if mirrored
    first = builder.math("ADD", low_x, is_mirrored)
    x = builder.math("ADD", builder.math("MULTIPLY", t_x, step), is_mirrored)
    is_right = builder.math("GREATER_THAN", x, y)
    return [
        (first, low_y, builder.math("SUBTRACT", 1.0, builder.math("MAXIMUM", x, y))),
        (builder.math("ADD", first, step), builder.math("ADD", low_y, 1.0), builder.math("MINIMUM", x, y)),
        (
            builder.math("ADD", builder.math("MULTIPLY", is_right, step), first),
            builder.math("ADD", low_y, builder.math("SUBTRACT", 1.0, is_right)),
            builder.math("ABSOLUTE", builder.math("SUBTRACT", x, y)),
        ),
    ]


def _build_frame_group(name: str, frames: FrameImages, interpolation: str) -> bpy.types.NodeTree:
    """Create the group "Frame": what a ray hits in the frame at Column, Row; see `sample_rays` in the tests of impostors."""
    inputs = (("Point", "Vector"), ("Direction", "Vector"), ("Min Distance", "Float"), ("Column", "Float"), ("Row", "Float"))
    group = create_group(f"{name} Frame", inputs, RAY_OUTPUTS)
    builder = NodeBuilder(group)
    point, direction, min_distance, column, row = list(builder.node("NodeGroupInput").outputs)[:5]
    half_cells = 0.5 * (frames.grid.frames_per_side - 1)
    x, y = (builder.math("SUBTRACT", builder.math("DIVIDE", value, half_cells), 1.0) for value in (column, row))
    frame_direction = from_octahedral(builder, x, y, frames.grid.upper)
    right = _right_axis(builder, frame_direction)
    up = builder.vector("CROSS_PRODUCT", frame_direction, right)
    cosine = builder.math("MAXIMUM", builder.vector("DOT_PRODUCT", frame_direction, direction), MIN_COSINE)
    base = builder.vector("DOT_PRODUCT", point, frame_direction)
    frame_corner = builder.combine(column, row, 0.0)
    height: SocketOrValue = 0.0
    for _ in range(PARALLAX_STEPS + 1):
        distance = builder.math("DIVIDE", builder.math("SUBTRACT", height, base), cosine)
        hit = builder.vector("ADD", point, builder.vector("SCALE", direction, distance))
        projected = builder.combine(builder.vector("DOT_PRODUCT", hit, right), builder.vector("DOT_PRODUCT", hit, up), 0.0)
        frame_uv = builder.vector("ADD", builder.vector("SCALE", projected, 0.5), (0.5, 0.5, 0.0))
        edge = 0.5 / frames.frame_resolution
        clamped = builder.vector("MINIMUM", builder.vector("MAXIMUM", frame_uv, (edge, edge, 0.0)), (1.0 - edge, 1.0 - edge, 0.0))
        uv = builder.vector("SCALE", builder.vector("ADD", frame_corner, clamped), 1.0 / frames.grid.frames_per_side)
        normal, encoded_height = _sample_image(builder, frames.images["normal_height"], uv, interpolation)
        height = builder.math("MULTIPLY", builder.math("SUBTRACT", encoded_height, 0.5), 2.0)
    color, alpha = _sample_image(builder, frames.images["color"], uv, interpolation)
    from_center = builder.separate(builder.vector("ABSOLUTE", builder.vector("SUBTRACT", frame_uv, (0.5, 0.5, 0.0))))
    is_inside = builder.math("LESS_THAN", builder.math("MAXIMUM", from_center[0], from_center[1]), 0.5)
    is_hit = builder.math("MULTIPLY", is_inside, builder.math("GREATER_THAN", distance, min_distance))
    if frames.roughness_metallic is None:
        image_color = _sample_image(builder, frames.images["roughness_metallic"], uv, interpolation)[0]
        roughness, metallic, _ = builder.separate_color(image_color)
    else:
        roughness, metallic = frames.roughness_metallic
    decoded = builder.vector("SUBTRACT", builder.vector("SCALE", normal, 2.0), (1.0, 1.0, 1.0))
    results = (color, builder.math("MULTIPLY", alpha, is_hit), decoded, roughness, metallic, distance)
    for result, target in zip(results, builder.node("NodeGroupOutput").inputs, strict=False):
        builder.connect(result, target)
    builder.arrange()
    return group


def from_octahedral(builder: NodeBuilder, x: SocketOrValue, y: SocketOrValue, upper: bool) -> bpy.types.NodeSocket:
    """Return the unit direction at the position x, y in -1..1 of the map. The inverse of `to_octahedral`."""
    if upper:
        x, y = (builder.math("MULTIPLY", builder.math(operation, x, y), 0.5) for operation in ("ADD", "SUBTRACT"))
    norm = builder.math("ADD", builder.math("ABSOLUTE", x), builder.math("ABSOLUTE", y))
    z = builder.math("SUBTRACT", 1.0, norm)
    direction = builder.combine(x, y, builder.math("MAXIMUM", z, 0.0) if upper else z)
    if not upper:
        direction = builder.vector("SUBTRACT", direction, fold_below_horizon(builder, x, y, z))
    return builder.vector("NORMALIZE", direction)


def _right_axis(builder: NodeBuilder, direction: SocketOrValue) -> bpy.types.NodeSocket:
    """Return the x axis of the frame seen from `direction`; see `OrthographicView.right`."""
    x, y, _ = builder.separate(direction)
    horizontal = builder.combine(builder.math("MULTIPLY", y, -1.0), x, 0.0)
    is_vertical = builder.math("LESS_THAN", builder.vector("DOT_PRODUCT", horizontal, horizontal), 1e-8)
    return builder.vector("NORMALIZE", builder.vector("ADD", horizontal, builder.combine(is_vertical, 0.0, 0.0)))


def _sample_image(
    builder: NodeBuilder, image: bpy.types.Image, uv: SocketOrValue, interpolation: str
) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """Return color and alpha of `image` at `uv`."""
    node = builder.node("ShaderNodeTexImage", {"image": image, "extension": "EXTEND", "interpolation": interpolation})
    builder.connect(uv, node.inputs["Vector"])
    return node.outputs["Color"], node.outputs["Alpha"]


def sample_ray(
    builder: NodeBuilder, group: bpy.types.NodeTree, point: SocketOrValue, direction: SocketOrValue, min_distance: SocketOrValue
) -> RaySockets:
    """Add a node of the group "Ray" and return its outputs."""
    node = builder.node("ShaderNodeGroup", {"node_tree": group, "width": 180.0})
    for operand, target in zip((point, direction, min_distance), node.inputs, strict=True):
        builder.connect(operand, target)
    return RaySockets(*node.outputs)
