"""On the page of a public name: which pages and which example of the site use it."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import gallery
from sphinx.application import Sphinx

import farhorizon

MOST = 3  # pages beside the example
ROOMS = ("howto", "tutorials", "explanation")  # equally many mentions: the first room is listed first
OTHERS = ("index", "coming_from")  # pages that explain no name


@cache
def _texts() -> dict[str, str]:
    """The pages of guidance and explanation by their place on the site."""
    paths = [path for room in ROOMS for path in sorted((gallery.DOCS / room).glob("*.md")) if path.stem not in OTHERS]
    paths.append(gallery.DOCS / "extending.md")
    return {f"/{path.relative_to(gallery.DOCS).with_suffix('')}": path.read_text(encoding="utf-8") for path in paths}


def mentions(name: str) -> list[str]:
    """Places of the pages that mention a public name most often, and of the shortest example that uses it."""
    used = re.compile(rf"\bfh\.{name}\b|`{name}[`(]")
    counts = {place: len(used.findall(text)) for place, text in _texts().items()}
    places = sorted(
        (place for place in counts if counts[place]), key=lambda place: (place == "/extending", -counts[place])
    )[:MOST]
    scripts = {path: path.read_text(encoding="utf-8") for path in gallery.examples() if path.suffix == ".py"}
    examples = sorted((path for path in scripts if used.search(scripts[path])), key=lambda path: len(scripts[path]))
    return places + [f"/gallery/{gallery.page(path.stem, 'py').removesuffix('.md')}" for path in examples[:1]]


def _add(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Append the pages to the docstring of a public class or function."""
    public = name.removeprefix("farhorizon.")
    if public in farhorizon.__all__ and (places := mentions(public)):
        lines += ["", ".. seealso:: " + ", ".join(f":doc:`{place}`" for place in places), ""]


def setup(app: Sphinx) -> dict[str, Any]:
    """After numpydoc, which sorts the sections of docstrings."""
    app.connect("autodoc-process-docstring", _add, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
