"""Recorders: what a run keeps step by step, and what follows from it."""
