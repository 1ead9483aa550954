"""The layers of Farfield: core, bridge, operators, panels. A layer imports only from the layers before it."""
