"""The FLIP metric: the perceived difference of two images that are shown alternately, computed by the authors' own program.

Andersson et al.: FLIP: a difference evaluator for alternating images, 2020. `reference_tools` installs the program.
"""

import json
import subprocess
from collections.abc import Sequence

import numpy as np

import reference_tools
from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import FarfieldError
from farfield.addon.core.files.temporary_folders import temporary_folder

PROGRAM = """
import json, sys
import numpy as np
import flip_evaluator
with np.load(sys.argv[1], allow_pickle=False) as file:
    pairs = [(file[f"reference_{index}"], file[f"image_{index}"]) for index in range(len(file.files) // 2)]
errors = [flip_evaluator.evaluate(*pair, "LDR", inputsRGB=True, applyMagma=False)[1] for pair in pairs]
print(json.dumps([float(error) for error in errors]))
"""


def mean_flip(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[float] | None:
    """Return the mean FLIP error of each pair of reference and image (H, W, 3), sRGB values in 0..1, at 67 pixels per degree: 0 if they are
    equal, at most 1. Returns None if the reference tools are not installed.

    Raises:
        FarfieldError: the program fails.
    """
    python = reference_tools.find_python()
    if python is None:
        return None
    with temporary_folder() as folder:
        path = folder / "pairs.npz"
        arrays = {}
        for index, pair in enumerate(pairs):
            for name, image in zip(("reference", "image"), pair, strict=True):
                arrays[f"{name}_{index}"] = np.ascontiguousarray(image[::-1], np.float32)
        np.savez(path, **arrays)
        outcome = subprocess.run([str(python), "-c", PROGRAM, str(path)], capture_output=True, text=True, check=False)
    if outcome.returncode:
        raise FarfieldError(f"The FLIP program failed; reinstall it with scripts/reference_tools.py. {outcome.stderr}")
    return json.loads(outcome.stdout.splitlines()[-1])
