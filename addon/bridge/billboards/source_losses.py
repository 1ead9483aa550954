"""What a cloud leaves out of the materials of its source."""

from collections.abc import Iterator

import bpy
import numpy as np

from ...core.geometry.mesh import connected_components, face_areas_and_normals
from ..geometry.meshes import Source, find_material
from ..shading.material_losses import describe_losses, is_glass

MAX_PANE_VOLUME = 0.02  # Relative to area**1.5 (a ball has 0.094): glass with more refracts visibly.


def describe_source_losses(source: Source) -> list[str]:
    """Return a sentence for each material of `source` of which a cloud leaves something out.

    Raises:
        GeometryError: a material was renamed or removed after the source was read.
    """
    owners: dict[bpy.types.Material, str] = {}
    for instance in source.instances:
        for key in instance.mesh.materials:
            if key is not None:
                owners.setdefault(find_material(key), instance.part or instance.name)
    return describe_losses(owners, set(_find_thick_glass(source)))


def _find_thick_glass(source: Source) -> Iterator[bpy.types.Material]:
    """Yield the materials that show glass on bodies rather than on panes."""
    for mesh in {id(instance.mesh): instance.mesh for instance in source.instances}.values():
        for index, key in enumerate(mesh.materials):
            material = None if key is None else find_material(key)
            triangles = mesh.triangles[mesh.material_indices == index]
            if material is not None and is_glass(material) and len(triangles):
                vertices = mesh.vertices.astype(np.float64)
                labels = connected_components(vertices, triangles)
                if any(_is_thick(vertices[triangles[labels == label]]) for label in np.unique(labels)):
                    yield material


def _is_thick(corners: np.ndarray) -> bool:
    """Return whether the triangles `corners` (T, 3, 3) enclose much volume for their area."""
    centered = corners - corners.reshape(-1, 3).mean(axis=0)
    volume = abs(float(np.linalg.det(centered).sum())) / 6.0
    area = float(face_areas_and_normals(corners)[0].sum())
    return volume > MAX_PANE_VOLUME * area**1.5
