"""Farfield: Blender scenes ready for any distance. A checkout is itself a valid extension."""


def register() -> None:
    """Register everything that Blender shows. Blender calls this when the extension is enabled."""
    from .addon import registration  # here, because the ground floor is also used where there is no bpy

    registration.register()


def unregister() -> None:
    """Take back all that `register` did."""
    from .addon import registration

    registration.unregister()
