"""Textures from photographs: one seamless texture for a mesh from registered photographs."""

from .importers import read_cameras
from .merging import merge
from .photo_texture import PhotoTexture
from .photographs.photograph import Photograph
from .registration.refinement import Refinement, refine
from .registration.registration import Registration, register
from .settings import PhotosSettings

__all__ = ["PhotoTexture", "Photograph", "PhotosSettings", "Refinement", "Registration", "merge", "read_cameras", "refine", "register"]
