"""Whether a level between the finest one and the next pays for its bytes, which the finest level needs as well."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .allocation import ErrorTable, PlanRow, make_plan
from .manifest import MeshLevel
from .textures.building import BuiltTextures

INSERTED_FRACTION = 0.65  # of the triangles of the finest level, at most
MIN_GAIN = 0.005  # of the error, on the average over the logarithm of the bytes
MIN_ERROR = 1e-3  # smaller errors count as this


def leave_out_error(table: ErrorTable) -> ErrorTable:
    """Return `table` without the last level but one."""
    return replace(table, level_errors=np.delete(table.level_errors, -2))


def is_worthwhile(levels: Sequence[MeshLevel], table: ErrorTable, built: BuiltTextures) -> bool:
    """Return whether plans with the last level but one predict clearly smaller errors than plans without it.

    Without it, the finest level would need its positions and texture coordinates, but neither its triangles nor its parents.

    Args:
        levels: coarsest first, at least three. table: with their errors.
    """
    sizes = np.cumsum([level.size for level in levels]).tolist()
    inserted = levels[-2]
    finest = sizes[-1] - inserted.corners.size - inserted.wedges.size - inserted.parents.size
    states = built.increments.measure_states(len(built.flips))
    with_it = make_plan(table.predict(built.flips).tabulate(), sizes, states)
    without = make_plan(leave_out_error(table).predict(built.flips).tabulate(), [*sizes[:-2], finest], states)
    end = without[-1].byte_count
    return average_log_error(with_it, end) <= average_log_error(without, end) + np.log1p(-MIN_GAIN)


def average_log_error(plan: Sequence[PlanRow], end: int) -> float:
    """Return the logarithm of the error of the best row for each number of bytes, averaged over the logarithm of the bytes from the first
    row to `end`."""
    rows = [row for row in plan if row.byte_count < end] or list(plan[:1])
    widths = np.diff(np.log([max(count, 1) for count in (*(row.byte_count for row in rows), end)]))
    errors = np.log([max(row.error, MIN_ERROR) for row in rows])
    return float(np.average(errors, weights=widths)) if widths.sum() > 0.0 else float(errors[-1])
