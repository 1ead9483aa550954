"""Answers of judges with what they were asked about, so that answers of several judges about several objects count together."""

import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import FileError, SettingsError
from ...json_values import parse_json
from .calibration import MIN_ANSWERS, Answer, Threshold, answers_from_rows, answers_to_rows, estimate_threshold

MAX_LEVEL = 99
MAX_ANSWERS = 100_000
MAX_ANSWER_BYTES = 2**26  # Limit of a file.


@dataclass(frozen=True)
class RecordedAnswer:
    """An answer.

    Attributes:
        name: of the object.
        stimulus: Weber fraction of the difference that it showed.
        answer: what the judge decided.
        expected_distance: from where on FLIP sees no difference; None in answers that do not tell it.
    """

    name: str
    stimulus: float
    answer: Answer
    expected_distance: float | None = None


def write_answers(records: Sequence[RecordedAnswer]) -> str:
    """Return answers as JSON."""
    rows = answers_to_rows([record.answer for record in records])
    for record, row in zip(records, rows, strict=True):
        row |= {"object": record.name, "stimulus": record.stimulus}
        row |= {} if record.expected_distance is None else {"expected_distance": record.expected_distance}
    return json.dumps(rows)


def read_answers(text: object) -> list[RecordedAnswer]:
    """Return the answers in a JSON text; none in an empty one.

    Raises:
        SettingsError: it is damaged.
    """
    if text in (None, ""):
        return []
    try:
        rows = parse_json(text) if isinstance(text, str) else None
    except ValueError:
        rows = None
    if not isinstance(rows, list) or len(rows) > MAX_ANSWERS:
        raise SettingsError("The recorded answers are damaged; clear them.")
    answers = answers_from_rows(rows, MAX_LEVEL)
    for number, row in enumerate(rows, 1):
        stimulus = row.get("stimulus")
        if not isinstance(stimulus, int | float) or not 0.0 <= stimulus < 1e6 or not isinstance(row.get("object"), str):
            raise SettingsError(f"Row {number} of the answers has no object or no Weber fraction; clear the answers.")
        expected = row.get("expected_distance", 1.0)
        if not isinstance(expected, int | float) or not 0.0 < expected < math.inf:
            raise SettingsError(f"Row {number} of the answers has a distance that is not positive; clear the answers.")
    return [
        RecordedAnswer(row["object"], float(row["stimulus"]), answer, row.get("expected_distance"))
        for row, answer in zip(rows, answers, strict=True)
    ]


def decode_answers(content: bytes, name: str) -> list[RecordedAnswer]:
    """Return the answers in a file.

    name: of the file.

    Raises:
        FileError: it has none, or is damaged.
    """
    try:
        records = read_answers(content.decode())
    except (UnicodeDecodeError, SettingsError):
        records = []
    if not records:
        raise FileError(f'"{name}" has no answers of a calibration; save them again from the scene in which they were given.')
    return records


def merge_answers(parts: Iterable[Sequence[RecordedAnswer]]) -> list[RecordedAnswer]:
    """Return the answers of several judges or files in their order. Those that an earlier part has do not count again."""
    merged: list[RecordedAnswer] = []
    for part in parts:
        known = Counter(merged)
        for record in part:
            if known[record]:
                known[record] -= 1
            else:
                merged.append(record)
    return merged


def estimate_recorded(records: Sequence[RecordedAnswer]) -> Threshold:
    """Return the threshold of all answers together.

    Raises:
        SettingsError: as `estimate_threshold`.
    """
    answers = [replace(record.answer, level=number) for number, record in enumerate(records, 1)]
    return estimate_threshold(answers, np.array([record.stimulus for record in records]))


def estimate_distance_factor(records: Sequence[RecordedAnswer]) -> float:
    """Return the factor by which judges moved levels farther away than FLIP does until they looked the same: the median of all answers.

    Raises:
        SettingsError: fewer than MIN_ANSWERS answers tell a distance.
    """
    ratios = [record.answer.accepted_distance / record.expected_distance for record in records if record.expected_distance is not None]
    if len(ratios) < MIN_ANSWERS:
        raise SettingsError(f"{len(ratios)} answers with distances are too few to estimate a factor; give at least {MIN_ANSWERS}.")
    return float(np.median(ratios))
