"""A run in time: its sources, steps, ends, output and checkpoints."""
