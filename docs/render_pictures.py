"""Render the images of README and docs: `python3 docs/render_pictures.py [out/demo/demo.blend] [--only NAME ...]`.

From the scene of the demo: tree (the tree and its cloud), levels (all levels, their quads, and each level at its switch distance), wood
(hundreds of trees, each with the level for its distance) and crossfade (a camera that moves away from one tree). Copied from the demo's
folder: relighting, forest, photos, terrain and texmesh. Independent of the demo: head (a closed surface with a procedural material),
relight (its relightable cloud under several Sun directions), unwrap (this surface with a checker on three UV maps), restore (a texture with
a hole, restored with several settings), landscape, canyon, lava, karst, desert and coast (terrains in nested boxes), woods and steppe (with
plants on them), copses (voxel trees in nested boxes) and walk (twelve frames of a walk through caves), cliffs (a terrain with cliffs as a
network of triangles and as right triangles), distance (a valley that was made distance-ready, half of it colored by level) and flight (the
same as an animation).
"""

import io
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import bpy
import numpy as np
from figures import distance_flight, terrain_views
from figures.crossfade_strip import draw_crossfade_strip
from figures.forest_lods import render_forest
from figures.relight_strip import draw_relight_strip
from figures.restore_comparison import draw_restore_comparison
from figures.terrain_cuts import compare_meshes
from figures.unwrap_comparison import unwrap_copies
from PIL import Image

import billboards
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud, clouds_in
from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.core.billboards.settings import BillboardSettings, BuildOptions
from farfield.addon.core.errors import FarfieldError
from farfield.addon.core.imaging import metrics
from farfield.addon.core.jobs.progress import Progress, run_to_end
from farfield.addon.operators.job_run import run_job
from lib import command_line, scene_files
from lib.atomic_output import atomic_file
from lib.contact_sheet import PAPER_GRAY, draw_contact_sheet, enlarge, write_png
from lib.demo_materials import create_material
from lib.studio import bounding_sphere, open_studio

VIEW_DIRECTION = np.array([0.55, -0.80, 0.22]) / np.linalg.norm([0.55, -0.80, 0.22])  # from the object towards the camera
VIEW_FROM_ABOVE = np.array([0.35, -0.60, 0.72]) / np.linalg.norm([0.35, -0.60, 0.72])
TREE_PIXELS = 600
LEVEL_PIXELS = 250
HEAD_PIXELS = 290
HEAD_ERROR = 0.02
HEAD_VOXEL = 0.04
MAP_PIXELS = 300
MAP_MARGIN = 45  # empty pixels along the edges of the render
CROSSFADE_PIXELS = 332
WIDE_PIXELS, WIDE_SAMPLES = 1600, 16  # Of denoised pictures as wide as a page.
FLIGHT_WIDTH = 480
RELIGHT_PIXELS = 426
RELIGHT_ERROR = 0.01
RELIGHT_ROUGHNESS = 0.3
RESTORE_PIXELS = 240
CLIFFS_PIXELS = 520
WALK_WIDTH = 184
WALK_ROWS = ("1 to 4", "5 to 8", "9 to 12")
WEBP_QUALITIES, MAX_WEBP_BYTES = (90, 80, 70, 60), 350_000  # The best quality that stays below, or the last one.


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Render the selected images and return the result in one line; raises FarfieldError when the demo's scene is missing."""
    parser = command_line.Parser(prog="render_pictures.py", description="Render the images of the README and the docs.")
    parser.add_argument("scene", type=Path, nargs="?", default=environment.ROOT / "out" / "demo" / "demo.blend")
    parser.add_argument("--only", nargs="+", choices=list(FIGURES), default=list(FIGURES), help="the images to render (default: all)")
    parser.add_argument("--out", type=Path, default=environment.ROOT / "docs" / "pictures", help="output folder (default: docs/pictures)")
    parser.add_argument("--samples", type=int, default=128, help="Cycles samples per pixel (default: 128)")
    given = parser.parse_args(arguments)
    out = given.out.absolute()
    for index, name in enumerate(given.only):
        line.show(Progress(index / len(given.only), f"Rendering {name}"))
        with tempfile.TemporaryDirectory() as folder:
            picture = Path(folder) / f"{name}{'.webp' if name in ANIMATIONS else '.png'}"
            FIGURES[name](given.scene.absolute(), picture, given.samples)
            if name in ANIMATIONS:
                with atomic_file(out / picture.name) as temporary:
                    shutil.copyfile(picture, temporary)
            else:
                save_webp(picture, out / f"{name}.webp")
    return f"{len(given.only)} images in {out}"


def tree(scene: Path, path: Path, samples: int) -> None:
    """Render the demo's tree and the finest level of its cloud from nearer than its switch distance."""
    cloud = open_demo_cloud(scene)
    images = crop_over_paper(render_groups([cloud.sources, [cloud.levels[0]]], TREE_PIXELS, samples))
    switch_pixels = diameter_in_pixels(cloud, cloud.errors[0])
    columns = [
        [f"the tree: {count_triangles(cloud.sources):,} triangles"],
        [f"its billboard cloud: {cloud.levels[0]['farfield_quads']:,} quads"],
    ]
    title = f"Seen {TREE_PIXELS / switch_pixels:.0f} times nearer than the switch distance of this level"
    write(path, draw_contact_sheet(title, [images], [""], columns))


def levels(scene: Path, path: Path, samples: int) -> None:
    """Render every level of the demo's cloud: enlarged, with quads in random colors, and at its switch distance."""
    cloud = open_demo_cloud(scene)
    groups = [cloud.sources, *([level] for level in cloud.levels)]
    large = render_groups(groups, LEVEL_PIXELS, samples)
    errors = [cloud.errors[0], *cloud.errors]
    small = [render_at_switch_distance(cloud, items, error, samples) for items, error in zip(groups, errors, strict=True)]
    assign_random_colors([item for items in groups for item in items])
    images = crop_over_paper(large + render_groups(groups, LEVEL_PIXELS, samples))
    large, colored = images[: len(groups)], images[len(groups) :]
    small = [enlarge_to_fit(image, large[0].shape[:2]) for image in small]
    columns = [["source", f"{count_triangles(cloud.sources):,} triangles"]]
    columns += [
        [f"level {index}", f"{level['farfield_quads']:,} quads", f"{level['farfield_texels'] / 1000:,.0f}k texels"]
        for index, level in enumerate(cloud.levels)
    ]
    rows = ["enlarged", "faces and quads", "error = 1 pixel"]
    write(path, draw_contact_sheet("One tree and the levels of its cloud", [large, colored, small], rows, columns))


def head(_scene: Path, path: Path, samples: int) -> None:
    """Render Blender's monkey as a closed surface with a procedural material, its quads and its cloud."""
    cloud, triangles = build_monkey_cloud(HEAD_ERROR)
    (monkey,), (level,) = cloud.sources, cloud.levels
    renders = render_groups([[monkey], [level]], HEAD_PIXELS, samples)
    assign_random_colors([level])
    source, textured, colored = crop_over_paper([*renders, render_groups([[monkey], [level]], HEAD_PIXELS, samples)[1]])
    columns = [
        ["source", f"{triangles:,} triangles"],
        ["the quads", f"{level['farfield_quads']:,} quads"],
        ["the cloud", f"{level['farfield_texels']:,} texels"],
    ]
    factor = HEAD_PIXELS / diameter_in_pixels(cloud, cloud.errors[0])
    title = f"Error {HEAD_ERROR:.0%} of the longest side, seen {factor:.0f} times nearer than the switch distance"
    write(path, draw_contact_sheet(title, [[source, colored, textured]], [""], columns))


def unwrap(_scene: Path, path: Path, samples: int) -> None:
    """Render the monkey with a checker on three UV maps, and the maps colored by stretch."""
    monkey = create_closed_monkey()
    bpy.ops.object.modifier_apply(modifier="Remesh")
    copies = unwrap_copies(monkey, VIEW_DIRECTION, MAP_PIXELS)
    renders = render_groups([[copy.item] for copy in copies], MAP_PIXELS + 2 * MAP_MARGIN, samples)
    names = "Blender's Minimum Stretch", "Farfield", "Farfield, more texels on this side"
    stretches = [f"L2 {copy.metrics.l2:.3f}, maximum {copy.metrics.linf:.1f}" for copy in copies]
    columns = [[name, f"{stretch}, {copy.metrics.overlaps} overlaps"] for name, stretch, copy in zip(names, stretches, copies, strict=True)]
    inside = slice(MAP_MARGIN, -MAP_MARGIN)
    textured = [metrics.composite_over_gray(render[inside, inside], PAPER_GRAY) for render in renders]
    title = f"A closed surface of {count_triangles([monkey]):,} triangles; below, red is stretched and blue is compressed"
    write(path, draw_contact_sheet(title, [textured, [copy.stretch_image for copy in copies]], ["", ""], columns))


def build_monkey_cloud(error: float, roughness: float = 0.45) -> tuple[SceneCloud, int]:
    """Build the cloud of a monkey of clay in a new scene. Returns it and the number of triangles of its source."""
    create_closed_monkey().data.materials.append(create_clay_material(roughness))
    job = billboards.prepare_input(None, BillboardSettings(levels=1, error=error, samples=32), BuildOptions(keep_original_visible=True))
    run_to_end(run_job(job))
    return billboards.read_built_clouds(job)[0], job.built_clouds[0][1].source_triangles


def create_closed_monkey() -> bpy.types.Object:
    """Create a new scene with nothing but Blender's monkey, closed by a Remesh modifier."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_monkey_add()
    monkey = bpy.context.object
    remesh = monkey.modifiers.new("Remesh", "REMESH")  # the monkey has holes behind its eyes
    remesh.mode, remesh.voxel_size, remesh.use_smooth_shade = "VOXEL", HEAD_VOXEL, True
    return monkey


def wood(scene: Path, path: Path, _samples: int) -> None:
    """Render hundreds of the demo's trees."""
    cloud = open_demo_cloud(scene)
    counts = render_forest(cloud, path, WIDE_PIXELS, WIDE_SAMPLES)
    names = {None: "source", **{index: f"level {index}" for index in range(len(cloud.levels))}}
    print(", ".join(f"{count} of {names[level]}" for level, count in counts.items()), file=sys.stderr)


def crossfade(scene: Path, path: Path, samples: int) -> None:
    """Render the demo's tree and its cloud while they cross-fade."""
    write(path, draw_crossfade_strip(open_demo_cloud(scene), VIEW_DIRECTION, CROSSFADE_PIXELS, samples))


def relight(_scene: Path, path: Path, samples: int) -> None:
    """Render Blender's monkey with a procedural material and its relightable cloud under several Sun directions."""
    cloud, _ = build_monkey_cloud(RELIGHT_ERROR, RELIGHT_ROUGHNESS)
    write(path, draw_relight_strip(cloud, VIEW_DIRECTION, RELIGHT_PIXELS, samples))


def restore(_scene: Path, path: Path, _samples: int) -> None:
    """Restore a texture with a hole, with and without an intensity gradient, with several settings."""
    write(path, draw_restore_comparison(RESTORE_PIXELS))


def render_wide(view: Callable[[Path, int, int], None], _scene: Path, path: Path, _samples: int) -> None:
    """Render a view of terrain in nested boxes."""
    with atomic_file(path) as temporary:
        view(temporary, WIDE_PIXELS, WIDE_SAMPLES)


def walk(_scene: Path, path: Path, samples: int) -> None:
    """Render twelve frames of a walk through caves, during which the terrain follows the walker."""
    with tempfile.TemporaryDirectory() as folder:
        images = [read_png(frame) for frame in terrain_views.walk(4 * len(WALK_ROWS), WALK_WIDTH, samples, Path(folder))]
    rows = [images[4 * row : 4 * row + 4] for row in range(len(WALK_ROWS))]
    write(path, draw_contact_sheet("Twelve frames of a walk", rows, WALK_ROWS, [[]] * 4))


def cliffs(_scene: Path, path: Path, samples: int) -> None:
    """Render a terrain with cliffs at full resolution, as a cut with few triangles, and as right triangles."""
    meshes = compare_meshes()
    material, *_, surface = create_material("Rock")
    surface.inputs["Base Color"].default_value = (0.36, 0.31, 0.25, 1.0)
    for mesh in meshes:
        mesh.item.data.materials.append(material)
    images = crop_over_paper(render_groups([[mesh.item] for mesh in meshes], CLIFFS_PIXELS, samples, VIEW_FROM_ABOVE))
    names = "all samples", "Farfield", "right triangles"
    columns = [[name, f"{mesh.triangles:,} triangles, error {mesh.error:.0f} m"] for name, mesh in zip(names, meshes, strict=True)]
    write(path, draw_contact_sheet("The same terrain with flat shading", [images], [""], columns))


def distance(_scene: Path, path: Path, samples: int) -> None:
    """Render a valley that was made distance-ready, half of it with each level in its own color."""
    print(distance_flight.build_ready_valley(WIDE_PIXELS, samples), file=sys.stderr)
    distance_flight.render_still(path)


def flight(_scene: Path, path: Path, samples: int) -> None:
    """Render a flight through this valley, and next to it the same with colored levels."""
    distance_flight.build_ready_valley(FLIGHT_WIDTH, samples)
    distance_flight.render_flight(path)


def read_png(path: Path) -> np.ndarray:
    """Return the values (H, W, 3) of an image file without color conversion, row 0 at the bottom."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    pixels = read_pixels(image)[..., :3].astype(np.float64)
    bpy.data.images.remove(image)
    return pixels


def copy_from_demo(scene: Path, path: Path, _samples: int) -> None:
    """Copy the image with the name of `path` from the folder of the demo's scene.

    Raises:
        FarfieldError: the image does not exist.
    """
    source = scene.with_name(path.name)
    if not source.is_file():
        raise FarfieldError(f'The file "{source}" does not exist; run scripts/demo.py first.')
    with atomic_file(path) as temporary:
        shutil.copyfile(source, temporary)


FIGURES = {
    "tree": tree,
    "levels": levels,
    "head": head,
    "unwrap": unwrap,
    "wood": wood,
    "crossfade": crossfade,
    "relight": relight,
    "restore": restore,
    **{name: partial(render_wide, view) for name, view in terrain_views.VIEWS.items()},
    "walk": walk,
    "cliffs": cliffs,
    "distance": distance,
    "flight": flight,
    "relighting": copy_from_demo,
    "forest": copy_from_demo,
    "photos": copy_from_demo,
    "terrain": copy_from_demo,
    "texmesh": copy_from_demo,
}


ANIMATIONS = {"flight"}


def open_demo_cloud(scene: Path) -> SceneCloud:
    """Open the scene file and return its cloud.

    Raises:
        FarfieldError: the file has no cloud with its source.
    """
    scene_files.open_scene(scene)
    clouds = [cloud for cloud in clouds_in(bpy.context.scene) if cloud.sources]
    if not clouds:
        raise FarfieldError(f'"{scene}" contains no cloud with its source; run scripts/demo.py first.')
    return clouds[0]


def render_groups(
    groups: Sequence[Sequence[bpy.types.Object]], pixels: int, samples: int, direction: np.ndarray = VIEW_DIRECTION
) -> list[np.ndarray]:
    """Render each group of objects (pixels, pixels, 4) from a unit `direction`, all scaled so that the first group fits."""
    center, radius = bounding_sphere(groups[0])
    with open_studio([item for items in groups for item in items], samples) as studio:
        return [studio.render(items, direction, center, 2.0 * radius / pixels, pixels) for items in groups]


def crop_over_paper(renders: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Crop the renders (H, W, 4) to the rectangle that contains all objects; return sRGB images (h, w, 3) over the sheet's gray."""
    window = metrics.crop_to_object(np.max([render[..., 3] for render in renders], axis=0), margin=4)
    return [metrics.composite_over_gray(render[window], PAPER_GRAY) for render in renders]


def render_at_switch_distance(cloud: SceneCloud, items: Sequence[bpy.types.Object], error: float, samples: int) -> np.ndarray:
    """Render the objects where `error` is one pixel: (h, w, 3) sRGB over the sheet's gray."""
    center, radius = bounding_sphere(cloud.sources)
    with open_studio(items, samples) as studio:
        render = studio.render(items, VIEW_DIRECTION, center, error, int(np.ceil(2.0 * radius / error)) + 2)
    return metrics.composite_over_gray(render[metrics.crop_to_object(render[..., 3], margin=1)], PAPER_GRAY)


def enlarge_to_fit(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return `image`, enlarged by the largest integer factor that fits, in the center of a canvas of `size`."""
    large = enlarge(image, max(1, min(size[0] // image.shape[0], size[1] // image.shape[1])))
    canvas = np.full((*size, 3), PAPER_GRAY)
    y, x = ((outer - inner) // 2 for outer, inner in zip(size, large.shape[:2], strict=True))
    canvas[y : y + large.shape[0], x : x + large.shape[1]] = large
    return canvas


def diameter_in_pixels(cloud: SceneCloud, error: float) -> float:
    """Return the diameter of the sources' bounding sphere in pixels where `error` is one pixel."""
    return 2.0 * bounding_sphere(cloud.sources)[1] / error


def count_triangles(objects: Sequence[bpy.types.Object]) -> int:
    """Return the number of triangles of the meshes of `objects`, before modifiers."""
    return sum(len(polygon.vertices) - 2 for item in objects for polygon in item.data.polygons)


def assign_random_colors(objects: Sequence[bpy.types.Object]) -> None:
    """Replace the materials: every connected component, such as a quad, gets a random color."""
    material, nodes, links, surface = create_material("Random Colors")
    surface.inputs["Roughness"].default_value = 0.9
    geometry, color = nodes.new("ShaderNodeNewGeometry"), nodes.new("ShaderNodeCombineColor")
    color.mode = "HSV"
    color.inputs[1].default_value, color.inputs[2].default_value = 0.45, 0.75
    links.new(geometry.outputs["Random Per Island"], color.inputs[0])
    links.new(color.outputs[0], surface.inputs["Base Color"])
    for item in objects:
        for slot in range(len(item.data.materials)):
            item.data.materials[slot] = material
        if "custom_normal" in item.data.attributes:  # those of a quad belong to its textures
            item.data.attributes.remove(item.data.attributes["custom_normal"])


def create_clay_material(roughness: float) -> bpy.types.Material:
    """Create clay with darker veins: noise in object coordinates, without an image."""
    material, nodes, links, surface = create_material("Clay")
    coordinates, noise, ramp = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeValToRGB")
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 2.5, 4.0
    stops = ramp.color_ramp.elements
    stops[0].position, stops[0].color = 0.44, (0.22, 0.06, 0.03, 1.0)
    stops[1].position, stops[1].color = 0.56, (0.72, 0.38, 0.20, 1.0)
    links.new(coordinates.outputs["Object"], noise.inputs["Vector"])
    links.new(noise.outputs[0], ramp.inputs[0])
    links.new(ramp.outputs["Color"], surface.inputs["Base Color"])
    surface.inputs["Roughness"].default_value = roughness
    return material


def save_webp(picture: Path, path: Path) -> None:
    """Convert a PNG to WebP: lossless if that is smaller, as it is for images of few colors. The file appears complete or not at all."""
    with Image.open(picture) as image:
        for quality in WEBP_QUALITIES:
            encoded = min((encode_webp(image, quality, lossless) for lossless in (False, True)), key=len)
            if len(encoded) <= MAX_WEBP_BYTES:
                break
    with atomic_file(path) as temporary:
        temporary.write_bytes(encoded)


def encode_webp(image: Image.Image, quality: int, lossless: bool) -> bytes:
    """Return the bytes of an image in the format WebP."""
    file = io.BytesIO()
    image.convert("RGB").save(file, "WEBP", lossless=lossless, quality=quality, method=6)
    return file.getvalue()


def write(path: Path, image: np.ndarray) -> None:
    """Write an image (H, W, 3). The file appears complete or not at all."""
    with atomic_file(path) as temporary:
        write_png(temporary, image)


if __name__ == "__main__":
    command_line.run(main)
