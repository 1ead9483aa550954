"""Projected Newton minimization of energies of UV maps. Steps never flip a triangle."""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from ...jobs.progress import Progress, Steps
from .uv_energy import UvEnergy

REGULARIZATION = 1e-8  # This multiple of the median is added to the diagonal: rotations and translations of a free map cost nothing.
REGULARIZATION_GROWTH = 1e3  # Factor where the factorization fails.
MAX_STEP_FRACTION = 0.7  # As a fraction of the step at which a triangle would have no area left.
ARMIJO = 1e-4  # A step must reach this fraction of the decrease that the gradient predicts.
MIN_STEP = 1e-10
MAX_FACTOR_REUSE = 14  # Steps per factorization; each costs a tenth of a new one.
RELAX_BELOW_STEP = 0.5  # After a shorter step the worst vertices are relaxed.
REFACTOR_BELOW_STEP = 0.1  # After a shorter step the Hessian is factorized again.
NEGLIGIBLE_ENERGY = 1e-3  # An excess below this fraction of the lower bound is not reduced further.


def minimize(energy: UvEnergy, uv: np.ndarray, tolerance: float, max_steps: int) -> Steps[np.ndarray]:
    """Return the uv (V, 2) at a local minimum of the energy near `uv`; `uv` itself where it is invalid.

    Stops after `max_steps`, or when a step with a new factorization decreases the energy by less than `tolerance`, relative to the
    excess over the lower bound or, if that is smaller, to the negligible energy.
    """
    value, factor, reuse_count, regularization = energy.value(uv), None, 0, REGULARIZATION
    if not np.isfinite(value):
        return uv
    for index in range(max_steps):
        yield Progress(index / max_steps, "Unwrapping")
        if factor is None or reuse_count >= MAX_FACTOR_REUSE:
            factor, reuse_count = _factorize(energy.hessian(uv), regularization), 0
        gradient = energy.gradient(uv)
        direction = np.full(gradient.shape, np.nan) if factor is None else -factor.solve(gradient)
        if not np.isfinite(direction).all():
            factor, regularization = None, REGULARIZATION_GROWTH * regularization
            continue
        expected_decrease = -float(gradient @ direction)
        accepted = _line_search(energy, uv, energy.displacement(direction), value, expected_decrease)
        if accepted is not None:
            step, uv, new_value = accepted
            if step < RELAX_BELOW_STEP:
                uv, new_value = _relax_if_better(energy, uv, new_value)
            decrease, value = value - new_value, new_value
            reuse_count = MAX_FACTOR_REUSE if step < REFACTOR_BELOW_STEP else reuse_count + 1
        excess = max(value - energy.lower_bound(), NEGLIGIBLE_ENERGY * energy.lower_bound())
        if accepted is None or max(decrease, 0.5 * expected_decrease) <= tolerance * excess:
            if reuse_count <= 1:
                break
            reuse_count = MAX_FACTOR_REUSE
    return uv


def _line_search(
    energy: UvEnergy, uv: np.ndarray, displacement: np.ndarray, value: float, expected_decrease: float
) -> tuple[float, np.ndarray, float] | None:
    """Return step length, new uv and energy along `displacement` (V, 2); None where no step decreases the energy `value` at `uv`."""
    max_step = MAX_STEP_FRACTION * energy.max_step(uv, displacement)
    step = min(1.0, max_step)
    new_uv = uv + step * displacement
    new_value = energy.value(new_uv)
    while not new_value <= value - ARMIJO * step * expected_decrease:
        step *= 0.5
        if step < MIN_STEP:
            return None
        new_uv = uv + step * displacement
        new_value = energy.value(new_uv)
    while 1.0 <= step < 0.5 * max_step:  # Far from the minimum a Newton step is too short where triangles expand.
        longer_uv = uv + 2.0 * step * displacement
        longer_value = energy.value(longer_uv)
        if longer_value >= new_value:
            break
        step, new_uv, new_value = 2.0 * step, longer_uv, longer_value
    return step, new_uv, new_value


def _relax_if_better(energy: UvEnergy, uv: np.ndarray, value: float) -> tuple[np.ndarray, float]:
    """Return uv with the worst vertices relaxed, and its energy, if that is lower than `value`."""
    relaxed = energy.relax_worst_vertices(uv)
    if relaxed is uv:
        return uv, value
    new_value = energy.value(relaxed)
    return (relaxed, new_value) if new_value < value else (uv, value)


def _factorize(hessian: sparse.csc_array, regularization: float) -> SuperLU | None:
    """Return the factors of a Hessian that is regularized, None if it is singular all the same."""
    shift = regularization * float(np.median(hessian.diagonal()))
    regularized = hessian + shift * sparse.eye_array(hessian.shape[0], format="csc")
    try:
        return splu(regularized, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # Singular.
        return None
