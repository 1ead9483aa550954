"""Perceptual levels of detail of textured meshes, found in scale space (TexMesh: Cheng and Boulanger)."""
