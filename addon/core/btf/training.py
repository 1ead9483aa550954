"""The views of a bake as the refinement asks for them: what it asks for again and again lies in memory, or in the work folder."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from threading import Lock

import numpy as np

from .fragments import Fragments, fragments_of
from .refine import RAYS, Look
from .shards import ShardStore
from .texels import Quads, Texels, View

KEPT_BYTES = 4e8  # of fragments and their colours; those of further views lie in the folder


@dataclass
class _Memory:
    """Fragments and their colours by the number of their view, and how deep they lie; threads may keep some at the same time."""

    free: float = KEPT_BYTES
    kept: dict[int, tuple[Fragments, np.ndarray]] = field(default_factory=dict)
    deepest: dict[int, int] = field(default_factory=dict)
    lock: Lock = field(default_factory=Lock)

    def keep(self, number: int, fragments: Fragments, colours: np.ndarray) -> bool:
        """Whether there is room; then they are kept."""
        with self.lock:
            fits = fragments.bytes + colours.nbytes <= self.free
            if fits:
                self.free -= fragments.bytes + colours.nbytes
                self.kept[number] = fragments, colours
        return fits


@dataclass(frozen=True)
class TrainingView:
    """A finished view of a bake, see `refine.Training`."""

    quads: Quads
    texels: Texels
    view: View
    store: ShardStore
    number: int
    memory: _Memory

    def fragments(self) -> Fragments:
        """What rays of the view meet, found anew."""
        found = fragments_of(self.quads, self.texels, self.view, RAYS)
        self.memory.deepest[self.number] = found.deepest
        return found

    def deepest(self) -> int:
        """The most quads behind each other along a ray; fragments are found for it where they have not been."""
        if self.number not in self.memory.deepest:
            self.fragments()
        return self.memory.deepest[self.number]

    def keep(self, fragments: Fragments, colours: np.ndarray) -> None:
        """Keep what `fragments` gave and what they show, for `look`. Raises FileError when the disk does not take it."""
        if not self.memory.keep(self.number, fragments, colours):
            self.store.write_look(self.number, fragments, colours)

    def look(self) -> Look:
        """What `keep` has kept, and what the original looks like; raises FileError when a file is gone or damaged."""
        kept = self.memory.kept.get(self.number)
        return Look(*(self.store.read_look(self.number) if kept is None else kept), self.store.photograph(self.number))


def training_views(quads: Quads, texels: Texels, views: Sequence[View], store: ShardStore) -> list[TrainingView]:
    """All `views`, which must stand in `store`."""
    memory = _Memory()
    return [TrainingView(quads, texels, view, store, number, memory) for number, view in enumerate(views)]
