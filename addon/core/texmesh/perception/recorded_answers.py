"""Answers of judges with what they were asked about, so that answers about several objects count together."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import SettingsError
from ...json_values import parse_json
from .calibration import Answer, Threshold, answers_from_rows, answers_to_rows, estimate_threshold

MAX_LEVEL = 99
MAX_ANSWERS = 100_000


@dataclass(frozen=True)
class RecordedAnswer:
    """An answer about an object, and the Weber fraction of the difference that it showed."""

    name: str
    stimulus: float
    answer: Answer


def write_answers(records: Sequence[RecordedAnswer]) -> str:
    """Return answers as JSON."""
    rows = answers_to_rows([record.answer for record in records])
    return json.dumps([{"object": record.name, "stimulus": record.stimulus, **row} for record, row in zip(records, rows, strict=True)])


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
    return [RecordedAnswer(row["object"], float(row["stimulus"]), answer) for row, answer in zip(rows, answers, strict=True)]


def estimate_recorded(records: Sequence[RecordedAnswer]) -> Threshold:
    """Return the threshold of all answers together.

    Raises:
        SettingsError: as `estimate_threshold`.
    """
    answers = [replace(record.answer, level=number) for number, record in enumerate(records, 1)]
    return estimate_threshold(answers, np.array([record.stimulus for record in records]))
