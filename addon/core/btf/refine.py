"""Silhouettes refined against final pictures: what quads let through between each other and cover twice is put right.

A texel's own alpha is right for itself, yet not for what a viewer gets: two quads that share a pixel half and half, one behind the other,
cover three quarters of it. So the weights of alpha are fitted anew, by a few damped Gauss-Newton steps, to what the original looked like
from the baked views: its coverage, and its colours under broad lights, which hardly have noise. Weights of colour are left: fitted to
noisy pictures from so few views they gain nothing elsewhere (docs/btf.md has the figures).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.ndimage import gaussian_filter

from ..direction_grids import DirectionGrid
from ..progress import Progress, Steps
from .factors import Factors, solved_rows
from .fragments import Fragments

RAYS = 2  # along each side of a pixel
STEPS = 6
COVERAGE_WEIGHT = 4.0  # of all coverage against all colours
DAMPING = 0.3  # of the mean diagonal
STRIDE = 0.7  # of a Gauss-Newton step: the texels along a ray move at once
CLEARLY = 0.02  # alpha this far beyond 0..1 no longer answers
SOFT = 1.5  # pixels over which brightness is taken, for errors relative to it
POWER = 1.2
DIM = 0.05  # of the mean brightness, added to it


@dataclass(frozen=True)
class Photograph:
    """The original from one view. colours (M, H, W, 3) float32: premultiplied, under M broad lights; coverage (H, W) float32."""

    colours: np.ndarray
    coverage: np.ndarray


class Training(Protocol):
    """What one view offers for the fit."""

    def fragments(self) -> Fragments:
        """What RAYS x RAYS rays a pixel meet of the quads."""

    def photograph(self) -> Photograph:
        """What they should add up to."""


def broad_lights(grid: DirectionGrid) -> np.ndarray:
    """The lights (L + 1, 5) under which pictures are compared, as sums over those of `grid` and the dome: all suns, suns more from +x than
    from -x, the same along y and z, and the dome."""
    suns = grid.solid_angles[:, None] * np.column_stack([np.ones(len(grid)), grid.directions])
    made = np.zeros((len(grid) + 1, 5), np.float32)
    made[:-1, :4], made[-1, 4] = suns, 1.0
    return made


def refined(
    views: Sequence[Training],
    colour: Factors,
    hues: np.ndarray,
    alpha: Factors,
    plain: np.ndarray,
    lights: np.ndarray,
    view_weights: np.ndarray,
) -> Steps[Factors]:
    """`alpha` with weights that make the pictures right, and one more component that is the same from every view.

    Args:
        hues: (N, 3) what colours are multiplied by. plain: (N,) what `alpha` comes on top of. lights: (L + 1, M), see `broad_lights`.
    """
    alpha = _with_constant(alpha)
    weights, count = alpha.weights, alpha.components
    view_weights = view_weights / view_weights.mean()
    basis = np.einsum("vklc,lm->vkmc", colour.basis.reshape(*colour.basis.shape[:2], -1, 3), lights)
    for number in range(STEPS):
        normal = np.zeros((len(weights), count, count), np.float32)
        right = np.zeros((len(weights), count), np.float32)
        for place, view in enumerate(views):
            yield Progress((number + place / len(views)) / STEPS, f"Refining, step {number + 1} of {STEPS}")
            fragments, photograph = view.fragments(), view.photograph()
            from_view = alpha.basis[place, :, 0]
            looked = _Look(fragments, photograph, basis[place], colour.weights, hues)
            slope, bend = looked.against(plain + weights @ from_view)
            right -= view_weights[place] * slope[:, None] * from_view
            touched = np.flatnonzero(bend)
            normal[touched] += (view_weights[place] * bend[touched, None, None]) * np.outer(from_view, from_view)
        weights = weights + STRIDE * solved_rows(normal, right, DAMPING)
    return replace(alpha, weights=weights)


def _with_constant(alpha: Factors) -> Factors:
    """The same with a component more whose weights are 0."""
    weights = np.column_stack([alpha.weights, np.zeros(len(alpha.weights), np.float32)])
    level = np.float32(np.sqrt((alpha.basis**2).mean()) or 1.0)
    basis = np.concatenate([alpha.basis, np.full_like(alpha.basis[:, :1], level)], axis=1)
    return Factors(weights, basis, alpha.known)


class _Look:
    """One view, as it comes out and as it should."""

    def __init__(self, fragments: Fragments, photograph: Photograph, basis: np.ndarray, weights: np.ndarray, hues: np.ndarray) -> None:
        self._fragments, count = fragments, len(fragments)
        starts = np.arange(0, 4 * count + 1, 4, dtype=np.int32)
        self._texture = sparse.csr_array((fragments.shares.ravel(), fragments.texels.ravel(), starts), shape=(count, len(weights)))
        pixels = photograph.coverage.size
        self._pixel = fragments.ray // RAYS**2
        lights = len(photograph.colours)
        wanted = photograph.colours.transpose(1, 2, 0, 3).reshape(pixels, -1)
        tinted = np.tile(self._texture @ hues, (1, lights))
        self._colours = np.maximum((self._texture @ weights) @ basis.reshape(len(basis), -1), -np.inf) * tinted
        self._wanted, self._coverage = wanted, photograph.coverage.ravel()
        self._importance = _importance(photograph).reshape(pixels, 1)
        energy = float((self._importance * wanted**2).sum())
        self._solid = COVERAGE_WEIGHT * energy / max(float((self._coverage**2).sum()), 1e-12)

    def against(self, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slope (N,) of the squared error by every texel's `alpha` (N,), and its bend (N,) as Gauss and Newton take it."""
        raw = self._texture @ alpha.astype(np.float32)
        own = np.clip(raw, 0.0, 1.0)
        through = self._fragments.transmitted(own)
        share = 1.0 / RAYS**2
        summing = sparse.csr_array((through * own * share, (self._pixel, np.arange(len(own)))), shape=(len(self._coverage), len(own)))
        off = self._importance * (summing @ self._colours - self._wanted)
        off_coverage = self._solid * (summing @ np.ones(len(own), np.float32) - self._coverage)
        value = np.einsum("fc,fc->f", self._colours, off[self._pixel]) + off_coverage[self._pixel]
        behind = self._fragments.behind(through * own * value)
        answers = (raw > -CLEARLY) & (raw < 1.0 + CLEARLY)
        slope = (through * value - behind / np.maximum(1.0 - own, 0.01)) * answers * share
        energy = np.einsum("fc,fc,f->f", self._colours, self._colours, self._importance[self._pixel, 0]) + self._solid
        bend = through**2 * energy * answers * share**2 * SHARING
        return self._texture.T @ slope, self._texture.T @ bend


SHARING = 4.0  # texels that the texture unit mixes move together, and so do the rays of a pixel


def _importance(photograph: Photograph) -> np.ndarray:
    """What errors count (H, W): people see them relative to the brightness around, premultiplied."""
    mean = photograph.colours[[0, -1]].mean(axis=(0, 3))
    around = gaussian_filter(mean, SOFT)
    return 1.0 / (around + DIM * float(mean.max()) + 1e-12) ** POWER


ReadPhotograph = Callable[[int], Photograph]
