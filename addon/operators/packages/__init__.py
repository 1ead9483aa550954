"""Operators of the tool `packages`."""
