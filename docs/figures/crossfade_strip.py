"""A strip of one cloud that cross-fades while the camera moves away: rendered, and colored by the level that each camera ray sees."""

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.billboards.scene_clouds import SceneCloud
from farfield.addon.bridge.billboards.source_objects import find_source_proxies
from farfield.addon.bridge.cameras import read_scene_camera
from farfield.addon.core.imaging import metrics
from lib.contact_sheet import PAPER_GRAY, draw_contact_sheet
from lib.studio import bounding_sphere, open_studio

FADE_RANGE = 0.25
BEFORE, AFTER = 0.8, 1.6  # distances without a fade, relative to the switch distance of the next level and of the shown level
LEVEL_COLORS = (0.22, 0.22, 0.22), (0.02, 0.20, 0.55), (0.80, 0.30, 0.02), (0.02, 0.32, 0.12)  # linear; the source first


def draw_crossfade_strip(cloud: SceneCloud, view: np.ndarray, cell_pixels: int, samples: int) -> np.ndarray:
    """Cross-fade `cloud`, which has its source, and return a strip (H, W, 3) of renders from the direction `view` (3,).

    Each render has the pixel size of the scene's camera at its distance. All are magnified to `cell_pixels` for the bounding sphere. The
    materials of the cloud are replaced.
    """
    camera = read_scene_camera(bpy.context.scene)
    frames = list_frames([camera.switch_distance(error) for error in cloud.errors])
    center, radius = bounding_sphere(cloud.sources)
    cloud.add_crossfade(bpy.context, FADE_RANGE)
    proxies = find_source_proxies(cloud.collection)
    items = [*proxies, *cloud.levels]
    pixel_sizes = [camera.pixel_size(distance) for distance, _ in frames]
    sizes = [int(np.ceil(2.0 * radius / pixel_size)) + 2 for pixel_size in pixel_sizes]
    rows = []
    with open_studio(items, samples) as studio:
        for row in range(2):
            if row == 1:
                assign_level_colors(proxies, cloud.levels)
                studio.set_samples(1)
            renders = [studio.render(items, view, center, *frame) for frame in zip(pixel_sizes, sizes, strict=True)]
            shown = [2.0 * radius / pixel_size for pixel_size in pixel_sizes]
            rows.append([magnify(render, diameter, cell_pixels) for render, diameter in zip(renders, shown, strict=True)])
    window = metrics.crop_to_object(np.max([render[..., 3] for row in rows for render in row], axis=0), margin=4)
    images = [[metrics.composite_over_gray(render[window], PAPER_GRAY) for render in row] for row in rows]
    labels = [[name, f"{distance:.0f} m"] for distance, name in frames]
    return draw_contact_sheet(
        f"A camera moves away from one tree, fade range {FADE_RANGE:.0%}", images, ["render", "level per camera ray"], labels
    )


def list_frames(switch_distances: list[float]) -> list[tuple[float, str]]:
    """Return distance and label of all frames: the source, then the middle of the fade to each level, and this level alone."""
    frames = [(BEFORE * switch_distances[0], "source")]
    names = ["source", *(f"L{index}" for index in range(len(switch_distances)))]
    for index, distance in enumerate(switch_distances):
        frames.append(((1.0 + 0.5 * FADE_RANGE) * distance, f"{names[index]} to {names[index + 1]}"))
        frames.append((AFTER * distance, names[index + 1]))
    return frames


def magnify(render: np.ndarray, diameter: float, cell_pixels: int) -> np.ndarray:
    """Resample the central `diameter` pixels of a render (N, N, 4) to (cell_pixels, cell_pixels, 4) by the nearest pixel."""
    offsets = (np.arange(cell_pixels) + 0.5) / cell_pixels - 0.5
    indices = np.floor(0.5 * len(render) + offsets * diameter).astype(int)
    return render[np.ix_(indices, indices)]


def assign_level_colors(proxies: list[bpy.types.Object], levels: list[bpy.types.Object]) -> None:
    """Let every level, and the proxies of the source, emit a color of their own; the silhouettes of their materials stay."""
    for index, group in enumerate((proxies, *([level] for level in levels))):
        for item in group:
            item.color = (*LEVEL_COLORS[index % len(LEVEL_COLORS)], 1.0)
            for slot in item.material_slots:
                emit_object_color(slot.material.node_tree)


def emit_object_color(tree: bpy.types.NodeTree) -> None:
    """Replace the reflectance of all Principled shaders of a node tree and its groups by emission of the object color."""
    for node in list(tree.nodes):
        if node.type == "GROUP" and node.node_tree is not None:
            emit_object_color(node.node_tree)
        if node.type != "BSDF_PRINCIPLED":
            continue
        for name, value in (
            ("Base Color", (0.0, 0.0, 0.0, 1.0)),
            ("Metallic", 0.0),
            ("Specular IOR Level", 0.0),
            ("Emission Strength", 1.0),
        ):
            for link in list(node.inputs[name].links):
                tree.links.remove(link)
            node.inputs[name].default_value = value
        color = tree.nodes.new("ShaderNodeObjectInfo").outputs["Color"]
        tree.links.new(color, node.inputs["Emission Color"])
