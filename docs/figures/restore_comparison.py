"""A texture with a hole, with and without an intensity gradient, restored with several splits into structure and texture."""

import sys

import numpy as np

from lib import environment

environment.import_farfield()
sys.path.append(str(environment.ROOT / "benchmarks"))  # whose textures are shown

from restore_holes import strokes
from restore_textures import canvas, granite

from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.restore.restoration import restore
from farfield.addon.core.restore.settings import RestoreSettings
from lib.contact_sheet import draw_contact_sheet

SETTINGS = {
    "synthesis by pixels": RestoreSettings(split="manual", sub_bands=0, method="pixels"),
    "pure diffusion": RestoreSettings(split="diffusion"),
    "default": RestoreSettings(),
}
TONE = np.float32([0.55, 0.50, 0.45])  # mean color of the texture
CONTRAST = 0.6  # The contrast of the texture leaves room for the gradient.
GRADIENT = 0.6  # difference between the darkest and the brightest corner
DISKS = ((0.36, 0.62, 0.24), (0.62, 0.36, 0.19))  # centers (row, column) and radii of the hole, relative to the side
HOLE_GRAY = 1.0
TEXTURE_SEED, WEAVE_SEED, SCRATCH_SEED = 3, 1, 3


def draw_restore_comparison(pixels: int) -> np.ndarray:
    """Restore squares of `pixels` per side and return a sheet (H, W, 3) of them: a row per texture, a column per split."""
    hole = create_hole(pixels)
    rows, counts = [], []
    for image in create_textures(pixels):
        restored = [run_to_end(restore(image, hole, settings)) for settings in SETTINGS.values()]
        rows.append([np.where(hole[..., None], np.float32(HOLE_GRAY), image), *(result.pixels for result in restored)])
        counts.append(restored[-1].sub_bands)
    title = f"Structure and texture; the default uses {counts[0]} sub-bands above and {counts[1]} below"
    return draw_contact_sheet(title, rows, ["even", "gradient"], [["missing part"], *([name] for name in SETTINGS)])


def create_textures(pixels: int) -> list[np.ndarray]:
    """Return a texture (pixels, pixels, 3) float32, and the same under an intensity gradient from the lower left to the upper right."""
    texture = granite(np.random.default_rng(TEXTURE_SEED), (pixels, pixels))
    texture = TONE + CONTRAST * (texture - texture.mean(axis=(0, 1)))
    y, x = np.mgrid[:pixels, :pixels] / pixels
    gradient = GRADIENT * (0.5 * (x + y) - 0.5)
    return [np.clip(image, 0.0, 1.0).astype(np.float32) for image in (texture, texture + gradient[..., None])]


def create_hole(pixels: int) -> np.ndarray:
    """Return a mask (pixels, pixels) bool of two disks that overlap."""
    y, x = np.mgrid[:pixels, :pixels] / pixels
    return np.any([np.hypot(y - row, x - column) < radius for row, column, radius in DISKS], axis=0)


def create_scratched_weave(pixels: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a weave (pixels, pixels, 3) float32, darker towards one side, with white scratches, and the scratches (pixels, pixels)
    bool."""
    weave = canvas(np.random.default_rng(WEAVE_SEED), (pixels, pixels)) * np.linspace(1.0, 0.5, pixels, dtype=np.float32)[:, None]
    scratches = strokes(np.random.default_rng(SCRATCH_SEED), (pixels, pixels))
    return np.where(scratches[..., None], np.float32(0.95), weave), scratches
