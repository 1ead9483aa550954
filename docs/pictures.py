"""The pictures of README and docs: `python3 docs/pictures.py [out/demo/demo.blend] [--only NAME ...]`.

tree: the demo's tree beside its cloud. levels: all its levels, their quads, and how each looks from its own distance. head: a closed
surface with a material of nodes, which needs no demo. unwrap: that surface with a checker on three UV maps, which needs none either. wood:
hundreds of trees, each as the level that its distance asks for. landscape, copses, walk: mountains in nested boxes, trees of voxels in
them, and twelve frames of a walk through caves, which need no demo. relighting, forest: what the demo left beside its scene, as it is.
"""

import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

import environment

environment.ensure()

import bpy
import numpy as np
import terrain
from unwrapped import unwrapped_copies
from wood import render_wood

import billboards
import command_line
import scene_files
from contact_sheet import PAPER, contact_sheet, enlarged, write_png
from demo_materials import new_material
from farfield.addon.bridge.images import pixels_of
from farfield.addon.core import metrics
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.errors import FarfieldError
from farfield.addon.core.progress import Progress, finish
from farfield.addon.operators.billboards_clouds import StandingCloud, clouds_in
from farfield.addon.operators.billboards_job import BuildOptions
from farfield.addon.operators.long_work import whole
from studio import bounds, studio
from whole_files import whole_file

VIEWER = np.array([0.55, -0.80, 0.22]) / np.linalg.norm([0.55, -0.80, 0.22])  # where the camera stands, seen from the object
TREE_PIXELS = 600
LEVEL_PIXELS = 250
HEAD_PIXELS = 290
HEAD_ERROR = 0.02
HEAD_VOXEL = 0.04
MAP_PIXELS = 300
MAP_TRIMMED = 45  # pixels along the edges of its render, where nothing is
WOOD_WIDTH = 660
LANDSCAPE_WIDTH = 720
WALK_WIDTH = 184
WALK_ROWS = ("1 to 4", "5 to 8", "9 to 12")


def main(arguments: list[str], line: command_line.ProgressLine) -> None:
    """Make the pictures that are asked for; raises FarfieldError when there is no scene to make them from."""
    parser = command_line.Parser(prog="pictures.py", description="Render the pictures of the README and the docs.")
    parser.add_argument("scene", type=Path, nargs="?", default=environment.ROOT / "out" / "demo" / "demo.blend")
    parser.add_argument("--only", nargs="+", choices=list(PICTURES), default=list(PICTURES), help="the pictures to make (default: all)")
    parser.add_argument("--out", type=Path, default=environment.ROOT / "docs" / "pictures", help="the folder (default: docs/pictures)")
    parser.add_argument("--samples", type=int, default=128, help="Cycles samples a pixel (default: 128)")
    given = parser.parse_args(arguments)
    for number, name in enumerate(given.only):
        line.show(Progress(number / len(given.only), f"Rendering {name}"))
        PICTURES[name](given.scene.absolute(), given.out.absolute() / f"{name}.png", given.samples)


def tree(scene: Path, path: Path, samples: int) -> None:
    """The demo's tree and the finest level of its cloud, nearer than that level is meant for."""
    cloud = demo_cloud(scene)
    both = on_paper(near([cloud.sources, [cloud.levels[0]]], TREE_PIXELS, samples))
    nearer = pixels_across(cloud, cloud.errors[0])
    columns = [
        [f"the tree: {triangles(cloud.sources):,} triangles"],
        [f"its billboard cloud: {cloud.levels[0]['farfield_quads']:,} quads"],
    ]
    title = f"Seen {TREE_PIXELS / nearer:.0f} times nearer than this level of the cloud is meant for"
    write(path, contact_sheet(title, [both], [""], columns))


def levels(scene: Path, path: Path, samples: int) -> None:
    """Every level of the demo's cloud: near, in quads, and with as many pixels as its distance leaves it."""
    cloud = demo_cloud(scene)
    shown = [cloud.sources, *([level] for level in cloud.levels)]
    close = near(shown, LEVEL_PIXELS, samples)
    errors = [cloud.errors[0], *cloud.errors]
    far = [at_switch_size(cloud, items, error, samples) for items, error in zip(shown, errors, strict=True)]
    paint_pieces([item for items in shown for item in items])
    pictures = on_paper(close + near(shown, LEVEL_PIXELS, samples))
    close, pieces = pictures[: len(shown)], pictures[len(shown) :]
    far = [enlarged_into(picture, close[0].shape[:2]) for picture in far]
    columns = [["original", f"{triangles(cloud.sources):,} triangles"]]
    columns += [
        [f"level {number}", f"{level['farfield_quads']:,} quads", f"{level['farfield_texels'] / 1000:,.0f}k texels"]
        for number, level in enumerate(cloud.levels)
    ]
    rows = ["seen near", "faces and quads", "error = 1 pixel"]
    write(path, contact_sheet("One tree and the levels of its cloud", [close, pieces, far], rows, columns))


def head(_scene: Path, path: Path, samples: int) -> None:
    """Blender's monkey, made a closed surface, with a procedural material; its quads and its cloud."""
    monkey = closed_monkey()
    monkey.data.materials.append(veined_clay())
    settings = BillboardSettings(levels=1, error=HEAD_ERROR, samples=32)
    job = billboards.prepare_input(settings, BuildOptions())
    finish(whole(job))
    cloud = billboards.standing(job)[0]
    level = cloud.levels[0]
    renders = near([[monkey], [level]], HEAD_PIXELS, samples)
    paint_pieces([level])
    original, copy, pieces = on_paper([*renders, near([[monkey], [level]], HEAD_PIXELS, samples)[1]])
    columns = [
        ["original", f"{job.made[0][1].source_triangles:,} triangles"],
        ["the quads", f"{level['farfield_quads']:,} of them"],
        ["the cloud", f"{level['farfield_texels']:,} texels"],
    ]
    share = f"{HEAD_ERROR:.0%}".replace("%", " %")
    title = f"Error {share} of the longest side, seen {HEAD_PIXELS / pixels_across(cloud, cloud.errors[0]):.0f} times nearer than meant"
    write(path, contact_sheet(title, [[original, pieces, copy]], [""], columns))


def unwrap(_scene: Path, path: Path, samples: int) -> None:
    """The same head with a checker on three UV maps, and the maps coloured by stretch."""
    monkey = closed_monkey()
    bpy.ops.object.modifier_apply(modifier="Remesh")
    copies = unwrapped_copies(monkey, VIEWER, MAP_PIXELS)
    renders = near([[copy.item] for copy in copies], MAP_PIXELS + 2 * MAP_TRIMMED, samples)
    names = "Minimum Stretch of Blender", "Farfield", "Farfield, most texels to this side"
    figures = [f"L2 {copy.figures.l2:.3f}, largest {copy.figures.linf:.1f}" for copy in copies]
    columns = [[name, f"{found}, {copy.figures.overlaps} overlaps"] for name, found, copy in zip(names, figures, copies, strict=True)]
    inside = slice(MAP_TRIMMED, -MAP_TRIMMED)
    worn = [metrics.over_grey(render[inside, inside], PAPER) for render in renders]
    title = f"A closed surface of {triangles([monkey]):,} triangles, cut and laid out; below, red is stretched and blue is crowded"
    write(path, contact_sheet(title, [worn, [copy.picture for copy in copies]], ["", ""], columns))


def closed_monkey() -> bpy.types.Object:
    """Blender's monkey alone in a new scene, with a modifier that makes it a closed surface."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_monkey_add()
    monkey = bpy.context.object
    remesh = monkey.modifiers.new("Remesh", "REMESH")  # the monkey has holes behind its eyes
    remesh.mode, remesh.voxel_size, remesh.use_smooth_shade = "VOXEL", HEAD_VOXEL, True
    return monkey


def wood(scene: Path, path: Path, samples: int) -> None:
    """Hundreds of the demo's trees."""
    cloud = demo_cloud(scene)
    planted = render_wood(cloud, path, WOOD_WIDTH, samples)
    names = {None: "original", **{number: f"level {number}" for number in range(len(cloud.levels))}}
    print(", ".join(f"{count} of {names[level]}" for level, count in planted.items()), file=sys.stderr)


def landscape(_scene: Path, path: Path, samples: int) -> None:
    """Mountains in nested boxes."""
    with whole_file(path) as temporary:
        terrain.landscape(temporary, LANDSCAPE_WIDTH, samples)


def copses(_scene: Path, path: Path, samples: int) -> None:
    """Copies of a tree of voxels in nested boxes."""
    with whole_file(path) as temporary:
        terrain.copses(temporary, LANDSCAPE_WIDTH, samples)


def walk(_scene: Path, path: Path, samples: int) -> None:
    """Twelve frames of a walk through caves, which the terrain follows."""
    with tempfile.TemporaryDirectory() as folder:
        pictures = [read_png(frame) for frame in terrain.walk(4 * len(WALK_ROWS), WALK_WIDTH, samples, Path(folder))]
    rows = [pictures[4 * row : 4 * row + 4] for row in range(len(WALK_ROWS))]
    write(path, contact_sheet("Twelve frames of a walk", rows, WALK_ROWS, [[]] * 4))


def read_png(path: Path) -> np.ndarray:
    """A picture (H, W, 3) as it is written, row 0 at the bottom."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    pixels = pixels_of(image)[..., :3].astype(np.float64)
    bpy.data.images.remove(image)
    return pixels


def left_by_demo(scene: Path, path: Path, _samples: int) -> None:
    """A picture of that name from the folder of the demo's scene.

    Raises:
        FarfieldError: when it is not there.
    """
    made = scene.with_name(path.name)
    if not made.is_file():
        raise FarfieldError(f'There is no "{made}"; run scripts/demo.py first.')
    with whole_file(path) as temporary:
        shutil.copyfile(made, temporary)


PICTURES = {
    "tree": tree,
    "levels": levels,
    "head": head,
    "unwrap": unwrap,
    "wood": wood,
    "landscape": landscape,
    "copses": copses,
    "walk": walk,
    "relighting": left_by_demo,
    "forest": left_by_demo,
}


def demo_cloud(scene: Path) -> StandingCloud:
    """The cloud of the scene file, which is opened.

    Raises:
        FarfieldError: when it holds none beside its original.
    """
    scene_files.open_scene(scene)
    clouds = [cloud for cloud in clouds_in(bpy.context.scene) if cloud.sources]
    if not clouds:
        raise FarfieldError(f'"{scene}" holds no cloud beside its original; run scripts/demo.py first.')
    return clouds[0]


def near(shown: Sequence[Sequence[bpy.types.Object]], pixels: int, samples: int) -> list[np.ndarray]:
    """One render (pixels, pixels, 4) of each group of objects, all from VIEWER and as large as the first group fits."""
    center, radius = bounds(shown[0])
    with studio([item for items in shown for item in items], samples) as room:
        return [room.picture(items, VIEWER, center, 2.0 * radius / pixels, pixels) for items in shown]


def on_paper(renders: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The renders (H, W, 4) cut to what any of them shows, as sRGB pictures (h, w, 3) on the sheet's paper."""
    window = metrics.crop_to_object(np.max([render[..., 3] for render in renders], axis=0), margin=4)
    return [metrics.over_grey(render[window], PAPER) for render in renders]


def at_switch_size(cloud: StandingCloud, items: Sequence[bpy.types.Object], error: float, samples: int) -> np.ndarray:
    """The objects where `error` is one pixel: (h, w, 3) sRGB on paper."""
    center, radius = bounds(cloud.sources)
    with studio(items, samples) as room:
        render = room.picture(items, VIEWER, center, error, int(np.ceil(2.0 * radius / error)) + 2)
    return metrics.over_grey(render[metrics.crop_to_object(render[..., 3], margin=1)], PAPER)


def enlarged_into(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """`picture` with every pixel repeated as often as fits, in the middle of a paper of `size`."""
    large = enlarged(picture, max(1, min(size[0] // picture.shape[0], size[1] // picture.shape[1])))
    canvas = np.full((*size, 3), PAPER)
    y, x = ((have - want) // 2 for have, want in zip(size, large.shape[:2], strict=True))
    canvas[y : y + large.shape[0], x : x + large.shape[1]] = large
    return canvas


def pixels_across(cloud: StandingCloud, error: float) -> float:
    """Pixels across the sphere around the sources where `error` is one pixel."""
    return 2.0 * bounds(cloud.sources)[1] / error


def triangles(objects: Sequence[bpy.types.Object]) -> int:
    """Triangles of the meshes of `objects`, before modifiers."""
    return sum(len(polygon.vertices) - 2 for item in objects for polygon in item.data.polygons)


def paint_pieces(objects: Sequence[bpy.types.Object]) -> None:
    """Give every connected piece, such as a quad, a colour of its own instead of its material."""
    material, nodes, links, surface = new_material("Pieces")
    surface.inputs["Roughness"].default_value = 0.9
    geometry, color = nodes.new("ShaderNodeNewGeometry"), nodes.new("ShaderNodeCombineColor")
    color.mode = "HSV"
    color.inputs[1].default_value, color.inputs[2].default_value = 0.45, 0.75
    links.new(geometry.outputs["Random Per Island"], color.inputs[0])
    links.new(color.outputs[0], surface.inputs["Base Color"])
    for item in objects:
        for slot in range(len(item.data.materials)):
            item.data.materials[slot] = material
        if "custom_normal" in item.data.attributes:  # a quad's follow its textures, these colours have none
            item.data.attributes.remove(item.data.attributes["custom_normal"])


def veined_clay() -> bpy.types.Material:
    """Clay with darker, duller veins: noise in object coordinates, as no image holds it."""
    material, nodes, links, surface = new_material("Clay")
    place, noise, ramp = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeValToRGB")
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 2.5, 4.0
    stops = ramp.color_ramp.elements
    stops[0].position, stops[0].color = 0.44, (0.22, 0.06, 0.03, 1.0)
    stops[1].position, stops[1].color = 0.56, (0.72, 0.38, 0.20, 1.0)
    links.new(place.outputs["Object"], noise.inputs["Vector"])
    links.new(noise.outputs[0], ramp.inputs[0])
    links.new(ramp.outputs["Color"], surface.inputs["Base Color"])
    surface.inputs["Roughness"].default_value = 0.45
    return material


def write(path: Path, picture: np.ndarray) -> None:
    """Write a picture (H, W, 3), whole or not at all."""
    with whole_file(path) as temporary:
        write_png(temporary, picture)


if __name__ == "__main__":
    command_line.run(main)
