"""Bidirectional texture functions as `.btf` files in the full-matrix-factorisation layout of the Bonn database (UBO2014), one matrix a
channel ("DFMF").

Such a file holds, for every channel, a matrix with a row for each view and light and a column for each pixel as U S V': the left singular
vectors, the singular values, and S V'. Our weights and basis are a product of that kind already, so nothing is lost but rounding.
"""

import struct
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from ..directions import to_spherical
from ..errors import FileError, SettingsError
from ..progress import Progress, Steps
from .decoding import BakedAtlas

SIGNATURE = b"!DFMF08FC"
VERSION = 4  # of the header: the first with named channels
CHANNELS = ("R", "G", "B")
NOTE = b"<farfield>radiance under a sun of unit irradiance, scene-linear Rec.709, angles in the object's frame</farfield>"
LARGEST = 2**32 - 1  # bytes: readers count the parts of the file with 32 bits
SCALAR = np.dtype("<f4")
CHUNK = 32_768  # pixels written at once


def write_fmf(stream: BinaryIO, atlas: BakedAtlas, views: np.ndarray, lights: np.ndarray, pixels_per_millimetre: float) -> Steps[None]:
    """Write a level's colours from unit directions `views` (N, 3) under `lights` (N, 3), both in the object's frame.

    The layout has no negative guard: what the shader cuts at 0 stays as it is.

    Raises:
        SettingsError: when there are not as many views as lights, which readers of the layout count on.
        FileError: when a part of the file would be larger than the layout can say.
    """
    if len(views) != len(lights):
        raise SettingsError(f"A .btf file needs as many lights as views, not {len(views)} and {len(lights)}; take the directions of Bonn.")
    width, height = atlas.size
    basis = atlas.seen_from(views, lights)
    rows, components = len(views) * len(lights), min(len(views) * len(lights), basis.shape[1])
    if len(CHANNELS) * max(rows, width * height) * components * SCALAR.itemsize > LARGEST:
        raise FileError(f"{width} x {height} pixels with {components} components are more than a .btf file can hold; bake a coarser level.")
    stream.write(_header(pixels_per_millimetre))
    stream.write(_directions(views, lights))
    stream.write(struct.pack("<II", width, height))
    stream.write(struct.pack("<II12f", components, 0, 0.0, 0.0, 0.0, *np.eye(3).ravel()))  # colours as they are: no mean, no transform
    for channel in range(len(CHANNELS)):
        label = f"Writing channel {channel + 1} of {len(CHANNELS)}"
        yield Progress(channel / len(CHANNELS), label)
        table = basis[..., channel].transpose(0, 2, 1).reshape(rows, -1).astype(np.float64)  # view, light; component
        left, strengths = _left_singular(table, _gram(atlas, channel))
        stream.write(struct.pack("<BIII", SCALAR.itemsize, components, rows, width * height))
        stream.write(strengths.astype(SCALAR).tobytes())
        stream.write(left.astype(SCALAR).tobytes())
        turn = table.T @ left
        for done, weights in enumerate(_tinted(atlas, channel)):
            stream.write((weights @ turn).astype(SCALAR).tobytes())
            yield Progress((channel + min((done + 1) * CHUNK / (width * height), 1.0)) / len(CHANNELS), label)


def _header(pixels_per_millimetre: float) -> bytes:
    channels = b"".join(struct.pack("<I", len(name)) + name.encode() for name in CHANNELS)
    fixed = struct.pack("<80s80s80s4f", b"Farfield", b"Cycles", b"sun", pixels_per_millimetre, 1.0, 1.0, 1.0)
    # The cosine flag is 0: the cosine of the light is in the values, readers must not put it in again.
    rest = fixed + struct.pack("<II", 0, len(NOTE)) + NOTE + struct.pack("<I", len(CHANNELS)) + channels
    return SIGNATURE + struct.pack("<II", 8 + len(rest), VERSION) + rest


def _directions(views: np.ndarray, lights: np.ndarray) -> bytes:
    """Every view as polar angle and turn, each followed by all lights."""
    under = struct.pack("<I", len(lights)) + to_spherical(lights).astype("<f4").tobytes()
    return struct.pack("<I", len(views)) + b"".join(angles.tobytes() + under for angles in to_spherical(views).astype("<f4"))


def _tinted(atlas: BakedAtlas, channel: int) -> Iterator[np.ndarray]:
    """The weights (M, components of all clusters) float64 of all pixels in one channel, some pixels at a time."""
    for start in range(0, len(atlas.tints), CHUNK):
        rows = slice(start, start + CHUNK)
        yield atlas.tints[rows, channel, None] * atlas.colour.spread(rows).astype(np.float64)


def _gram(atlas: BakedAtlas, channel: int) -> np.ndarray:
    return sum(weights.T @ weights for weights in _tinted(atlas, channel))


def _left_singular(table: np.ndarray, gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Left singular vectors and singular values of table @ weights.T, whose weights.T @ weights is `gram`: any root of it will do."""
    values, vectors = np.linalg.eigh(gram)
    left, strengths, _ = np.linalg.svd(table @ (vectors * np.sqrt(np.maximum(values, 0.0))), full_matrices=False)
    return left, strengths
