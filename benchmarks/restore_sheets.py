"""Contact sheets of `bench_restore.py`: restored images side by side, at 100 % and three times nearer."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from restore_cases import Comparison

from lib.contact_sheet import draw_contact_sheet, enlarge, write_png

NEARER = 3  # factor of the second sheet


def write_sheets(folder: Path, name: str, comparisons: Sequence[Comparison], methods: Sequence[str]) -> None:
    """Write the images of one texture, a row per mask, as `NAME.png` and `NAME nearer.png`. The text shows two scores of each mask:
    patch distance and boundary energy, or contour error and FLIP."""
    folder.mkdir(parents=True, exist_ok=True)
    columns = ["masked", "truth", *methods]
    labels = [[column, *describe(comparisons, column)] for column in columns]
    rows = [[draw_panel(comparison, column) for column in columns] for comparison in comparisons]
    nearer = [
        [enlarge(image[area], NEARER) for image in images]
        for images, area in zip(rows, (find_detail(comparison.case.mask) for comparison in comparisons), strict=True)
    ]
    for suffix, images in (("", rows), (" nearer", nearer)):
        title = f"{name}{suffix}"
        sheet = draw_contact_sheet(title, images, [comparison.case.mask_name for comparison in comparisons], labels)
        write_png(folder / f"{name}{suffix}.png", sheet)


def draw_panel(comparison: Comparison, column: str) -> np.ndarray:
    """Return the image (H, W, 3) of one method, the masked image, or a gray image where the method failed."""
    case = comparison.case
    if column == "masked":
        return np.where(case.mask[..., None], [1.0, 0.0, 1.0], case.image)
    image = comparison.images.get(column, np.full_like(case.image, 0.5))
    return np.broadcast_to(image, (*image.shape[:2], 3))


def describe(comparisons: Sequence[Comparison], column: str) -> list[str]:
    """Return the scores of a method, one line per mask."""
    found = [comparison.scores.get(column, {}) for comparison in comparisons]
    pairs = (("distance", "boundary"), ("contours", "flip"))
    return ["  ".join(f"{scores[name]:.4f}" for pair in pairs if pair[0] in scores for name in pair) for scores in found]


def find_detail(mask: np.ndarray) -> tuple[slice, slice]:
    """Return the rows and columns of the part of the image, a third of its size, whose fraction of boundary pixels is largest."""
    from scipy.ndimage import binary_dilation, uniform_filter

    boundary = binary_dilation(mask) & ~mask
    size = tuple(side // NEARER for side in mask.shape)
    density = uniform_filter(boundary.astype(np.float64), size, mode="constant")
    inner = tuple(slice(length // 2, side - length + length // 2 + 1) for side, length in zip(mask.shape, size, strict=True))
    row, column = np.unravel_index(density[inner].argmax(), density[inner].shape)
    return slice(row, row + size[0]), slice(column, column + size[1])
