"""Worker process of `campaign_files.py`: runs a tool on each public file and compares what it reads or writes with a reference.

python3 benchmarks/campaign_file_worker.py SPECIFICATION.json
"""

import json
import os
import shutil
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()
sys.path.append(str(environment.ROOT / "tests"))

import campaign_checks
import campaign_surfaces
import numpy as np
from campaign_commands import CommandCase
from campaign_runs import BUILD_FLAGS
from campaign_worker import MAX_TEXT, add_leftovers, as_pairs, captured, limit_memory, run_script
from PIL import Image

from farfield.addon.bridge.imaging.image_files import EXTENSIONS as IMAGE_EXTENSIONS
from farfield.addon.bridge.imaging.image_files import read_image_size
from farfield.addon.bridge.imaging.images import read_gray_image
from farfield.addon.core.bdam import FieldSettings, open_field
from farfield.addon.core.bdam.fields.terrain_field import warn_of_heights
from farfield.addon.core.clipbox.files.readers import read_heights
from farfield.addon.core.errors import FarfieldError
from farfield.addon.core.photos.importers import read_camera_file

REFERENCES = "FARFIELD_REFERENCES"  # names the Python that has other programs' readers
LEVEL_FLAGS = ("--ratios", "0.5", "--views", "6")
TERRAIN_FLAGS = ("--resolution", "32", "--boxes", "6", "--voxel-size", "2")
WHITE = 1.0  # height of a white pixel as `read_heights` returns it
PHOTO_FLAGS = ("--size", "256")
VOLUMES = (".vdb", ".nii", ".raw")
POINTS = 200  # that are projected by all cameras
Values = dict[str, Any]


def main() -> None:
    content = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    sandbox, jobs = Path(content["sandbox"]), json.loads((Path(content["sandbox"]) / "jobs.json").read_text(encoding="utf-8"))
    limit_memory(content["memory_gb"])
    with Path(content["log"]).open("a", encoding="utf-8", buffering=1) as log:
        for index in content["cases"]:
            log.write(json.dumps({"case": index, "event": "start"}) + "\n")
            start = time.monotonic()
            result = run_job(jobs[index]["tool"], Path(jobs[index]["path"]), sandbox)
            fields = {"case": index, "event": "end", **result, "seconds": round(time.monotonic() - start, 2)}
            log.write(json.dumps(fields) + "\n")
    os._exit(0)  # Blender 4.5 hangs during shutdown


def run_job(tool: str, path: Path, sandbox: Path) -> dict[str, Any]:
    """Run one tool on one file and return what happened."""
    folder = sandbox / "jail" / "case"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    os.chdir(folder)
    os.environ["PWD"] = str(folder)  # Blender prefers it to the working directory
    try:
        before, names = path.stat(), _names(path.parent)
        script, arguments = ARGUMENTS[tool](path, folder)
        state = campaign_checks.read_state(folder)
        with captured(sandbox) as texts:
            code = run_script(CommandCase(script, arguments))
        problems = campaign_checks.check_messages(code, *texts, interrupted=False)
        if code != 0 and campaign_checks.read_state(folder) != state:
            problems.append(campaign_checks.Problem("left behind", " ".join(_names(folder))))
        after = path.stat()
        if (before.st_mtime_ns, before.st_size) != (after.st_mtime_ns, after.st_size) or names != _names(path.parent):
            problems.append(campaign_checks.Problem("input changed", str(path)))
        problems = add_leftovers(problems, sandbox)
        for log in (sandbox / "tmp").glob("*.log"):
            log.unlink()  # A defect is reported with its own file only.
        result = {"kind": "script", "code": code, "stdout": texts[0][-MAX_TEXT:], "stderr": texts[1][-MAX_TEXT:]}
        if (code == 0 or tool == "photos") and tool in COMPARISONS:  # cameras also without their photographs
            with captured(sandbox), suppress(FarfieldError):
                result["comparison"] = COMPARISONS[tool](path, folder)
        return result | {"problems": as_pairs(problems)}
    except Exception:  # noqa: BLE001 a defect of the campaign must not end it
        return {"kind": "campaign", "problems": [("campaign", traceback.format_exc()[-MAX_TEXT:])]}


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def _restore_arguments(path: Path, folder: Path) -> tuple[str, list[str]]:
    """Return arguments with a mask of a rectangle in the middle of the image."""
    try:
        width, height = read_image_size(path)
    except FarfieldError:
        width, height = 16, 16
    mask = np.zeros((height, width), bool)
    sides = [max(1, min(12, side // 5)) for side in (height, width)]
    mask[tuple(slice((total - side) // 2, (total - side) // 2 + side) for total, side in zip((height, width), sides, strict=True))] = True
    np.save(folder / "mask.npy", mask)
    Image.fromarray(mask.astype(np.uint8) * 255).save(folder / "mask.png")
    return "restore", [str(path), str(folder / "mask.png"), "--out", str(_restored(path, folder))]


def _restored(path: Path, folder: Path) -> Path:
    return folder / f"out{path.suffix if path.suffix.lower() in IMAGE_EXTENSIONS else '.png'}"


def _terrain_arguments(path: Path, folder: Path) -> tuple[str, list[str]]:
    """Return arguments with a viewer on the ground."""
    arguments = ["--source", str(path), "--out", str(folder / "out.ply"), *TERRAIN_FLAGS]
    if path.suffix.lower() in VOLUMES:
        return "clipbox", ["--terrain", "volume", *arguments]
    try:
        heights = read_heights(path, read_gray_image).heights
        height = float(np.median(heights[np.isfinite(heights)])) if np.isfinite(heights).any() else 0.0
    except FarfieldError:
        height = 0.0
    return "clipbox", ["--terrain", "heights", f"--at=0,0,{height:.6f}", *arguments]


def _photo_arguments(path: Path, folder: Path) -> tuple[str, list[str]]:
    """Return arguments for cameras next to a mesh and photographs, as in ../shared/data."""
    place = next((parent for parent in path.parents if (parent / "images").is_dir()), path.parent)
    mesh = next((mesh for mesh in (place / "plane.obj", *sorted(place.glob("*.ply"))) if mesh.exists()), place / "none.obj")
    arguments = [str(mesh), "--cameras", str(path), "--images", str(place / "images"), "--texture", str(folder / "out.png")]
    return "photos", [*arguments, *PHOTO_FLAGS]


ARGUMENTS: dict[str, Callable[[Path, Path], tuple[str, list[str]]]] = {
    "texmesh": lambda path, folder: ("texmesh", ["levels", str(path), "--out", str(folder / "out.glb"), *LEVEL_FLAGS]),
    "unwrap": lambda path, folder: ("unwrap", [str(path), "--out", str(folder / "out.glb")]),
    "billboards": lambda path, folder: ("billboards", [str(path), "--out", str(folder / "out.blend"), *BUILD_FLAGS]),
    "bdam": lambda path, folder: ("bdam", ["build", str(path), "--out", str(folder / "store")]),
    "clipbox": _terrain_arguments,
    "restore": _restore_arguments,
    "photos": _photo_arguments,
}


def _compare_levels(path: Path, folder: Path) -> Values:
    """Compare level 0 with the file."""
    expected = campaign_surfaces.read_surface(path, None)
    return campaign_surfaces.compare(expected, campaign_surfaces.read_surface(folder / "out-L0.glb", expected.bounds))


def _compare_unwrapped(path: Path, folder: Path) -> Values:
    expected = campaign_surfaces.read_surface(path, None, renders=False)
    return campaign_surfaces.compare(expected, campaign_surfaces.read_surface(folder / "out.glb", expected.bounds, renders=False))


def _compare_store(path: Path, folder: Path) -> Values:
    """Compare the heights that a store is built from."""
    field = warn_of_heights(open_field([path], FieldSettings(), read_gray_image))
    rows, columns = field.shape
    np.save(folder / "heights.npy", field.read(slice(0, rows), slice(0, columns)))
    step = list(field.placement.step) if field.placement.is_placed else None
    return _query(
        kind="heights",
        path=str(path),
        heights=str(folder / "heights.npy"),
        step=step,
        white=FieldSettings().image_height if field.mosaic.sources[0].is_gray else None,
    ) | {"warnings": list(field.warnings)}


def _compare_heights(path: Path, folder: Path) -> Values:
    """Compare the heights that boxes are built from; their spacing in meters has no counterpart elsewhere."""
    found = read_heights(path, read_gray_image)
    np.save(folder / "heights.npy", found.heights)
    return _query(
        kind="heights", path=str(path), heights=str(folder / "heights.npy"), step=None, white=WHITE if found.pixel_size is None else None
    ) | {"warnings": list(found.warnings)}


def _compare_pixels(path: Path, folder: Path) -> Values:
    return _query(kind="image", path=str(path), out=str(_restored(path, folder)), mask=str(folder / "mask.npy"))


def _compare_projections(path: Path, folder: Path) -> Values:
    """Compare the projections of points around the cameras."""
    cameras = read_camera_file(path, lambda _: (640, 480)).cameras
    centers = np.array([camera.position for camera in cameras])
    spread = max(float(np.ptp(centers, axis=0).max()), 1.0)
    points = centers.mean(axis=0) + np.random.default_rng(1).normal(size=(POINTS, 3)) * spread
    np.save(folder / "points.npy", points)
    found = []
    for camera in cameras:
        positions, _, is_valid = camera.project(points)
        found.append(np.where(is_valid[:, None], positions, np.nan))
    np.save(folder / "projections.npy", np.array(found))
    names = [camera.name for camera in cameras]
    files = {"points": str(folder / "points.npy"), "projections": str(folder / "projections.npy")}
    return _query(kind="cameras", path=str(path), names=names, **files)


COMPARISONS: dict[str, Callable[[Path, Path], Values]] = {
    "texmesh": _compare_levels,
    "unwrap": _compare_unwrapped,
    "bdam": _compare_store,
    "clipbox": _compare_heights,
    "restore": _compare_pixels,
    "photos": _compare_projections,
}


@cache
def _references() -> subprocess.Popen:
    script = Path(__file__).with_name("campaign_references.py")
    return subprocess.Popen(
        [os.environ.get(REFERENCES) or sys.executable, str(script)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )


def _query(**request: Any) -> Values:
    """Return the answer of the reference readers. Without one for this file it only tells why."""
    process = _references()
    process.stdin.write(json.dumps(request) + "\n")
    process.stdin.flush()
    line = process.stdout.readline()
    if not line:
        _references.cache_clear()
        return {"no_reference": "the reference reader crashed"}
    return json.loads(line)


if __name__ == "__main__":
    main()
