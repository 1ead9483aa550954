"""Compact regions of the primitives on one plane, so that no texture is wasted on the space between distant parts."""

import numpy as np
from scipy.ndimage import label

from ...geometry.transforms import frame_from_normal

MAX_GRID_CELLS = 384  # Cells along the longer side of a plane.
MAX_COMPONENTS = 192  # Bounds the time of joining components, which is quadratic.
MIN_SAVED_FRACTION = 0.5  # A split must save this fraction of a rectangle's area.


def split_into_regions(corners: np.ndarray, owned: np.ndarray, normal: np.ndarray, error: float) -> list[np.ndarray]:
    """Split the primitives on one plane into parts that are worth a rectangle of their own.

    Primitives are connected if their footprints touch on a grid with the resolution of the error. Connected components are joined, the pair
    with the least waste first, until every further pair would waste more than half of its rectangle. Components that own nothing do not get
    a rectangle, but are drawn on the rectangles that contain them.

    Args:
        corners: (K, C, 3) float64 corners of the primitives on the plane.
        owned: (K,) bool, the primitives that the plane has to show.
        normal: (3,) unit normal of the plane.
        error: a length; smaller gaps are ignored.

    Returns:
        One (K,) bool mask per region. Every owned primitive is in at least one.
    """
    low, high = _compute_footprints(corners, normal)
    components = _label_components(low, high, error)
    needed = np.unique(components[owned])
    boxes = _component_boxes(components, low, high)[needed]
    groups = _join(boxes)
    regions = []
    for group in np.unique(groups):
        members = np.flatnonzero(groups == group)
        box_low, box_high = boxes[members, :2].min(axis=0), boxes[members, 2:].max(axis=0)
        is_inside = ((low >= box_low) & (high <= box_high)).all(axis=1)
        regions.append(is_inside & ~(owned & ~np.isin(components, needed[members])))
    return regions


def _compute_footprints(corners: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the minima and maxima (K, 2) of every primitive along the principal axes of the plane."""
    u, v, _ = frame_from_normal(normal)
    local = corners @ np.stack([u, v], axis=1)
    points = local.reshape(-1, 2)
    axes = np.linalg.svd((points - points.mean(axis=0)).T @ (points - points.mean(axis=0)))[0]
    rotated = local @ axes
    return rotated.min(axis=1), rotated.max(axis=1)


def _label_components(low: np.ndarray, high: np.ndarray, error: float) -> np.ndarray:
    """Label (K,) the connected component of every footprint, from 0."""
    origin = low.min(axis=0)
    extent = high.max(axis=0) - origin
    scale = float(extent.max())
    components = np.zeros(len(low), np.int64)
    cell = max(error, scale / MAX_GRID_CELLS)
    while scale > 0.0:
        first, last = ((low - origin) / cell).astype(np.int64), ((high - origin) / cell).astype(np.int64)
        differences = np.zeros(last.max(axis=0) + 2, np.int64)
        for x, y, sign in ((first[:, 0], first[:, 1], 1), (last[:, 0] + 1, first[:, 1], -1), (first[:, 0], last[:, 1] + 1, -1),
                           (last[:, 0] + 1, last[:, 1] + 1, 1)):  # fmt: skip
            np.add.at(differences, (x, y), sign)
        is_filled = differences.cumsum(axis=0).cumsum(axis=1) > 0
        labels, count = label(is_filled, np.ones((3, 3)))
        components = labels[first[:, 0], first[:, 1]] - 1
        if count <= MAX_COMPONENTS:
            break
        cell *= 2.0
    return components


def _component_boxes(components: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Compute the bounding boxes (B, 4) of the components: low x, low y, high x, high y."""
    count = int(components.max()) + 1
    boxes = np.concatenate([np.full((count, 2), np.inf), np.full((count, 2), -np.inf)], axis=1)
    np.minimum.at(boxes[:, :2], components, low)
    np.maximum.at(boxes[:, 2:], components, high)
    return boxes


def _join(boxes: np.ndarray) -> np.ndarray:
    """Group (B,) the boxes: join pairs, least waste first, while at most MIN_SAVED_FRACTION of the joint box is wasted."""
    groups = np.arange(len(boxes))
    boxes, alive = boxes.copy(), np.ones(len(boxes), bool)
    waste = np.stack([_compute_waste(boxes, box) for box in boxes])
    np.fill_diagonal(waste, np.inf)
    while alive.sum() > 1:
        first, second = divmod(int(waste.argmin()), len(boxes))
        if waste[first, second] > MIN_SAVED_FRACTION:
            break
        groups[groups == second] = first
        alive[second] = False
        boxes[first, :2] = np.minimum(boxes[first, :2], boxes[second, :2])
        boxes[first, 2:] = np.maximum(boxes[first, 2:], boxes[second, 2:])
        waste[first] = _compute_waste(boxes, boxes[first])
        waste[first, first] = np.inf
        waste[first, ~alive] = np.inf
        waste[:, first] = waste[first]
        waste[second] = waste[:, second] = np.inf
    return groups


def _compute_waste(boxes: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Compute the empty fraction (B,) of the joint box of `box` and each of `boxes`."""
    joint = np.maximum(boxes[:, 2:], box[2:]) - np.minimum(boxes[:, :2], box[:2])
    joint_area = joint.prod(axis=1)
    filled = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1) + (box[2:] - box[:2]).prod()
    return 1.0 - filled / np.where(joint_area > 0.0, joint_area, 1.0)
