"""Heights in the plane with their gradients: simplex noise, its sum over octaves, and gullies along the gradient.

Octaves fade where samples cannot resolve them, so that all boxes show the same ground with more or less detail. Simplex noise after
Gustavson, Simplex Noise Demystified, 2005. Gullies are phasor noise (Tricard et al., Procedural Phasor Noise, 2019) whose waves lie across
the gradient of the ground, octave after octave: small valleys lead to large ones.
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import gather
from .hashing import hash_lattice

SKEW, UNSKEW = 0.5 * (np.sqrt(3.0) - 1.0), (3.0 - np.sqrt(3.0)) / 6.0
SIMPLEX_SCALE = 99.2  # Makes simplex noise lie between about -1 and 1.
SIMPLEX_CELLS = 0.7  # Wavelengths per lattice unit.
ANGLES = 2.0 * np.pi * np.arange(256) / 256.0
GRADIENTS = np.cos(ANGLES).astype(np.float32), np.sin(ANGLES).astype(np.float32)
UNRESOLVED, RESOLVED = 3.0, 7.0  # Samples per wavelength at which an octave begins to show, and from which it shows in full.
OCTAVE_TURN = 1.1  # Radians by which each octave is turned, so that lattices do not coincide.
KERNEL_RADIUS = 1.25  # Of the waves of gullies, in cells. A kernel farther than the next cell has no influence.
JITTER = 0.5  # Of the centers of kernels, in cells.
MAX_GAIN = 1.6  # By which waves that cancel out are strengthened.
MEAN_DEPTH = 0.2  # Of gullies, relative to their amplitude: more is eroded than added.
BRANCHING = 0.7  # How much gullies turn those that lead to them. More makes knife edges where the gradient turns at once.
SHARPNESS = 1.6  # Of ridges between gullies: they need as many times the samples of waves.


@dataclass(frozen=True)
class Heights:
    """Heights and their derivatives.

    Attributes:
        height: (X, Y) float32, a length.
        gradient_x: (X, Y) float32.
        gradient_y: (X, Y) float32.
    """

    height: np.ndarray
    gradient_x: np.ndarray
    gradient_y: np.ndarray

    @property
    def steepness(self) -> np.ndarray:
        """The length (X, Y) of the gradient."""
        return np.sqrt(self.gradient_x**2 + self.gradient_y**2)

    def add(self, other: "Heights", factor: np.ndarray | float = 1.0) -> "Heights":
        """Return these heights and `factor` times the other ones."""
        factor = np.float32(factor) if np.isscalar(factor) else factor
        gradient_x, gradient_y = self.gradient_x + factor * other.gradient_x, self.gradient_y + factor * other.gradient_y
        return Heights(self.height + factor * other.height, gradient_x, gradient_y)

    def scale(self, factor: float) -> "Heights":
        """Return `factor` times these heights."""
        return Heights(*(np.float32(factor) * values for values in (self.height, self.gradient_x, self.gradient_y)))

    def multiply(self, other: "Heights") -> "Heights":
        """Return the product of two fields."""
        gradient_x, gradient_y = (
            first * other.height + self.height * second
            for first, second in ((self.gradient_x, other.gradient_x), (self.gradient_y, other.gradient_y))
        )
        return Heights(self.height * other.height, gradient_x, gradient_y)

    def map(self, height: np.ndarray, derivative: np.ndarray) -> "Heights":
        """Return a function of these heights, whose values and `derivative` (X, Y) are given."""
        return Heights(height, self.gradient_x * derivative, self.gradient_y * derivative)


@dataclass(frozen=True)
class Gullies:
    """What `carve_gullies` carves.

    Attributes:
        wavelength: of the widest gullies, a length.
        octaves: their number, each half as wide as the one before.
        depth: of the widest, relative to their wavelength.
        gain: of the relative depth from octave to octave.
        onset: length of the gradient at which gullies have half of their depth; level ground has none.
    """

    wavelength: float
    octaves: int
    depth: float
    gain: float
    onset: float


def resolve(wavelength: float, spacing: float) -> float:
    """Return how much of an octave samples with a `spacing` show, from 0 to 1."""
    t = min(max((wavelength / spacing - UNRESOLVED) / (RESOLVED - UNRESOLVED), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


def simplex_noise(x: np.ndarray, y: np.ndarray, seed: int) -> Heights:
    """Return noise between about -1 and 1 with mean 0. x, y: positions (X, Y) in lattice units."""
    skew = (x + y) * SKEW
    column, row = np.floor(x + skew), np.floor(y + skew)
    unskew = (column + row) * UNSKEW
    x0, y0 = (x - (column - unskew)).astype(np.float32), (y - (row - unskew)).astype(np.float32)
    column, row = column.astype(np.int64), row.astype(np.int64)
    right = (x0 > y0).astype(np.int64)
    bits, first, stride = _hash_around(column, row, range(2), seed)
    tables = [table[bits & np.uint32(255)] for table in GRADIENTS]
    height, gradient_x, gradient_y = (np.zeros(x0.shape, np.float32) for _ in range(3))
    for corner, (step_x, step_y) in enumerate(((0, 0), (right, 1 - right), (1, 1))):
        dx, dy = (start - np.float32(step) + np.float32(corner * UNSKEW) for start, step in ((x0, step_x), (y0, step_y)))
        index = first + (step_x * stride + step_y)
        corner_x, corner_y = (gather(table, index) for table in tables)
        reach = np.maximum(np.float32(0.5) - dx * dx - dy * dy, np.float32(0.0))
        cube = reach * reach * reach
        along = corner_x * dx + corner_y * dy
        height += cube * reach * along
        gradient_x += cube * (reach * corner_x - 8.0 * along * dx)
        gradient_y += cube * (reach * corner_y - 8.0 * along * dy)
    return Heights(SIMPLEX_SCALE * height, SIMPLEX_SCALE * gradient_x, SIMPLEX_SCALE * gradient_y)


def sum_octaves(x: np.ndarray, y: np.ndarray, spacing: float, wavelength: float, octaves: int, seed: int, gain: float = 0.5) -> Heights:
    """Return fractional Brownian motion: octaves of noise, each with half the wavelength of the last and `gain` times its amplitude, which
    is 1 at first. x, y: positions (X, Y). spacing: of samples; octaves that it cannot resolve fade out."""
    zero = np.zeros(np.broadcast_shapes(x.shape, y.shape), np.float32)
    total, amplitude = Heights(zero, zero, zero), 1.0
    for octave in range(octaves):
        shown = resolve(wavelength, spacing)
        if shown == 0.0:
            break
        cosine, sine, cell = np.cos(OCTAVE_TURN * octave), np.sin(OCTAVE_TURN * octave), SIMPLEX_CELLS * wavelength
        noise = simplex_noise((cosine * x + sine * y) / cell, (cosine * y - sine * x) / cell, seed + octave)
        gradient_x, gradient_y = cosine * noise.gradient_x - sine * noise.gradient_y, sine * noise.gradient_x + cosine * noise.gradient_y
        turned = Heights(noise.height, (gradient_x / cell).astype(np.float32), (gradient_y / cell).astype(np.float32))
        total = total.add(turned, shown * amplitude)
        amplitude *= gain
        wavelength *= 0.5
    return total


def carve_gullies(ground: Heights, x: np.ndarray, y: np.ndarray, spacing: float, gullies: Gullies, seed: int) -> Heights:
    """Return ground with gullies. x, y: positions (X, Y). spacing: of samples; gullies that it cannot resolve fade out."""
    wavelength, depth, guide = gullies.wavelength, gullies.depth, ground
    for octave in range(gullies.octaves):
        shown = resolve(wavelength, SHARPNESS * spacing)
        if shown == 0.0:
            break
        squares = ground.steepness**2  # So that gullies fade where the gradient turns around summits and hollows.
        factor = np.float32(shown * depth * wavelength) * squares / (squares + np.float32(gullies.onset**2))
        waves = _waves_across_gradient(guide, x / wavelength, y / wavelength, seed + octave)
        rate = np.float32(1.0 / wavelength)
        scaled = Heights(waves.height - np.float32(MEAN_DEPTH), waves.gradient_x * rate, waves.gradient_y * rate)
        ground, guide = ground.add(scaled, factor), guide.add(scaled, np.float32(BRANCHING) * factor)
        wavelength *= 0.5
        depth *= gullies.gain
    return ground


def _waves_across_gradient(ground: Heights, x: np.ndarray, y: np.ndarray, seed: int) -> Heights:
    """Return waves of the length of a cell between -1 and 1, whose crests lie along the gradient. x, y: positions (X, Y) in cells."""
    steepness = np.maximum(ground.steepness, np.float32(1e-9))
    across_x, across_y = -ground.gradient_y / steepness, ground.gradient_x / steepness
    column, row = np.floor(x), np.floor(y)
    x0, y0 = (x - column).astype(np.float32), (y - row).astype(np.float32)
    column, row = column.astype(np.int64), row.astype(np.int64)
    bits, first, stride = _hash_around(column, row, range(-1, 2), seed)
    jitters = [half.astype(np.float32) * np.float32(JITTER / 65536.0) for half in (bits & np.uint32(0xFFFF), bits >> np.uint32(16))]
    cosine, sine, total = (np.zeros(x0.shape, np.float32) for _ in range(3))
    for step_x in (-1, 0, 1):
        for step_y in (-1, 0, 1):
            jitter_x, jitter_y = (gather(jitter, first + (step_x * stride + step_y)) for jitter in jitters)
            dx = x0 - np.float32(step_x + 0.5 * (1.0 - JITTER)) - jitter_x
            dy = y0 - np.float32(step_y + 0.5 * (1.0 - JITTER)) - jitter_y
            reach = np.maximum(np.float32(1.0) - (dx * dx + dy * dy) * np.float32(KERNEL_RADIUS**-2), np.float32(0.0))
            weight = reach * reach * reach
            phase = np.float32(2.0 * np.pi) * (dx * across_x + dy * across_y)
            cosine += weight * np.cos(phase)
            sine += weight * np.sin(phase)
            total += weight
    length = np.sqrt(cosine * cosine + sine * sine) + np.float32(1e-9)
    gain = np.minimum(total, np.float32(MAX_GAIN) * length) / (total * length)
    crest = np.float32(-2.0 * np.pi) * sine * gain
    return Heights(cosine * gain, crest * across_x, crest * across_y)


def _hash_around(column: np.ndarray, row: np.ndarray, steps: range, seed: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Hash the lattice points around samples (X, Y), each one once where samples are close to each other.

    Args:
        column, row: (X, Y) int64, the lattice points of the samples. steps: from these to others.

    Returns:
        Hashes (H,) uint32, the indices (X, Y) intp of the points of the samples in them, and a stride: the hash of the point that is `i`
        columns and `j` rows farther is `i` strides plus `j` farther.
    """
    first_column, first_row = int(column.min()) + steps[0], int(row.min()) + steps[0]
    columns, stride = int(column.max()) + steps[-1] + 1 - first_column, int(row.max()) + steps[-1] + 1 - first_row
    if columns * stride <= len(steps) ** 2 * column.size:
        points = np.arange(first_column, first_column + columns)[:, None], np.arange(first_row, first_row + stride)
        first = (column - first_column) * stride + (row - first_row)
    else:  # samples are far from each other: each one has its own points
        stride, own = len(steps), np.arange(len(steps)) + steps[0]
        points = column.ravel()[:, None, None] + own[:, None], row.ravel()[:, None, None] + own
        first = np.arange(column.size).reshape(column.shape) * stride**2 - steps[0] * (stride + 1)
    return hash_lattice(*points, np.int64(0), seed).ravel(), first, stride
