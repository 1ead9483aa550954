"""All that a layout's energy is made of: stretch, and where asked for what keeps triangles in shape and the border from itself."""

from collections.abc import Callable

import numpy as np
from scipy import sparse

from .assembly import Assembly, assembled
from .border_barrier import BorderBarrier
from .shape_barrier import ShapeBarrier
from .stretch_energy import StretchEnergy


class LayoutEnergy:
    """See `newton.Energy`. assembly: of the stretch's triangles. border: None where it does not move. mend: see `mended`."""

    def __init__(
        self,
        assembly: Assembly,
        stretch: StretchEnergy,
        shapes: list[ShapeBarrier],
        border: BorderBarrier | None,
        mend: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        self._assembly, self._stretch, self._shapes, self._border, self.mended = assembly, stretch, shapes, border, mend

    def value(self, layout: np.ndarray) -> float:
        """The energy; infinite where triangles are flipped, out of shape, or the border crosses itself."""
        total = self._stretch.value(layout)
        for each in (*self._shapes, self._border):
            if each is not None and np.isfinite(total):
                total += each.value(layout)
        return total

    def least(self) -> float:
        """What no layout goes below."""
        return self._stretch.least()

    def longest_step(self, layout: np.ndarray, move: np.ndarray) -> float:
        """The multiple of `move` (V, 2) at which a triangle has no area left, or the border comes upon itself."""
        farthest = self._stretch.longest_step(layout, move)
        return farthest if self._border is None else min(farthest, self._border.longest_step(layout, move))

    def slope(self, layout: np.ndarray) -> np.ndarray:
        """Slope (N,) by the unknowns."""
        total = self._stretch.slope(layout)
        for shape in self._shapes:
            np.add.at(total, *shape.slopes(layout))
        made = self._assembly.slope(total)
        if self._border is not None:
            vertices, slopes = self._border.slopes(layout)
            made += assembled(self._assembly.unknowns(vertices), slopes, self._assembly.size)
        return made

    def bend(self, layout: np.ndarray) -> sparse.csc_array:
        """Bend (N, N) by the unknowns, positive."""
        total = self._stretch.bend(layout)
        for shape in self._shapes:
            np.add.at(total, *shape.bends(layout))
        made = self._assembly.bend(total)
        if self._border is not None:
            vertices, bends = self._border.bends(layout)
            made = made + assembled(self._assembly.unknowns(vertices), bends, self._assembly.size)
        return made

    def move(self, unknowns: np.ndarray) -> np.ndarray:
        """Moves (V, 2) from the `unknowns` (N,)."""
        return self._assembly.move(unknowns)
