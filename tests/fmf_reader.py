"""A reader of `.btf` files that is independent of the writer: the format as documented by the files of the Bonn database."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class FmfFile:
    """views (V, 2), lights (L, 2): polar angle and azimuth in radians. channels: name to U (V * L, K), S (K,), SV (H * W, K)."""

    header: dict[str, object]
    views: np.ndarray
    lights: np.ndarray
    size: tuple[int, int]
    channels: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]

    def decode_image(self, view: int, light: int) -> np.ndarray:
        """Return the image (H, W, 3) of a view and light, row 0 at the bottom."""
        row = view * len(self.lights) + light
        return np.stack([sv @ u[row] for u, _, sv in self.channels.values()], axis=1).reshape(self.size[1], self.size[0], 3)


class _ByteReader:
    def __init__(self, content: bytes) -> None:
        self.content, self.position = content, 0

    def unpack(self, layout: str) -> tuple:
        values = struct.unpack_from("<" + layout, self.content, self.position)
        self.position += struct.calcsize("<" + layout)
        return values

    def read_floats(self, *shape: int) -> np.ndarray:
        return np.array(self.unpack(f"{int(np.prod(shape))}f"), np.float32).reshape(shape)


def read_fmf(path: Path) -> FmfFile:
    """Read a file with one single-precision matrix per channel."""
    data = _ByteReader(path.read_bytes())
    assert data.unpack("9s")[0] == b"!DFMF08FC"
    start = data.position
    size, version, setup, _, _, per_millimeter, *_ = data.unpack("II80s80s80s4f")
    cosine, length = data.unpack("II")
    (note,) = data.unpack(f"{length}s")
    names = [data.unpack(f"{data.unpack('I')[0]}s")[0].decode() for _ in range(data.unpack("I")[0])]
    assert data.position - start == size
    header = {"version": version, "setup": setup.rstrip(b"\0").decode(), "per_millimeter": per_millimeter, "cosine": cosine, "note": note}
    views, lights = [], []
    for _ in range(data.unpack("I")[0]):
        views.append(data.read_floats(2))
        lights.append(data.read_floats(data.unpack("I")[0], 2))
    assert all(np.array_equal(view_lights, lights[0]) for view_lights in lights)
    width, height = data.unpack("II")
    _, color_model = data.unpack("II")
    mean, transform = data.read_floats(3), data.read_floats(3, 3)
    assert color_model == 0 and not mean.any() and np.array_equal(transform, np.eye(3))
    channels = {}
    for name in names:
        scalar_bytes, components, rows, columns = data.unpack("BIII")
        assert (scalar_bytes, rows, columns) == (4, len(views) * len(lights[0]), width * height)
        singular_values = data.read_floats(components)
        channels[name] = (data.read_floats(rows, components), singular_values, data.read_floats(columns, components))
    assert data.position == len(data.content), "there is data after the last matrix"
    return FmfFile(header, np.array(views), lights[0], (width, height), channels)
