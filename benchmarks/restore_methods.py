"""The methods that `bench_restore.py` compares: Farfield with several settings, and the peers, which run in a process of their own."""

import json
import select
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np

import reference_tools
from farfield.addon.core.errors import FarfieldError
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.restore.restoration import restore
from farfield.addon.core.restore.settings import RestoreSettings

FARFIELD = {  # settings by the name of the method
    "farfield": RestoreSettings(),
    "kappa-0": RestoreSettings(split="manual", sub_bands=0),
    "diffusion": RestoreSettings(split="diffusion"),
}
DIFFUSION_PEERS = ("telea", "telea-10", "navier-stokes", "navier-stokes-10", "biharmonic")
PATCH_PEERS = ("shift-map", "patchmatch-7", "patchmatch-15")
PEERS = (*DIFFUSION_PEERS, "fsr", *PATCH_PEERS)  # fsr extrapolates frequencies: neither of the two


class Restored(NamedTuple):
    """A restored image (H, W, C) float32 of 8-bit values, None after an error; the seconds, the kappa of Farfield, and the error."""

    image: np.ndarray | None
    seconds: float = 0.0
    kappa: int | None = None
    error: str | None = None


class Methods:
    """Runs methods by name. The process of the peers starts on first use; it is stopped if an answer takes more than `timeout` seconds."""

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self._folder = tempfile.TemporaryDirectory(prefix="farfield-benchmark-")
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self._stop()
        self._folder.cleanup()

    def run(self, method: str, image: np.ndarray, mask: np.ndarray) -> Restored:
        """Restore `image` (H, W, C) float32 of 8-bit values where `mask` (H, W) is set."""
        if method in FARFIELD:
            return restore_with(FARFIELD[method], image, mask)
        folder = Path(self._folder.name)
        values = np.rint(np.broadcast_to(image, (*image.shape[:2], 3))[::-1] * 255.0).astype(np.uint8)
        np.savez(folder / "input.npz", image=values, mask=mask[::-1])
        answer = self._ask({"method": method, "input": str(folder / "input.npz"), "output": str(folder / "output.npy")})
        if "error" in answer:
            return Restored(None, error=answer["error"])
        restored = np.load(folder / "output.npy", allow_pickle=False)[::-1].astype(np.float32) / 255.0
        if image.shape[2] == 1:
            restored = restored.mean(axis=2, keepdims=True)
        return Restored(np.where(mask[..., None], restored, image), answer["seconds"])

    def read(self, path: str) -> np.ndarray:
        """Read a photograph: (H, W, C) float32 in 0..1, row 0 at the bottom.

        Raises:
            FarfieldError: the file cannot be read.
        """
        output = Path(self._folder.name) / "output.npy"
        answer = self._ask({"read": path, "output": str(output)})
        if "error" in answer:
            raise FarfieldError(f'Cannot read "{path}": {answer["error"]}.')
        pixels = np.load(output, allow_pickle=False)[::-1].astype(np.float32) / 255.0
        return pixels[..., None] if pixels.ndim == 2 else pixels

    def _ask(self, request: dict[str, str]) -> dict[str, float | str]:
        """Send a request to the peers and wait for the answer."""
        if self._process is None:
            python = reference_tools.find_python()
            if python is None:
                raise FarfieldError("The peers are not installed; run python3 scripts/reference_tools.py.")
            command = [str(python), str(Path(__file__).with_name("restore_peers.py"))]
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        print(json.dumps(request), file=self._process.stdin, flush=True)
        ready, _, _ = select.select([self._process.stdout], [], [], self.timeout)
        line = self._process.stdout.readline() if ready else ""
        if line:
            return json.loads(line)
        reason = f"the process ended with code {self._process.wait()}" if ready else f"no answer within {self.timeout:g} s"
        self._stop()
        return {"error": reason}

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def restore_with(settings: RestoreSettings, image: np.ndarray, mask: np.ndarray) -> Restored:
    """Restore an image with Farfield and round it to 8 bits, as peers do. The pixels to be restored are set to zero before."""
    hidden = np.where(mask[..., None], np.float32(0.0), image)
    started = time.perf_counter()
    try:
        restoration = run_to_end(restore(hidden, mask, settings, is_color=image.shape[2] >= 3))
    except FarfieldError as error:
        return Restored(None, error=str(error))
    seconds = time.perf_counter() - started
    rounded = np.rint(np.clip(restoration.pixels, 0.0, 1.0) * 255.0).astype(np.float32) / 255.0
    return Restored(rounded, seconds, restoration.sub_bands)
