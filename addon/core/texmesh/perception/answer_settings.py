"""Settings of levels that the answers of judges give."""

from collections.abc import Sequence

from ...errors import SettingsError
from ...messages import format_count
from ...settings import describe
from ..settings import TexmeshSettings
from .recorded_answers import RecordedAnswer, estimate_distance_factor, estimate_recorded

LIMITS = {item.name: item for item in describe(TexmeshSettings)}


def estimate_settings(records: Sequence[RecordedAnswer]) -> tuple[dict[str, float], str]:
    """Return the values of settings that answers give, by name and within their limits, and a sentence about them. Without enough answers
    that tell distances, only the threshold is given.

    Raises:
        SettingsError: as `estimate_recorded`.
    """
    threshold = estimate_recorded(records)
    value = _limit("weber_threshold", threshold.value)
    values = {"weber_threshold": value}
    message = f"The threshold is {value:.3g}, between {threshold.low:.3g} and {threshold.high:.3g} with 95% confidence"
    try:
        values["distance_factor"] = _limit("distance_factor", estimate_distance_factor(records))
        message += f", and distances are {values['distance_factor']:.3g} times those of FLIP"
    except SettingsError:  # answers of earlier versions
        pass
    return values, f"{message}, from {format_count(threshold.answers, 'answer')}."


def _limit(name: str, value: float) -> float:
    return min(max(value, LIMITS[name].minimum), LIMITS[name].maximum)
