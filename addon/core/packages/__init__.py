"""Packages of textured meshes that are sent over a network within a time limit (sections III.B, III.C, V and VI of the TexMesh paper).

`build_package` builds the package of a mesh, `write_package` writes it with the page that shows it, and `read_package` checks one.
"""

from .files import PackageContent, read_package, write_package
from .material_sources import MaterialSource
from .package import Package, build_package
from .settings import PackageSettings

__all__ = [
    "MaterialSource",
    "Package",
    "PackageContent",
    "PackageSettings",
    "build_package",
    "read_package",
    "write_package",
]
