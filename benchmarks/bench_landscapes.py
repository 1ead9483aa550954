"""Landscapes compared with real ones: `python3 benchmarks/bench_landscapes.py [flags]`.

Prints JSON. Parts (`--only`): `shape` (spectral slope of heights, distribution of slopes and drainage density of *Alps*, *Hills* and
*Canyon* against windows of real elevation models of the same size and spacing), `detail` (the finest octave of pictures of the ground
near the camera against photographs of ground) and `repetition` (largest peak of the autocorrelation of the colors of the ground at 10,
100 and 1000 m, of which 1 is a texture that repeats). Each run draws other seeds and places; --seed repeats one.
"""

import heapq
import secrets
import sys
import tempfile
from argparse import Namespace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "scripts"), str(ROOT / "docs")]

from lib import environment

environment.ensure()
environment.import_farfield()

import benchmark_cli
import bpy
import numpy as np
import tifffile
from figures import terrain_views
from PIL import Image
from scipy.ndimage import distance_transform_edt, gaussian_filter

from farfield.addon.bridge.clipbox.materials import create_terrain_material
from farfield.addon.bridge.geometry.mesh_arrays import write_triangles
from farfield.addon.bridge.rendering.render_scene import RenderScene, prepare_cycles, render_scene
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.landscapes import LANDSCAPES, SEEDS, Shape, find_base, read_shape
from lib import command_line

DATA = environment.ROOT.parent / "shared" / "data" / "dem"
PHOTOGRAPHS = DATA.parent / "sceaux" / "images"
VOID, MAX_VOIDS = -1000.0, 0.1  # Heights below it are unknown; which part of a window may be, and is that of the nearest sample then.
MIN_GRADIENT = 0.06  # Median gradient; less is a plain or the sea.
WINDOW, SPACING = 200, 75.0  # Samples along a side, and meters between them: those of the elevation models along a parallel.
METERS_PER_DEGREE = 111_320.0
CHANNEL_AREA = 0.5e6  # Square meters that drain through a cell of a channel.
PERCENTILES = (10, 25, 50, 75, 90)
COMPARED, COUNT = ("alps", "hills", "canyon"), 4
NEIGHBORS = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]
EXTENTS, PIXELS = (10.0, 100.0, 1000.0), 256  # Meters that are covered by renders of the ground.
REPEATED = "hills", "mesas", "dunes"
CAMERAS, VIEW_PIXELS, VIEW_SAMPLES, EYE_HEIGHT, AHEAD = 12, 256, 16, 1.7, 6.0  # Cameras near the ground; meters.
GROUND_OF_PHOTOGRAPHS, GROUND_OF_VIEWS, PART = 0.1, 0.4, 48  # The lowest part of pictures, and sides of the parts of it that count, pixels.
PEAK_BOUND = 0.15


def measure_shape(given: Namespace) -> dict[str, Any]:
    """Return the range of each measure in windows of real elevation models, and the measures of landscapes, each with other seeds."""
    random = np.random.default_rng(given.seed)
    if not DATA.exists():
        return {"skipped": f"there is no folder {DATA.name} with elevation models"}
    real = [describe_heights(heights, SPACING) for path in sorted(DATA.glob("*.tif")) for heights in read_windows(path)]
    figures: dict[str, Any] = {"windows_of_real_terrain": len(real)}
    figures["real"] = {name: [round(float(edge(item[name] for item in real)), 3) for edge in (min, max)] for name in real[0]}
    y, x = (SPACING * values.astype(np.float64) for values in np.mgrid[:WINDOW, :WINDOW])
    for terrain in COMPARED:
        found = []
        for _ in range(COUNT):
            shape = Shape(SEEDS * int(random.integers(10_000)), 1.0, 1.0)
            corner = random.uniform(-1e5, 1e5, 2)
            found.append(describe_heights(LANDSCAPES[terrain](x + corner[0], y + corner[1], SPACING, shape).height, SPACING))
        figures[terrain] = {name: [round(item[name], 3) for item in found] for name in found[0]}
        figures[terrain]["within_the_range"] = {
            name: sum(low <= item[name] <= high for item in found) / COUNT for name, (low, high) in figures["real"].items()
        }
    return figures


def read_windows(path: Path) -> list[np.ndarray]:
    """Return the windows (WINDOW, WINDOW) of an elevation model in degrees, neither plains nor full of voids, resampled to SPACING."""
    heights = tifffile.imread(path).astype(np.float64)
    with tifffile.TiffFile(path) as file:
        north, degrees = file.pages[0].tags["ModelTiepointTag"].value[4], file.pages[0].tags["ModelPixelScaleTag"].value[0]
    windows = []
    step_y = SPACING / (degrees * METERS_PER_DEGREE)
    step_x = step_y / np.cos(np.radians(north - 0.5))
    rows, columns = int(np.ceil(WINDOW * step_y)), int(np.ceil(WINDOW * step_x))
    for top in range(0, heights.shape[0] - rows, rows):
        for left in range(0, heights.shape[1] - columns, columns):
            part = heights[top : top + rows + 1, left : left + columns + 1]
            is_void = part < VOID
            if is_void.mean() > MAX_VOIDS:
                continue
            part = part[tuple(distance_transform_edt(is_void, return_distances=False, return_indices=True))]
            if np.median(np.hypot(*np.gradient(part, SPACING))) > MIN_GRADIENT:
                x = np.arange(WINDOW) * step_x
                along = np.stack([np.interp(x, np.arange(part.shape[1]), row) for row in part])
                y = np.arange(WINDOW) * step_y
                windows.append(np.stack([np.interp(y, np.arange(part.shape[0]), column) for column in along.T], axis=1))
    return windows


def describe_heights(heights: np.ndarray, spacing: float) -> dict[str, float]:
    """Return the measures of heights (N, N) in meters."""
    angles = np.degrees(np.arctan(np.hypot(*np.gradient(heights, spacing))))
    named = {f"slope_{percent}": float(np.percentile(angles, percent)) for percent in PERCENTILES}
    return {"spectral_slope": fit_spectrum(heights), **named, "drainage_km_per_km2": measure_drainage(heights, spacing)}


def fit_spectrum(heights: np.ndarray) -> float:
    """Return the exponent of the radial mean of the power spectrum, between a quarter of the window and three samples."""
    size = len(heights)
    window = np.hanning(size)[:, None] * np.hanning(size)
    power = np.abs(np.fft.fftshift(np.fft.fft2((heights - heights.mean()) * window))) ** 2
    y, x = np.indices(heights.shape) - size // 2
    frequencies = np.arange(4, size // 3)
    radial = np.bincount(np.hypot(x, y).astype(int).ravel(), power.ravel())[frequencies]
    radial /= np.bincount(np.hypot(x, y).astype(int).ravel())[frequencies]
    return float(np.polyfit(np.log(frequencies), np.log(radial), 1)[0])


def measure_drainage(heights: np.ndarray, spacing: float) -> float:
    """Return kilometers of channels per square kilometer: cells through which CHANNEL_AREA drains, by the steepest of eight directions,
    after depressions were filled to their outlets (Barnes et al., Priority-Flood, 2014)."""
    rows, columns = heights.shape
    receiver, order, is_done = np.full(heights.size, -1), [], np.zeros(heights.shape, bool)
    queue = [(float(heights[i, j]), i, j) for i in range(rows) for j in range(columns) if i in (0, rows - 1) or j in (0, columns - 1)]
    heapq.heapify(queue)
    for _, i, j in queue:
        is_done[i, j] = True
    while queue:
        level, i, j = heapq.heappop(queue)
        order.append(i * columns + j)
        for row, column in NEIGHBORS:
            a, b = i + row, j + column
            if 0 <= a < rows and 0 <= b < columns and not is_done[a, b]:
                is_done[a, b] = True
                receiver[a * columns + b] = i * columns + j
                heapq.heappush(queue, (max(level, float(heights[a, b])), a, b))
    area = np.full(heights.size, spacing**2)
    for cell in reversed(order):
        if receiver[cell] >= 0:
            area[receiver[cell]] += area[cell]
    cells = np.arange(heights.size)
    is_channel = (area >= CHANNEL_AREA) & (receiver >= 0)
    steps = np.hypot(cells // columns - receiver // columns, cells % columns - receiver % columns)
    return float(steps[is_channel].sum() * spacing / 1e3 / (heights.size * spacing**2 / 1e6))


def measure_detail(given: Namespace) -> dict[str, Any]:
    """Return the detail of photographs of ground, and of landscapes from random places near the ground, relative to their median."""
    random = np.random.default_rng(given.seed)
    if not PHOTOGRAPHS.exists():
        return {"skipped": f"there is no folder {PHOTOGRAPHS.parent.name} with photographs"}
    photographs = [describe_detail(path, GROUND_OF_PHOTOGRAPHS) for path in sorted(PHOTOGRAPHS.glob("*.jpg"))]
    usual, found = float(np.median(photographs)), {}
    for number in range(CAMERAS):
        terrain = list(LANDSCAPES)[number % len(LANDSCAPES)]
        settings = ClipboxSettings(terrain=terrain, seed=int(random.integers(10_000)), resolution=96, voxel_size=0.5)
        place, angle, shape = random.uniform(-2000.0, 2000.0, 2), random.uniform(0.0, 2.0 * np.pi), read_shape(settings)
        ends = np.array([place, place + AHEAD * np.array([np.cos(angle), np.sin(angle)])])
        heights = LANDSCAPES[terrain](ends[:, :1], ends[:, 1:], 0.5, shape).height[:, 0] - find_base(terrain, shape)
        points = np.column_stack([ends, heights + [EYE_HEIGHT, 0.0]])
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "view.png"
            terrain_views.square_view(path, VIEW_PIXELS, VIEW_SAMPLES, settings, points[0], points[1])
            found[f"{terrain} {number}"] = round(describe_detail(path, GROUND_OF_VIEWS) / usual, 2)
    return {"photographs": [round(value, 4) for value in photographs], "relative_to_their_median": found}


def describe_detail(path: Path, ground: float) -> float:
    """Return the RMS of the finest octave of a picture's luminance relative to its mean, median of the parts of its lowest fraction."""
    values = np.asarray(Image.open(path).convert("L"), np.float64)
    values = values[int((1.0 - ground) * len(values)) :]
    means = 0.25 * (values[:-1, :-1] + values[1:, :-1] + values[:-1, 1:] + values[1:, 1:])
    corners = [(row, column) for row in range(0, len(means) - PART + 1, PART) for column in range(0, means.shape[1] - PART + 1, PART)]
    parts = [(slice(row, row + PART), slice(column, column + PART)) for row, column in corners]
    return float(np.median([np.sqrt(((values[:-1, :-1] - means)[part] ** 2).mean()) / means[part].mean() for part in parts]))


def measure_repetition(given: Namespace) -> dict[str, Any]:
    """Return the largest peaks of the autocorrelation of the ground of landscapes, each at another place."""
    random = np.random.default_rng(given.seed)
    figures: dict[str, Any] = {"bound": PEAK_BOUND}
    for terrain in REPEATED:
        figures[terrain] = {}
        for extent in EXTENTS:
            with render_scene("Ground") as work:
                colors = render_ground(work, terrain, extent, random.uniform(-5000.0, 5000.0, 2))
            figures[terrain][f"{extent:g}"] = round(find_peak(colors), 3)
    return figures


def render_ground(work: RenderScene, terrain: str, extent: float, place: np.ndarray) -> np.ndarray:
    """Render level ground from above, lit from all sides, (PIXELS, PIXELS) luminance."""
    root = work.own(bpy.data.objects.new("Root", None))
    root.location = (*(-place), 0.0)
    mesh = work.own(bpy.data.meshes.new("Ground"))
    half = 0.5 * extent
    write_triangles(
        mesh, np.array([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]), np.array([(0, 1, 2), (0, 2, 3)])
    )
    mesh.materials.append(work.own(create_terrain_material("Ground", root, -200.0, 200.0, 1.0, terrain=terrain)))
    work.add_object(mesh)
    prepare_cycles(work.scene, 4, 1)
    work.scene.world = work.own(work.add_world(1.0))
    work.scene.render.resolution_x = work.scene.render.resolution_y = PIXELS
    work.camera.data.type, work.camera.data.ortho_scale = "ORTHO", extent
    work.camera.location.z, work.camera.data.clip_end = 0.5 * extent, 10.0 * extent
    bpy.context.view_layer.update()
    return work.render()[..., :3].mean(axis=2)


def find_peak(values: np.ndarray) -> float:
    """Return the largest autocorrelation of values (N, N) beyond the central peak, which ends where it first falls to 0 in all directions.

    What is larger than an eighth of the picture is removed, since it has too few repetitions to be told from a trend.
    """
    size = len(values)
    details = values - gaussian_filter(values, size / 16.0, mode="reflect")
    padded = np.zeros((2 * size, 2 * size))
    padded[:size, :size] = details
    correlation = np.fft.ifft2(np.abs(np.fft.fft2(padded)) ** 2).real
    mask = np.zeros_like(padded)
    mask[:size, :size] = 1.0
    overlap = np.fft.ifft2(np.abs(np.fft.fft2(mask)) ** 2).real
    correlation = np.fft.fftshift(correlation / np.maximum(overlap, 1.0))
    y, x = np.indices(correlation.shape) - size
    distance = np.hypot(x, y)
    correlation /= correlation[size, size]
    radial = np.array([correlation[(distance >= radius) & (distance < radius + 1.0)].max() for radius in range(size // 2)])
    below = np.flatnonzero(radial < 0.05)
    first = int(below[0]) if len(below) else int(np.argmin(radial))
    return float(correlation[(distance > first) & (distance < 0.75 * size)].max())


PARTS = {"shape": measure_shape, "detail": measure_detail, "repetition": measure_repetition}


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Measure; returns the measurements as JSON."""
    parser = benchmark_cli.build_parser("bench_landscapes.py", __doc__, PARTS)
    parser.add_argument("--seed", type=int, default=secrets.randbelow(1_000_000), help="of the seeds and places")
    return benchmark_cli.run_parts(parser.parse_args(arguments), PARTS)


if __name__ == "__main__":
    command_line.run(main)
