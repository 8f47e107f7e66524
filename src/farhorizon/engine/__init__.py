"""Compiled time loops behind an interface of plain arrays."""
