"""What a bake of a standing cloud will take, and how far one that was stopped has come. Cheap enough for every redraw of the panel."""

import hashlib
import tempfile
from pathlib import Path

import numpy as np

from ..bridge import clouds
from ..bridge.btf_clouds import texels_of_level
from ..bridge.btf_snapshot import store_folder
from ..core.btf.estimate import BakeEstimate, LevelExtent, estimate, side_of
from ..core.btf.settings import BtfSettings
from ..core.btf.shards import ShardStore
from ..core.btf.texels import Texels
from ..core.errors import SettingsError
from ..core.parallel import read_word
from .billboards_clouds import StandingCloud

_latest: tuple[tuple, list[LevelExtent]] | None = None  # a cloud as it was, and its extents
_paces: dict[str, float] = {}  # by the name of the cloud, latest last: how bakes of this session went against their estimates


def work_folder(cloud: StandingCloud, settings: BtfSettings) -> Path:
    """Where finished views of a bake wait for its end: one folder for each cloud and each set of renders."""
    errors = " ".join(f"{error:.9g}" for error in cloud.errors)
    words = f"{cloud.collection.get(clouds.FINGERPRINT, '')} {errors} {settings.of_capture}"
    return Path(tempfile.gettempdir()) / f"farfield-btf-{hashlib.sha256(words.encode()).hexdigest()[:16]}"


def views_done(cloud: StandingCloud, settings: BtfSettings) -> int:
    """Views of all levels that stand in the work folder of a bake that was stopped."""
    folder = work_folder(cloud, settings)
    if not folder.is_dir():
        return 0
    stores = [ShardStore(store_folder(folder, number)) for number in range(len(cloud.levels))]
    return sum(store.has(view) for store in stores for view in range(settings.views))


def estimated(cloud: StandingCloud, settings: BtfSettings) -> BakeEstimate:
    """What a bake of all levels of `cloud` will take, at the pace of its last bake in this session, or else of any cloud's.

    Raises:
        SettingsError: when there is no such executor.
    """
    word = read_word(settings.executor)
    pace = _paces.get(cloud.collection.name, next(reversed(_paces.values()), 1.0))
    # How many workers a scheduler has is not asked while a panel is drawn.
    return estimate(_extents(cloud), settings, word.processes if word.scheduler is None else 1, pace)


def remember_pace(cloud: StandingCloud, settings: BtfSettings, seconds: float) -> None:
    """Let later estimates know that a whole bake took so many `seconds`."""
    name = cloud.collection.name
    expected = estimated(cloud, settings).seconds / _paces.get(name, next(reversed(_paces.values()), 1.0))
    _paces.pop(name, None)
    _paces[name] = seconds / expected


def check(settings: BtfSettings) -> str:
    """What is wrong with the settings, or an empty string."""
    try:
        _ = settings.view_grid, settings.light_grid, read_word(settings.executor)
    except SettingsError as error:
        return str(error)
    return ""


def _extents(cloud: StandingCloud) -> list[LevelExtent]:
    """Texels and picture sides of the levels. Worked out once for each state of a cloud: too slow for every redraw."""
    global _latest
    state = (cloud.collection.get(clouds.FINGERPRINT), *((level.name, level["farfield_error"], *level.location) for level in cloud.levels))
    if _latest is None or _latest[0] != state:
        _latest = state, [_extent(texels_of_level(level)) for level in cloud.levels]
    return _latest[1]


def _extent(texels: Texels) -> LevelExtent:
    low, high = texels.positions.min(axis=0), texels.positions.max(axis=0)
    reach = np.linalg.norm(texels.positions - 0.5 * (low + high), axis=1).max()
    return LevelExtent(len(texels), side_of(float(reach), texels.side))
