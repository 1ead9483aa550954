"""What prevents a triangle count from being reached, in words."""

import numpy as np

from .collapse_guards import FLIP, FOLD, SHORT_CURVE, TOPOLOGY, VALID
from .engine import CollapseEngine

REFUSALS = {
    VALID: "{} without a possible collapse",
    FOLD: "{} that would fold the surface over",
    FLIP: "{} that would flip texture coordinates",
    SHORT_CURVE: "{} that would remove the last triangle of an island or of a loop of seams",
    TOPOLOGY: "{} that would pinch the surface or close a component",
}


def name_constraint(engine: CollapseEngine, target: int) -> str:
    """Return a sentence that names what keeps the current vertices from being removed, the most frequent reason first."""
    topology = engine.topology
    is_kept = topology.is_used & ~topology.is_removable
    counts = {
        "{} at corners, crossings or ends of seams and boundaries": np.count_nonzero(is_kept & ~topology.is_locked),
        "{} at edges with more than two triangles or opposite orientations": np.count_nonzero(is_kept & topology.is_locked),
    }
    for reason, text in REFUSALS.items():
        counts[text] = np.count_nonzero(topology.is_removable & (engine.reasons == reason))
    parts = [text.format(count) for text, count in sorted(counts.items(), key=lambda item: -item[1]) if count]
    total = np.count_nonzero(topology.is_used)
    return f"{engine.triangle_count} triangles remain instead of {target}, because of {total} vertices these stay: {', '.join(parts)}."
