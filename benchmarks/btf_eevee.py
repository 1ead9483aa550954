"""EEVEE against Cycles: `python3 benchmarks/btf_eevee.py RELIT.blend --report R.json [--upper-hemisphere] [--pairs 6] [--sheet S.png]`.

RELIT.blend holds a relightable cloud, as scripts/btf.py leaves it. Both engines draw its finest level from the same held-out views under
the same suns, at the switch size. EEVEE needs OpenGL or Vulkan; where there is neither, Blender may end this process.
"""

import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

import environment

environment.ensure()

import bpy
import numpy as np

import command_line
import scene_files
from comparison import BORDER
from contact_sheet import write_png
from farfield.addon.bridge.btf_clouds import light_with
from farfield.addon.compat import eevee_engine
from farfield.addon.core.progress import Progress, Steps, finish
from farfield.addon.operators.billboards_clouds import clouds_in
from relighting import Relighting, held_out_pairs, relighting_sheet
from studio import SKY_RADIANCE, bounds, studio


def main(arguments: list[str], line: command_line.ProgressLine) -> None:
    """Draw, compare, report."""
    parser = command_line.Parser(prog="btf_eevee.py", description="Compare EEVEE with Cycles on a relightable cloud.")
    parser.add_argument("input", type=Path, help="a .blend file with a relightable cloud")
    parser.add_argument("--report", type=Path, required=True, help="a JSON file for the figures")
    parser.add_argument("--upper-hemisphere", action="store_true", help="views and suns from above the horizon only")
    parser.add_argument("--pairs", type=int, default=6, help="held-out pairs of view and sun (default: 6)")
    parser.add_argument("--samples", type=int, default=64, help="samples a pixel of both engines (default: 64)")
    parser.add_argument("--sheet", type=Path, help="a PNG file for the contact sheet")
    given = parser.parse_args(arguments)
    scene_files.open_scene(given.input.absolute())
    level = clouds_in(bpy.context.scene)[0].levels[0]
    compared = finish(drawn_by_both(level, held_out_pairs(given.pairs, given.upper_hemisphere), given.samples), line.show)
    line.clear()
    command_line.write_report(
        given.report.absolute(), {**compared.figures()["EEVEE"], "worst_ssim": round(compared.scores()[0, :, 1].min(), 4)}
    )
    if given.sheet is not None:
        write_png(given.sheet, relighting_sheet(f"{level.name} drawn by Cycles and EEVEE", compared, range(given.pairs)))


def drawn_by_both(level: bpy.types.Object, pairs: tuple[np.ndarray, np.ndarray], samples: int) -> Steps[Relighting]:
    """The relightable `level` as Cycles and as EEVEE draw it, for every pair of view and sun; without lamps when this ends."""
    engines = {"Cycles": "CYCLES", "EEVEE": eevee_engine()}
    pixel_size = float(level["farfield_error"])
    center, radius = bounds([level])
    size = math.ceil(2.0 * radius / pixel_size) + 2 * BORDER
    views, suns = pairs
    pictures = np.empty((2, len(views), size, size, 4), np.float32)
    with studio([level], samples) as room:
        light_with(level, [room.sun], [SKY_RADIANCE] * 3)
        room.take_samples(samples)
        for number, (name, engine) in enumerate(engines.items()):
            room.render_with(engine)
            for place, (view, sun) in enumerate(zip(views, suns, strict=True)):
                yield Progress((number + place / len(views)) / 2, f"Rendering with {name}, {place + 1} of {len(views)}")
                room.shine_from(sun)
                pictures[number, place] = room.picture([level], view, center, pixel_size, size)
        light_with(level, [], [0.0] * 3)
    return Relighting(views, suns, list(engines), pictures, pixel_size)


if __name__ == "__main__":
    command_line.run(main)
