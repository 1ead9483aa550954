"""Other programs that fill missing parts of images, for `bench_restore.py`. Runs in the environment of the reference tools.

Reads requests from the standard input, one JSON object per line, and answers each with one line of JSON:

    {"method": NAME, "input": FILE.npz, "output": FILE.npy}    fills `image` (H, W, 3) uint8 where `mask` (H, W) bool is set
    {"read": FILE, "output": FILE.npy}                         reads an image; `skimage:NAME` is one of scikit-image

Arrays have row 0 at the top. The answer has the seconds of a restoration without input and output, or an error.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import imageio.v3
import numpy as np
import patchmatch
import skimage
from skimage.restoration import inpaint_biharmonic

Restore = Callable[[np.ndarray, np.ndarray], np.ndarray]


def with_opencv(flag: int, radius: float) -> Restore:
    """Return a call of `cv2.inpaint`."""
    return lambda image, mask: cv2.inpaint(image, mask.astype(np.uint8), radius, flag)


def with_xphoto(flag: int) -> Restore:
    """Return a call of `cv2.xphoto.inpaint`, whose masks are zero where pixels are missing."""

    def restore(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
        result = np.zeros_like(image)
        cv2.xphoto.inpaint(image, np.where(mask, 0, 255).astype(np.uint8), result, flag)
        return result

    return restore


def with_shift_map(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Call the shift map of `cv2.xphoto.inpaint`, which expects CIELAB."""
    restored = with_xphoto(cv2.xphoto.INPAINT_SHIFTMAP)(cv2.cvtColor(image, cv2.COLOR_RGB2LAB), mask)
    return cv2.cvtColor(restored, cv2.COLOR_LAB2RGB)


def with_biharmonic(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Call scikit-image, one hole after the other: it solves all of them as one dense system otherwise."""
    restored = inpaint_biharmonic(image, mask, split_into_regions=True, channel_axis=-1)
    return np.clip(np.rint(restored * 255.0), 0, 255).astype(np.uint8)


def with_patchmatch(radius: int) -> Restore:
    """Return a call of PyPatchMatch with patches of this radius, whose sides are twice as long and a pixel more."""

    def restore(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
        patchmatch.set_random_seed(0)
        return patchmatch.inpaint(image, mask, patch_size=radius)

    return restore


METHODS = {
    "telea": with_opencv(cv2.INPAINT_TELEA, 3.0),
    "telea-10": with_opencv(cv2.INPAINT_TELEA, 10.0),
    "navier-stokes": with_opencv(cv2.INPAINT_NS, 3.0),
    "navier-stokes-10": with_opencv(cv2.INPAINT_NS, 10.0),
    "biharmonic": with_biharmonic,
    "fsr": with_xphoto(cv2.xphoto.INPAINT_FSR_BEST),
    "shift-map": with_shift_map,
    "patchmatch-7": with_patchmatch(3),
    "patchmatch-15": with_patchmatch(7),
}


def answer(request: dict[str, str]) -> dict[str, float | str]:
    """Do what one request asks."""
    if "read" in request:
        name = request["read"]
        path = Path(skimage.__file__).parent / "data" / name.removeprefix("skimage:") if name.startswith("skimage:") else Path(name)
        np.save(request["output"], imageio.v3.imread(path))
        return {}
    with np.load(request["input"], allow_pickle=False) as file:
        image, mask = file["image"], file["mask"]
    image[mask] = 0
    started = time.perf_counter()
    try:
        restored = METHODS[request["method"]](image, mask)
    except (cv2.error, MemoryError, RuntimeError, ValueError) as error:
        return {"error": f"{type(error).__name__}: {error}"}
    seconds = time.perf_counter() - started
    np.save(request["output"], restored)
    return {"seconds": seconds}


def main() -> None:
    """Answer requests until the standard input ends."""
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
