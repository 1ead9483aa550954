"""The views of a bake as the refinement asks for them, with what it asks for again and again kept as long as memory allows."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from .fragments import Fragments, fragments_of
from .photographs import Photograph
from .refine import RAYS
from .shards import ShardStore
from .texels import Quads, Texels, View

KEPT_BYTES = 4e8  # of fragments; those of further views are found anew at every step


@dataclass
class _Memory:
    """Fragments by the number of their view."""

    free: float = KEPT_BYTES
    kept: dict[int, Fragments] = field(default_factory=dict)


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
        """What rays of the view meet."""
        kept = self.memory.kept.get(self.number)
        if kept is not None:
            return kept
        found = fragments_of(self.quads, self.texels, self.view, RAYS)
        if found.bytes <= self.memory.free:
            self.memory.free -= found.bytes
            self.memory.kept[self.number] = found
        return found

    def photograph(self) -> Photograph:
        """What the original looks like."""
        return self.store.photograph(self.number)


def training_views(quads: Quads, texels: Texels, views: Sequence[View], store: ShardStore) -> list[TrainingView]:
    """All `views`, which must stand in `store`."""
    memory = _Memory()
    return [TrainingView(quads, texels, view, store, number, memory) for number, view in enumerate(views)]
