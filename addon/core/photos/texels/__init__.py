"""Texels of a texture: where they are on the surface, and their colors from photographs, blended, sharpened and interpolated."""
