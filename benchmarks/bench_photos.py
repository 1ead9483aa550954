"""Textures from photographs compared with the truth and with those of other programs: `python3 benchmarks/bench_photos.py [flags]`.

Prints JSON. Parts (`--only`): `synthetic` (painted models: PSNR against the paint, and jumps across borders and UV seams), `sceaux`
(rendered against the photographs, with time and memory), `leave_one_out` (against a photograph that was not used), `growth` (seconds and
memory by number of photographs), `holes` (holes in known textures), `registering` (cameras from pairs of points), `refining` (those
cameras refined against other photographs), `alignment` (merges of photographs with wrong poses). Each run draws other
paints, cameras and holes; --seed repeats one. Settings may be tuned on `--set tuning`, so that nothing is concluded from it.
"""

import secrets
import sys
import time
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import benchmark_cli
import numpy as np
from photos_hole_scores import fill_and_score, punch_holes
from photos_inputs import SETS, Unwrapped, load_model, load_photographs, read_mesh, unwrap_mesh
from photos_methods import FARFIELD, PEERS, Textured, run_method
from photos_models import Shoot, make_paint, photograph_model
from photos_refining import measure_alignment, measure_refining
from photos_registering import measure_registering
from photos_scores import find_truth, score_render, score_seams, score_truth

from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.photographs.photograph import Photograph
from farfield.addon.core.photos.settings import PhotosSettings
from lib import command_line
from lib.contact_sheet import write_png

DATA = environment.ROOT.parent / "shared" / "data"
SCEAUX = (("mesh_15k.ply", 2048), ("mesh_175k.ply", 4096))
GROWTH = (10, 40, 160)
HOLES, HOLE_FRACTION, HOLE_SIZE = 50, 0.01, 4096


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = benchmark_cli.build_parser("bench_photos.py", __doc__, PARTS)
    parser.add_argument("--set", choices=list(SETS), default="judging", help="the set of models")
    parser.add_argument("--methods", nargs="+", choices=[*FARFIELD, *PEERS], default=["farfield", *PEERS], help="methods to compare")
    parser.add_argument("--seed", type=int, help="seed of paints, cameras and holes; a random one by default")
    parser.add_argument("--size", type=int, default=1024, help="pixels per side of the textures of models")
    parser.add_argument("--data", type=Path, default=DATA, help="folder with the data")
    parser.add_argument("--sheets", type=Path, help="folder for photographs next to renders")
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Measure and return the results as JSON; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    given.seed = secrets.randbits(31) if given.seed is None else given.seed
    parts = {"seed": lambda _: {"seed": given.seed}} | PARTS
    given.only = ["seed", *given.only]
    line.clear()
    return benchmark_cli.run_parts(given, parts)


def measure_synthetic(given: Namespace) -> dict[str, Any]:
    """Compare textures of painted models with the paint."""
    figures: dict[str, Any] = {}
    for index, name in enumerate(SETS[given.set]):
        random = np.random.default_rng([given.seed, index])
        unwrapped, paint, shoot = shoot_model(name, given, random)
        truth = find_truth(*unwrapped, given.size, paint, shoot.true_cameras)
        perfect = np.zeros((given.size**2, 3), np.float32)
        perfect[truth.texels] = truth.colors
        figures[name] = {}
        for method in given.methods:
            result = run_method(method, *unwrapped, shoot.photographs, given.size)
            figures[name][method] = describe(result)
            if result.colors is not None:
                figures[name][method] |= {
                    "psnr": score_truth(result.colors, truth),
                    "jumps": score_seams(*unwrapped, result.colors, result.source),
                    "true_jumps": score_seams(*unwrapped, perfect.reshape(given.size, given.size, 3), result.source),
                }
            report("synthetic", name, method, figures[name][method])
    return figures


def shoot_model(name: str, given: Namespace, random: np.random.Generator) -> tuple[Unwrapped, Any, Shoot]:
    """Return a model, its paint and photographs of it."""
    unwrapped = load_model(name, given.data, random)
    paint = make_paint(unwrapped.mesh.vertices, random)
    return unwrapped, paint, photograph_model(unwrapped.mesh, paint, random)


def measure_sceaux(given: Namespace) -> dict[str, Any]:
    """Compare the castle, rendered from each camera, with the photographs."""
    figures: dict[str, Any] = {}
    for mesh_name, size in SCEAUX:
        photographs = load_photographs(given.data)
        started = time.perf_counter()
        unwrapped = unwrap_mesh(read_mesh(given.data / "sceaux" / mesh_name))
        figures[mesh_name] = {"size": size, "unwrap_seconds": round(time.perf_counter() - started, 2)}
        before = command_line.peak_memory_mb()
        for method in given.methods:
            result = run_method(method, *unwrapped, photographs, size)
            row = describe(result)
            if method in FARFIELD:
                row["peak_memory_above_input_mb"] = round(command_line.peak_memory_mb() - before, 1)
            if result.colors is not None:
                row |= compare_renders(unwrapped, result, photographs, given.sheets, f"{Path(mesh_name).stem}-{method}")
            figures[mesh_name][method] = row
            report("sceaux", mesh_name, method, row)
    return figures


def measure_leave_one_out(given: Namespace) -> dict[str, Any]:
    """Leave out each photograph of the castle in turn, and compare the texture of the others with it."""
    photographs = load_photographs(given.data)
    unwrapped = unwrap_mesh(read_mesh(given.data / "sceaux" / SCEAUX[0][0]))
    figures: dict[str, Any] = {method: [] for method in given.methods}
    for index, photograph in enumerate(photographs):
        others = photographs[:index] + photographs[index + 1 :]
        for method in given.methods:
            result = run_method(method, *unwrapped, others, SCEAUX[0][1])
            if result.colors is None:
                figures[method].append(describe(result))
                continue
            score = score_render(*unwrapped, result.colors, photograph)
            figures[method].append({"name": photograph.camera.name, "ssim": score.ssim, "psnr": score.psnr})
            report("leave_one_out", photograph.camera.name, method, figures[method][-1])
    for method, rows in figures.items():
        scored = [row for row in rows if "ssim" in row]
        means = {key: round(float(np.mean([row[key] for row in scored])), 4) for key in ("ssim", "psnr")} if scored else {}
        figures[method] = means | {"photographs": rows}
    return figures


def measure_growth(given: Namespace) -> dict[str, Any]:
    """Measure seconds and memory of merging by the number of photographs, which are those of the castle with jitter of their exposures."""
    random = np.random.default_rng([given.seed, 300])
    photographs = load_photographs(given.data)
    unwrapped = unwrap_mesh(read_mesh(given.data / "sceaux" / SCEAUX[0][0]))
    figures: dict[str, Any] = {}
    for count in GROWTH:
        repeated = [
            jitter(photographs[index % len(photographs)], random) if index >= len(photographs) else photographs[index]
            for index in range(count)
        ]
        before = command_line.peak_memory_mb()
        started = time.perf_counter()
        result = run_to_end(merge(*unwrapped, repeated, PhotosSettings(size=SCEAUX[0][1])))
        figures[str(count)] = {
            "seconds": round(time.perf_counter() - started, 2),
            "stages": {name: round(seconds, 2) for name, seconds in result.seconds.items()},
            "input_mb": round(sum(each.pixels.nbytes for each in repeated) / 1e6, 1),
            "peak_memory_above_input_mb": round(command_line.peak_memory_mb() - before, 1),
        }
        report("growth", str(count), "farfield", figures[str(count)])
        del repeated, result
    return figures


def jitter(photograph: Photograph, random: np.random.Generator) -> Photograph:
    """Return the photograph with another brightness."""
    scaled = photograph.pixels.astype(np.float32) * np.float32(random.uniform(0.9, 1.1))
    return replace(photograph, pixels=np.clip(np.rint(scaled), 0, 255).astype(np.uint8))


def measure_holes(given: Namespace) -> dict[str, Any]:
    """Punch holes into textures that are known, the castle's and those of painted models, and fill them."""
    figures: dict[str, Any] = {}
    for index, name in enumerate(("sceaux", *SETS[given.set][:2])):
        random = np.random.default_rng([given.seed, 400, index])
        if name == "sceaux":
            unwrapped, photographs = unwrap_mesh(read_mesh(given.data / "sceaux" / SCEAUX[0][0])), load_photographs(given.data)
        else:
            unwrapped, _, shoot = shoot_model(name, given, random)
            photographs = shoot.photographs
        result = run_to_end(merge(*unwrapped, photographs, PhotosSettings(size=HOLE_SIZE)))
        missing = punch_holes(unwrapped, result.source >= 0, HOLE_FRACTION, HOLES, random)
        covered = (result.source >= 0) | result.holes
        figures[name] = fill_and_score(unwrapped, result.colors, covered, missing, given.sheets and given.sheets / f"holes-{name}.png")
        report("holes", name, "all", figures[name])
    return figures


def compare_renders(
    unwrapped: Unwrapped, result: Textured, photographs: list[Photograph], sheets: Path | None, name: str
) -> dict[str, Any]:
    """Return the scores of a texture rendered from the cameras of `photographs`."""
    rows = []
    for photograph in photographs:
        score = score_render(*unwrapped, result.colors, photograph)
        rows.append({"name": photograph.camera.name, "ssim": score.ssim, "psnr": score.psnr})
        if sheets is not None:
            sheets.mkdir(parents=True, exist_ok=True)
            pair = [photograph.pixels.astype(np.float32) / 255.0, score.image]
            write_png(sheets / f"{name}-{Path(photograph.camera.name).stem}.png", np.concatenate(pair, axis=1))
    black = (
        np.count_nonzero((result.colors.reshape(-1, 3)[(result.source >= 0).ravel()] == 0.0).all(axis=1))
        if result.source is not None
        else None
    )
    means = {key: round(float(np.mean([row[key] for row in rows])), 4) for key in ("ssim", "psnr")}
    return means | {"black_texels": black, "photographs": rows}


def describe(result: Textured) -> dict[str, Any]:
    """Return the figures of a texture that need no comparison."""
    if result.colors is None:
        return {"error": result.error}
    return {"seconds": round(result.seconds, 2)} | ({} if result.stages is None else {"stages": result.stages, "holes": result.holes})


def report(part: str, case: str, method: str, row: dict[str, Any]) -> None:
    """Print what has been measured so far."""
    short = {key: value for key, value in row.items() if key not in ("photographs", "stages")}
    print(f"{part}, {case}, {method}: {short}", file=sys.stderr, flush=True)


PARTS = {
    "synthetic": measure_synthetic,
    "sceaux": measure_sceaux,
    "leave_one_out": measure_leave_one_out,
    "growth": measure_growth,
    "holes": measure_holes,
    "registering": lambda given: measure_registering(np.random.default_rng([given.seed, 500])),
    "refining": lambda given: measure_refining(np.random.default_rng([given.seed, 600])),
    "alignment": lambda given: measure_alignment(given.seed, given.size),
}


if __name__ == "__main__":
    command_line.run(main)
