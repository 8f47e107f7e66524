"""``python -m farhorizon``."""

from farhorizon.cli import process

process()
