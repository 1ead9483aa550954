"""How light shows on a material of some base color: factors that are multiplied with its images, and how its opacity counts."""

from dataclasses import dataclass
from typing import Any

from ..json_values import numbers, text

ALPHA_MODES = ("opaque", "mask", "blend")
MAX_FACTOR = 1e6


@dataclass(frozen=True)
class Shading:
    """Factors of a material, with the meaning that they have in glTF.

    Attributes:
        roughness, metallic: 0 to 1.
        emission: scene-linear RGB, strength included.
        normal_scale: of the slopes of the normal map.
        alpha_mode: one of ALPHA_MODES. "mask" shows what is at least as opaque as `alpha_cutoff`, "blend" lets through.
        alpha_cutoff: 0 to 1.
        is_unlit: whether the base color shows as it is, without light.
    """

    roughness: float = 0.5
    metallic: float = 0.0
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    normal_scale: float = 1.0
    alpha_mode: str = "opaque"
    alpha_cutoff: float = 0.5
    is_unlit: bool = False


DEFAULT_SHADING = Shading()


def decode_shading(values: dict[str, Any]) -> Shading:
    """Return the shading in an object of JSON, as `dataclasses.asdict` writes it.

    Raises:
        ValueError, KeyError: it is none.
    """
    mode = text(values["alpha_mode"], "a mode")
    if mode not in ALPHA_MODES:
        raise ValueError("an unknown mode")
    fractions = (values[name] for name in ("roughness", "metallic", "alpha_cutoff"))
    roughness, metallic, cutoff = numbers(list(fractions), "fractions", 3, 0.0, 1.0)
    red, green, blue = numbers(values["emission"], "a color", 3, 0.0, MAX_FACTOR)
    (normal_scale,) = numbers([values["normal_scale"]], "a factor", 1, -MAX_FACTOR, MAX_FACTOR)
    return Shading(roughness, metallic, (red, green, blue), normal_scale, mode, cutoff, values["is_unlit"] is True)
