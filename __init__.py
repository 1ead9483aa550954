"""Farfield prepares Blender scenes for distant views. A checkout is itself a valid extension."""


def register() -> None:
    """Register Farfield. Blender calls this when the extension is enabled."""
    from .addon import registration  # here, because the core is also used without bpy

    registration.register()


def unregister() -> None:
    """Unregister Farfield."""
    from .addon import registration

    registration.unregister()
