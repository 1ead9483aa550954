"""How like its original a cloud looks: `python3 benchmarks/pictures.py CLOUD.blend [--level 0] [--sheet SHEET.png] [--report R.json]`.

CLOUD.blend holds an original and its billboard cloud, as scripts/billboards.py leaves them. Both are rendered from held-out views at the
switch size under one lamp; SSIM and silhouette overlap are printed view by view as JSON, and drawn as a contact sheet.
"""

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

import environment

environment.ensure()

import bpy

import command_line
import scene_files
from comparison import compare, sheet
from contact_sheet import write_png
from farfield.addon.core.directions import held_out_views
from farfield.addon.core.errors import FarfieldError
from farfield.addon.core.progress import finish
from farfield.addon.operators.billboards_clouds import StandingCloud, clouds_in
from whole_files import whole_file


def main(arguments: list[str], line: command_line.ProgressLine) -> None:
    """Compare, print, draw; raises FarfieldError when the file holds no cloud with its original."""
    parser = command_line.Parser(prog="pictures.py", description="Compare a billboard cloud with its original in Cycles.")
    parser.add_argument("input", type=Path, help="a .blend file with an original and its cloud")
    parser.add_argument("--level", type=int, default=0, help="the level to compare, 0 is the finest (default: 0)")
    parser.add_argument("--views", type=int, default=12, help="number of held-out views (default: 12)")
    parser.add_argument("--samples", type=int, default=64, help="Cycles samples a pixel (default: 64)")
    parser.add_argument("--sheet", type=Path, help="a PNG file for the contact sheet")
    parser.add_argument("--report", type=Path, help="a JSON file for the figures")
    given = parser.parse_args(arguments)
    scene_files.open_scene(given.input.absolute())
    cloud = the_cloud(given.input.name, given.level)
    level = cloud.levels[given.level]
    compared = finish(compare(cloud.sources, level, directions=held_out_views(given.views), samples=given.samples), line.show)
    line.clear()
    figures = {"level": given.level, "quads": level["farfield_quads"], "texels": level["farfield_texels"], **compared.figures()}
    print(json.dumps(figures, indent=2))
    if given.report is not None:
        command_line.write_report(given.report.absolute(), figures)
    if given.sheet is not None:
        size = f"{figures['quads']:,} quads, {figures['texels']:,} texels"
        title = f"{cloud.collection.name}, level {given.level}: {size}; error = 1 px"
        with whole_file(given.sheet.absolute()) as path:
            write_png(path, sheet(title, compared))


def the_cloud(name: str, level: int) -> StandingCloud:
    """The first cloud of the open scene, which must have its original and this level."""
    standing = [cloud for cloud in clouds_in(bpy.context.scene) if cloud.sources]
    if not standing:
        raise FarfieldError(f'"{name}" holds no billboard cloud beside its original; make one with scripts/billboards.py.')
    if not 0 <= level < len(standing[0].levels):
        raise FarfieldError(f'"{standing[0].collection.name}" has levels 0 to {len(standing[0].levels) - 1}, not {level}.')
    return standing[0]


if __name__ == "__main__":
    command_line.run(main)
