"""What pages ask for by a comment, which a reader of the plain Markdown does not see:

``<!-- keys -->`` every key of a case file, ``<!-- commands -->`` the command line, ``<!-- gallery -->`` all examples,
``<!-- pictures -->`` a few of them, ``<!-- run: NAME -->`` a program beside the page, what it printed and how long it
took, ``<!-- check: NAME -->`` and ``<!-- compare: NAME -->`` what these commands say of a case, and after them
``<!-- picture: FILE | CAPTION -->`` a picture that was drawn. Links to examples lead to their pages in the gallery.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

import commands
import gallery
import keys
import programs
from sphinx.application import Sphinx

ASKED = re.compile(
    r"^<!-- (keys|commands|gallery|pictures|run|check|compare|picture)(?:: (.*?))? -->$", re.MULTILINE | re.DOTALL
)
EXAMPLE = re.compile(r"\]\((?:\.\./)+examples(?:/([\w-]+)\.(toml|py))?\)")

OUTSIDE = re.compile(
    r"\[([^\]]*)\]\((?:\.\./)+(?:README|benchmarks/README)\.md\)"
)  # pages of the repository, not of the site


def read(app: Sphinx, name: str, content: list[str]) -> None:
    """Put in what a page asks for."""
    page = Path(app.srcdir) / f"{name}.md"
    ran: list[programs.Run] = []

    def made(found: re.Match[str]) -> str:
        what, given = found[1], found[2]
        if what in ("run", "check", "compare"):
            ran.append(programs.run((page.parent / given).resolve(), what))
            return (listed(given) if what == "run" else "") + said(ran[-1])
        if what == "picture":
            file, _, caption = (part.strip() for part in given.partition("|"))
            return picture(page.parent, ran[-1], file, " ".join(caption.split()))
        made_of = {"keys": keys.markdown, "commands": commands.markdown, "gallery": gallery.cards}
        return {**made_of, "pictures": gallery.pictures}[what]()

    up = posixpath.relpath("gallery", posixpath.dirname(name) or ".")
    linked = EXAMPLE.sub(lambda m: f"]({up}/{gallery.page(m[1], m[2]) if m[1] else 'index.md'})", content[0])
    content[0] = ASKED.sub(made, OUTSIDE.sub(r"\1", linked))


def listed(path: str) -> str:
    """A program."""
    language = "toml" if path.endswith(".toml") else "python"
    return f"```{{literalinclude}} {path}\n:language: {language}\n:caption: {Path(path).name}\n```\n\n"


def said(ran: programs.Run) -> str:
    """What a command printed, and how long it took."""
    return "\n".join(["```text", f"$ {ran.command}", *ran.printed.splitlines(), "```", "", programs.took(ran)])


def picture(folder: Path, ran: programs.Run, file: str, caption: str) -> str:
    """A figure of a picture that a program drew."""
    found = [one for one in ran.pictures if one.name == file]
    if not found:
        raise LookupError(f"{ran.command} drew {[one.name for one in ran.pictures]}, not {file}")
    way = posixpath.relpath(found[0].as_posix(), folder.as_posix())
    return f"```{{figure}} {way}\n:alt: {caption}\n\n{caption}\n```"


def setup(app: Sphinx) -> dict[str, Any]:
    """Before anything is read the gallery's pages are there."""
    app.connect("config-inited", lambda app, config: gallery.write())
    app.connect("source-read", read)
    return {"parallel_read_safe": False, "parallel_write_safe": True}
