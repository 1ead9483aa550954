"""The whole workflow of Farfield: `python3 scripts/demo.py [--input FILE] [--quick] [--out DIR]`.

Grows a tree, builds its billboard cloud with levels of detail, compares every level with the tree in Cycles, bakes relightable
textures for one of them, compares it under other Sun directions, and plants a forest of it. Then photographs another model with eight
virtual cameras, merges the photographs into a texture, and compares it with the truth. Last, builds a fractal terrain and flies over it,
and makes perceptual levels of a textured ring.
Writes to out/demo/: the scene (demo.blend), contact sheets (contact-sheet.png, relighting.png), the forest (forest.blend, forest.png), the
model with its cameras (photos.blend, photos.png), the terrain (terrain/, terrain.png), the levels (texmesh.blend, texmesh.png), and the
results (report.json, report.md).
--input uses your own mesh instead of the tree; --quick uses fewer leaves, a larger error, and fewer and smaller renders.
"""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from lib import environment

environment.ensure()
environment.import_farfield()

import bpy
import numpy as np

import billboards
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud
from farfield.addon.core.billboards.settings import BillboardSettings, BuildOptions
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.file_access import check_writable, convert_os_errors
from farfield.addon.core.geometry.directions import held_out_views
from farfield.addon.core.jobs.progress import StageClock, run_to_end, subprogress
from farfield.addon.operators.job_run import run_job
from lib import command_line, run_files, scene_files
from lib.atomic_output import atomic_folder
from lib.comparison import Comparison, compare_cloud, draw_comparison_sheet
from lib.contact_sheet import write_png
from lib.demo_forest import DAY, TREE_COUNT, render_day, write_forest
from lib.demo_levels import LevelsPreset, make_and_compare
from lib.demo_photos import PhotosPreset, photograph_and_merge
from lib.demo_relighting import RelightingPreset, bake_and_compare
from lib.demo_report import to_markdown
from lib.demo_terrain import TerrainPreset, build_and_fly
from lib.demo_tree import grow_tree
from lib.studio import SUN_ANGLE, SUN_STRENGTH, bounding_sphere, look_at_matrix, open_studio, set_uniform_sky, sun_matrix

LEVEL_COUNT = 3
MAX_SHEET_COLUMNS = 6
CLOSE_UP_FACTOR = 3.0  # pixels of the close-up per pixel at the switch distance
VIEW_DIRECTION = np.array([0.55, -0.80, 0.22]) / np.linalg.norm([0.55, -0.80, 0.22])  # from the tree towards the active camera


@dataclass(frozen=True)
class DemoPreset:
    """The amount of work."""

    leaves: int
    error: float
    capture_samples: int
    views: int
    samples: int
    compared_levels: int
    relighting: RelightingPreset
    forest_width: int
    forest_samples: int
    photos: PhotosPreset
    terrain: TerrainPreset
    levels: LevelsPreset


FULL = DemoPreset(
    leaves=6000,
    error=0.01,
    capture_samples=16,
    views=8,
    samples=24,
    compared_levels=LEVEL_COUNT,
    relighting=RelightingPreset(
        level=2,
        bake=BtfSettings(views_per_side=6),
        pairs=6,
        samples=32,
        frames=12,
        frame_samples=16,
    ),
    forest_width=340,
    forest_samples=6,
    photos=PhotosPreset(photograph_width=1200, samples=8, texture_size=2048, view_pixels=128),
    terrain=TerrainPreset(size=513, frames=5, width=240, samples=8),
    levels=LevelsPreset(segments=64, views=3),
)
QUICK = DemoPreset(
    leaves=1000,
    error=0.03,
    capture_samples=4,
    views=6,
    samples=8,
    compared_levels=1,
    relighting=RelightingPreset(
        level=1,
        bake=BtfSettings(views_per_side=3, alpha_components=4, samples=2),
        pairs=2,
        samples=8,
        frames=6,
        frame_samples=2,
    ),
    forest_width=240,
    forest_samples=2,
    photos=PhotosPreset(photograph_width=400, samples=2, texture_size=512, view_pixels=128),
    terrain=TerrainPreset(size=129, frames=2, width=160, samples=2),
    levels=LevelsPreset(segments=40, views=2),
)
BUILD_END, COMPARISON_END, RELIGHTING_END, FOREST_END, PHOTOS_END, TERRAIN_END = (
    0.17,
    0.31,
    0.63,
    0.8,
    0.89,
    0.96,
)  # fractions of the progress


def check_demo_folder(folder: Path) -> None:
    """Raise FileError if nothing can be written to `folder`, or if it has other files than those of an earlier demo."""
    path = folder / "report.json"
    check_writable(path)
    with convert_os_errors(f'Cannot read "{folder}"'):
        if not folder.is_dir() or not any(folder.iterdir()):
            return
        try:
            is_demo = set(json.loads(path.read_text(encoding="utf-8"))) >= {"levels", "forest", "texmesh"}
        except (FileNotFoundError, TypeError, ValueError):
            is_demo = False
    if not is_demo:
        raise FileError(f'The folder "{folder}" contains other files; choose an empty or a new folder.')


DEMO_FOLDER = run_files.PathType(is_output=True, is_folder=True, check=check_demo_folder)


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the demo and return its result in one line; raises FarfieldError for an invalid input or folder."""
    parser = command_line.Parser(
        prog="demo.py",
        description="Grow a tree, build its billboard cloud, make it relightable, plant a forest, make a texture from photographs, "
        "fly over a terrain, and make levels of a textured mesh.",
    )
    parser.add_argument(
        "--input", type=run_files.INPUT, help="your own mesh instead of the tree: .blend .obj .ply .stl .glb .gltf .fbx .usd"
    )
    parser.add_argument("--quick", action="store_true", help="fewer leaves, a larger error and fewer renders; takes about a minute")
    parser.add_argument("--out", type=DEMO_FOLDER, default=Path("out") / "demo", help="the folder for the results (default: out/demo)")
    given = parser.parse_args(arguments)
    preset = QUICK if given.quick else FULL
    out = given.out.absolute()
    clock = StageClock()
    with clock.stage("scene"):
        prepare_scene(given.input, preset)
    settings = BillboardSettings(error=preset.error, levels=LEVEL_COUNT, samples=preset.capture_samples)
    job = billboards.prepare_input(given.input, settings, BuildOptions(combine_selected=True, keep_original_visible=True))
    run_to_end(subprogress(run_job(job), 0.0, BUILD_END), line.show)
    cloud = billboards.read_built_clouds(job)[0]
    with clock.stage("compare"):
        comparisons = compare_levels(cloud, preset, line)
        close_up = render_close_up(cloud, preset)
    report = billboards.build_report(job, clock)
    for level, comparison in zip(report["levels"], comparisons, strict=False):
        level["comparison"] = comparison.to_report()
    title = format_title(cloud, report)
    with atomic_folder(out) as folder:
        write_cloud(folder, title, cloud, comparisons[0], close_up)
        report |= make_relightable(folder, cloud, preset, upper_hemisphere=given.input is None, line=line)
        report["photos"] = texture_from_photographs(folder, preset.photos, line)
        report["terrain"] = fly_over_terrain(folder, preset.terrain, line)
        report["texmesh"] = make_perceptual_levels(folder, preset.levels, line)
        command_line.write_report(folder / "report.json", report)
        (folder / "report.md").write_text(to_markdown(title, report), encoding="utf-8")
    return f"{title}; images, report and scenes in {out}"


def prepare_scene(path: Path | None, preset: DemoPreset) -> None:
    """Open the user's file or grow the tree; add a camera, a Sun light and a World if the scene has none."""
    if path is None:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        grow_tree(seed=0, leaves=preset.leaves)
    else:
        scene_files.open_scene(path.absolute())
    scene = bpy.context.scene
    if scene.camera is None:
        scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        scene.collection.objects.link(scene.camera)
    if not any(item.type == "LIGHT" for item in scene.objects):
        light = bpy.data.lights.new("Sun", "SUN")
        light.energy, light.angle = SUN_STRENGTH, SUN_ANGLE
        sun = bpy.data.objects.new("Sun", light)
        sun.matrix_world = sun_matrix()
        scene.collection.objects.link(sun)
    if scene.world is None:
        scene.world = bpy.data.worlds.new("Sky")
        set_uniform_sky(scene.world)


def compare_levels(cloud: SceneCloud, preset: DemoPreset, line: command_line.ProgressLine) -> list[Comparison]:
    """Compare levels with the source, finest first, each at its own switch distance."""
    comparisons = []
    for index, level in enumerate(cloud.levels[: preset.compared_levels]):
        steps = compare_cloud(cloud.sources, level, directions=held_out_views(preset.views), samples=preset.samples)
        start, stop = (BUILD_END + (COMPARISON_END - BUILD_END) * number / preset.compared_levels for number in (index, index + 1))
        comparisons.append(run_to_end(subprogress(steps, start, stop), line.show))
    return comparisons


def render_close_up(cloud: SceneCloud, preset: DemoPreset) -> np.ndarray:
    """Render the source and the finest level from nearer than its switch distance: (2, H, W, 4)."""
    center, radius = bounding_sphere(cloud.sources)
    pixel_size = cloud.errors[0] / CLOSE_UP_FACTOR
    size = int(np.ceil(2.0 * radius / pixel_size))
    finest = cloud.levels[0]
    with open_studio([*cloud.sources, finest], preset.samples) as studio:
        return np.stack([studio.render(visible, VIEW_DIRECTION, center, pixel_size, size) for visible in (cloud.sources, [finest])])


def show_at_switch_distance(cloud: SceneCloud) -> None:
    """Move the camera just beyond the switch distance of the finest level and show the level for this distance."""
    center, radius = bounding_sphere(cloud.sources)
    scene = bpy.context.scene
    distance = float(cloud.levels[0]["farfield_switch_distance"]) + radius
    scene.camera.matrix_world = look_at_matrix(VIEW_DIRECTION, center + 1.01 * distance * VIEW_DIRECTION)
    scene.camera.data.clip_end = max(scene.camera.data.clip_end, 4.0 * distance)
    bpy.context.view_layer.update()
    bpy.ops.farfield.billboards_show_level()


def format_title(cloud: SceneCloud, report: dict[str, Any]) -> str:
    """Return the title of the contact sheet."""
    size = f"{report['source_triangles']:,} triangles as {report['quads']:,} quads and {report['texels']:,} texels"
    return f"{cloud.collection.name}: {size}, where the error is one pixel"


def write_cloud(folder: Path, title: str, cloud: SceneCloud, finest: Comparison, close_up: np.ndarray) -> None:
    """Write the contact sheet of the cloud and its scene to `folder`. The visibility of the source is restored afterwards."""
    columns = np.linspace(0, len(finest.directions) - 1, MAX_SHEET_COLUMNS).round().astype(int).tolist()
    write_png(folder / "contact-sheet.png", draw_comparison_sheet(title, finest, columns, close_up))
    hidden = [(item, item.hide_viewport, item.hide_render) for item in cloud.sources]
    show_at_switch_distance(cloud)
    scene_files.save_scene(folder / "demo.blend")
    for item, in_viewport, in_render in hidden:
        item.hide_viewport, item.hide_render = in_viewport, in_render


def make_relightable(
    folder: Path, cloud: SceneCloud, preset: DemoPreset, upper_hemisphere: bool, line: command_line.ProgressLine
) -> dict[str, Any]:
    """Bake one level of `cloud`, compare it and plant a forest of it, which replaces the scene. Writes all images to `folder`.

    upper_hemisphere: only bake views and lights above the horizon, for the tree on its ground. Returns the figures for the report.
    """
    clock = StageClock()
    relighting = replace(preset.relighting, bake=replace(preset.relighting.bake, upper_hemisphere=upper_hemisphere))
    with clock.stage("bake and compare"):
        relit = run_to_end(subprogress(bake_and_compare(cloud, relighting), COMPARISON_END, RELIGHTING_END), line.show)
    figures = relit.to_report()
    write_png(folder / "relighting.png", relit.draw_sheet())
    with clock.stage("forest"):
        write_forest(relit.cloud, folder / "forest.blend", preset.forest_width, preset.forest_samples)
        sheet = run_to_end(subprogress(render_day(folder / "forest.blend"), RELIGHTING_END, FOREST_END), line.show)
    write_png(folder / "forest.png", sheet)
    forest = {"trees": TREE_COUNT, "hours": [hour.name for hour in DAY]}
    seconds = {**relit.job.clock.seconds, **clock.seconds}
    return {"relighting": {**figures, "seconds": {stage: round(duration, 4) for stage, duration in seconds.items()}}, "forest": forest}


def texture_from_photographs(folder: Path, preset: PhotosPreset, line: command_line.ProgressLine) -> dict[str, Any]:
    """Photograph a model, which replaces the scene, merge, and compare. Writes sheet and scene to `folder`; returns the figures."""
    result = run_to_end(subprogress(photograph_and_merge(preset), FOREST_END, PHOTOS_END), line.show)
    write_png(folder / "photos.png", result.draw_sheet())
    scene_files.save_scene(folder / "photos.blend")
    return result.to_report()


def fly_over_terrain(folder: Path, preset: TerrainPreset, line: command_line.ProgressLine) -> dict[str, Any]:
    """Build a terrain and fly over it; its scene replaces the former one. Writes store and sheet to `folder`; returns the figures."""
    result = run_to_end(subprogress(build_and_fly(preset, folder), PHOTOS_END, TERRAIN_END), line.show)
    write_png(folder / "terrain.png", result.draw_sheet())
    return result.to_report()


def make_perceptual_levels(folder: Path, preset: LevelsPreset, line: command_line.ProgressLine) -> dict[str, Any]:
    """Make levels of a textured ring; its scene replaces the former one. Writes scene and sheet to `folder`; returns the figures."""
    result = run_to_end(subprogress(make_and_compare(preset), TERRAIN_END, 1.0), line.show)
    write_png(folder / "texmesh.png", result.draw_sheet())
    scene_files.save_scene(folder / "texmesh.blend")
    return result.to_report()


if __name__ == "__main__":
    command_line.run(main)
