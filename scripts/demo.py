"""The main job from start to end: `python3 scripts/demo.py [--input FILE] [--quick] [--out DIR]`.

Grows a tree, builds its billboard cloud in three levels, compares every level with the tree in Cycles, bakes relightable textures for one
of them, compares that under other suns, and plants a forest of it. Leaves in out/demo/ the scene (demo.blend), contact sheets
(contact-sheet.png, relighting.png), the forest (forest.blend, forest.png) and the figures (report.json, report.md). --input takes a mesh
of your own instead of the tree; --quick makes fewer leaves, a coarser cloud, and fewer and smaller renders.
"""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

import environment

environment.ensure()

import bpy
import numpy as np

import billboards
import command_line
import scene_files
from comparison import Comparison, compare, sheet
from contact_sheet import write_png
from demo_relighting import RelightingEffort, bake_and_compare
from demo_report import markdown
from demo_tree import grow
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.directions import held_out_views
from farfield.addon.core.progress import StageClock, finish, scaled
from farfield.addon.operators.billboards_clouds import StandingCloud
from farfield.addon.operators.billboards_job import BuildOptions
from farfield.addon.operators.long_work import whole
from forest import DAY, TREES, render_day, write_forest
from studio import SUN_ANGLE, SUN_STRENGTH, bounds, looking_along, paint_sky, studio, sun_matrix
from whole_files import check_writable, whole_folder

LEVELS = 3
COLUMNS = 6
NEARER = 3.0  # the close-up shows what is a pixel at the switch size as so many
VIEWER = np.array([0.55, -0.80, 0.22]) / np.linalg.norm([0.55, -0.80, 0.22])  # where the scene's camera stands, seen from the tree


@dataclass(frozen=True)
class Effort:
    """How much the demo does."""

    leaves: int
    error: float
    capture_samples: int
    views: int
    samples: int
    compared_levels: int
    relighting: RelightingEffort
    forest_width: int
    forest_samples: int


FULL = Effort(
    leaves=6000,
    error=0.01,
    capture_samples=16,
    views=8,
    samples=24,
    compared_levels=LEVELS,
    relighting=RelightingEffort(
        level=2,
        bake=BtfSettings(views=36, lights=25, components=12, alpha_components=12, samples=4),
        pairs=6,
        samples=32,
        frames=12,
        frame_samples=16,
    ),
    forest_width=340,
    forest_samples=6,
)
QUICK = Effort(
    leaves=1000,
    error=0.03,
    capture_samples=4,
    views=6,
    samples=8,
    compared_levels=1,
    relighting=RelightingEffort(
        level=1,
        bake=BtfSettings(views=9, lights=9, components=4, alpha_components=4, shadows=64, shadow_components=8, samples=2),
        pairs=2,
        samples=8,
        frames=6,
        frame_samples=2,
    ),
    forest_width=240,
    forest_samples=2,
)
BUILT, COMPARED, RELIT = 0.25, 0.4, 0.8  # of the bar


def main(arguments: list[str], line: command_line.ProgressLine) -> None:
    """Run the demo; raises FarfieldError when the input or the folder is bad."""
    parser = command_line.Parser(prog="demo.py", description="Grow a tree, build its billboard cloud, compare the two.")
    parser.add_argument("--input", type=Path, help="a mesh of your own instead of the tree: .blend .obj .ply .stl .glb .gltf .fbx .usd")
    parser.add_argument("--quick", action="store_true", help="fewer leaves, a coarser cloud and fewer renders, done within a minute")
    parser.add_argument("--out", type=Path, default=Path("out") / "demo", help="the folder for the results (default: out/demo)")
    given = parser.parse_args(arguments)
    effort = QUICK if given.quick else FULL
    out = given.out.absolute()
    check_writable(out / "report.json")
    clock = StageClock()
    with clock.stage("scene"):
        set_scene(given.input, effort)
    settings = BillboardSettings(error=effort.error, levels=LEVELS, samples=effort.capture_samples)
    job = billboards.prepare_input(settings, BuildOptions(together=True))
    finish(scaled(whole(job), 0.0, BUILT), line.show)
    cloud = billboards.standing(job)[0]
    with clock.stage("compare"):
        comparisons = compare_levels(cloud, effort, line)
        close_up = near_pictures(cloud, effort)
    report = billboards.report(job, clock)
    for level, compared in zip(report["levels"], comparisons, strict=False):
        level["pictures"] = compared.figures()
    heading = title(cloud, report)
    with whole_folder(out) as folder:
        leave_cloud(folder, heading, cloud, comparisons[0], close_up)
        report |= relight(folder, cloud, effort, upper=given.input is None, line=line)
        command_line.write_report(folder / "report.json", report)
        (folder / "report.md").write_text(markdown(heading, report), encoding="utf-8")
    line.clear()
    print(f"{heading}.\nPictures, figures and scenes are in {out}.", file=sys.stderr)


def set_scene(path: Path | None, effort: Effort) -> None:
    """Open the user's file or grow the tree, and give the scene a camera, a sun and a sky where it has none."""
    if path is None:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        grow(seed=0, leaves=effort.leaves)
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
        paint_sky(scene.world)


def compare_levels(cloud: StandingCloud, effort: Effort, line: command_line.ProgressLine) -> list[Comparison]:
    """Comparisons of the levels with the original, finest first, each at its own switch size."""
    comparisons = []
    for index, level in enumerate(cloud.levels[: effort.compared_levels]):
        steps = compare(cloud.sources, level, directions=held_out_views(effort.views), samples=effort.samples)
        start, stop = (BUILT + (COMPARED - BUILT) * place / effort.compared_levels for place in (index, index + 1))
        comparisons.append(finish(scaled(steps, start, stop), line.show))
    return comparisons


def near_pictures(cloud: StandingCloud, effort: Effort) -> np.ndarray:
    """Renders (2, H, W, 4) of the original and of the finest level, from nearer than that level is meant for."""
    center, radius = bounds(cloud.sources)
    pixel_size = cloud.errors[0] / NEARER
    size = int(np.ceil(2.0 * radius / pixel_size))
    finest = cloud.levels[0]
    with studio([*cloud.sources, finest], effort.samples) as room:
        return np.stack([room.picture(shown, VIEWER, center, pixel_size, size) for shown in (cloud.sources, [finest])])


def stand_at_switch_distance(cloud: StandingCloud) -> None:
    """Put the camera where the finest level is just not told from the original, and show what belongs there."""
    center, radius = bounds(cloud.sources)
    scene = bpy.context.scene
    distance = float(cloud.levels[0]["farfield_switch_distance"]) + radius
    scene.camera.matrix_world = looking_along(VIEWER, center + 1.01 * distance * VIEWER)
    scene.camera.data.clip_end = max(scene.camera.data.clip_end, 4.0 * distance)
    bpy.context.view_layer.update()
    bpy.ops.farfield.billboards_show_level()


def title(cloud: StandingCloud, report: dict[str, Any]) -> str:
    """The line above the contact sheet."""
    size = f"{report['source_triangles']:,} triangles as {report['quads']:,} quads and {report['texels']:,} texels"
    return f"{cloud.collection.name}: {size}, at the size where its error is one pixel"


def leave_cloud(folder: Path, heading: str, cloud: StandingCloud, finest: Comparison, close_up: np.ndarray) -> None:
    """Write the sheet of the cloud and its scene into `folder`. In the scene that is open the original is seen as before."""
    columns = np.linspace(0, len(finest.directions) - 1, COLUMNS).round().astype(int).tolist()
    write_png(folder / "contact-sheet.png", sheet(heading, finest, columns, close_up))
    hidden = [(item, item.hide_viewport, item.hide_render) for item in cloud.sources]
    stand_at_switch_distance(cloud)
    scene_files.save_scene(folder / "demo.blend")
    for item, in_viewport, in_render in hidden:
        item.hide_viewport, item.hide_render = in_viewport, in_render


def relight(folder: Path, cloud: StandingCloud, effort: Effort, upper: bool, line: command_line.ProgressLine) -> dict[str, Any]:
    """Bake one level of `cloud`, compare it and plant a forest of it, which replaces the scene; all pictures into `folder`.

    upper: the original stands on the ground; whether a user's does, nobody knows. Returns the figures.
    """
    clock = StageClock()
    relighting = replace(effort.relighting, bake=replace(effort.relighting.bake, upper_hemisphere=upper))
    with clock.stage("bake and compare"):
        relit = finish(scaled(bake_and_compare(cloud, relighting), COMPARED, RELIT), line.show)
    figures = relit.figures()
    write_png(folder / "relighting.png", relit.sheet())
    with clock.stage("forest"):
        write_forest(relit.cloud, folder / "forest.blend", effort.forest_width, effort.forest_samples)
        pictures = finish(scaled(render_day(folder / "forest.blend"), RELIT, 1.0), line.show)
    write_png(folder / "forest.png", pictures)
    forest = {"trees": TREES, "hours": [hour.name for hour in DAY]}
    seconds = {**relit.job.clock.seconds, **clock.seconds}
    return {"relighting": {**figures, "seconds": {stage: round(taken, 4) for stage, taken in seconds.items()}}, "forest": forest}


if __name__ == "__main__":
    command_line.run(main)
