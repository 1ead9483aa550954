"""The storeys of the house, from the ground up: core, bridge, operators, panels. Imports run downwards only."""
