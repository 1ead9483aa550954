"""The images of one run of `restore.py`: their paths, the restoration of each, and its outputs, which appear when all of them are done."""

import argparse
import shutil
from dataclasses import dataclass
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.imaging.image_files import read_image_file, write_image_file
from farfield.addon.bridge.imaging.image_storage import ImageFile
from farfield.addon.core.errors import FileError, ImageError
from farfield.addon.core.files.file_access import check_readable
from farfield.addon.core.files.outputs import Input, Output
from farfield.addon.core.jobs.progress import StageClock, Steps
from farfield.addon.core.restore.frequency_split import MAX_DEVIATION
from farfield.addon.core.restore.restoration import Restoration, restore
from farfield.addon.core.restore.settings import RestoreSettings
from lib.atomic_output import atomic_file, atomic_folder
from lib.contact_sheet import write_png
from lib.kappa_chart import draw_kappa_chart
from lib.numbered_files import find_numbers, find_placeholder, numbered_path
from lib.restore_masks import is_mask_file, masked_pixels, read_mask
from lib.run_files import RunFiles
from lib.script_stdout import mute_stderr

BAND_PREFIX = "high"  # Stages with this prefix have the mean 0 and are shown around middle gray.
NORMAL_CHANNELS = 3
INPUTS = {  # and names in messages
    "image": "the image",
    "mask": "the mask",
    "source_mask": "--source-mask",
    "barriers": "--barriers",
    "maps": "--maps",
    "normals": "--normals",
}
MASKS = {"mask": "mask", "source_mask": "source mask", "barriers": "barrier mask"}  # and names in messages
OUTPUTS = {"out": "--out", "curve": "--curve", "maps_out": "--maps-out", "normals_out": "--normals-out"}


@dataclass(frozen=True)
class ImageJob:
    """One image to restore.

    number: of the tile or frame, None for a single image. paths: absolute paths by the names of the arguments, those of lists with a number
    behind, without those that were not given. mask_rule: the word for alpha or the color that selects missing pixels, None for a mask in a
    file.
    """

    number: int | None
    paths: dict[str, Path]
    mask_rule: str | None

    def check(self, files: RunFiles) -> None:
        """Raise FileError if an input cannot be read, or an output cannot be written or would replace another file of the run."""
        inputs = [(INPUTS[_argument(name)], path) for name, path in self.paths.items() if _argument(name) in INPUTS]
        for _, path in inputs:
            check_readable(path)
        if self.number is None:  # the arguments have been checked, but for the mask, which may also be a word
            files.check(inputs=[Input(INPUTS["mask"], self.paths["mask"])] if "mask" in self.paths else [])
        else:
            outputs = [Output(f'{OUTPUTS[_argument(name)]} "{path.name}"', path) for name, path in self.outputs().items()]
            files.check(outputs, [Input(f'{name} "{path.name}"', path) for name, path in inputs])

    def outputs(self) -> dict[str, Path]:
        """Return the paths of the files to write, the result last: the others may still fail."""
        paths = {name: path for name, path in self.paths.items() if _argument(name) in OUTPUTS}
        return {name: path for name, path in paths.items() if name != "out"} | {"out": paths["out"]}

    def further_maps(self) -> list[tuple[Path, str]]:
        """Return the paths of the further maps of the material, the normal map last, and the names of their outputs."""
        names = sorted((name for name in self.paths if _argument(name) in ("maps", "normals")), key=lambda name: name == "normals")
        return [(self.paths[name], name.replace(_argument(name), f"{_argument(name)}_out")) for name in names]

    def scratch_path(self, name: str, scratch: Path) -> Path:
        """Return where the output `name` is kept until all images are done; it has the file name that it will get."""
        folder = scratch / f"{name}-{self.number}"
        folder.mkdir(exist_ok=True)
        return folder / self.paths[name].name


def _argument(name: str) -> str:
    """Return the name of an argument without the number of a path of a list."""
    return name.rstrip("0123456789")


def list_jobs(given: argparse.Namespace) -> list[ImageJob]:
    """Return the images of the command line: one, or all existing tiles or frames.

    Raises:
        FileError: there is none, or an output lacks the placeholder of the image.
    """
    is_file = is_mask_file(given.mask)
    paths = {name: getattr(given, name) for name in (*INPUTS, *OUTPUTS) if name != "mask"} | {"mask": Path(given.mask) if is_file else None}
    for name in ("maps", "maps_out"):
        paths |= {f"{name}{index}": path for index, path in enumerate(paths.pop(name))}
    paths = {name: path.absolute() for name, path in paths.items() if path is not None}
    rule = None if is_file else given.mask
    placeholder = find_placeholder(paths["image"])
    if placeholder is None:
        return [ImageJob(None, paths, rule)]
    placeholders = {name: placeholder if placeholder in path.name else find_placeholder(path) for name, path in paths.items()}
    for name in paths:
        if _argument(name) in OUTPUTS and placeholders[name] is None:
            raise FileError(f'{OUTPUTS[_argument(name)]} is "{paths[name]}" for several images; put {placeholder} into its name.')
    return [
        ImageJob(
            number,
            {name: path if placeholders[name] is None else numbered_path(path, placeholders[name], number) for name, path in paths.items()},
            rule,
        )
        for number in find_numbers(paths["image"], placeholder)
    ]


def restore_image(
    job: ImageJob, given: argparse.Namespace, settings: RestoreSettings, tolerance: float, scratch: Path, clock: StageClock
) -> Steps[dict[str, Any]]:
    """Restore one image, write its outputs to the folder `scratch`, and return its part of the report.

    A tile or frame without missing pixels is written as it is; `restore` refuses a single image without any.

    Raises:
        FileError: a file cannot be read, or an output cannot be written.
        ImageError: the image or a mask is unusable; the message names the image.
    """
    path = job.paths["image"]
    with clock.stage("read"), mute_stderr():  # libraries print what is wrong with a file
        image = read_image_file(path, is_color=not (given.data or given.normal_map))
        if given.normal_map and image.pixels.shape[2] < NORMAL_CHANNELS:
            raise ImageError(f'"{path}" has {image.pixels.shape[2]} channels and a normal map 3; leave out --normal-map.')
        maps = [image, *(_read_map(further, image, path) for further, _ in job.further_maps())]
        starts = list(accumulate((each.pixels.shape[2] for each in maps), initial=0))
        remarks: list[str] = []
        mask, source_mask, barriers = (_read_mask(job, name, image, remarks) for name in MASKS)
        if mask is None:
            mask = masked_pixels(job.mask_rule, image, path, tolerance)
    restoration = None
    if job.number is None or mask.any():
        try:
            restoration = yield from restore(
                np.concatenate([each.pixels for each in maps], axis=2) if len(maps) > 1 else image.pixels,
                mask,
                settings,
                source_mask=source_mask,
                barriers=barriers,
                is_color=image.is_color,
                further_maps=tuple(starts[1:-1]),
                normal_channels=(*((0,) if given.normal_map else ()), *((starts[-2],) if given.normals else ())),
                keep_stages=given.stages is not None,
            )
        except ImageError as error:
            raise ImageError(f'"{path}": {error}') from error
        for stage, seconds in restoration.seconds.items():
            clock.seconds[stage] = clock.seconds.get(stage, 0.0) + seconds
    with clock.stage("write"), mute_stderr():
        for each, name, (start, stop) in zip(maps, ["out", *(name for _, name in job.further_maps())], pairwise(starts), strict=True):
            pixels = each.pixels if restoration is None else restoration.pixels[..., start:stop]
            write_image_file(job.scratch_path(name, scratch), pixels, each, mask)
        if restoration is not None:
            _write_stages(job, restoration, scratch)
            if "curve" in job.paths:
                write_png(
                    job.scratch_path("curve", scratch), draw_kappa_chart(restoration.deviations, restoration.sub_bands, MAX_DEVIATION)
                )
    return _figures(path, image, mask, restoration) | {"remarks": remarks}


def _read_map(path: Path, image: ImageFile, image_path: Path) -> ImageFile:
    """Return a further map of the material of `image`, as data. Raises ImageError if its size differs."""
    found = read_image_file(path, is_color=False)
    (height, width), expected = found.pixels.shape[:2], image.pixels.shape[:2]
    if (height, width) != expected:
        raise ImageError(
            f'"{path}" has {width} x {height} pixels and "{image_path}" {expected[1]} x {expected[0]}; they must have the same size.'
        )
    return found


def _read_mask(job: ImageJob, name: str, image: ImageFile, remarks: list[str]) -> np.ndarray | None:
    """Return a mask (H, W) bool by its name in MASKS, None if it is no file. Adds to the `remarks` of the image."""
    if name not in job.paths:
        return None
    mask, remark = read_mask(job.paths[name], image, job.paths["image"], MASKS[name])
    remarks += [remark] if remark else []
    return mask


def _figures(path: Path, image: ImageFile, mask: np.ndarray, restoration: Restoration | None) -> dict[str, Any]:
    """Return the part of the report about one image. kappa is None where all sub-bands are structure, or nothing was missing."""
    height, width, channels = image.pixels.shape
    kappa = None if restoration is None or restoration.sub_bands < 0 else restoration.sub_bands
    return {
        "image": path.name,
        "size": [width, height],
        "channels": channels,
        "depth": image.depth,
        "masked_pixels": int(mask.sum()),
        "holes": 0 if restoration is None else restoration.hole_count,
        "kappa": kappa,
    }


def _write_stages(job: ImageJob, restoration: Restoration, scratch: Path) -> None:
    """Write the images of the stages as PNG, those of a tile or frame with its number in front."""
    folder = scratch / "stages"
    folder.mkdir(exist_ok=True)
    prefix = "" if job.number is None else f"{job.number:04d}_"
    for name, stage in restoration.stages.items():
        shown = stage[..., :3] + 0.5 if name.startswith(BAND_PREFIX) else stage[..., :3]
        write_png(folder / f"{prefix}{name}.png", np.broadcast_to(shown if shown.shape[2] == 3 else shown[..., :1], (*shown.shape[:2], 3)))


def publish(jobs: list[ImageJob], stages: Path | None, scratch: Path) -> None:
    """Move all outputs from the folder `scratch` to their paths.

    Raises:
        FileError: one cannot be written.
    """
    names = sorted(path.name for path in (scratch / "stages").iterdir()) if (scratch / "stages").is_dir() else []
    if names:
        _publish_folder(stages, scratch / "stages", names)
    for name in jobs[0].outputs():
        for job in jobs:
            source = job.scratch_path(name, scratch)
            if source.is_file():
                with atomic_file(job.paths[name]) as temporary:
                    shutil.move(source, temporary)


def _publish_folder(target: Path, source: Path, names: list[str]) -> None:
    """Move the files `names` from the folder `source` to the folder `target`, which is created with them if it does not exist."""
    if not target.exists():
        with atomic_file(target) as temporary:
            shutil.move(source, temporary)
        return
    with atomic_folder(target) as temporary:
        for name in names:
            shutil.move(source / name, temporary / name)
