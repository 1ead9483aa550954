"""Part `fragments` of bench_packages.py: the fragments of the paper (section III.C, Figures 7 and 9) and the lookup table of every scale.

The textures of the paper are not published. Those of real models and a generated one stand for them.
"""

import sys
from argparse import Namespace
from typing import Any

import numpy as np
from PIL import Image
from sending.fragments import (
    DEFAULT_TOLERANCE,
    FRAGMENT_UNIT,
    CodedFragments,
    count_features,
    make_fragment_grid,
    measure_fragmentation,
    measure_quality_sizes,
    normalize_counts,
    quality_of_scale,
    tabulate_sizes,
)
from texmesh_models import open_textured

from farfield.addon.core.imaging.coded_images import encode
from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.scale_space.analysis import analyze_scale_space
from farfield.addon.core.texmesh.scale_space.features import SCALES
from farfield.addon.core.texmesh.settings import AnalysisSettings
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

MODELS = ("spot", "blub", "fuze", "sceaux")  # and a generated one
TABLE_MODEL = "spot"
ROWS = (  # Rows of Figure 7: side in pixels and qualities.
    (1024, (20, 40, 50, 60)),
    (512, (40, 50, 60)),
    (256, (20, 60)),
)
QUALITIES = tuple(range(10, 101, 10))  # Qualities of Figure 9.
THRESHOLDS = tuple(np.linspace(0.0, 1.0, 11).round(2).tolist())
MAP_SCALE = 8  # whose map of qualities is reported
TABLES_BEGIN, SCAN_BEGIN = (b"\xff\xdb", b"\xff\xc4"), b"\xff\xda"  # DQT and DHT, SOS


def measure_fragments(given: Namespace) -> dict[str, Any]:
    """Return Figures 7 and 9, and the lookup table of the model TABLE_MODEL."""
    names = given.models or [*MODELS, f"planet:{given.seed}"]
    figure_7, figure_9, lookup = {}, {}, None
    for name in names:
        model = open_textured(given.data, name, given.seed)
        image = next(item for item in model.images if item is not None)
        print(name, image.shape, file=sys.stderr)
        figure_7[name] = [row for side, qualities in ROWS for row in measure_rows(resize(image, side), qualities)]
        figure_9[name] = np.round(measure_quality_sizes(resize(image, ROWS[0][0]), QUALITIES), 1).tolist()
        if name == TABLE_MODEL:
            scale_map = run_to_end(analyze_scale_space(model.mesh, [LINEAR_OF_BYTE[image]], AnalysisSettings()))
            lookup = tabulate_scales(model.mesh, image, scale_map.last_scales)
    return {"figure_7": figure_7, "figure_9": {"qualities": QUALITIES, "bytes": figure_9}, "lookup": lookup}


def resize(image: np.ndarray, side: int) -> np.ndarray:
    """Return an image (H, W, 3) uint8 with `side` pixels per side."""
    return np.asarray(Image.fromarray(image).resize((side, side), Image.Resampling.LANCZOS))


def measure_rows(image: np.ndarray, qualities: tuple[int, ...]) -> list[dict[str, int]]:
    """Return rows of Figure 7: bytes of all fragments, also without the tables that all of them repeat, of one file of the decoded
    fragments, and of the image as one file."""
    grid = make_fragment_grid(image.shape[1], image.shape[0], FRAGMENT_UNIT)
    fragments = CodedFragments(image, grid)
    rows = []
    for row in measure_fragmentation(image, qualities):
        files = fragments.code(np.full((grid.rows, grid.columns), row.quality))
        abbreviated = sum(len(file) - count_table_bytes(file) for file in files)
        rows.append({"side": image.shape[1], "abbreviated": abbreviated} | row._asdict())
    return rows


def count_table_bytes(file: bytes) -> int:
    """Return the bytes of the quantization and Huffman tables of a JPEG file, which an abbreviated one (ITU-T T.81, B.5) leaves out."""
    position, total = 2, 0
    while file[position : position + 2] != SCAN_BEGIN:
        length = 2 + int.from_bytes(file[position + 2 : position + 4], "big")
        total += length if file[position : position + 2] in TABLES_BEGIN else 0
        position += length
    return total


def tabulate_scales(mesh: TexturedMesh, image: np.ndarray, last_scales: np.ndarray) -> dict[str, Any]:
    """Return the bytes against the threshold of every scale, and what they are of."""
    grid = make_fragment_grid(image.shape[1], image.shape[0])
    fragments, features = CodedFragments(image, grid), count_features(mesh, (0,), last_scales, grid)
    tables = [tabulate_sizes(fragments, features, scale, np.array(THRESHOLDS)) for scale in range(SCALES)]
    mean = float(normalize_counts(features.counts[MAP_SCALE]).mean())
    nearest = int(np.abs(np.array(THRESHOLDS) - mean).argmin())
    return {
        "side": image.shape[1],
        "fragment": grid.tile_size,
        "tolerance": DEFAULT_TOLERANCE,
        "thresholds": THRESHOLDS,
        "qualities": [quality_of_scale(scale) for scale in range(SCALES)],
        "bytes": [table.byte_counts.tolist() for table in tables],
        "uniform": [sum(map(len, fragments.code(np.full((grid.rows, grid.columns), quality_of_scale(scale))))) for scale in range(SCALES)],
        "single": [len(encode(image, "jpeg", max(round(quality_of_scale(scale)), 1))) for scale in range(SCALES)],
        "map": {
            "scale": MAP_SCALE,
            "threshold": THRESHOLDS[nearest],
            "features": features.counts[MAP_SCALE].tolist(),
            "qualities": tables[MAP_SCALE].qualities[nearest].tolist(),
        },
    }
