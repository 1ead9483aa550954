"""Restoration of images: the missing parts are filled with structure and texture."""

from .restoration import Restoration, restore
from .settings import RestoreSettings

__all__ = ["Restoration", "RestoreSettings", "restore"]
