"""How different two pictures look to people who flip between them: FLIP, by its authors' own program.

(Andersson et al.: FLIP: a difference evaluator for alternating images, 2020.) It stands in the environment of the peers.
"""

import json
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import environment
import peers

environment.import_farfield()

from farfield.addon.core.errors import FarfieldError

PROGRAM = """
import json, sys
import numpy as np
import flip_evaluator
with np.load(sys.argv[1], allow_pickle=False) as file:
    pairs = [(file[f"reference_{number}"], file[f"picture_{number}"]) for number in range(len(file.files) // 2)]
errors = [flip_evaluator.evaluate(*pair, "LDR", inputsRGB=True, applyMagma=False)[1] for pair in pairs]
print(json.dumps([float(error) for error in errors]))
"""


def mean_flip(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[float] | None:
    """Mean FLIP error of each pair of reference and picture (H, W, 3), sRGB values in 0..1, as seen at 67 pixels a degree: 0 when they are
    equal, at most 1. None where the environment of the peers does not stand.

    Raises:
        FarfieldError: when the program fails.
    """
    python = peers.python()
    if python is None:
        return None
    with tempfile.TemporaryDirectory(prefix="farfield-flip-") as folder:
        path = Path(folder) / "pairs.npz"
        arrays = {}
        for number, pair in enumerate(pairs):
            for name, picture in zip(("reference", "picture"), pair, strict=True):
                arrays[f"{name}_{number}"] = np.ascontiguousarray(picture[::-1], np.float32)
        np.savez(path, **arrays)
        outcome = subprocess.run([str(python), "-c", PROGRAM, str(path)], capture_output=True, text=True, check=False)
    if outcome.returncode:
        raise FarfieldError(f"The program that measures FLIP failed; make its environment anew with scripts/peers.py. {outcome.stderr}")
    return json.loads(outcome.stdout.splitlines()[-1])
