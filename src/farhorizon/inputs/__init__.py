"""User inputs: expressions, signals, sources, incident waves, loads, cracks, conditions and prescribed values."""
