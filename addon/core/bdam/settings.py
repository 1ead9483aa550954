"""Settings of *Large Terrain*."""

from dataclasses import dataclass

from ..settings import Choice, Settings, setting

LEAVES = {
    "16": Choice("16", "Patches of about 256 triangles, as in the paper: finer steps of detail, more patches"),
    "32": Choice("32", "Patches of about 1,000 triangles"),
    "64": Choice("64", "Patches of about 4,000 triangles: fewer and larger steps of detail"),
}


@dataclass(frozen=True, kw_only=True)
class BdamSettings(Settings):
    """Settings of the build of a large terrain."""

    leaf: str = setting("32", "Samples along the short edges of the finest patches", label="Patch Size", choices=LEAVES)
    height_step: float = setting(
        0.0,
        "Meters between two heights that are stored. 0 for that of the source, or a two-hundredth of a cell",
        minimum=0.0,
        maximum=1000.0,
    )
    cell_size: float = setting(1.0, "Meters between two samples of a source without a position", minimum=1e-3, maximum=1e6)
    image_height: float = setting(100.0, "Meters between black and white of a source that is an image", minimum=1e-3, maximum=1e6)
    allow_gaps: bool = setting(False, "Accept several sources that do not fill their common rectangle; the gaps become holes")
    executor: str = setting(
        "processes",
        "Where patches are built: serial, processes, processes:N, or dask:tcp://HOST:PORT. Dask needs a work folder that all share",
    )
