"""Self-contained HTML: tables for notebooks, and complete pages."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from html import escape
from pathlib import Path

_STYLE = """body { font: 15px/1.5 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #222 }
h1 { font-size: 1.5em } h2 { font-size: 1.15em; margin-top: 2em; border-bottom: 1px solid #ccc }
table { border-collapse: collapse } th, td { text-align: left; vertical-align: top; padding: .15em .8em .15em 0 }
th { font-weight: 600; white-space: nowrap } img { max-width: 100%; display: block; margin: 1em 0 }
pre { background: #f5f5f5; padding: .8em; overflow-x: auto; font-size: 13px } .doubt { color: #a00 }"""


def table(rows: Iterable[tuple[str, object]], title: str = "") -> str:
    """Names and values in two columns, escaped."""
    head = f"<caption><b>{escape(title)}</b></caption>" if title else ""
    body = "".join(f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in rows)
    return f"<table>{head}{body}</table>"


def listed(lines: Iterable[str], style: str = "") -> str:
    """Lines as a list, escaped; empty if there are none."""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f'<ul class="{escape(style)}">{items}</ul>' if items else ""


def preformatted(text: str) -> str:
    """Preformatted text, escaped."""
    return f"<pre>{escape(text)}</pre>"


def picture(path: Path) -> str:
    """A PNG file, embedded."""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img alt="{escape(path.stem)}" src="data:image/png;base64,{data}">'


def film(data: bytes, encoding: str) -> str:
    """A film, GIF or MP4, embedded."""
    source = base64.b64encode(data).decode("ascii")
    if encoding == "mp4":
        return f'<video controls autoplay loop muted src="data:video/mp4;base64,{source}"></video>'
    return f'<img alt="film" src="data:image/{encoding};base64,{source}">'


def page(title: str, sections: Iterable[tuple[str, str]]) -> str:
    """A complete page of sections (heading, HTML); sections without content are omitted."""
    body = "".join(f"<h2>{escape(heading)}</h2>{content}" for heading, content in sections if content)
    return (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{escape(title)}</h1>{body}</body></html>\n"
    )
