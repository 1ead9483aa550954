"""Compare EEVEE with Cycles: `python3 benchmarks/bench_btf_eevee.py RELIT.blend --report R.json [--upper-hemisphere] [--pairs 6]
[--sheet S.png]`.

RELIT.blend contains a relightable cloud written by scripts/btf.py. Both engines render its finest level from the same held-out views under
the same Sun lights, at its switch distance. EEVEE needs OpenGL or Vulkan; without them Blender may abort this process.
"""

import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import bpy
import numpy as np

from farfield.addon.bridge.billboards.scene_clouds import clouds_in
from farfield.addon.bridge.btf.levels.emission_levels import link_suns
from farfield.addon.compat import eevee_engine
from farfield.addon.core.jobs.progress import Progress, Steps, run_to_end
from lib import command_line, scene_files
from lib.comparison import MARGIN_PIXELS
from lib.contact_sheet import write_png
from lib.relighting import RelightingComparison, draw_relighting_sheet, held_out_pairs
from lib.studio import SKY_RADIANCE, bounding_sphere, open_studio


def main(arguments: list[str], line: command_line.ProgressLine) -> None:
    """Render, compare and report."""
    parser = command_line.Parser(prog="bench_btf_eevee.py", description="Compare EEVEE with Cycles on a relightable cloud.")
    parser.add_argument("input", type=Path, help="a .blend file with a relightable cloud")
    parser.add_argument("--report", type=Path, required=True, help="a JSON file for the measurements")
    parser.add_argument("--upper-hemisphere", action="store_true", help="only views and Suns above the horizon")
    parser.add_argument("--pairs", type=int, default=6, help="held-out pairs of view and Sun (default: 6)")
    parser.add_argument("--samples", type=int, default=64, help="samples per pixel of both engines (default: 64)")
    parser.add_argument("--sheet", type=Path, help="a PNG file for the contact sheet")
    options = parser.parse_args(arguments)
    scene_files.open_scene(options.input.absolute())
    level = clouds_in(bpy.context.scene)[0].levels[0]
    comparison = run_to_end(render_with_both(level, held_out_pairs(options.pairs, options.upper_hemisphere), options.samples), line.show)
    line.clear()
    command_line.write_report(
        options.report.absolute(), {**comparison.mean_scores()["EEVEE"], "worst_ssim": round(comparison.compute_scores()[0, :, 1].min(), 4)}
    )
    if options.sheet is not None:
        write_png(options.sheet, draw_relighting_sheet(f"{level.name} rendered by Cycles and EEVEE", comparison, range(options.pairs)))


def render_with_both(level: bpy.types.Object, pairs: tuple[np.ndarray, np.ndarray], samples: int) -> Steps[RelightingComparison]:
    """Render the relightable `level` with Cycles and EEVEE for every pair of view and Sun. No Sun light is linked to it afterwards."""
    engines = {"Cycles": "CYCLES", "EEVEE": eevee_engine()}
    pixel_size = float(level["farfield_error"])
    center, radius = bounding_sphere([level])
    size = math.ceil(2.0 * radius / pixel_size) + 2 * MARGIN_PIXELS
    views, suns = pairs
    renders = np.empty((2, len(views), size, size, 4), np.float32)
    with open_studio([level], samples) as studio:
        link_suns(level, [studio.sun], [SKY_RADIANCE] * 3)
        studio.set_samples(samples)
        for i, (name, engine) in enumerate(engines.items()):
            studio.set_engine(engine)
            for j, (view, sun) in enumerate(zip(views, suns, strict=True)):
                yield Progress((i + j / len(views)) / 2, f"Rendering with {name}, {j + 1} of {len(views)}")
                studio.set_sun_direction(sun)
                renders[i, j] = studio.render([level], view, center, pixel_size, size)
        link_suns(level, [], [0.0] * 3)
    return RelightingComparison(views, suns, list(engines), renders, pixel_size)


if __name__ == "__main__":
    command_line.run(main)
