"""Compares refit levels with levels by other programs: `python3 benchmarks/texmesh_refits.py [flags]`. Prints JSON.

For each model and target: the triangles, the texture deviation and the geometric deviation (mean and maximum, from both sides) of all
methods, and the ratios of Farfield's to the best of the peers that reach their target. Models are tuned on TUNING_MODELS alone; generated
models have the seeds of `--seed`, by default new ones in every run.
"""

import json
import sys
import tempfile
import time
from argparse import Namespace
from dataclasses import asdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import benchmark_cli
import numpy as np
import texmesh_files
import texmesh_models
import texmesh_peers
from PIL import Image
from texmesh_deviation import make_refit_levels, measure_geometric_deviation, measure_texture_deviation

from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh
from lib import command_line

FRACTIONS = (0.5, 0.25, 0.1, 0.03)
TUNING_MODELS = ("spot", "planet:1")
MAX_TEXTURE_RATIO = 0.7
MAX_EXCESS = 1.02  # A peer with at most this multiple of a target reaches it.
MIN_REACHED = 0.9  # A peer with less than this fraction of a target is not comparable.
SAMPLES = 50_000


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = benchmark_cli.build_parser("texmesh_refits.py", __doc__, PARTS)
    parser.add_argument("--models", nargs="+", default=None, help="names of texmesh_models.open_model; by default those that judge")
    parser.add_argument("--seed", type=int, default=int(np.random.SeedSequence().entropy % 10**6), help="of the generated models")
    parser.add_argument("--data", type=Path, default=environment.ROOT.parent / "shared" / "data", help="the folder of the meshes")
    return parser


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Run the selected parts; raises FarfieldError if the input is invalid."""
    return benchmark_cli.run_parts(build_parser().parse_args(arguments), PARTS)


def measure_refits(given: Namespace) -> dict[str, Any]:
    """Measure all models."""
    generated = [f"{kind}:{given.seed + index}" for index, kind in enumerate(texmesh_models.GENERATORS)]
    names = given.models or [*(set(texmesh_models.REAL_MODELS) - set(TUNING_MODELS)), "bunny", *generated]
    results = {}
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            results[name] = measure_model(texmesh_models.open_model(given.data, name), Path(folder))
        print(name, json.dumps(results[name]), file=sys.stderr)
    return results


def measure_model(fine: TexturedMesh, folder: Path) -> dict[str, Any]:
    """Measure the levels of one model by all methods."""
    source = folder / "fine.obj"
    textures = {int(material): f"texture_{material}.png" for material in np.unique(fine.materials)}
    for texture in textures.values():
        Image.new("RGB", (4, 4)).save(folder / texture)
    texmesh_files.write_obj(source, fine, textures)
    targets = [max(round(fraction * len(fine.triangles)), 1) for fraction in FRACTIONS]
    started = time.process_time()
    levels = run_to_end(make_refit_levels(fine, targets, TexmeshSettings()))
    result: dict[str, Any] = {"triangles": len(fine.triangles), "cpu_seconds": round(time.process_time() - started, 1)}
    for fraction, target, level in zip(FRACTIONS, targets, levels, strict=True):
        farfield, peers = measure_level(fine, level), {}
        for name, simplify in texmesh_peers.PEERS.items():
            peer = simplify(source, folder, target)
            peers[name] = {"failure": peer.message} if peer.mesh is None else measure_level(fine, peer.mesh)
        result[f"{fraction:.0%}"] = {"target": target, "ratios": compare(farfield, peers, target), "farfield": farfield, **peers}
    return result


def measure_level(fine: TexturedMesh, level: TexturedMesh) -> dict[str, Any]:
    """Return the triangles and the deviations of a level."""
    texture, geometry = measure_texture_deviation(fine, level, SAMPLES), measure_geometric_deviation(fine, level, SAMPLES)
    return {"triangles": len(level.triangles), "texture": asdict(texture), "geometry": asdict(geometry)}


def compare(farfield: dict[str, Any], peers: dict[str, Any], target: int) -> dict[str, Any]:
    """Return the ratios of each measure to the best peer, and the peers that do not reach the target."""
    reached = {
        name: figures
        for name, figures in peers.items()
        if "failure" not in figures and MIN_REACHED * target <= figures["triangles"] <= MAX_EXCESS * target
    }
    ratios: dict[str, Any] = {"not_reached": sorted(set(peers) - set(reached)), "max_texture_ratio": MAX_TEXTURE_RATIO}
    for measure, statistics in (("texture", ("mean",)), ("geometry", ("mean", "max"))):
        for side in ("from_fine", "from_level"):
            for statistic in statistics:
                best = min(reached, key=lambda name: reached[name][measure][side][statistic], default=None)
                if best is not None:
                    ratio = farfield[measure][side][statistic] / reached[best][measure][side][statistic]
                    ratios[f"{measure} {side} {statistic}"] = {"ratio": round(ratio, 3), "best": best}
    return ratios


PARTS = {"refits": measure_refits}


if __name__ == "__main__":
    command_line.run(main)
