"""The photograph that each triangle is textured from.

Minimizes the sum of how much worse than the best each triangle's photograph is, and of a penalty per pair of neighbors with different
photographs (as in Lempitsky and Ivanov, "Seamless Mosaicing of Image-Based Texture Maps", 2007), by loopy belief propagation.
"""

import numpy as np

from ..geometry.edges import Edges

ITERATIONS = 60
DAMPING = 0.5
SMOOTHNESS = 0.6  # of a pair of neighbors with different photographs; the loss of a photograph with half the resolution is 1


def choose_labels(qualities: np.ndarray, edges: Edges) -> np.ndarray:
    """Return the photograph (T,) int32 of each triangle, -1 where none sees it.

    qualities: (T, K) float, how well each photograph shows each triangle, 0 where it does not.
    """
    best = qualities.max(axis=1, initial=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        losses = np.where(qualities > 0.0, np.log2(best[:, None] / qualities), np.inf)
    losses = np.where(np.isfinite(losses), np.minimum(losses, 20.0), 40.0)
    losses[best <= 0.0] = 0.0
    halfedges = edges.interior_halfedges // 3
    to, back = np.concatenate([halfedges[:, 1], halfedges[:, 0]]), np.concatenate([halfedges[:, 0], halfedges[:, 1]])
    count = len(halfedges)
    reverse = np.concatenate([np.arange(count, 2 * count), np.arange(count)])
    messages = np.zeros((2 * count, qualities.shape[1]), np.float32)
    order = np.argsort(to, kind="stable")
    starts = np.searchsorted(to[order], np.arange(len(qualities) + 1))
    for _ in range(ITERATIONS):
        outgoing = _beliefs(losses, messages, order, starts)[back] - messages[reverse]
        outgoing = np.minimum(outgoing, outgoing.min(axis=1, keepdims=True) + SMOOTHNESS)
        outgoing -= outgoing.min(axis=1, keepdims=True)
        change = float(np.abs(outgoing - messages).max(initial=0.0))
        messages += (1.0 - DAMPING) * (outgoing - messages)
        if change < 0.01:
            break
    labels = _beliefs(losses, messages, order, starts).argmin(axis=1)
    return np.where(best > 0.0, labels, -1).astype(np.int32)


def _beliefs(losses: np.ndarray, messages: np.ndarray, order: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return the losses (T, K) plus the sums of the messages to each triangle."""
    sums = np.concatenate([np.zeros((1, messages.shape[1])), np.cumsum(messages[order], axis=0, dtype=np.float64)])
    return losses + (sums[starts[1:]] - sums[starts[:-1]])
