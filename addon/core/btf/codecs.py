"""The codecs that settings can name."""

from collections.abc import Sequence

import numpy as np

from ..progress import Steps
from .alternation import ViewData
from .factors import Factors, factorise
from .lpca import factorise_locally
from .settings import BtfSettings


def compressed_colours(
    views: Sequence[ViewData], rows: int, weights: np.ndarray, column_weights: np.ndarray, settings: BtfSettings
) -> Steps[Factors]:
    """Factors of the colours that `views` know of `rows` texels, by the codec of the settings; weights as for `factorise`."""
    if settings.codec == "lpca":
        steps = factorise_locally(views, rows, settings.clusters, settings.cluster_components, weights, column_weights, settings.seed)
    else:
        steps = factorise(views, rows, settings.components, weights, column_weights, settings.seed)
    return (yield from steps)
