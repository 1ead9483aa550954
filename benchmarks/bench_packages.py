"""Packages measured against the bounds of their design: `python3 benchmarks/bench_packages.py [flags]`. Prints JSON.

Parts (`--only`), each in a module `packages_PART.py`:

- `bytes`: bytes until a model looks right, compared with gltfpack and WebP
- `building`: time and memory of a package with 200k triangles and a texture of 4096 x 4096
- `meshes`: bytes of meshes compared with gltfpack and Draco
- `textures`: bytes of the textures of packages at equal FLIP
- `roles`: bytes of base color, normal and roughness maps
- `fragments`: Figures 7 and 9, and the lookup table of the fragments of the paper
- `sending`: packages over 200 replayed traces, or --package over the connection in the file --trace
- `server`: many clients, and random requests

Each run generates other models, textures and views; --seed repeats one.
"""

import secrets
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "scripts"), str(ROOT / "tests"), str(ROOT / "tests" / "packages")]

from lib import environment

environment.ensure()
environment.import_farfield()

import benchmark_cli
from packages_building import measure_building
from packages_bytes import measure_bytes
from packages_fragments import measure_fragments
from packages_meshes import measure_meshes
from packages_roles import measure_roles
from packages_sending import measure_sending
from packages_server import measure_server
from packages_textures import measure_textures
from packages_views import VIEWS

from lib import command_line, run_files

PARTS = {
    "bytes": measure_bytes,
    "building": measure_building,
    "meshes": measure_meshes,
    "textures": measure_textures,
    "roles": measure_roles,
    "fragments": measure_fragments,
    "sending": measure_sending,
    "server": measure_server,
}


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = benchmark_cli.build_parser("bench_packages.py", __doc__, PARTS)
    parser.add_argument("--models", nargs="+", default=None, help="names of texmesh_models.open_model; by default all that judge")
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**6), help="of generated models, textures and views")
    parser.add_argument("--data", type=Path, default=environment.ROOT.parent / "shared" / "data", help="the folder of the meshes")
    sizes = list(VIEWS)
    parser.add_argument("--sizes", nargs="+", type=int, choices=sizes, default=sizes, help="of images, for the parts bytes and textures")
    parser.add_argument("--minutes", type=float, default=120.0, help="after which the parts bytes and textures begin no further model")
    parser.add_argument("--package", type=run_files.parse_path, help="the folder of a package, for the part sending")
    parser.add_argument(
        "--trace",
        type=run_files.parse_path,
        help="text file of a connection, for --package: seconds and bytes per second, or Mahimahi's",
    )
    return parser


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Run the selected parts; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    print(f"seed {given.seed}", file=sys.stderr)
    return benchmark_cli.run_parts(given, PARTS)


if __name__ == "__main__":
    command_line.run(main)
