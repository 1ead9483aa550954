"""Operators of the tool `texmesh`."""
