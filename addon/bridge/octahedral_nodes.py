"""Octahedral maps of directions in shader nodes; the formulas are those of `core.directions`."""

import bpy

from .wiring import Operand, Wiring


def place_on_map(wiring: Wiring, direction: Operand, upper: bool) -> bpy.types.NodeSocket:
    """The place (x, y, 0) in -1..1 of a `direction` of any length; on the upper half, what lies below the horizon counts as on it."""
    if upper:
        direction = wiring.vector("MAXIMUM", direction, (-1e6, -1e6, 0.0))
    size = wiring.vector("DOT_PRODUCT", wiring.vector("ABSOLUTE", direction), (1.0, 1.0, 1.0))
    flat = wiring.vector("SCALE", direction, wiring.math("DIVIDE", 1.0, wiring.math("MAXIMUM", size, 1e-12)))
    x, y, z = wiring.separate(flat)
    if upper:
        return wiring.combine(wiring.math("ADD", x, y), wiring.math("SUBTRACT", x, y), 0.0)
    folded = wiring.vector("SCALE", _signs(wiring, x, y), _below(wiring, z))
    return wiring.vector("ADD", wiring.combine(x, y, 0.0), folded)


def direction_on_map(wiring: Wiring, x: Operand, y: Operand, upper: bool) -> bpy.types.NodeSocket:
    """The unit direction at the place x, y in -1..1 of the map; the inverse of `place_on_map`."""
    if upper:
        x, y = (wiring.math("MULTIPLY", wiring.math(operation, x, y), 0.5) for operation in ("ADD", "SUBTRACT"))
    sides = wiring.math("ADD", wiring.math("ABSOLUTE", x), wiring.math("ABSOLUTE", y))
    z = wiring.math("SUBTRACT", 1.0, sides)
    direction = wiring.combine(x, y, wiring.math("MAXIMUM", z, 0.0) if upper else z)
    if not upper:
        direction = wiring.vector("SUBTRACT", direction, wiring.vector("SCALE", _signs(wiring, x, y), _below(wiring, z)))
    return wiring.vector("NORMALIZE", direction)


def _below(wiring: Wiring, z: Operand) -> bpy.types.NodeSocket:
    """How far below the horizon: there the corners of the map fold outwards."""
    return wiring.math("MAXIMUM", wiring.math("MULTIPLY", z, -1.0), 0.0)


def _signs(wiring: Wiring, x: Operand, y: Operand) -> bpy.types.NodeSocket:
    """(sign x, sign y, 0), where 0 counts as negative."""
    return wiring.combine(
        *(wiring.math("SUBTRACT", wiring.math("MULTIPLY", wiring.math("GREATER_THAN", value, 0.0), 2.0), 1.0) for value in (x, y)), 0.0
    )
