"""Refinement of silhouettes against reference images, so that overlapping quads neither leave gaps nor cover pixels twice.

The alpha of each texel is correct by itself, but not after compositing: two quads that each cover half of a pixel, one behind the other,
cover three quarters of it. So the weights of alpha are fitted again, through the alpha compositing of the quads, to reference images of the
source from the baked views: its coverage, and its colors under low-order lights. Colors are not refined: fitted to the few noisy views that
show a texel, they get worse for all other views and lights, see docs/results/btf.md.

The texels along a ray change together, dozens of them in a tree crown, so independent steps would overshoot and oscillate. The method is
preconditioned nonlinear conjugate gradients (Polak-Ribiere with restarts), with step lengths from the Gauss-Newton curvature along the
direction. It is stopped early, which keeps texels with little data near their initial values.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.ndimage import gaussian_filter

from ...jobs.chunks import map_ordered
from ...jobs.progress import Progress, Steps, subprogress
from ..capture.observations import ReferenceImage
from ..factorization.als import solve_rows
from ..factorization.factors import Factors
from .fragments import Fragments

RAYS_PER_SIDE = 2  # Rays per side of a pixel.
ITERATIONS = 10
GRADIENT_PROGRESS = 0.6  # The gradient takes this fraction of an iteration's time; the rest goes to the step length.
DAMPING = 0.005  # Relative to the mean curvature, for the component that is the same in every view.
VARYING_DAMPING = 12.0  # The same for view-dependent components, which have less data.
FINITE_DIFFERENCE_STEP = 0.05  # Change of alpha to measure the curvature.
COVERAGE_WEIGHT = 4.0  # Weight of the coverage of an image relative to its colors.
MIN_TRANSMITTANCE = 0.01  # Fragments behind less transmittance are dropped.
ALPHA_SLACK = 0.02  # Alpha this far outside 0..1 has no gradient.
LUMINANCE_SIGMA = 1.5  # Pixels; errors are perceived relative to the local luminance.
LUMINANCE_POWER = 1.2  # 2 would make the squared error fully relative.
LUMINANCE_FLOOR = 0.05  # This fraction of the maximum luminance is added to the local one.


@dataclass(frozen=True)
class TrainingView:
    """One view: the quads as rendered, and the reference.

    fragments: of RAYS_PER_SIDE x RAYS_PER_SIDE rays per pixel. colors (F, M * 3) float16: of the fragments under M low-order lights.
    reference: the image that they should add up to.
    """

    fragments: Fragments
    colors: np.ndarray
    reference: ReferenceImage


class TrainingViewSource(Protocol):
    """Access to one training view."""

    def load(self) -> TrainingView:
        """Return the view. Called at least twice per iteration."""


def refine_alpha(sources: Sequence[TrainingViewSource], alpha: Factors, pbr_alpha: np.ndarray, view_weights: np.ndarray) -> Steps[Factors]:
    """Return `alpha` with refined weights, and with one more component that is the same in every view.

    pbr_alpha: (N,) is added to `alpha`. view_weights: (V,).
    """
    alpha = _append_constant_component(alpha)
    loss = RenderingLoss(sources, pbr_alpha, alpha.basis[:, :, 0], view_weights / view_weights.mean())
    damping = np.append(np.full(alpha.components - 1, VARYING_DAMPING), DAMPING)
    weights, previous, direction = alpha.weights, None, np.zeros_like(alpha.weights)
    for iteration in range(ITERATIONS):
        start, gradient_end, end = iteration / ITERATIONS, (iteration + GRADIENT_PROGRESS) / ITERATIONS, (iteration + 1) / ITERATIONS
        gradient, preconditioner = yield from subprogress(loss.gradient_and_preconditioner(weights), start, gradient_end)
        preconditioned_gradient = solve_rows(preconditioner, loss.grams, gradient, damping)
        direction = _polak_ribiere(gradient, preconditioned_gradient, previous, direction)
        previous = gradient, preconditioned_gradient
        curvature = yield from subprogress(loss.curvature_along(weights, direction), gradient_end, end)
        if curvature <= 0.0:
            break
        weights = weights - np.float32(float(np.vdot(gradient, direction)) / curvature) * direction
    return replace(alpha, weights=weights)


def _polak_ribiere(
    gradient: np.ndarray, preconditioned_gradient: np.ndarray, previous: tuple[np.ndarray, np.ndarray] | None, direction: np.ndarray
) -> np.ndarray:
    """Return the next descent direction (N, K), conjugate to the last `direction`; steepest descent where that is not a descent direction.

    previous: gradient and preconditioned gradient of the last iteration.
    """
    if previous is None:
        return -preconditioned_gradient
    beta = float(np.vdot(gradient, preconditioned_gradient - previous[1])) / max(float(np.vdot(*previous)), 1e-30)
    conjugate = max(beta, 0.0) * direction - preconditioned_gradient
    return conjugate if np.vdot(gradient, conjugate) < 0.0 else -preconditioned_gradient


class RenderingLoss:
    """Error of all views as a function of the weights (N, K) of alpha. view_basis (V, K): its basis. view_weights (V,)."""

    def __init__(
        self, sources: Sequence[TrainingViewSource], pbr_alpha: np.ndarray, view_basis: np.ndarray, view_weights: np.ndarray
    ) -> None:
        self._sources, self._pbr_alpha, self._view_basis = sources, pbr_alpha, view_basis
        self._view_weights = view_weights.astype(np.float32)
        self.grams = np.einsum("v,vk,vl->vkl", view_weights, view_basis, view_basis)

    def gradient_and_preconditioner(self, weights: np.ndarray) -> Steps[tuple[np.ndarray, np.ndarray]]:
        """Return the gradient (N, K) float32 with respect to the weights, and a diagonal preconditioner (V, N) with respect to the alpha of
        each view."""
        gradient, preconditioner = np.zeros_like(weights), np.zeros((len(self._sources), len(weights)), np.float32)

        def evaluate(view: int) -> tuple[np.ndarray, np.ndarray]:
            return self._load(view).gradient_and_preconditioner(self._alpha(weights, view))

        for view, (alpha_gradient, preconditioner[view]) in enumerate(map_ordered(evaluate, range(len(self._sources)))):
            yield Progress(view / len(self._sources), "Refining")
            gradient += self._view_weights[view] * np.outer(alpha_gradient, self._view_basis[view])
        return gradient, preconditioner

    def curvature_along(self, weights: np.ndarray, direction: np.ndarray) -> Steps[float]:
        """Return the second derivative along a `direction` (N, K) of the weights."""

        def evaluate(view: int) -> float:
            return self._load(view).curvature_along(self._alpha(weights, view), direction @ self._view_basis[view])

        total = 0.0
        for view, curvature in enumerate(map_ordered(evaluate, range(len(self._sources)))):
            yield Progress(view / len(self._sources), "Refining")
            total += float(self._view_weights[view]) * curvature
        return total

    def _load(self, view: int) -> "AlphaCompositing":
        return AlphaCompositing(self._sources[view].load(), len(self._pbr_alpha))

    def _alpha(self, weights: np.ndarray, view: int) -> np.ndarray:
        return self._pbr_alpha + weights @ self._view_basis[view]


def compute_texel_colors(color: Factors, view: int, chromaticity: np.ndarray, lights: np.ndarray) -> np.ndarray:
    """Return the colors (N, M * 3) float32 of all texels from a view under `lights` (L + 1, M), weights of the columns of `color`, times
    `chromaticity` (N, 3)."""
    components, columns = color.basis.shape[1:]
    basis = np.einsum("klc,lm->kmc", color.basis[view].reshape(components, columns // 3, 3), lights).reshape(components, -1)
    return color.reconstruct(basis.astype(np.float32)) * np.tile(chromaticity, (1, lights.shape[1]))


def shade(fragments: Fragments, colors: np.ndarray) -> np.ndarray:
    """Return the colors (F, D) float16 of fragments for texels with `colors` (N, D)."""
    return (_lookup_matrix(fragments, len(colors)) @ colors).astype(np.float16)


def cull_hidden(fragments: Fragments, alpha: np.ndarray) -> Fragments:
    """Return the fragments that are not hidden by others, for texels with `alpha` (N,)."""
    fragment_alpha = np.clip(np.einsum("ft,ft->f", fragments.weights, alpha[fragments.texel_indices]), 0.0, 1.0)
    return fragments.subset(fragments.transmittance(fragment_alpha) > MIN_TRANSMITTANCE)


def _append_constant_component(alpha: Factors) -> Factors:
    """Return the factors with a further component that is equal in all views, with weights of 0."""
    weights = np.column_stack([alpha.weights, np.zeros(len(alpha.weights), np.float32)])
    magnitude = np.float32(np.sqrt((alpha.basis**2).mean()) or 1.0)
    return replace(alpha, weights=weights, basis=np.concatenate([alpha.basis, np.full_like(alpha.basis[:, :1], magnitude)], axis=1))


class AlphaCompositing:
    """Composited image of a training view as a function of the alpha of its N texels, and its error against the reference."""

    def __init__(self, view: TrainingView, texel_count: int) -> None:
        self._fragments, reference = view.fragments, view.reference
        self._lookup = _lookup_matrix(view.fragments, texel_count)
        self._colors = view.colors.astype(np.float32)
        self._pixels = view.fragments.ray_indices // RAYS_PER_SIDE**2
        self._reference_coverage = reference.coverage.ravel()
        self._reference_colors = reference.colors.transpose(1, 2, 0, 3).reshape(len(self._reference_coverage), -1)
        self._importance = _pixel_importance(reference).reshape(-1, 1)
        energy = float((self._importance * self._reference_colors**2).sum())
        self._coverage_weight = COVERAGE_WEIGHT * energy / max(float((self._reference_coverage**2).sum()), 1e-12)

    def error(self, alpha: np.ndarray) -> float:
        """Return half the weighted squared error of the image for texels with `alpha` (N,). Only tests use it."""
        _, _, color_errors, coverage_errors = self._composite(alpha)
        return 0.5 * float((self._importance * color_errors**2).sum() + self._coverage_weight * (coverage_errors**2).sum())

    def gradient_and_preconditioner(self, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradient (N,) of `error` at `alpha` (N,), and a diagonal preconditioner (N,).

        The preconditioner is the geometric mean of two curvatures: that of each texel alone, and that of all texels of its pixels together,
        which is an upper bound.
        """
        fragment_alpha, transmittance, color_errors, coverage_errors = self._composite(alpha)
        derivative = np.einsum("fc,fc->f", self._colors, (self._importance * color_errors)[self._pixels])
        derivative = derivative + self._coverage_weight * coverage_errors[self._pixels]
        behind = self._fragments.sum_behind(transmittance * fragment_alpha * derivative)
        unclamped_alpha = self._lookup @ alpha.astype(np.float32)
        is_active = (unclamped_alpha > -ALPHA_SLACK) & (unclamped_alpha < 1.0 + ALPHA_SLACK)
        scale = is_active / np.float32(RAYS_PER_SIDE**2)
        energy = np.einsum("fc,fc->f", self._colors, self._colors) * self._importance[self._pixels, 0] + self._coverage_weight
        gradient = (transmittance * derivative - behind / np.maximum(1.0 - fragment_alpha, 0.01)) * scale
        magnitude = np.sqrt(energy) * transmittance * scale
        pixel_magnitude = np.bincount(self._pixels, magnitude, len(coverage_errors)).astype(np.float32)
        own, upper_bound = (self._lookup.T @ (magnitude * other) for other in (magnitude, pixel_magnitude[self._pixels]))
        return self._lookup.T @ gradient, np.sqrt(own * upper_bound)

    def curvature_along(self, alpha: np.ndarray, direction: np.ndarray) -> float:
        """Return the Gauss-Newton curvature of `error` at `alpha` (N,) along a `direction` (N,)."""
        step = FINITE_DIFFERENCE_STEP / max(float(np.abs(direction).max(initial=0.0)), 1e-12)
        before, after = (
            transmittance * fragment_alpha for fragment_alpha, transmittance in map(self._transmit, (alpha, alpha + step * direction))
        )
        colors, coverage = self._accumulate(after - before)
        return float((self._importance * colors**2).sum() + self._coverage_weight * (coverage**2).sum()) / step**2

    def _composite(self, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return alpha (F,) and transmittance (F,) of the fragments, and the errors of colors (P, M * 3) and coverage (P,)."""
        fragment_alpha, transmittance = self._transmit(alpha)
        colors, coverage = self._accumulate(transmittance * fragment_alpha)
        return fragment_alpha, transmittance, colors - self._reference_colors, coverage - self._reference_coverage

    def _transmit(self, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return alpha (F,) of the fragments, and the transmittance (F,) in front of them."""
        fragment_alpha = np.clip(self._lookup @ alpha.astype(np.float32), 0.0, 1.0)
        return fragment_alpha, self._fragments.transmittance(fragment_alpha)

    def _accumulate(self, contributions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return colors (P, M * 3) and coverage (P,) of the pixels, for the `contributions` (F,) of fragments to their rays."""
        pixel_contributions = contributions / np.float32(RAYS_PER_SIDE**2)
        shape = (len(self._reference_coverage), len(contributions))
        sum_matrix = sparse.csr_array((pixel_contributions, (self._pixels, np.arange(len(contributions)))), shape=shape)
        return sum_matrix @ self._colors, sum_matrix.sum(axis=1)


def _pixel_importance(reference: ReferenceImage) -> np.ndarray:
    """Return the weight (H, W) of the squared error of each pixel."""
    luminance = np.maximum(reference.colors[[0, -1]], 0.0).mean(axis=(0, 3))
    local_luminance = gaussian_filter(luminance, LUMINANCE_SIGMA) + LUMINANCE_FLOOR * float(luminance.max()) + 1e-12
    return 1.0 / local_luminance**LUMINANCE_POWER


def _lookup_matrix(fragments: Fragments, texel_count: int) -> sparse.csr_array:
    """Return the matrix of the bilinear texture lookup, from values of all texels (N,) to values of fragments (F,)."""
    row_starts = np.arange(0, 4 * len(fragments) + 1, 4, dtype=np.int32)
    matrix = (fragments.weights.ravel(), fragments.texel_indices.ravel(), row_starts)
    return sparse.csr_array(matrix, shape=(len(fragments), texel_count))
