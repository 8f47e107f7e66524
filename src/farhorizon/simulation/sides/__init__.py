"""Sides of the near field: layers chosen and given, extensions, and conditions along outlines."""
