"""Render the images of the tutorial by running the scripts on its page: `python3 docs/tutorial_pictures.py [--only NAME ...]`.

tutorial_ground (the ground from above, and its boxes in colors), tutorial_pine and tutorial_rock (their levels, enlarged and as large as
where they switch), tutorial (the final image) and tutorial_levels (the same, colored by level).
"""

import re
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import bpy
import numpy as np
from figures.crossfade_strip import LEVEL_COLORS
from render_pictures import VIEW_DIRECTION, crop_over_paper, enlarge_to_fit, read_png, save_webp, write

from farfield.addon.bridge.billboards.scene_clouds import clouds_in
from farfield.addon.bridge.billboards.source_objects import find_source_proxies
from farfield.addon.core.imaging import metrics
from farfield.addon.core.jobs.progress import Progress
from lib import command_line
from lib.contact_sheet import PAPER_GRAY, draw_contact_sheet
from lib.demo_materials import create_material
from lib.studio import bounding_sphere, look_at_matrix, open_studio

PAGE = Path(__file__).resolve().parent / "tutorial.md"
VIEW_WIDTH = 1600
GROUND_SIZE = 440, 248
CELL_PIXELS = 210
ROCK_COLUMNS = 4
BOX_COLORS = (0.75, 0.24, 0.03), (0.02, 0.25, 0.6), (0.1, 0.4, 0.08), (0.7, 0.5, 0.05), (0.3, 0.06, 0.4), (0.05, 0.4, 0.4), (0.3, 0.3, 0.3)
PAPER_COLOR = 0.7, 0.7, 0.68  # The ground below things that are colored by level.
GROUND_TARGET = np.array([0.0, 40.0, 0.0])
GROUND_DIRECTION = np.array([0.15, -0.72, 0.68]) / np.linalg.norm([0.15, -0.72, 0.68])  # from the ground towards the camera
GROUND_DISTANCE = 560.0  # meters


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the steps of the page, render the selected images and return the result in one line."""
    parser = command_line.Parser(prog="tutorial_pictures.py", description="Render the images of the tutorial.")
    names = [name for pictures in PICTURES.values() for name in pictures]
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="the images to render (default: all)")
    parser.add_argument("--out", type=Path, default=PAGE.parent / "pictures", help="output folder (default: docs/pictures)")
    parser.add_argument("--samples", type=int, default=32, help="Cycles samples per pixel (default: 32)")
    given = parser.parse_args(arguments)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    set_size(VIEW_WIDTH, VIEW_WIDTH * 9 // 16)
    steps = read_steps()
    for index, (step, code) in enumerate(steps.items()):
        line.show(Progress(index / len(steps), step))
        if step != "step 5: the render":
            exec(compile(code, f"tutorial.md, {step}", "exec"), {})
        for name, draw in PICTURES.get(step, {}).items():
            if name in given.only:
                line.show(Progress(index / len(steps), name))
                with tempfile.TemporaryDirectory() as folder:
                    draw(Path(folder) / "picture.png", given.samples)
                    save_webp(Path(folder) / "picture.png", given.out.absolute() / f"{name}.webp")
    return f"{len(given.only)} images in {given.out.absolute()}"


def read_steps() -> dict[str, str]:
    """Return the scripts of the page by their first line."""
    return dict(re.findall(r"```python\n# ([^\n]*)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL))


def draw_ground(path: Path, samples: int) -> None:
    """Render the ground from the camera, and from above in colors by box."""
    scene = bpy.context.scene
    camera = scene.camera
    set_size(*GROUND_SIZE)
    images = [render_view(samples)]
    root = next(item for item in scene.objects if item.farfield_clipbox_follow_camera)
    root.farfield_clipbox_follow_camera = False  # the boxes stay around the camera of the tutorial
    scene.camera = bpy.data.objects.new("Above", camera.data)
    scene.collection.objects.link(scene.camera)
    scene.camera.matrix_world = look_at_matrix(GROUND_DIRECTION, GROUND_TARGET + GROUND_DISTANCE * GROUND_DIRECTION)
    meshes = [item.data for item in root.children]
    ground, boxes = meshes[0].materials[0], [create_box_material(color) for color in BOX_COLORS]
    for block in root.children:
        block.data.materials[0] = boxes[int(block["farfield_clipbox_block"].split()[0]) % len(boxes)]
    images.append(render_view(samples))
    for mesh in meshes:
        mesh.materials[0] = ground
    bpy.data.objects.remove(scene.camera)
    scene.camera = camera
    root.farfield_clipbox_follow_camera = True
    set_size(VIEW_WIDTH, VIEW_WIDTH * 9 // 16)
    triangles = sum(len(polygon.vertices) - 2 for mesh in meshes for polygon in mesh.polygons)
    columns = [["the view of the camera"], ["its nested boxes from above", f"{triangles:,} triangles"]]
    write(path, draw_contact_sheet("The ground after Create", [images], [""], columns))


def create_box_material(color: tuple[float, float, float]) -> bpy.types.Material:
    """Return a matte material of a scene-linear color."""
    material, *_, surface = create_material("Box")
    surface.inputs["Base Color"].default_value = (*color, 1.0)
    surface.inputs["Roughness"].default_value = 1.0
    return material


def draw_pine(path: Path, samples: int) -> None:
    """Render the pine and the levels of its cloud without cross-fades."""
    (cloud,) = clouds_in(bpy.context.scene)
    cloud.remove_crossfade()
    columns = [["the pine", f"{len(cloud.sources[0].data.polygons):,} faces"]]
    columns += [[f"level {index}", f"{level['farfield_quads']:,} quads"] for index, level in enumerate(cloud.levels)]
    errors = [cloud.errors[0], *cloud.errors]
    write(
        path,
        draw_levels(
            "One pine and the levels of its cloud", [cloud.sources, *([level] for level in cloud.levels)], errors, columns, samples
        ),
    )
    bpy.ops.farfield.billboards_crossfade()


def draw_rock(path: Path, samples: int) -> None:
    """Render levels of the rock without cross-fades."""
    bpy.ops.farfield.texmesh_show(level=0)
    original, *levels = rock_levels()
    diameter = 2.0 * bounding_sphere([original])[1]
    levels = [level for level in levels if level["farfield_error"] > diameter / CELL_PIXELS][:ROCK_COLUMNS]
    errors = [levels[0]["farfield_error"], *(level["farfield_error"] for level in levels)]
    levels = [original, *levels]
    columns = [[f"L{level['farfield_level']}", f"{len(level.data.polygons):,} triangles"] for level in levels]
    write(path, draw_levels("A rock and some of its levels", [[level] for level in levels], errors, columns, samples))
    bpy.ops.farfield.texmesh_crossfade()


def rock_levels() -> list[bpy.types.Object]:
    """Return the levels of the rock, the original first."""
    return sorted(bpy.data.collections["Rock Levels"].objects, key=lambda item: item["farfield_level"])


def draw_levels(
    title: str, groups: Sequence[Sequence[bpy.types.Object]], errors: Sequence[float], columns: Sequence[Sequence[str]], samples: int
) -> np.ndarray:
    """Return a sheet (H, W, 3) of groups of objects, enlarged and where `errors` (scene units) are one pixel."""
    center, radius = bounding_sphere(groups[0])
    with open_studio([item for items in groups for item in items], samples) as studio:
        large = [studio.render(items, VIEW_DIRECTION, center, 2.0 * radius / CELL_PIXELS, CELL_PIXELS) for items in groups]
        small = [
            studio.render(items, VIEW_DIRECTION, center, error, int(np.ceil(2.0 * radius / error)) + 2)
            for items, error in zip(groups, errors, strict=True)
        ]
    large = crop_over_paper(large)
    small = [metrics.composite_over_gray(render[metrics.crop_to_object(render[..., 3], margin=1)], PAPER_GRAY) for render in small]
    small = [enlarge_to_fit(image, large[0].shape[:2]) for image in small]
    return draw_contact_sheet(title, [large, small], ["enlarged", "at the switch"], columns)


def draw_view(path: Path, samples: int) -> None:
    """Render the final image."""
    write(path, render_view(samples))


def draw_view_by_level(path: Path, samples: int) -> None:
    """Render the final image with a color per level."""
    paper = create_box_material(PAPER_COLOR)
    for item in bpy.context.scene.objects:
        if "farfield_clipbox_block" in item:
            item.data.materials[0] = paper
    (cloud,) = clouds_in(bpy.context.scene)
    originals = find_source_proxies(cloud.collection)
    for number, items in enumerate((originals, *([level] for level in cloud.levels))):
        emit_color(items, LEVEL_COLORS[number])
    for number, level in enumerate(rock_levels()):
        emit_color([level], LEVEL_COLORS[min(number, len(LEVEL_COLORS) - 1)])
    write(path, render_view(samples))


def emit_color(items: Sequence[bpy.types.Object], color: tuple[float, float, float]) -> None:
    """Let objects emit a scene-linear color instead of reflecting light; the silhouettes of their materials stay."""
    for item in items:
        for index, material in enumerate(item.data.materials):
            item.data.materials[index] = copy = material.copy()
            _emit(copy.node_tree, color)


def _emit(tree: bpy.types.NodeTree, color: tuple[float, float, float]) -> None:
    """Let all Principled shaders of a node tree and of copies of its groups emit a color."""
    for node in tree.nodes:
        if node.type == "GROUP" and node.node_tree is not None:
            node.node_tree = node.node_tree.copy()
            _emit(node.node_tree, color)
        if node.type == "BSDF_PRINCIPLED":
            values = {
                "Base Color": (0.0, 0.0, 0.0, 1.0),
                "Metallic": 0.0,
                "Specular IOR Level": 0.0,
                "Emission Color": (*color, 1.0),
                "Emission Strength": 1.0,
            }
            for name, value in values.items():
                for link in list(node.inputs[name].links):
                    tree.links.remove(link)
                node.inputs[name].default_value = value


def set_size(width: int, height: int) -> None:
    """Set the size of renders in pixels."""
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100


def render_view(samples: int) -> np.ndarray:
    """Render the scene and return its display values (H, W, 3), row 0 at the bottom."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.cycles.device = "CYCLES", samples, "CPU"
    scene.cycles.use_denoising = True
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "view.png")
        bpy.ops.render.render(write_still=True)
        return read_png(Path(scene.render.filepath))


PICTURES = {  # step -> images after it
    "step 1: the ground": {"tutorial_ground": draw_ground},
    "step 2: its cloud": {"tutorial_pine": draw_pine},
    "step 3: its levels": {"tutorial_rock": draw_rock},
    "step 5: the render": {"tutorial": draw_view, "tutorial_levels": draw_view_by_level},
}


if __name__ == "__main__":
    command_line.run(main)
