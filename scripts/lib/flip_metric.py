"""The FLIP metric: the perceived difference of two images that are shown alternately, computed by the authors' own program.

Andersson et al.: FLIP: a difference evaluator for alternating images, 2020. `reference_tools` installs the program.
"""

import subprocess
from collections.abc import Sequence

import numpy as np

import reference_tools
from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import FarfieldError
from farfield.addon.core.files.temporary_folders import temporary_folder

PROGRAM = """
import sys
import numpy as np
import flip_evaluator
with np.load(sys.argv[1], allow_pickle=False) as file:
    pairs = [(file[f"reference_{index}"], file[f"image_{index}"]) for index in range(len(file.files) // 2)]
parameters = {"ppd": float(sys.argv[3])} if len(sys.argv) > 3 else {}
maps = [flip_evaluator.evaluate(*pair, "LDR", inputsRGB=True, applyMagma=False, parameters=parameters)[0] for pair in pairs]
np.savez(sys.argv[2], *[np.asarray(map).reshape(pair[0].shape[:2]) for map, pair in zip(maps, pairs)])
"""


def mean_flip(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[float] | None:
    """Return the mean FLIP error of each pair of reference and image (H, W, 3), sRGB values in 0..1, at 67 pixels per degree: 0 if they are
    equal, at most 1. Returns None if the reference tools are not installed.

    Raises:
        FarfieldError: the program fails.
    """
    maps = flip_maps(pairs)
    return None if maps is None else [float(errors.mean(dtype=np.float64)) for errors in maps]


def flip_maps(pairs: Sequence[tuple[np.ndarray, np.ndarray]], pixels_per_degree: float | None = None) -> list[np.ndarray] | None:
    """Return the FLIP error (H, W) in each pixel of each pair, at 67 pixels per degree by default; otherwise as `mean_flip`."""
    python = reference_tools.find_python()
    if python is None:
        return None
    with temporary_folder() as folder:
        path, result = folder / "pairs.npz", folder / "maps.npz"
        arrays = {}
        for index, pair in enumerate(pairs):
            for name, image in zip(("reference", "image"), pair, strict=True):
                arrays[f"{name}_{index}"] = np.ascontiguousarray(image[::-1], np.float32)
        np.savez(path, **arrays)
        options = [] if pixels_per_degree is None else [str(pixels_per_degree)]
        command = [str(python), "-c", PROGRAM, str(path), str(result), *options]
        outcome = subprocess.run(command, capture_output=True, text=True, check=False)
        if outcome.returncode:
            raise FarfieldError(f"The FLIP program failed; reinstall it with scripts/reference_tools.py. {outcome.stderr}")
        with np.load(result, allow_pickle=False) as file:
            return [file[name][::-1] for name in file.files]
