"""Settings of the simplification of textured meshes."""

from dataclasses import dataclass

from ...settings import Settings, Unit, setting


@dataclass(frozen=True, kw_only=True)
class SimplificationSettings(Settings):
    """Settings of a simplification by half-edge collapses."""

    protected_fraction: float = setting(
        0.5,
        "Of the vertices, those whose removal would be seen most at the moment, which stay whatever their scale; 0 for the order of scales"
        " alone",
        minimum=0.0,
        maximum=0.95,
        unit=Unit.FRACTION,
        group="Simplification",
    )
    drastic: bool = setting(
        True,
        "If a triangle count cannot be reached otherwise: ignore folds of small triangles, seams of normals and colors; drop thin"
        " UV islands and small components; close small holes",
        label="Drastic Simplification",
        panel_label="Drastic",
        group="Simplification",
    )
    drastic_size: float = setting(
        1.0,
        "Size of parts that drastic simplification drops or closes, relative to the mean edge length of a mesh with the intended triangle"
        " count",
        minimum=0.0,
        maximum=10.0,
        group="Simplification",
    )
