"""What the machine code of a function depends on: the definitions that it uses, in its own module and in others of the
engine, without comments, docstrings and annotations.

Numba's cache knows only the file of a function: a comment there would cost a compilation, and a change in a file from
which the function takes something would go unnoticed.
"""

from __future__ import annotations

import ast
import hashlib
import json
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numba

from farhorizon.files.cache import cache_folder, sealed, unsealed, write

_PACKAGE = Path(__file__).parents[2]
_STARTED = time.time()
_VERSION = f"{sys.version_info[:2]} {Path(__file__).read_text()}"  # of what is kept on disk
#: Key of the statements of a module that bind no name; everything in the module depends on them.
_UNNAMED = ""


class _Source(NamedTuple):
    """Definitions of a module, by name: hashes of their code, and the names that they use (dotted if an attribute of a
    name); and what its imports bind, as module and name there ("" for a module itself).
    """

    codes: dict[str, list[str]]
    uses: dict[str, list[str]]
    imports: dict[str, list[str]]


class _Plain(ast.NodeTransformer):
    """Removes docstrings and annotations, and collects the names that are used."""

    def __init__(self) -> None:
        self.used: set[str] = set()

    def generic_visit(self, node: ast.AST) -> ast.AST:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Module)):
            if ast.get_docstring(node, clean=False) is not None:
                node.body = node.body[1:]
            if not isinstance(node, (ast.ClassDef, ast.Module)):
                node.returns = None
        if isinstance(node, ast.arg):
            node.annotation = None
        if isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None)
        return super().generic_visit(node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if isinstance(node.value, ast.Name):
            self.used.add(f"{node.value.id}.{node.attr}")
            return node
        return self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> ast.AST:
        self.used.add(node.id)
        return node


def _bound(statement: ast.stmt) -> list[str]:
    """Names that a statement of a module binds."""
    if isinstance(statement, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
        return [statement.name]
    return [n.id for n in ast.walk(statement) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]


def _imported(statement: ast.stmt) -> Iterator[tuple[str, list[str]]]:
    """Names that imports of the engine in a statement bind, also within functions, with what they stand for."""
    for node in ast.walk(statement):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("farhorizon.engine"):
            for alias in node.names:
                inner = _file_of(f"{node.module}.{alias.name}").is_file()
                place = [f"{node.module}.{alias.name}", ""] if inner else [str(node.module), alias.name]
                yield alias.asname or alias.name, place


def _analysed(text: str) -> _Source:
    """Definitions of a module, statement by statement."""
    source = _Source({}, {}, {})
    for statement in ast.parse(text).body:
        source.imports.update(_imported(statement))
        if isinstance(statement, (ast.Import, ast.ImportFrom)) or _is_text(statement):
            continue
        plain = _Plain()
        code = hashlib.sha256(ast.dump(plain.visit(statement)).encode()).hexdigest()
        for name in _bound(statement) or [_UNNAMED]:
            source.codes.setdefault(name, []).append(code)
            source.uses[name] = sorted(plain.used.union(source.uses.get(name, ())))
    return source


def _is_text(statement: ast.stmt) -> bool:
    """Whether a statement is a docstring."""
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _file_of(module: str) -> Path:
    """File of a module, or where it would be."""
    return _PACKAGE.joinpath(*module.split(".")[1:]).with_suffix(".py")


@cache
def _source(path: Path) -> _Source:
    """Definitions of a file. If it has changed since it was imported, what this process compiles is not for others."""
    source = _source_of(path.read_text())
    if path.is_relative_to(_PACKAGE) and path.stat().st_mtime > _STARTED:
        source.codes.setdefault(_UNNAMED, []).append(uuid.uuid4().hex)
        source.uses.setdefault(_UNNAMED, [])
    return source


def _source_of(text: str) -> _Source:
    """Definitions of a module; they are kept on disk, because parsing takes longer than everything else here."""
    mark = hashlib.sha256(f"{_VERSION} {text}".encode()).hexdigest()
    place = cache_folder() / f"source_{mark[:32]}.json"
    with suppress(OSError):
        data = unsealed(place.read_bytes())
        if data is not None:
            return _Source(**json.loads(data))
    source = _analysed(text)
    with suppress(OSError):
        write(place, sealed(json.dumps(source._asdict()).encode()))
    return source


def _used(path: Path, name: str) -> Iterator[tuple[Path, str | None]]:
    """Definitions that one in a file uses directly; None stands for all of a file."""
    source = _source(path)
    if name not in source.codes:
        module, original = source.imports[name]
        yield _file_of(module), original or None
        return
    if _UNNAMED in source.codes:
        yield path, _UNNAMED
    for used in source.uses[name]:
        first, _, attribute = used.partition(".")
        if first in source.codes:
            yield path, first
        elif first in source.imports:
            module, original = source.imports[first]
            yield _file_of(module), original or attribute or None


def hash_of(text: str) -> str:
    """Hash of the code of a module, without what it imports."""
    return hashlib.sha256(json.dumps(_source_of(text), sort_keys=True).encode()).hexdigest()


def definitions(path: Path, name: str | None = None) -> dict[tuple[Path, str], list[str]]:
    """Hashes of the code of all that a definition in a file depends on, by file and name; without a name, or with one
    that is unknown, of all that the file depends on.
    """
    waiting: list[tuple[Path, str | None]] = [(path, name)]
    hashes: dict[tuple[Path, str], list[str]] = {}
    while waiting:
        place, definition = waiting.pop()
        source = _source(place)
        known = definition in source.codes or definition in source.imports
        for part in [definition] if definition is not None and known else source.codes:
            if (place, part) not in hashes:
                hashes[place, part] = source.codes.get(part, [])
                waiting += _used(place, part)
    return hashes


def digest(path: Path, name: str | None = None) -> str:
    """Hash of Numba's version and of the code in `definitions`."""
    parts = sorted(f"{place.stem}.{part} {codes}" for (place, part), codes in definitions(path, name).items())
    return hashlib.sha256("\n".join([numba.__version__, *parts]).encode()).hexdigest()
