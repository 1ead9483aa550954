"""The paper's experiment (section IV.A): judges move a simplified object until it looks like the original, and a threshold is estimated.

The original turns at the left, the simplified object at the right, at a distance that grows linearly with its scale. A judge who sees a
difference moves it away; otherwise the judge moves it nearer, until a difference is seen. Answers are rows for a JSON file.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...errors import SettingsError

START_JITTER = 0.2  # Relative variation of the start distance, so that judges do not learn it.
MAX_DISTANCE = 1e30
MIN_ANSWERS = 8
RIDGE = 1e-2  # weight of the prior on the steepness, in units of the spread of the stimuli: answers that separate perfectly stay finite
MAX_STEPS, STEP_TOLERANCE = 100, 1e-10  # Limits of Newton's method.
NORMAL_QUANTILE = 1.959964  # Quantile of the normal distribution for a 95 % confidence interval.
BINS = 6  # Bins of stimuli, for the correlation.


@dataclass(frozen=True)
class Trial:
    """What a judge is shown: the level, 1 for the first below the original, and the distance at the start, in the unit of the scene."""

    level: int
    start_distance: float


@dataclass(frozen=True)
class Answer:
    """What a judge decided. level, start_distance: of the trial. accepted_distance: nearest one at which the levels look the same."""

    level: int
    start_distance: float
    accepted_distance: float

    @property
    def is_noticed(self) -> bool:
        """Whether the judge saw a difference at the start and moved the object farther away."""
        return self.accepted_distance > self.start_distance


@dataclass(frozen=True)
class Threshold:
    """A psychometric function.

    The probability that a difference of `stimulus` is noticed is 1 / (1 + exp(-steepness (stimulus - value))).

    Attributes:
        value: the threshold, noticed in half of all trials.
        low, high: its 95 % confidence interval.
        steepness: per unit of the stimulus.
        correlation: between the function and the fractions of answers that noticed a difference, NaN if either is constant.
        answers: their number.
    """

    value: float
    low: float
    high: float
    steepness: float
    correlation: float
    answers: int


def next_trial(answers: Sequence[Answer], level_count: int, farthest: float, seed: int) -> Trial:
    """Return the trial after `answers`. The same seed and number of answers give the same trial.

    Every level is shown once, in random order, before any is shown again. The start distance of level i is about i / `level_count` of
    `farthest`, the distance at which the coarsest level is shown.

    Raises:
        SettingsError: there is no level, or `farthest` is not a positive distance.
    """
    if level_count < 1 or not 0.0 < farthest <= MAX_DISTANCE:
        raise SettingsError("An experiment needs at least one level and a positive distance of the coarsest one; make levels first.")
    turn, position = divmod(len(answers), level_count)
    random = np.random.default_rng([seed, turn])
    order, jitters = random.permutation(level_count), random.uniform(-START_JITTER, START_JITTER, level_count)
    level = int(order[position]) + 1
    return Trial(level, float(farthest * level / level_count * (1.0 + jitters[position])))


def record_answer(trial: Trial, accepted_distance: float) -> Answer:
    """Return the answer to `trial`: where the judge left the object.

    Raises:
        SettingsError: the distance is not positive.
    """
    if not 0.0 < accepted_distance <= MAX_DISTANCE:
        raise SettingsError(f"The accepted distance must be positive, not {accepted_distance:g}.")
    return Answer(trial.level, trial.start_distance, float(accepted_distance))


def answers_to_rows(answers: Sequence[Answer]) -> list[dict[str, Any]]:
    """Return `answers` as rows for JSON."""
    return [asdict(answer) for answer in answers]


def answers_from_rows(rows: object, level_count: int) -> list[Answer]:
    """Return the answers of JSON `rows`.

    Raises:
        SettingsError: a row is damaged, or refers to a level that does not exist.
    """
    answers = []
    for number, row in enumerate(rows if isinstance(rows, list) else [None], 1):
        values = [row.get(name) for name in ("level", "start_distance", "accepted_distance")] if isinstance(row, dict) else []
        are_numbers = [isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) for value in values]
        if len(values) != 3 or not all(are_numbers) or not 1 <= values[0] <= level_count or min(values[1:]) <= 0.0:
            raise SettingsError(f"Row {number} of the answers is not that of a level from 1 to {level_count} with positive distances.")
        answers.append(Answer(int(values[0]), float(values[1]), float(values[2])))
    return answers


def estimate_threshold(answers: Sequence[Answer], stimuli: np.ndarray) -> Threshold:
    """Return the threshold between unnoticed and noticed differences, by logistic regression.

    Args:
        stimuli: (L,) Weber fraction of each level, in the order of their numbers.

    Raises:
        SettingsError: there are less than 8 answers, all agree, or all levels that were judged have the same fraction.
    """
    if len(answers) < MIN_ANSWERS:
        raise SettingsError(f"{len(answers)} answers are too few to estimate a threshold; give at least {MIN_ANSWERS}.")
    intensities = np.array([stimuli[answer.level - 1] for answer in answers], np.float64)
    noticed = np.array([answer.is_noticed for answer in answers], np.float64)
    spread = float(intensities.std())
    if noticed.min() == noticed.max() or spread <= 0.0:
        raise SettingsError("All answers agree, so that no threshold lies between them; judge levels that differ more.")
    center = float(intensities.mean())
    coefficients, covariance = _fit_logistic((intensities - center) / spread, noticed)
    offset, steepness = coefficients
    if steepness <= 0.0:
        raise SettingsError("Small differences were noticed more often than large ones; repeat the experiment.")
    position = -offset / steepness
    gradient = np.array([-1.0 / steepness, offset / steepness**2])  # Gradient of the position, for the delta method.
    half = NORMAL_QUANTILE * math.sqrt(float(gradient @ covariance @ gradient))
    value = center + spread * position
    fitted = 1.0 / (1.0 + np.exp(-(offset + steepness * (intensities - center) / spread)))
    correlation = _correlate_bins(intensities, noticed, fitted)
    return Threshold(value, value - spread * half, value + spread * half, float(steepness / spread), correlation, len(answers))


def _fit_logistic(x: np.ndarray, noticed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return offset and steepness (2,) of the logistic function of standardized `x` (N,), and their covariance, by Newton's method."""
    design = np.stack([np.ones_like(x), x], axis=1)
    prior = RIDGE * np.diag([0.0, 1.0])
    coefficients = np.zeros(2)

    def objective(candidate: np.ndarray) -> float:
        linear = design @ candidate
        return float((np.logaddexp(0.0, linear) - noticed * linear).sum() + 0.5 * candidate @ prior @ candidate)

    for _ in range(MAX_STEPS):
        fitted = 1.0 / (1.0 + np.exp(-np.clip(design @ coefficients, -500.0, 500.0)))
        gradient = design.T @ (fitted - noticed) + prior @ coefficients
        hessian = design.T @ (design * (fitted * (1.0 - fitted))[:, None]) + prior
        step = np.linalg.solve(hessian, gradient)
        length = 1.0
        while objective(coefficients - length * step) > objective(coefficients) and length > STEP_TOLERANCE:
            length *= 0.5
        coefficients = coefficients - length * step
        if np.abs(length * step).max() < STEP_TOLERANCE:
            break
    return coefficients, np.linalg.inv(hessian)


def _correlate_bins(stimuli: np.ndarray, noticed: np.ndarray, fitted: np.ndarray) -> float:
    """Return Pearson's correlation between the fractions of noticed answers and the fitted ones, over groups of similar stimuli."""
    groups = np.array_split(np.argsort(stimuli, kind="stable"), min(BINS, len(np.unique(stimuli))))
    observed, predicted = (np.array([values[group].mean() for group in groups]) for values in (noticed, fitted))
    if observed.std() == 0.0 or predicted.std() == 0.0:
        return math.nan
    return float(np.corrcoef(observed, predicted)[0, 1])
