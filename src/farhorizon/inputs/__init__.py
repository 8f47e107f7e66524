"""What a user puts into a medium: expressions, sources, loads, cracks, conditions, prescribed values."""
