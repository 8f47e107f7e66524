"""Commented cases to start from, one for each kind of problem."""

from __future__ import annotations

from importlib.resources import files

KINDS = ("wave", "elastic", "fracture", "diffusion", "heat", "corrosion", "exact-bar")


def template(kind: str) -> str:
    """Text of the commented case of a kind, one of `KINDS`."""
    return files(__name__).joinpath(f"{kind}.toml").read_text(encoding="utf-8")


def brief(kind: str) -> str:
    """What the case of a kind is about: the first line of its comments."""
    return template(kind).partition("\n")[0].removeprefix("# ")
