"""Registration of all operators, properties and panels with Blender, unregistered in reverse order."""

from .operators import documentation, follow_handlers, image_editors, long_work, presets, results, scatter, sky, source_tracking, user_cache
from .operators.bdam import build as bdam_build
from .operators.bdam import freeze as bdam_freeze
from .operators.bdam import ground as bdam_ground
from .operators.bdam import operators as bdam_operators
from .operators.billboards import operators as billboards_operators
from .operators.btf import exports as btf_exports
from .operators.btf import operators as btf_operators
from .operators.clipbox import convert_to_mesh as clipbox_convert
from .operators.clipbox import edits as clipbox_edits
from .operators.clipbox import ground as clipbox_ground
from .operators.clipbox import live_update as clipbox_live_update
from .operators.clipbox import operators as clipbox_operators
from .operators.distance import operators as distance_operators
from .operators.distance import viewport as distance_viewport
from .operators.packages import operators as packages_operators
from .operators.packages import viewing as packages_viewing
from .operators.photos import import_cameras as photos_import
from .operators.photos import operators as photos_operators
from .operators.photos import previews as photos_previews
from .operators.photos import refinement as photos_refinement
from .operators.photos import registration as photos_registration
from .operators.restore import operators as restore_operators
from .operators.texmesh import answer_files as texmesh_answer_files
from .operators.texmesh import calibration as texmesh_calibration
from .operators.texmesh import exports as texmesh_exports
from .operators.texmesh import operators as texmesh_operators
from .operators.texmesh import overlays as texmesh_overlays
from .operators.texmesh import preview as texmesh_preview
from .operators.unwrap import operators as unwrap_operators
from .panels import bdam as bdam_panels
from .panels import billboards as billboards_panels
from .panels import btf as btf_panels
from .panels import clipbox as clipbox_panels
from .panels import distance as distance_panels
from .panels import menus, preferences
from .panels import packages as packages_panels
from .panels import photos as photos_panels
from .panels import presets as presets_panels
from .panels import restore as restore_panels
from .panels import results as results_panels
from .panels import texmesh as texmesh_panels
from .panels import unwrap as unwrap_panels

MODULES = (
    results,
    long_work,
    documentation,
    follow_handlers,
    image_editors,
    scatter,
    sky,
    source_tracking,
    user_cache,
    preferences,
    presets,
    billboards_operators,
    btf_operators,
    btf_exports,
    unwrap_operators,
    photos_operators,
    photos_import,
    photos_previews,
    photos_refinement,
    photos_registration,
    restore_operators,
    texmesh_operators,
    texmesh_exports,
    texmesh_overlays,
    texmesh_preview,
    texmesh_calibration,
    texmesh_answer_files,
    packages_operators,
    packages_viewing,
    clipbox_operators,
    clipbox_convert,
    clipbox_edits,
    clipbox_ground,
    clipbox_live_update,
    bdam_operators,
    bdam_ground,
    bdam_freeze,
    bdam_build,
    distance_operators,
    distance_viewport,
    presets_panels,
    distance_panels,  # The first panel of the tab.
    billboards_panels,
    btf_panels,
    unwrap_panels,
    photos_panels,
    restore_panels,
    texmesh_panels,
    packages_panels,
    clipbox_panels,
    bdam_panels,
    results_panels,
    menus,
)


def register() -> None:
    """Register all operators, property groups and panels."""
    for module in MODULES:
        module.register()


def unregister() -> None:
    """Unregister everything; a running job is cancelled."""
    for module in reversed(MODULES):
        module.unregister()
