"""Whether a level between the finest one and the next pays for its bytes, which the finest level needs as well."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .manifest import MeshLevel
from .planning import ErrorTable, PlanRow, make_plan
from .textures.building import BuiltTextures

INSERTED_FRACTION = 0.7  # of the triangles of the finest level, at most
ERRORS = np.geomspace(0.07, 0.04, 16)  # around which models begin to look right: what plans are compared at
MIN_GAIN = 0.01  # of the bytes with which plans have these errors, on the average of their logarithms


def leave_out_error(table: ErrorTable) -> ErrorTable:
    """Return `table` without the last level but one."""
    return replace(table, level_errors=np.delete(table.level_errors, -2))


def is_worthwhile(levels: Sequence[MeshLevel], table: ErrorTable, built: BuiltTextures) -> bool:
    """Return whether plans with the last level but one need clearly fewer bytes for ERRORS than plans without it.

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
    errors = ERRORS[(without[0].error > ERRORS) & (without[-1].error <= ERRORS)]
    if not len(errors):
        return False
    return bool(np.log(find_bytes(with_it, errors) / find_bytes(without, errors)).mean() <= np.log1p(-MIN_GAIN))


def find_bytes(plan: Sequence[PlanRow], errors: np.ndarray) -> np.ndarray:
    """Return the bytes (N,) of the first rows of `plan` whose errors are at most `errors` (N,), which the last row reaches."""
    found = np.array([row.error for row in plan])
    counts = np.array([row.byte_count for row in plan], np.float64)
    return counts[np.searchsorted(-found, -errors)]
