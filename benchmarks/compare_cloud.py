"""Compare a cloud with its source: `python3 benchmarks/compare_cloud.py CLOUD.blend [--level 0] [--sheet SHEET.png] [--report R.json]`.

CLOUD.blend contains a source and its billboard cloud, as written by scripts/billboards.py. Both are rendered from held-out views at the
switch distance under one light. Prints SSIM and silhouette overlap of every view as JSON; --sheet writes the renders as a contact sheet.
"""

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import bpy

from farfield.addon.bridge.billboards.scene_clouds import SceneCloud, clouds_in
from farfield.addon.bridge.objects import temporarily_visible
from farfield.addon.core.errors import FarfieldError
from farfield.addon.core.geometry.directions import held_out_views
from farfield.addon.core.jobs.progress import run_to_end
from lib import command_line, scene_files
from lib.atomic_output import atomic_file
from lib.comparison import compare_cloud, draw_comparison_sheet
from lib.contact_sheet import write_png


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Compare the cloud and return the scores as JSON; raises FarfieldError when the file has no cloud with its source."""
    parser = command_line.Parser(prog="compare_cloud.py", description="Compare a billboard cloud with its source in Cycles.")
    parser.add_argument("input", type=Path, help="a .blend file with a source and its cloud")
    parser.add_argument("--level", type=int, default=0, help="the level to compare, 0 is the finest (default: 0)")
    parser.add_argument("--views", type=int, default=12, help="number of held-out views (default: 12)")
    parser.add_argument("--samples", type=int, default=64, help="Cycles samples per pixel (default: 64)")
    parser.add_argument("--sheet", type=Path, help="a PNG file for the contact sheet")
    parser.add_argument("--report", type=Path, help="a JSON file for the measurements")
    given = parser.parse_args(arguments)
    scene_files.open_scene(given.input.absolute())
    cloud = select_cloud(given.input.name, given.level)
    level = cloud.levels[given.level]
    with temporarily_visible(bpy.context, cloud.sources):  # the build hides them by default
        comparison = run_to_end(
            compare_cloud(cloud.sources, level, directions=held_out_views(given.views), samples=given.samples), line.show
        )
    figures = {"level": given.level, "quads": level["farfield_quads"], "texels": level["farfield_texels"], **comparison.to_report()}
    if given.report is not None:
        command_line.write_report(given.report.absolute(), figures)
    if given.sheet is not None:
        size = f"{figures['quads']:,} quads, {figures['texels']:,} texels"
        title = f"{cloud.collection.name}, level {given.level}: {size}; error = 1 px"
        with atomic_file(given.sheet.absolute()) as path:
            write_png(path, draw_comparison_sheet(title, comparison))
    return json.dumps(figures, indent=2)


def select_cloud(name: str, level: int) -> SceneCloud:
    """Return the first cloud of the open scene that has its source.

    Raises:
        FarfieldError: there is none, or it does not have this level.
    """
    clouds = [cloud for cloud in clouds_in(bpy.context.scene) if cloud.sources]
    if not clouds:
        raise FarfieldError(f'"{name}" contains no billboard cloud with its source; create one with scripts/billboards.py.')
    if not 0 <= level < len(clouds[0].levels):
        raise FarfieldError(f'"{clouds[0].collection.name}" has levels 0 to {len(clouds[0].levels) - 1}, not {level}.')
    return clouds[0]


if __name__ == "__main__":
    command_line.run(main)
