"""A reader of `.btf` files that knows nothing of the writer, for its tests: the layout as the Bonn database describes it by its files."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class FmfFile:
    """angles in radians, (V, 2) and (L, 2): from the pole, around it. channels: name to (U (V * L, K), S (K,), SV (H * W, K))."""

    header: dict[str, object]
    views: np.ndarray
    lights: np.ndarray
    size: tuple[int, int]
    channels: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]

    def image(self, view: int, light: int) -> np.ndarray:
        """(H, W, 3), row 0 at the bottom."""
        row = view * len(self.lights) + light
        return np.stack([sv @ u[row] for u, _, sv in self.channels.values()], axis=1).reshape(self.size[1], self.size[0], 3)


class _Bytes:
    def __init__(self, content: bytes) -> None:
        self.content, self.place = content, 0

    def take(self, layout: str) -> tuple:
        values = struct.unpack_from("<" + layout, self.content, self.place)
        self.place += struct.calcsize("<" + layout)
        return values

    def floats(self, *shape: int) -> np.ndarray:
        return np.array(self.take(f"{int(np.prod(shape))}f"), np.float32).reshape(shape)


def read_fmf(path: Path) -> FmfFile:
    """The whole of a file with one matrix a channel, of single precision."""
    data = _Bytes(path.read_bytes())
    assert data.take("9s")[0] == b"!DFMF08FC"
    start = data.place
    size, version, setup, _, _, per_millimetre, *_ = data.take("II80s80s80s4f")
    cosine, length = data.take("II")
    (note,) = data.take(f"{length}s")
    names = [data.take(f"{data.take('I')[0]}s")[0].decode() for _ in range(data.take("I")[0])]
    assert data.place - start == size
    header = {"version": version, "setup": setup.rstrip(b"\0").decode(), "per_millimetre": per_millimetre, "cosine": cosine, "note": note}
    views, lights = [], []
    for _ in range(data.take("I")[0]):
        views.append(data.floats(2))
        lights.append(data.floats(data.take("I")[0], 2))
    assert all(np.array_equal(each, lights[0]) for each in lights)
    width, height = data.take("II")
    _, colour_model = data.take("II")
    mean, transform = data.floats(3), data.floats(3, 3)
    assert colour_model == 0 and not mean.any() and np.array_equal(transform, np.eye(3))
    channels = {}
    for name in names:
        scalar, components, rows, columns = data.take("BIII")
        assert (scalar, rows, columns) == (4, len(views) * len(lights[0]), width * height)
        strengths = data.floats(components)
        channels[name] = (data.floats(rows, components), strengths, data.floats(columns, components))
    assert data.place == len(data.content), "something follows the last matrix"
    return FmfFile(header, np.array(views), lights[0], (width, height), channels)
