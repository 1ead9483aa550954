"""Restoration of images: the missing parts are filled with structure and texture."""
