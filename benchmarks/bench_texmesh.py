"""Perceptual levels measured against the bounds of their design: `python3 benchmarks/bench_texmesh.py [flags]`. Prints JSON.

Parts (`--only`), each in a module `texmesh_PART.py` if no other one is named:

- `speed` (texmesh_levels.py): time and memory with 200k triangles and a texture of 4096 x 4096
- `refits`: deviations compared with other programs
- `glb`: the Khronos validator, with --validator
- `switching` (texmesh_levels.py): FLIP between neighboring levels at their switch distance, in views that the search did not use
- `renders`: FLIP of levels by Farfield and by other programs against the original
- `rebakes`: FLIP and bytes of rebaked textures
- `targets` (texmesh_levels.py): subset levels, bit for bit
- `paper`: Figures 4, 10 and 11
- `ordinary`: ordinary assets with whole materials, compared with other programs; --flip renders them, --pictures writes sheets

Each run generates other models, textures and views; --seed repeats one.
"""

import secrets
import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import benchmark_cli
import texmesh_glb
from texmesh_levels import measure_speed, measure_switching, measure_targets
from texmesh_ordinary import measure_ordinary
from texmesh_paper import measure_paper
from texmesh_refits import measure_refits
from texmesh_renders import measure_rebakes, measure_renders

from farfield.addon.core.errors import SettingsError
from lib import command_line


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = benchmark_cli.build_parser("bench_texmesh.py", __doc__, PARTS)
    parser.add_argument(
        "--models", nargs="+", default=None, help="names of texmesh_models.open_model, or of texmesh_assets.open_asset; by default all"
    )
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**6), help="of generated models, textures and views")
    parser.add_argument("--data", type=Path, default=environment.ROOT.parent / "shared" / "data", help="the folder of the meshes")
    parser.add_argument("--validator", type=Path, help="a folder with node_modules/gltf-validator, for the part glb")
    parser.add_argument("--flip", action="store_true", help="also render ordinary assets and compare them by FLIP")
    parser.add_argument("--pictures", type=Path, help="a folder for sheets of ordinary assets")
    return parser


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Run the selected parts; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    print(f"seed {given.seed}", file=sys.stderr)
    return benchmark_cli.run_parts(given, PARTS)


def measure_glb(given: Namespace) -> dict[str, Any]:
    """Return what the Khronos validator finds in generated files.

    Raises:
        SettingsError: there is no validator.
    """
    if given.validator is None:
        raise SettingsError("The part glb needs --validator; install the npm package gltf-validator in a folder, or leave the part out.")
    return texmesh_glb.validate_scenes(given.validator)


PARTS = {
    "speed": measure_speed,
    "refits": measure_refits,
    "glb": measure_glb,
    "switching": measure_switching,
    "renders": measure_renders,
    "rebakes": measure_rebakes,
    "targets": measure_targets,
    "paper": measure_paper,
    "ordinary": measure_ordinary,
}


if __name__ == "__main__":
    command_line.run(main)
