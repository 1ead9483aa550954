"""Everything that Blender learns when the extension is enabled, in order, and forgets in reverse."""

from .operators import billboards as billboards_operators
from .operators import btf as btf_operators
from .operators import btf_exports, clipbox_freeze, long_work
from .operators import clipbox as clipbox_operators
from .operators import unwrap as unwrap_operators
from .panels import billboards as billboards_panels
from .panels import btf as btf_panels
from .panels import clipbox as clipbox_panels
from .panels import unwrap as unwrap_panels

MODULES = (
    billboards_operators,
    btf_operators,
    btf_exports,
    unwrap_operators,
    clipbox_operators,
    clipbox_freeze,
    billboards_panels,
    btf_panels,
    unwrap_panels,
    clipbox_panels,
)


def register() -> None:
    """Register all operators, settings and panels."""
    for module in MODULES:
        module.register()


def unregister() -> None:
    """Take all of them away again, after ending what still runs."""
    long_work.close()
    for module in reversed(MODULES):
        module.unregister()
