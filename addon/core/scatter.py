"""Settings of plants and rocks that are scattered on landscapes."""

from dataclasses import dataclass

from .settings import Choice, Settings, setting

KINDS = {
    "meadow": Choice("Meadow", "Grass with groups of bushes and stones, trees in hollows, and rubble below cliffs"),
    "forest": Choice("Forest", "Conifers with grass and bushes between them, and rubble below cliffs"),
    "rocks": Choice("Rocks", "Groups of stones, and rubble below cliffs and on hillsides"),
    "steppe": Choice("Steppe", "Dry tufts, groups of bushes and stones, and rubble below cliffs"),
}


@dataclass(frozen=True, kw_only=True)
class ScatterSettings(Settings):
    """Settings of *Scatter*."""

    kind: str = setting("meadow", "What grows and lies on the ground", choices=KINDS)
    density: float = setting(1.0, "Factor of the number of plants and rocks", minimum=0.0, maximum=10.0)
    distance: float = setting(1.0, "Factor of the distances to the camera up to which they are there", minimum=0.1, maximum=10.0)
    wind: float = setting(0.0, "How far plants lean and sway in the wind; more than 0 takes time for every frame", minimum=0.0, maximum=1.0)
    seed: int = setting(0, "Seed of all places and shapes", minimum=0, maximum=10_000)
