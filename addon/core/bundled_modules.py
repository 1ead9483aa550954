"""The modules that Farfield needs beyond Blender's Python: those of the wheels in the zip. Scripts read the list before any import."""

BUNDLED_MODULES = ("PIL", "fast_simplification", "meshopt", "scipy", "tifffile", "threadpoolctl", "xatlas")
