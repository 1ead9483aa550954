"""Silhouettes refined against final pictures: what quads let through between each other and cover twice is put right.

A texel's own alpha is right for itself, yet not for what a viewer gets: two quads that share a pixel half and half, one behind the other,
cover three quarters of it. So the weights of alpha are fitted anew, through the compositing of the quads, to what the original looked like
from the baked views: its coverage, and its colours under broad lights. Colours stay: their weights, fitted to noisy pictures from the few
views that see a texel, become worse for every other view and light (docs/btf.md has the figures).

All texels along a ray move at once, dozens in a crown, so steps of each by itself overshoot and swing from too little to too much. Hence
conjugate gradients (Polak and Ribiere, as far as they point downhill) with the length of each step from the bend along it, as Gauss and
Newton take it. They are ended early, which keeps texels that little is known of near to where they were.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.ndimage import gaussian_filter

from ..parallel import mapped
from ..progress import Progress, Steps, scaled
from .alternation import solved_rows
from .factors import Factors
from .fragments import Fragments
from .photographs import Photograph

RAYS = 2  # along each side of a pixel
STEPS = 10
SLOPING = 0.6  # of a step is spent on its direction, the rest on its length
DAMPING = 0.005  # of the mean bend, for what is the same from every view
VARYING_DAMPING = 12.0  # the same for what depends on the view, which has less to go by
SMALL = 0.05  # alpha by which the picture is changed to see how it bends
COVERAGE_WEIGHT = 4.0  # of all coverage against all colours
LEAST_SEEN = 0.01  # of a fragment through those before it: what is hidden more matters to no pixel
CLEARLY = 0.02  # alpha this far beyond 0..1 no longer answers
AROUND = 1.5  # pixels over which brightness is taken: people see errors relative to it
RELATIVE = 1.2  # power of it; 2 would be relative alone
DIM = 0.05  # of the largest brightness, added to it


@dataclass(frozen=True)
class Look:
    """A view, as it is and as it should be.

    fragments: what RAYS x RAYS rays a pixel meet of the quads. colours (F, M * 3) float16: what these show under M broad lights.
    photograph: what they should add up to.
    """

    fragments: Fragments
    colours: np.ndarray
    photograph: Photograph


class Training(Protocol):
    """What one view offers for the fit."""

    def look(self) -> Look:
        """The view; asked for at every step."""


def refined(views: Sequence[Training], alpha: Factors, plain: np.ndarray, view_weights: np.ndarray) -> Steps[Factors]:
    """`alpha` with weights that make the pictures right, and one more component that is the same from every view.

    plain: (N,) what `alpha` comes on top of. view_weights: (V,).
    """
    alpha = _with_constant(alpha)
    pictures = _Pictures(views, plain, alpha.basis[:, :, 0], view_weights / view_weights.mean())
    damping = np.append(np.full(alpha.components - 1, VARYING_DAMPING), DAMPING)
    weights, before, course = alpha.weights, None, np.zeros_like(alpha.weights)
    for number in range(STEPS):
        begun, sloped, ended = number / STEPS, (number + SLOPING) / STEPS, (number + 1) / STEPS
        slope, bends = yield from scaled(pictures.slope(weights), begun, sloped)
        uphill = solved_rows(bends, pictures.grams, slope, damping)
        course = _conjugate(slope, uphill, before, course)
        before = slope, uphill
        bend = yield from scaled(pictures.bend(weights, course), sloped, ended)
        if bend <= 0.0:
            break
        weights = weights - np.float32(float(np.vdot(slope, course)) / bend) * course
    return replace(alpha, weights=weights)


def _conjugate(slope: np.ndarray, uphill: np.ndarray, before: tuple[np.ndarray, np.ndarray] | None, course: np.ndarray) -> np.ndarray:
    """The next course (N, K) downhill: conjugate to the last one, unless that leads uphill. before: slope and uphill of the last step."""
    if before is None:
        return -uphill
    turned = float(np.vdot(slope, uphill - before[1])) / max(float(np.vdot(*before)), 1e-30)
    made = max(turned, 0.0) * course - uphill
    return made if np.vdot(slope, made) < 0.0 else -uphill


class _Pictures:
    """The pictures of all views, by the weights (N, K) of alpha. from_views (V, K): its basis; view_weights (V,)."""

    def __init__(self, views: Sequence[Training], plain: np.ndarray, from_views: np.ndarray, view_weights: np.ndarray) -> None:
        self._views, self._plain, self._from_views, self._counting = views, plain, from_views, view_weights.astype(np.float32)
        self.grams = np.einsum("v,vk,vl->vkl", view_weights, from_views, from_views)

    def slope(self, weights: np.ndarray) -> Steps[tuple[np.ndarray, np.ndarray]]:
        """Slope (N, K) float32 of the error by the weights, and the bends (V, N) of every view by its texels' alpha."""
        slope, bends = np.zeros_like(weights), np.zeros((len(self._views), len(weights)), np.float32)

        def answer(place: int) -> tuple[np.ndarray, np.ndarray]:
            return self._composited(place).against(self._alpha(weights, place))

        for place, (own, bends[place]) in enumerate(mapped(answer, range(len(self._views)))):
            yield Progress(place / len(self._views), "Refining")
            slope += self._counting[place] * np.outer(own, self._from_views[place])
        return slope, bends

    def bend(self, weights: np.ndarray, course: np.ndarray) -> Steps[float]:
        """How the error bends along a `course` (N, K) of the weights."""

        def answer(place: int) -> float:
            return self._composited(place).bend_along(self._alpha(weights, place), course @ self._from_views[place])

        total = 0.0
        for place, own in enumerate(mapped(answer, range(len(self._views)))):
            yield Progress(place / len(self._views), "Refining")
            total += float(self._counting[place]) * own
        return total

    def _composited(self, place: int) -> "_Compositing":
        return _Compositing(self._views[place].look(), len(self._plain))

    def _alpha(self, weights: np.ndarray, place: int) -> np.ndarray:
        return self._plain + weights @ self._from_views[place]


def texel_colours(colour: Factors, view: int, hues: np.ndarray, lights: np.ndarray) -> np.ndarray:
    """Colours (N, M * 3) float32 of all texels from a view under `lights` (L + 1, M), sums over the columns of `colour`, times their `hues`
    (N, 3)."""
    components, columns = colour.basis.shape[1:]
    basis = np.einsum("klc,lm->kmc", colour.basis[view].reshape(components, columns // 3, 3), lights).reshape(components, -1)
    return colour.applied(basis.astype(np.float32)) * np.tile(hues, (1, lights.shape[1]))


def shown(fragments: Fragments, colours: np.ndarray) -> np.ndarray:
    """What fragments show (F, D) float16 of texels with `colours` (N, D)."""
    return (_texture(fragments, len(colours)) @ colours).astype(np.float16)


def seen(fragments: Fragments, alpha: np.ndarray) -> Fragments:
    """Those of `fragments` that others do not hide, where texels have `alpha` (N,)."""
    own = np.clip(np.einsum("ft,ft->f", fragments.shares, alpha[fragments.texels]), 0.0, 1.0)
    return fragments.chosen(fragments.transmitted(own) > LEAST_SEEN)


def _with_constant(alpha: Factors) -> Factors:
    """The same with one more component, of weights 0."""
    weights = np.column_stack([alpha.weights, np.zeros(len(alpha.weights), np.float32)])
    size = np.float32(np.sqrt((alpha.basis**2).mean()) or 1.0)
    return replace(alpha, weights=weights, basis=np.concatenate([alpha.basis, np.full_like(alpha.basis[:, :1], size)], axis=1))


class _Compositing:
    """A look of quads with `texels` texels: how it comes out, and how that answers to their alpha."""

    def __init__(self, look: Look, texels: int) -> None:
        self._fragments, photograph = look.fragments, look.photograph
        self._texture = _texture(look.fragments, texels)
        self._colours = look.colours.astype(np.float32)
        self._pixel = look.fragments.ray // RAYS**2
        self._coverage = photograph.coverage.ravel()
        self._wanted = photograph.colours.transpose(1, 2, 0, 3).reshape(len(self._coverage), -1)
        self._importance = _importance(photograph).reshape(-1, 1)
        energy = float((self._importance * self._wanted**2).sum())
        self._solid = COVERAGE_WEIGHT * energy / max(float((self._coverage**2).sum()), 1e-12)

    def error(self, alpha: np.ndarray) -> float:
        """Half the squared error of the picture when texels have `alpha` (N,)."""
        _, _, off, off_coverage = self._composed(alpha)
        return 0.5 * float((self._importance * off**2).sum() + self._solid * (off_coverage**2).sum())

    def against(self, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slope (N,) of `error` by every texel's `alpha` (N,), and what it bends by as a preconditioner takes it (N,).

        That is between the bend by the texel alone and the one by all texels of its pixels at once, which is a bound: their geometric mean.
        """
        own, through, off, off_coverage = self._composed(alpha)
        value = np.einsum("fc,fc->f", self._colours, (self._importance * off)[self._pixel]) + self._solid * off_coverage[self._pixel]
        behind = self._fragments.behind(through * own * value)
        raw = self._texture @ alpha.astype(np.float32)
        answers = ((raw > -CLEARLY) & (raw < 1.0 + CLEARLY)) / np.float32(RAYS**2)
        energy = np.einsum("fc,fc->f", self._colours, self._colours) * self._importance[self._pixel, 0] + self._solid
        slope = (through * value - behind / np.maximum(1.0 - own, 0.01)) * answers
        share = np.sqrt(energy) * through * answers
        together = np.bincount(self._pixel, share, len(off_coverage)).astype(np.float32)
        alone, bound = (self._texture.T @ (share * other) for other in (share, together[self._pixel]))
        return self._texture.T @ slope, np.sqrt(alone * bound)

    def bend_along(self, alpha: np.ndarray, course: np.ndarray) -> float:
        """How `error` bends along a `course` (N,) of `alpha` (N,), as Gauss and Newton take it."""
        step = SMALL / max(float(np.abs(course).max(initial=0.0)), 1e-12)
        sent, moved = (through * own for own, through in map(self._transmission, (alpha, alpha + step * course)))
        colours, coverage = self._summed(moved - sent)
        return float((self._importance * colours**2).sum() + self._solid * (coverage**2).sum()) / step**2

    def _composed(self, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Alpha (F,) of the fragments, what is seen of them (F,), and how far colours (P, M * 3) and coverage (P,) are off."""
        own, through = self._transmission(alpha)
        colours, coverage = self._summed(through * own)
        return own, through, colours - self._wanted, coverage - self._coverage

    def _transmission(self, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Alpha (F,) of the fragments, and what is seen of them (F,)."""
        own = np.clip(self._texture @ alpha.astype(np.float32), 0.0, 1.0)
        return own, self._fragments.transmitted(own)

    def _summed(self, sent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Colours (P, M * 3) and coverage (P,) of the pixels, of whose rays fragments send `sent` (F,)."""
        shares = sent / np.float32(RAYS**2)
        summing = sparse.csr_array((shares, (self._pixel, np.arange(len(sent)))), shape=(len(self._coverage), len(sent)))
        return summing @ self._colours, summing.sum(axis=1)


def _importance(photograph: Photograph) -> np.ndarray:
    """What a squared error counts in each pixel (H, W)."""
    brightness = np.maximum(photograph.colours[[0, -1]], 0.0).mean(axis=(0, 3))
    return 1.0 / (gaussian_filter(brightness, AROUND) + DIM * float(brightness.max()) + 1e-12) ** RELATIVE


def _texture(fragments: Fragments, texels: int) -> sparse.csr_array:
    """What the texture unit does: values of so many texels (N,) to those of fragments (F,)."""
    taps = np.arange(0, 4 * len(fragments) + 1, 4, dtype=np.int32)
    return sparse.csr_array((fragments.shares.ravel(), fragments.texels.ravel(), taps), shape=(len(fragments), texels))
