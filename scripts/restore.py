"""Restore the missing parts of an image: `python3 scripts/restore.py IMAGE MASK --out OUT [flags]`.

IMAGE is a PNG, TIFF, JPEG or OpenEXR file; OUT gets the same depth, color profile and alpha, and its other pixels stay as they are. MASK is
an image whose bright pixels are missing, the word `alpha` (pixels with alpha 0 are missing), or a color `#RRGGBB` (pixels of this color are
missing). `tex.<UDIM>.png` stands for all tiles of a texture, `frame_####.png` for all frames of a sequence; OUT then contains the same
placeholder, and MASK and the other images may. `blender --background --python scripts/restore.py -- IMAGE MASK --out OUT` does the same.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from lib import environment

environment.ensure(exits_on_signals=True)
environment.import_farfield()

from farfield.addon.bridge.imaging.image_files import EXTENSIONS
from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.files.file_access import convert_os_errors, resolve_links
from farfield.addon.core.files.temporary_folders import temporary_folder
from farfield.addon.core.jobs.progress import StageClock, Steps, run_to_end, subprogress
from farfield.addon.core.messages import format_count
from farfield.addon.core.restore.settings import MaskSettings, RestoreSettings
from farfield.addon.core.settings import add_flags, check, describe, with_flags
from lib import command_line, run_files
from lib.restore_jobs import ImageJob, list_jobs, publish, restore_image

TOLERANCE = next(item for item in describe(MaskSettings) if item.name == "color_tolerance")


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the script."""
    parser = command_line.Parser(
        prog="restore.py",
        description="Fill the missing parts of an image with structure and texture. --sub-bands without --split implies --split manual.",
    )
    parser.add_argument(
        "image", type=run_files.INPUT, help="a .png, .tif, .jpg or .exr file; name.<UDIM>.png for tiles, name_####.png for frames"
    )
    parser.add_argument("mask", help="an image that is bright where pixels are missing, the word alpha, or a color #RRGGBB")
    written = run_files.OUTPUT.ending_in(*EXTENSIONS)
    parser.add_argument("--out", type=written, required=True, help="the file to write: .png, .tif, .jpg or .exr")
    parser.add_argument(TOLERANCE.flag, default="2%", help="largest difference from the color of MASK, 0 to 100%% (default: 2%%)")
    parser.add_argument("--source-mask", type=run_files.INPUT, help="an image that is bright where texture may be copied from")
    parser.add_argument("--barriers", type=run_files.INPUT, help="an image that is bright where diffusion must not pass")
    parser.add_argument("--data", action="store_true", help="the image is data instead of color, used as it is stored")
    parser.add_argument("--normal-map", action="store_true", help="the image is a normal map: data, and the result is normalized")
    parser.add_argument(
        "--maps", type=run_files.INPUT, nargs="+", default=[], help="further maps of the material, to restore like the image"
    )
    parser.add_argument("--maps-out", type=written, nargs="+", default=[], help="the files to write for --maps, in the same order")
    parser.add_argument("--normals", type=run_files.INPUT, help="the normal map of the material, to restore like the image")
    parser.add_argument("--normals-out", type=written, help="the file to write for --normals")
    parser.add_argument("--stages", type=run_files.IMAGE_FOLDER, help="write images of the stages to this folder, as PNG files")
    parser.add_argument(
        "--curve", type=run_files.OUTPUT.ending_in(".png"), help="draw the curve that decides about --split auto, as a PNG file"
    )
    parser.add_argument("--report", type=run_files.REPORT, help="write a report of the run to this JSON file")
    add_flags(parser, RestoreSettings)
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the script and return the summary; raises FarfieldError if the input is invalid."""
    start = time.perf_counter()
    given = build_parser().parse_args(arguments)
    settings, tolerance = read_settings(given), read_tolerance(str(given.color_tolerance))
    check_flags(given, settings)
    jobs = list_jobs(given)
    for job in jobs:
        job.check(given.files)
    clock = StageClock()
    folder = existing_folder(jobs[0].paths["out"])
    with convert_os_errors(f'Cannot write in "{folder}"'), temporary_folder(folder) as scratch:
        images = run_to_end(restore_images(jobs, given, settings, tolerance, scratch, clock), line.show)
        line.clear()
        with clock.stage("write"):
            publish(jobs, given.stages and given.stages.absolute(), scratch)
    if given.report is not None:
        seconds = clock.seconds | {"total": time.perf_counter() - start}
        command_line.write_report(given.report.absolute(), build_report(images, seconds))
    return summarize(images)


def restore_images(
    jobs: list[ImageJob], given: argparse.Namespace, settings: RestoreSettings, tolerance: float, scratch: Path, clock: StageClock
) -> Steps[list[dict[str, Any]]]:
    """Restore all images one by one and return their parts of the report."""
    images = []
    for index, job in enumerate(jobs):
        steps = restore_image(job, given, settings, tolerance, scratch, clock)
        images.append((yield from subprogress(steps, index / len(jobs), (index + 1) / len(jobs))))
    return images


def read_settings(given: argparse.Namespace) -> RestoreSettings:
    """Return the settings of the flags. A number of sub-bands selects the manual split.

    Raises:
        SettingsError: a flag is invalid.
    """
    if given.sub_bands is not None and given.split is None:
        given.split = "manual"
    return command_line.read_settings(given, RestoreSettings)[RestoreSettings]


def read_tolerance(text: str) -> float:
    """Return the tolerance of colors, 0 to 1, written as a percentage or a fraction.

    Raises:
        SettingsError: it is not.
    """
    try:
        tolerance = TOLERANCE.parse(text)
        check(TOLERANCE, tolerance)
    except SettingsError as error:
        raise with_flags(error) from None
    return tolerance


def check_flags(given: argparse.Namespace, settings: RestoreSettings) -> None:
    """Raise FileError or SettingsError if an output has a wrong extension or contradicts the settings, or cannot be written."""
    if not given.mask.strip():
        raise FileError('The path of MASK is empty; give an image, "alpha" or a color #RRGGBB.')
    if len(given.maps) != len(given.maps_out) or (given.normals is None) != (given.normals_out is None):
        raise SettingsError("--maps and --maps-out must name as many files, and --normals needs --normals-out.")
    if given.curve is not None and settings.split != "auto":
        raise SettingsError("--curve draws what decides about --split auto; leave out --curve or the other split.")


def existing_folder(path: Path) -> Path:
    """Return the folder of `path`, or the nearest folder above it that exists; `path` has been checked to be writable."""
    return next(folder for folder in resolve_links(path).parents if folder.is_dir())


def build_report(images: list[dict[str, Any]], seconds: dict[str, float]) -> dict[str, Any]:
    """Return the report of the run: the figures of a single image, or the sums and the figures of each."""
    single = {key: figure for key, figure in images[0].items() if key != "image"}
    totals = {key: sum(image[key] for image in images) for key in ("masked_pixels", "holes")}
    return {
        **(single if len(images) == 1 else totals),
        "images": images,
        "seconds": {stage: round(duration, 4) for stage, duration in seconds.items()},
        "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
    }


def summarize(images: list[dict[str, Any]]) -> str:
    """Return one sentence about the result."""
    pixels, holes = (sum(image[key] for image in images) for key in ("masked_pixels", "holes"))
    what = "" if len(images) == 1 else f" of {len(images)} images"
    remarks = dict.fromkeys(remark for image in images for remark in image["remarks"])
    return " ".join([f"Restored {format_count(pixels, 'pixel')} in {format_count(holes, 'hole')}{what}.", *remarks])


if __name__ == "__main__":
    command_line.run(main)
