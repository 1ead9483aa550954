"""Compact regions of what lies on one plane: texture is not spent on the space between far parts."""

import numpy as np
from scipy.ndimage import label

GRID = 384  # most cells along the longer side of a plane
MAX_PARTS = 192
SAVED_SHARE = 0.5  # of a rectangle's area that a split has to save


def split_into_regions(corners: np.ndarray, owned: np.ndarray, normal: np.ndarray, error: float) -> list[np.ndarray]:
    """Parts of the primitives on one plane that are worth a rectangle of their own.

    Primitives connect where their footprints touch on a grid as fine as the error. Connected parts are joined again, the pair first that
    wastes least, until every further joint would waste more than half of its rectangle. Parts that own nothing bring no rectangle, but are
    drawn on the rectangles that hold them.

    Args:
        corners: (K, C, 3) float64 corners of the primitives on the plane.
        owned: (K,) bool, the primitives that the plane answers for.
        normal: (3,) unit normal of the plane.
        error: length that one does not see.

    Returns:
        One (K,) bool mask a region. Every owned primitive is in one at least.
    """
    low, high = _footprints(corners, normal)
    parts = _connected(low, high, error)
    needed = np.unique(parts[owned])
    boxes = _part_boxes(parts, low, high)[needed]
    groups = _join(boxes)
    regions = []
    for group in np.unique(groups):
        members = np.flatnonzero(groups == group)
        box_low, box_high = boxes[members, :2].min(axis=0), boxes[members, 2:].max(axis=0)
        inside = ((low >= box_low) & (high <= box_high)).all(axis=1)
        regions.append(inside & ~(owned & ~np.isin(parts, needed[members])))
    return regions


def _footprints(corners: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Low and high (K, 2) of every primitive along the principal axes of the plane."""
    helper = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    helper /= np.linalg.norm(helper)
    flat = corners @ np.stack([helper, np.cross(normal, helper)], axis=1)
    points = flat.reshape(-1, 2)
    axes = np.linalg.svd((points - points.mean(axis=0)).T @ (points - points.mean(axis=0)))[0]
    turned = flat @ axes
    return turned.min(axis=1), turned.max(axis=1)


def _connected(low: np.ndarray, high: np.ndarray, error: float) -> np.ndarray:
    """Label (K,) of the connected part of every footprint, from 0."""
    start = low.min(axis=0)
    extent = high.max(axis=0) - start
    scale = float(extent.max())
    parts = np.zeros(len(low), np.int64)
    cell = max(error, scale / GRID)
    while scale > 0.0:
        first, last = ((low - start) / cell).astype(np.int64), ((high - start) / cell).astype(np.int64)
        marks = np.zeros(last.max(axis=0) + 2, np.int64)
        for x, y, sign in ((first[:, 0], first[:, 1], 1), (last[:, 0] + 1, first[:, 1], -1), (first[:, 0], last[:, 1] + 1, -1),
                           (last[:, 0] + 1, last[:, 1] + 1, 1)):  # fmt: skip
            np.add.at(marks, (x, y), sign)
        filled = marks.cumsum(axis=0).cumsum(axis=1) > 0
        labels, count = label(filled, np.ones((3, 3)))
        parts = labels[first[:, 0], first[:, 1]] - 1
        if count <= MAX_PARTS:
            break
        cell *= 2.0
    return parts


def _part_boxes(parts: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(P, 4) boxes of the parts: low x, low y, high x, high y."""
    count = int(parts.max()) + 1
    boxes = np.concatenate([np.full((count, 2), np.inf), np.full((count, 2), -np.inf)], axis=1)
    np.minimum.at(boxes[:, :2], parts, low)
    np.maximum.at(boxes[:, 2:], parts, high)
    return boxes


def _join(boxes: np.ndarray) -> np.ndarray:
    """Group (P,) of every box: pairs are joined, the least waste first, while less than SAVED_SHARE of the joint box is wasted."""
    groups = np.arange(len(boxes))
    boxes, alive = boxes.copy(), np.ones(len(boxes), bool)
    waste = np.stack([_waste(boxes, box) for box in boxes])
    np.fill_diagonal(waste, np.inf)
    while alive.sum() > 1:
        first, second = divmod(int(waste.argmin()), len(boxes))
        if waste[first, second] > SAVED_SHARE:
            break
        groups[groups == second] = first
        alive[second] = False
        boxes[first, :2] = np.minimum(boxes[first, :2], boxes[second, :2])
        boxes[first, 2:] = np.maximum(boxes[first, 2:], boxes[second, 2:])
        waste[first] = _waste(boxes, boxes[first])
        waste[first, first] = np.inf
        waste[first, ~alive] = np.inf
        waste[:, first] = waste[first]
        waste[second] = waste[:, second] = np.inf
    return groups


def _waste(boxes: np.ndarray, box: np.ndarray) -> np.ndarray:
    """(P,) share of the box around `box` and each of `boxes` that neither fills."""
    joint = np.maximum(boxes[:, 2:], box[2:]) - np.minimum(boxes[:, :2], box[:2])
    joint_area = joint.prod(axis=1)
    filled = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1) + (box[2:] - box[:2]).prod()
    return 1.0 - filled / np.where(joint_area > 0.0, joint_area, 1.0)
