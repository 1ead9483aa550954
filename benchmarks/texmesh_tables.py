"""Prints the Markdown tables of docs/results/texmesh.md from reports: `python3 benchmarks/texmesh_tables.py REPORT.json [MORE.json ...]`.

Reports are those of `bench_texmesh.py --report`. Models of later reports replace those of earlier ones.
"""

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

PEERS = {  # columns by the names of texmesh_peers; gltfpack by its flags
    "blender": "Decimate",
    "gltfpack -si": "-si",
    "gltfpack -si -sv": "-si -sv",
    "gltfpack -si -sp": "-si -sp",
    "gltfpack -si -sp -sv": "-si -sp -sv",
    "pymeshlab": "pymeshlab",
}
NAMED_PEERS = ("blender", "gltfpack -si", "gltfpack -si -sp", "pymeshlab")  # those of the bound
SIDES = ("from_fine", "from_level")
LAST_SCALE = 20


def main(paths: Sequence[str]) -> None:
    """Print the tables of all parts that the reports contain."""
    parts: dict[str, dict[str, Any]] = {}
    for path in paths:
        for part, figures in json.loads(Path(path).read_text("utf-8")).items():
            parts.setdefault(part, {}).update(figures)
    for part, build in TABLES.items():
        if part in parts:
            print(f"\n<!-- {part} -->\n{build(parts[part])}")


def build_switches(models: dict[str, Any]) -> str:
    """Return the FLIP at each switch."""
    rows = []
    for name, model in models.items():
        for number, switch in enumerate(model["switches"], 1):
            figures = [
                switch["triangles"],
                switch["pixels"],
                switch["difference_of_search"],
                switch["difference"],
                switch["local_difference"],
            ]
            rows.append([name, f"L{number}", *figures])
    return _table(["model", "level", "triangles", "pixels", "FLIP in views of the search", "in other views", "95th percentile"], rows)


def build_renders(models: dict[str, Any]) -> str:
    """Return the FLIP of all methods against the original."""
    rows = []
    for name, model in models.items():
        for number, level in enumerate(model["levels"], 1):
            peers = [_render_cell(level["methods"].get(peer), level["triangles"]) for peer in PEERS]
            own = level["methods"]["farfield"]["mean"]
            rows.append([name, f"L{number}", level["triangles"], level["pixels"], f"{own:.4f}", *peers, level["ratio"]])
    return _table(["model", "level", "triangles", "pixels", "Farfield", *PEERS.values(), "ratio to the best"], rows)


def build_rebakes(models: dict[str, Any]) -> str:
    """Return FLIP against the original without and with rebaked textures, and bytes of images."""
    rows = []
    for name, model in models.items():
        original = model["original"]
        rows.append([name, "L0", "", "", _join_sizes(original["sizes"]), original["png"], original["jpeg"], "", "", ""])
        for number, level in enumerate(model["levels"], 1):
            cells = [f"{level[at]['plain']:.3f}, {level[at]['rebaked']:.3f}" for at in ("switch", "nearer")]
            step = f"{level['switch']['step']:.3f}, {level['switch']['step_rebaked']:.3f}"
            images = [_join_sizes(level["sizes"]), level["png"], level["jpeg"]]
            rows.append([name, f"L{number}", level["triangles"], level["pixels"], *images, *cells, step])
    titles = ["model", "level", "triangles", "pixels", "image", "PNG", "JPEG", "FLIP at the switch", "3 times nearer", "to the finer level"]
    return _table(titles, rows)


def _join_sizes(sizes: list[list[int]]) -> str:
    return ", ".join(f"{width} x {height}" for width, height in sizes)


def build_refits(models: dict[str, Any]) -> str:
    """Return the deviations of refit levels compared with those of other programs."""
    rows = []
    for name, model in models.items():
        for part in [key for key in model if key.endswith("%")]:
            level = model[part]
            left_out = level["ratios"]["not_reached"]
            reached = [peer for peer in PEERS if peer not in left_out]
            own = level["farfield"]
            named = [peer for peer in reached if peer in NAMED_PEERS]
            texture = [_divide(level, peers, lambda item: item["texture"]["from_fine"]["mean"]) for peers in (named, reached)]
            sides = [
                " / ".join(_divide(level, reached, lambda item, key=(side, kind): item["geometry"][key[0]][key[1]]) for side in SIDES)
                for kind in ("mean", "max")
            ]
            both = _divide(level, reached, lambda item: max(item["geometry"][side]["max"] for side in SIDES))
            count = f"{own['triangles']:,} of {level['target']:,}"
            mean = f"{1e4 * own['texture']['from_fine']['mean']:.2f}"
            rows.append([name, part, count, mean, *texture, *sides, both, ", ".join(left_out) or "none", model["cpu_seconds"]])
    titles = ["model", "part", "triangles", "texture mean, 1e-4", "ratio, named peers", "ratio, all peers", "geometric mean ratios"]
    return _table([*titles, "geometric maximum ratios", "maximum, both sides", "peers that miss the target", "CPU s"], rows)


def _divide(level: dict[str, Any], peers: Sequence[str], measure: Callable[[dict[str, Any]], float]) -> str:
    """Return the ratio of Farfield's figure to the smallest one of `peers`."""
    return f"{measure(level['farfield']) / min(measure(level[peer]) for peer in peers):.2f}" if peers else "none"


def build_targets(models: dict[str, Any]) -> str:
    """Return the triangles of subset levels."""
    rows = []
    for name, model in models.items():
        reached = [f"{level['triangles']:,} of {level['target']:,}" for level in model["levels"]]
        constraints = sorted({level["constraint"] for level in model["levels"] if level["constraint"]})
        is_subset = all(level["is_subset"] for level in model["levels"])
        rows.append([name, f"{model['triangles']:,}", *reached, "yes" if is_subset else "no", " ".join(constraints) or "none"])
    return _table(["model", "triangles", "50 %", "25 %", "10 %", "3 %", "bit for bit", "constraint"], rows)


def build_paper(figures: dict[str, Any]) -> str:
    """Return the tables to compare with Figures 4, 10 and 11."""
    scales = [str(scale) for scale in range(LAST_SCALE + 1)]
    counts = _table(["vertices", *scales], [[name, *values] for name, values in figures["figure_4"].items()])
    ranges = _table(["range", *scales], [[name, *(f"{value:.2f}" for value in values)] for name, values in figures["figure_10"].items()])
    rows = [[name, values["samples"], values["row_spacings"], values["height_fraction"]] for name, values in figures["convergence"].items()]
    convergence = _table(["body", "samples", "last sigma in distances between rows", "relative to the height"], rows)
    titles = ["scale", *scales[1:]]
    rows = []
    for name, body in figures["figure_11"].items():
        rows.append([f"{name}, triangles", *body["triangles"]])
        rows.append([f"{name}, distance in heights", *(f"{distance:.0f}" for distance in body["distances"])])
        rows.append([f"{name}, zones", *_mark_zones(body["zones"])])
    return "\n\n".join([counts, ranges, convergence, _table(titles, rows)])


def build_fragments(figures: dict[str, Any]) -> str:
    """Return Figures 7 and 9, and the lookup table."""
    rows = []
    for name, measured in figures["figure_7"].items():
        for row in measured:
            sizes = [_kilobytes(row[key]) for key in ("non_fragmented", "fragmented", "abbreviated", "single")]
            rows.append([name, f"{row['side']}²", row["quality"], *sizes, f"{row['abbreviated'] / row['non_fragmented']:.2f}"])
    titles = [
        "texture",
        "pixels",
        "quality",
        "non-fragmented",
        "sum of fragments",
        "without tables",
        "one file",
        "without tables / non-fragmented",
    ]
    figure_9 = figures["figure_9"]
    sizes = [[name, *(f"{size:,.0f}" for size in values)] for name, values in figure_9["bytes"].items()]
    tables = [_table(titles, rows), _table(["bytes of a fragment at quality", *map(str, figure_9["qualities"])], sizes)]
    lookup = figures["lookup"]
    if lookup is not None:
        rows = [
            [scale, f"{quality:g}", *map(_kilobytes, byte_counts), _kilobytes(lookup["single"][scale])]
            for scale, (quality, byte_counts) in enumerate(zip(lookup["qualities"], lookup["bytes"], strict=True))
        ]
        tables.append(_table(["scale", "Q", *(f"{threshold:g}" for threshold in lookup["thresholds"]), "one file"], rows))
    return "\n\n".join(tables)


def build_packaging(figures: dict[str, Any]) -> str:
    """Return the stages of a package."""
    stages = [[row["stage"] or "Start", row["seconds"], row["cpu_seconds"], row["peak_memory_mb"]] for row in figures["stages"]]
    total = ["all", figures["seconds"], figures["cpu_seconds"], figures["peak_memory_mb"]]
    return _table(["stage", "s", "CPU s", "peak memory so far, MB"], [*stages, total])


def _kilobytes(count: int) -> str:
    return f"{count / 1000.0:,.0f}"


def _mark_zones(zones: list[list[int]]) -> list[str]:
    """Return per scale from 1 on whether the refinement from it to the next finer one is perceptible (red) or not (green)."""
    starts = {start for start, _ in zones}
    return ["red" if scale in starts else "green" for scale in range(1, LAST_SCALE + 1)]


def _render_cell(method: dict[str, Any] | None, count: int) -> str:
    if method is None:
        return "fails"
    text = f"{method['mean']:.4f}"
    return text if 0.9 * count <= method["triangles"] <= 1.02 * count else f"{text} ({method['triangles']:,} triangles)"


def _table(titles: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    lines = [titles, ["---"] * len(titles), *rows]
    return "\n".join(_join(line) for line in lines)


def _join(line: Sequence[Any]) -> str:
    cells = [f"{cell:,}" if isinstance(cell, int) else str(cell) for cell in line]
    return f"|{'|'.join(cells)}|" if cells[0] == "---" else f"| {' | '.join(cells)} |"


TABLES = {
    "switching": build_switches,
    "renders": build_renders,
    "rebakes": build_rebakes,
    "refits": build_refits,
    "targets": build_targets,
    "paper": build_paper,
    "fragments": build_fragments,
    "packaging": build_packaging,
}


if __name__ == "__main__":
    main(sys.argv[1:])
