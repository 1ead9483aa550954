"""What grows and lies on landscapes: plants and rocks, and where."""
