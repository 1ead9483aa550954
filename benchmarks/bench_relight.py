"""Relightable clouds under all kinds of light, on models that nobody tuned on: `python3 benchmarks/bench_relight.py [--models MODEL ...]
[--errors 1% 2%] [--pairs N] [--lights KIND ...] [--seed N] [--work DIR] [--sheets DIR] [--report R.json]`.

Prints JSON. Every model is built and baked with default settings. It is compared with its source from random views under random lights,
next to the same cloud with its PBR maps, at the switch size: PSNR of display values over the rectangle of the object. The bound is that
no model gets worse than its PBR maps. Each run draws other directions; --seed repeats one.
"""

import json
import secrets
import sys
import tempfile
from argparse import Namespace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import bpy
import numpy as np
from btf_bakes import build_cloud, run_script
from btf_models import DATA, MODELS
from scipy.ndimage import binary_erosion

from farfield.addon.bridge.billboards.scene_clouds import SceneCloud, clouds_in
from farfield.addon.bridge.shading.node_builder import nodes_in
from farfield.addon.core.jobs.progress import Progress, Steps, run_to_end, subprogress
from lib import command_line, scene_files
from lib.contact_sheet import write_png
from lib.relighting import Candidate, RelightingComparison, compare_relighting, copy_with_pbr_material, draw_relighting_sheet
from lib.shader_nodes import find_node
from lib.studio import bounding_sphere, open_studio
from lib.studio_lights import LIGHT_KINDS

SHEET_COLUMNS = 6
SPECK, NEARER, SPECK_PAIRS = 0.1, 3.0, 4  # radiance; factor of the size; pairs of view and Sun
SHADOW_MARGIN = 4  # pixels between counted shadows and light: silhouettes of a cloud may be off by one error, which is three pixels


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = command_line.Parser(prog="bench_relight.py", description="Compare relightable clouds with PBR maps under all lights.")
    parser.add_argument("--models", nargs="+", choices=list(MODELS), default=list(MODELS), help="the models to measure (default: all)")
    parser.add_argument("--errors", nargs="+", default=["1%", "2%"], help="errors of the clouds (default: 1%% 2%%)")
    parser.add_argument("--lights", nargs="+", choices=LIGHT_KINDS, default=list(LIGHT_KINDS), help="kinds of light (default: all)")
    parser.add_argument("--pairs", type=int, default=24, help="pairs of view and Sun (default: 24); a third as many of other lights")
    parser.add_argument("--samples", type=int, default=32, help="samples of the compared renders (default: 32)")
    parser.add_argument("--reference-samples", type=int, default=96, help="samples of the source in them (default: 96)")
    parser.add_argument("--seed", type=int, help="seed of the directions (default: a random one)")
    parser.add_argument("--bake-flags", default="", help="flags of the bake, for comparisons of settings (default: none)")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the meshes (default: ../shared/data next to the project)")
    parser.add_argument("--work", type=Path, help="folder for clouds and finished views, so that a cancelled run can resume")
    parser.add_argument("--sheets", type=Path, help="folder for contact sheets")
    parser.add_argument("--report", type=Path, help="write the measurements to this JSON file")
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the benchmark and return its measurements as JSON; raises FarfieldError if a mesh is missing or a bake fails."""
    options = build_parser().parse_args(arguments)
    seed = secrets.randbelow(2**31) if options.seed is None else options.seed
    figures: dict[str, Any] = {"seed": seed, "models": {}}
    with tempfile.TemporaryDirectory(prefix="farfield-benchmark-") as folder:
        options.work = Path(folder) if options.work is None else options.work.absolute()
        runs = [(name, error) for name in options.models for error in options.errors]
        for index, (name, error) in enumerate(runs):
            steps = measure_model(name, error, seed + index, options)
            scores = run_to_end(subprogress(steps, index / len(runs), (index + 1) / len(runs)), line.show)
            figures["models"][f"{name} {error}"] = scores
            print(f"{name} {error}: {json.dumps(scores)}", file=sys.stderr, flush=True)
            if options.report is not None:
                command_line.write_report(options.report.absolute(), figures | {"summary": summarize(figures["models"], options.lights)})
    line.clear()
    return json.dumps(figures | {"summary": summarize(figures["models"], options.lights)}, indent=2)


def measure_model(name: str, error: str, seed: int, options: Namespace) -> Steps[dict[str, Any]]:
    """Build, bake and compare one model."""
    yield Progress(0.0, f"Building and baking {name}")
    cloud_path = build_cloud(name, options, error).path
    folder = cloud_path.parent
    relightable_path = folder / "relightable.blend"
    report = folder / "bake.json"
    run_script("btf.py", cloud_path, "--out", relightable_path, "--work", folder / "views", "--report", report, *options.bake_flags.split())
    bake = json.loads(report.read_text(encoding="utf-8"))
    scene_files.open_scene(relightable_path)
    cloud = clouds_in(bpy.context.scene)[0]
    plain = Candidate("PBR", [copy_with_pbr_material(cloud.levels[0])])
    nodes = {(node.id_data.name, node.name): node for node in nodes_in(cloud.levels[0].data.materials[0].node_tree)}.values()
    scores: dict[str, Any] = {
        "quads": int(cloud.levels[0]["farfield_quads"]),
        "bake_seconds": round(sum(value for stage, value in bake["seconds"].items() if stage != "read"), 1),
        "render_seconds": bake["bare_render_seconds"],
        "nodes": len(nodes),
        "images": len({node.image.name for node in nodes if node.type == "TEX_IMAGE"}),
    }
    for index, kind in enumerate(options.lights):
        count = options.pairs if kind == "sun" else max(1, options.pairs // 3)
        pairs = random_pairs(count, np.random.default_rng([seed, index]))
        steps = compare_relighting(
            cloud.sources, cloud.levels[0], [plain], cloud.errors[0], pairs, options.samples, options.reference_samples, kind
        )
        start, end = 0.2 + 0.8 * index / len(options.lights), 0.2 + 0.8 * (index + 1) / len(options.lights)
        comparison = yield from subprogress(steps, start, end)
        scores[kind] = score(comparison)
        if options.sheets is not None:
            write_sheet(options.sheets, f"{name} {error} {kind}", comparison)
    scores["specks"] = yield from count_specks(cloud, plain, np.random.default_rng([seed, len(options.lights)]), options.samples)
    return scores


def count_specks(cloud: SceneCloud, plain: Candidate, generator: np.random.Generator, samples: int) -> Steps[dict[str, int]]:
    """Count pixels brighter than SPECK where the source is in full shadow, three times nearer than the switch distance, without a sky."""
    level, counts = cloud.levels[0], {"shadow pixels": 0, "relightable": 0, "plain": 0}
    center, radius = bounding_sphere(cloud.sources)
    pixel_size = cloud.errors[0] / NEARER
    views, suns = random_pairs(SPECK_PAIRS, generator)
    with open_studio([*cloud.sources, level, *plain.objects], samples) as studio:
        find_node(studio.work.scene.world.node_tree, "BACKGROUND").inputs["Strength"].default_value = 0.0
        for view, sun in zip(views, suns, strict=True):
            yield Progress(0.0, "Looking for light in shadows")
            studio.set_sun_direction(sun)
            size = int(2.0 * radius / pixel_size)
            source, relightable, pbr = (
                studio.render(items, view, center, pixel_size, size) for items in (cloud.sources, [level], plain.objects)
            )
            in_shadow = binary_erosion((source[..., 3] > 0.99) & (source[..., :3].max(axis=2) < 1e-3), iterations=SHADOW_MARGIN)
            counts["shadow pixels"] += int(in_shadow.sum())
            for name, image in (("relightable", relightable), ("plain", pbr)):
                counts[name] += int((image[in_shadow][:, :3].max(axis=1, initial=0.0) > SPECK).sum())
    return counts


def random_pairs(count: int, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return random unit view directions (count, 3) and light directions (count, 3)."""
    directions = generator.standard_normal((2, count, 3))
    return tuple(directions / np.linalg.norm(directions, axis=2, keepdims=True))


def score(comparison: RelightingComparison) -> dict[str, Any]:
    """Return mean and worst PSNR of both, the mean gain in dB, and the smallest gain of a pair."""
    psnr = comparison.compute_scores()[..., 0]
    gain = psnr[0] - psnr[1]
    return {
        "relightable": round(float(psnr[0].mean()), 2),
        "plain": round(float(psnr[1].mean()), 2),
        "gain": round(float(gain.mean()), 2),
        "min_gain": round(float(gain.min()), 2),
        "worst": [round(float(values.min()), 2) for values in psnr],
        "ssim": [round(float(value), 4) for value in comparison.compute_scores()[..., 1].mean(axis=1)],
    }


def summarize(models: dict[str, dict[str, Any]], lights: list[str]) -> dict[str, Any]:
    """Return for each kind of light the mean gain over models, the smallest one, and the smallest gain of a pair."""
    summary = {}
    for kind in lights:
        gains = {name: scores[kind]["gain"] for name, scores in models.items()}
        pairs = {name: scores[kind]["min_gain"] for name, scores in models.items()}
        worst, worst_pair = min(gains, key=gains.get), min(pairs, key=pairs.get)
        mean = round(float(np.mean(list(gains.values()))), 2)
        summary[kind] = {"mean_gain": mean, "smallest": [worst, gains[worst]], "smallest_of_a_pair": [worst_pair, pairs[worst_pair]]}
    return summary


def write_sheet(folder: Path, name: str, comparison: RelightingComparison) -> None:
    """Write the pairs with the smallest gains as a contact sheet."""
    folder.mkdir(parents=True, exist_ok=True)
    psnr = comparison.compute_scores()[..., 0]
    columns = np.argsort(psnr[0] - psnr[1])[:SHEET_COLUMNS].tolist()
    write_png(folder / f"{name}.png", draw_relighting_sheet(f"{name}: the pairs with the smallest gains", comparison, columns))


if __name__ == "__main__":
    command_line.run(main)
