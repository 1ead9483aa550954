"""What is left of captured colours when lobes and hues are taken out: what components are for."""

import numpy as np

from ..direction_grids import DirectionGrid
from ..parallel import mapped
from ..progress import Progress, Steps
from .alternation import by_light
from .broad_suns import BroadSuns
from .lobes import Lobes
from .readings import Colours, Rest
from .shards import ShardStore

SPIKE, DOME_SPIKE = 0.5 / np.pi, 1.0  # radiance under a sun, and under the dome, above which a rest is a highlight that moved
HOLE, DOME_HOLE = 1.0 / np.pi, 1.0  # how far below the lobes it may be: a white surface that lies in the shade


def write_rests(store: ShardStore, hues: np.ndarray, lobes: Lobes | None, views: DirectionGrid, suns: BroadSuns) -> Steps[list[Rest]]:
    """Take `lobes` and `hues` (N, 3) out of the colours that `store` holds of all `views`, and keep what is left there.

    What is beyond the brightness of paper is cut: there a highlight stands in another place than its lobe, and such numbers, which are
    the largest of all, would spend the components on themselves.
    """

    def write_rest(number: int) -> Rest:
        visible, values = Colours(store, number).read()
        values = by_light(values)
        if lobes is not None:
            values = values - lobes.of_grid(views.directions[number], suns, visible)
            values[:, :-1] = np.clip(values[:, :-1], -HOLE, SPIKE)
            values[:, -1] = np.clip(values[:, -1], -DOME_HOLE, DOME_SPIKE)
        store.write_rest(number, visible, (values / hues[visible, None]).reshape(len(visible), 3 * values.shape[1]))
        return Rest(store, number)

    rests = []
    for rest in mapped(write_rest, range(len(views))):
        yield Progress(len(rests) / len(views), "Taking out the gloss")
        rests.append(rest)
    return rests
