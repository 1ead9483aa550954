"""Screenshots of the panels in a real Blender window, for the docs: `python3 docs/screenshots.py [--out DIR] [--tool TOOL ...] [--all]`.

Needs `../shared/tools/blender-gui`. Writes the images that the pages show to docs/pictures; with --all, every panel in both themes to DIR.
"""

import argparse
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parent / "scripts"))

from lib import environment

environment.ensure()

import itertools
import json

import bpy
import numpy as np
from figures.restore_comparison import create_scratched_weave

from lib import blender_window, command_line
from lib.contact_sheet import write_png

SIZES = {"closed": (1280, 720), "open": (1280, 1400)}  # The size of the window, by the state of the sub-panels.
SIZES_BY_TOOL = {  # The tools whose windows have other sizes.
    "restore": {"closed": (960, 660), "open": (960, 1400)},  # whose screenshots show the image as well
    "bdam": {"closed": (1280, 1130), "open": (1280, 1700)},
    "texmesh": {"closed": (1280, 860), "open": (1280, 1700)},
}
RESTORE_PIXELS = 400
TOOLS = ("billboards", "btf", "unwrap", "restore", "photos", "clipbox", "bdam", "texmesh", "packages")
SECONDS = 200
DRIVER = FOLDER / "figures" / "window_screenshots.py"
PAGES = {  # image of the docs -> screenshots side by side
    "quick_start.png": ("billboards-settings", "billboards-levels"),
    "panel_btf.png": ("btf-settings", "btf-baked"),
    "panel_unwrap.png": ("unwrap-settings", "unwrap-figures"),
    "panel_restore.png": ("restore-mask", "restore-result"),
    "panel_photos.png": ("photos-mesh", "photos-photographs"),
    "panel_clipbox.png": ("clipbox-settings", "clipbox-active"),
    "panel_bdam.png": ("bdam-settings", "bdam-loaded"),
    "panel_texmesh.png": ("texmesh-settings", "texmesh-levels"),
    "panel_packages.png": ("packages-settings",),
    "window.png": ("window",),
}
GAP = 12  # pixels between two screenshots


def read_image(path: Path) -> np.ndarray:
    """Return the sRGB values (H, W, 3) of a PNG, row 0 at the bottom."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.is_data = True
    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)[..., :3]


def crop(image: np.ndarray, box: tuple[int, int, int, int]) -> np.ndarray:
    """Return the part `box` (x, y, width, height; from the lower left) of `image` (H, W, 3)."""
    x, y, width, height = box
    return image[y : y + height, x : x + width]


def side_by_side(images: list[np.ndarray]) -> np.ndarray:
    """Return `images` (H, W, 3) in a row on white, aligned at the top."""
    height = max(len(image) for image in images)
    columns = []
    for image in images:
        column = np.ones((height, image.shape[1], 3), np.float32)
        column[height - len(image) :] = image
        columns += [column, np.ones((height, GAP, 3), np.float32)]
    return np.concatenate(columns[:-1], axis=1)


def take_screenshots(subpanels: str, tool: str) -> dict[str, np.ndarray]:
    """Return the screenshots (H, W, 3) of the panel of `tool` by name, with sub-panels "open" or "closed"."""
    with tempfile.TemporaryDirectory() as scratch:
        resources, folder = Path(scratch, "resources"), Path(scratch, "screenshots")
        folder.mkdir()
        blender_window.install(resources)
        if tool in ("restore", "photos"):
            weave, scratches = create_scratched_weave(RESTORE_PIXELS)
            write_png(folder / "weave.png", weave)
            write_png(folder / "mask.png", np.repeat(scratches[..., None].astype(np.float32), 3, axis=2))
        size = SIZES_BY_TOOL.get(tool, SIZES)[subpanels]
        log = blender_window.run(resources, DRIVER, [folder, subpanels, tool], size=size, seconds=SECONDS)
        index = folder / "index.json"
        if not index.exists():
            sys.exit(f"Blender ended with {log.returncode} and left no screenshots:\n{log.stdout[-3000:]}\n{log.stderr[-3000:]}")
        report = json.loads(index.read_text(encoding="utf-8"))
        if report["error"]:
            sys.exit(report["error"])
        return {name: crop(read_image(folder / f"{name}.png"), box) for name, box in report["boxes"].items()}


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=FOLDER / "pictures", help="folder of the images (default: docs/pictures)")
    parser.add_argument("--tool", nargs="+", choices=TOOLS, default=TOOLS, help="tools whose panels to show (default: all)")
    parser.add_argument("--all", action="store_true", help="write every screenshot in both themes instead of the images of the docs")
    given = parser.parse_args(arguments)
    reason = blender_window.unavailable_reason()
    if reason:
        sys.exit(f"No screenshots: {reason}.")
    images = {}
    for subpanels, tool in itertools.product(SIZES if given.all else ("closed",), given.tool):
        images |= {f"{name}-{subpanels}": image for name, image in take_screenshots(subpanels, tool).items()}
    given.out.mkdir(parents=True, exist_ok=True)
    if given.all:
        for name, image in images.items():
            write_png(given.out / f"{name}.png", image)
    else:
        for name, parts in PAGES.items():
            if f"{parts[0]}-dark-closed" in images:
                write_png(given.out / name, side_by_side([images[f"{part}-dark-closed"] for part in parts]))
    return f"screenshots in {given.out}"


if __name__ == "__main__":
    command_line.run(main)
