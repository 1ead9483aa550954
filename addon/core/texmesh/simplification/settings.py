"""Settings of the simplification of textured meshes."""

from dataclasses import dataclass

from ...settings import Choice, Settings, Unit, setting

PLANE, CENTER, SKELETON, QUADRIC = "plane", "center", "skeleton", "quadric"
PERCEPTUAL_VALUES = {
    PLANE: Choice("Plane", "Distance of the removed vertex to the mean plane of its neighbors, summed over what it has absorbed"),
    CENTER: Choice("Center", "Displacement of the removed vertex, relative to the distance of the kept vertex to the center of the mesh"),
    SKELETON: Choice("Skeleton", "As Center, with the centers of the cross sections along the longest axis in place of one center"),
    QUADRIC: Choice("Quadric", "Root of the mean squared distance of the kept vertex to the planes that the removed vertex stands for"),
}


@dataclass(frozen=True, kw_only=True)
class SimplificationSettings(Settings):
    """Settings of a simplification by half-edge collapses."""

    perceptual_value: str = setting("plane", "How much the removal of a vertex is seen", choices=PERCEPTUAL_VALUES, group="Simplification")
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
