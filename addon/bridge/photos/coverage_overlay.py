"""Overlay that colors faces by whether photographs show them."""

import bpy
import numpy as np

from ...core.geometry.mesh import TriangleMesh, vertex_normals
from ...core.photos.previews import CLASS_COLORS
from ..geometry.meshes import SourceInstance
from ..overlays.face_overlay import FaceColors, FaceOverlay, offset_from_faces


class CoverageOverlay(FaceOverlay):
    """The colors of some objects, computed once. It hides itself when one of them or a camera changes, and on undo and in other files."""

    def __init__(self) -> None:
        super().__init__()
        self._found: dict[int, FaceColors] = {}
        self._watched: set[int] = set()

    def show_classes(self, instances: list[SourceInstance], mesh: TriangleMesh, classes: np.ndarray, cameras: list[int]) -> None:
        """Show the `classes` (T,) of the triangles of `mesh`, which is that of all `instances` in world space.

        cameras: session UIDs of the objects from whose photographs they were found.
        """
        self.hide()
        vertices = offset_from_faces(mesh.vertices, vertex_normals(mesh.vertices, mesh.triangles))
        owners = np.repeat([each.object_uid for each in instances], [len(each.mesh.triangles) for each in instances])
        for owner in np.unique(owners):
            own = owners == owner
            self._found[int(owner)] = FaceColors(vertices[mesh.triangles[own]], CLASS_COLORS[classes[own]], is_world=True)
        self._watched = {*self._found, *cameras}
        self.show()

    def hide(self) -> None:
        """Stop drawing the overlay and forget the classes."""
        super().hide()
        self._found.clear()
        self._watched.clear()

    def find_key(self, item: bpy.types.Object) -> int | None:
        """Return the session UID of an object with classes."""
        return item.session_uid if item.session_uid in self._found else None

    def read_colors(self, item: bpy.types.Object) -> FaceColors:
        """Return the colors of an object with classes."""
        return self._found[item.session_uid]

    def update(self, depsgraph: bpy.types.Depsgraph | None) -> None:
        """Hide the overlay if a mesh or a camera has changed."""
        updates = [] if depsgraph is None else [each for each in depsgraph.updates if each.is_updated_geometry or each.is_updated_transform]
        changed = {each.id.original.session_uid for each in updates if isinstance(each.id, bpy.types.Object)}
        if depsgraph is None or changed & self._watched:
            self.hide()


overlay = CoverageOverlay()
