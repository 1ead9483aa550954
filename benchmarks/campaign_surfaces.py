"""What Blender's own importers read from a mesh file: figures of its surface and small renders of it, for `campaign_files.py`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np

from lib import environment

environment.import_farfield()

from lib import scene_files

SIDE, SAMPLES = 96, 24  # Pixels per side and samples of a render.
DIRECTIONS = ((0.7, -1.0, 0.5), (-0.4, 0.9, -0.6))  # Directions of the views, towards the camera.
MIN_OVERLAP, MAX_COLOR_DIFFERENCE = 0.95, 0.03
MAX_FIGURE_DIFFERENCE = 1e-3  # relative
MIN_ALTITUDE = 1e-4  # Relative to the size; quantization makes thinner triangles vanish.


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface in world space: triangles, area, bounds (2, 3) and renders (H, W, 4), premultiplied, of all DIRECTIONS."""

    triangles: int
    area: float
    bounds: np.ndarray
    images: list[np.ndarray]


def read_surface(path: Path, frame: np.ndarray | None, renders: bool = True) -> Surface:
    """Open a file near the origin, measure all that renders show, and render it.

    frame: bounds (2, 3) of the views, None for those of the surface. Raises FarfieldError if Blender cannot read the file.
    """
    scene_files.open_near_origin(path)
    shapes = {bone.custom_shape for item in bpy.data.objects if item.pose is not None for bone in item.pose.bones}
    for item in bpy.context.scene.objects:
        item.hide_render |= item.type not in ("MESH", "CURVE", "SURFACE", "META", "FONT", "EMPTY") or item in shapes
        item.hide_viewport = item.hide_render
        if item.name in bpy.context.view_layer.objects:
            item.hide_set(False)
    bpy.context.view_layer.update()
    corners = _read_triangles()
    if not len(corners):
        return Surface(0, 0.0, np.zeros((2, 3)), [])
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = 0.5 * np.linalg.norm(sides, axis=1)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    bounds = np.array([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])
    count = int(np.count_nonzero(2 * areas > MIN_ALTITUDE * np.ptp(bounds, axis=0).max() * longest))
    frame = bounds if frame is None else frame
    images = [_render(frame, np.array(direction)) for direction in DIRECTIONS] if renders else []
    return Surface(count, float(areas.sum()), bounds, images)


def compare(expected: Surface, found: Surface) -> dict[str, Any]:
    """Return how far a surface is from the expected one; "problem" is there if it is too far."""
    size = max(float(np.ptp(expected.bounds, axis=0).max()), 1e-30)
    figures: dict[str, Any] = {
        "triangles": [expected.triangles, found.triangles],
        "area": _relative(found.area, expected.area),
        "bounds": float(np.abs(expected.bounds - found.bounds).max()) / size,
    }
    problems = [name for name in ("area", "bounds") if figures[name] > MAX_FIGURE_DIFFERENCE]
    if abs(found.triangles - expected.triangles) > 0.005 * expected.triangles + 2:
        problems.append("triangles")
    if expected.images and found.images:
        overlaps, differences = zip(*(map_pair(*pair) for pair in zip(expected.images, found.images, strict=True)), strict=True)
        figures |= {"overlap": round(min(overlaps), 4), "color": round(max(differences), 4)}
        problems += ["overlap"] if figures["overlap"] < MIN_OVERLAP else []
        problems += ["color"] if figures["color"] > MAX_COLOR_DIFFERENCE else []
    return figures | ({"problem": f"{', '.join(problems)} differ"} if problems else {})


def map_pair(expected: np.ndarray, found: np.ndarray) -> tuple[float, float]:
    """Return the overlap of the alpha of two renders, and the mean difference of their pixels where one of them shows something."""
    union, common = (kind(expected[..., 3], found[..., 3]).sum() for kind in (np.maximum, np.minimum))
    visible = np.maximum(expected[..., 3], found[..., 3]) > 0.05
    difference = float(np.abs(np.clip(expected, 0, 2) - np.clip(found, 0, 2))[visible].mean()) if visible.any() else 0.0
    return float(common / union) if union > 0 else 1.0, difference


def _relative(value: float, expected: float) -> float:
    return abs(value - expected) / expected if expected else abs(value)


def _read_triangles() -> np.ndarray:
    """Return the corners (T, 3, 3) of everything that renders show, in world space."""
    parts = [np.zeros((0, 3, 3))]
    graph = bpy.context.evaluated_depsgraph_get()
    for instance in graph.object_instances:
        item = instance.object
        if item.type == "EMPTY" or not instance.show_self or item.original.hide_render:
            continue
        try:
            mesh = item.to_mesh()
        except RuntimeError:
            continue
        mesh.calc_loop_triangles()
        vertices, triangles = np.empty(3 * len(mesh.vertices), np.float32), np.empty(3 * len(mesh.loop_triangles), np.int32)
        mesh.vertices.foreach_get("co", vertices)
        mesh.loop_triangles.foreach_get("vertices", triangles)
        matrix = np.array(instance.matrix_world)
        positions = vertices.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
        parts.append(positions[triangles.reshape(-1, 3)])
        item.to_mesh_clear()
    return np.concatenate(parts)


def _render(frame: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Render the scene in white surroundings without other lights, in parallel projection."""
    scene = bpy.context.scene
    center, radius = frame.mean(axis=0), max(float(np.linalg.norm(np.ptp(frame, axis=0))) / 2, 1e-6)
    direction = direction / np.linalg.norm(direction)
    data = bpy.data.cameras.new("view")
    data.type, data.ortho_scale, data.clip_start, data.clip_end = "ORTHO", 2.05 * radius, radius / 100, 10 * radius
    camera = bpy.data.objects.new("view", data)
    camera.location = center + 3 * radius * direction
    camera.rotation_euler = mathutils.Vector(direction.tolist()).to_track_quat("Z", "Y").to_euler()
    scene.collection.objects.link(camera)
    world = bpy.data.worlds.new("white")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    scene.world, scene.camera = world, camera
    settings = scene.render
    settings.engine, settings.film_transparent, settings.use_compositing, settings.use_sequencer = "CYCLES", True, False, False
    settings.resolution_x = settings.resolution_y = SIDE
    settings.resolution_percentage, settings.use_border = 100, False
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.seed, scene.cycles.max_bounces = SAMPLES, False, 1, 2
    scene.cycles.transparent_max_bounces = 64
    scene.view_settings.view_transform, scene.view_settings.look = "Raw", "None"
    settings.image_settings.file_format, settings.image_settings.color_mode = "OPEN_EXR", "RGBA"
    path = Path(bpy.app.tempdir) / "view.exr"
    settings.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    pixels = np.empty(4 * SIDE * SIDE, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    path.unlink()
    return pixels.reshape(SIDE, SIDE, 4)
