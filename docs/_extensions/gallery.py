"""A page of each example: its header as text, the program, what it prints and draws."""

from __future__ import annotations

import ast
import os
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import programs

DOCS = Path(__file__).resolve().parents[1]
EXAMPLES = DOCS.parent / "examples"
SCRIPTS = Path(__file__).with_name("scripts.py")
REFUSED = {"dispersive_pulse": 2}  # an example of what `run` does not do; its exit code
BEST = ("front.png", "damage.png", "u.png")  # pictures that stand for an example, the first of them that it has
FIRST = (  # examples whose pictures the start page shows, each of a kind of its own
    "two_notches.toml",
    "branching.toml",
    "elastic_blast.toml",
    "letters.toml",
    "heated_borehole.py",
    "hidden_inclusion.py",
)
KINDS = {  # by what a case or script mentions
    "Corrosion": r'type = "corrosion"|fh\.Corrosion',
    "Diffusion and heat": r'type = "(diffusion|heat)"|fh\.(Diffusion|Heat)\(',
    "Cracks that grow": r"critical_stretch|fracture_energy",
    "Elastic waves": r'type = "(elastic|correspondence)"|fh\.(Elastic|Correspondence)\(',
    "Scalar waves": "",
}


def page(name: str, kind: str) -> str:
    """File of an example's page in the gallery."""
    return f"{name}_{kind}.md"


def write() -> None:
    """The pages, and nothing else, lie in gallery/ beside its index."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # each is a process of its own, of one thread
        list(pool.map(ran, examples()))
    wanted = {page(path.stem, path.suffix[1:]): _page(path) for path in examples()}
    for old in (DOCS / "gallery").glob("*.md"):
        if old.name not in wanted and old.name != "index.md":
            old.unlink()
    for name, text in wanted.items():
        file = DOCS / "gallery" / name
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def cards() -> str:
    """All examples by kind, each with its picture."""
    lines = []
    for kind in KINDS:
        paths = [path for path in examples() if _kind(path) == kind]
        lines += [f"## {kind}", "", "::::{grid} 1 1 2 2", ":gutter: 2", ""]
        for path in paths:
            lines += _card(path, f"{path.stem}_{path.suffix[1:]}", "..")
        lines += ["::::", ""]
    pages = [page(path.stem, path.suffix[1:]).removesuffix(".md") for path in examples()]
    return "\n".join([*lines, "```{toctree}", ":hidden:", "", *pages, "```"])


def pictures() -> str:
    """The examples that the start page shows."""
    lines = ["::::{grid} 2 2 3 3", ":gutter: 2", ""]
    for path in (EXAMPLES / name for name in FIRST):
        lines += _card(path, f"gallery/{path.stem}_{path.suffix[1:]}", ".")
    return "\n".join([*lines, "::::"])


def _card(path: Path, target: str, up: str) -> list[str]:
    """An example with its picture, on a page from which `up` leads to docs/."""
    title = header(path)[0]
    lines = [f":::{{grid-item-card}} {title}", f":link: {target}", ":link-type: doc"]
    if best := _best(path):
        lines += [f":img-bottom: {_way(best, up)}", f":img-alt: {title}"]
    return [*lines, ":::", ""]


def examples() -> list[Path]:
    """Case files and scripts."""
    return sorted([*EXAMPLES.glob("*.toml"), *EXAMPLES.glob("*.py")])


def _kind(path: Path) -> str:
    source = path.read_text(encoding="utf-8")
    return next(kind for kind, pattern in KINDS.items() if re.search(pattern, source))


def ran(path: Path) -> programs.Run:
    """What an example did."""
    return programs.run(path, code=REFUSED.get(path.stem, 0), drawn=SCRIPTS if path.suffix == ".py" else None)


def _best(path: Path) -> Path | None:
    pictures = {one.name: one for one in ran(path).pictures}
    return next((pictures[name] for name in BEST if name in pictures), next(iter(pictures.values()), None))


def _way(picture: Path, up: str = "..") -> str:
    return f"{up}/{picture.relative_to(DOCS).as_posix()}"


def _page(path: Path) -> str:
    title, paragraphs = header(path)
    done = ran(path)
    language = "toml" if path.suffix == ".toml" else "python"
    lines = [f"# {title}", "", *(line for paragraph in paragraphs for line in (paragraph, ""))]
    for picture in sorted(done.pictures, key=lambda one: BEST.index(one.name) if one.name in BEST else len(BEST)):
        lines += [f"```{{figure}} {_way(picture)}", f":alt: {title}: {picture.stem}", "```", ""]
    lines += [
        f"```{{literalinclude}} ../../examples/{path.name}",
        f":language: {language}",
        f":caption: {path.name}",
        "```",
    ]
    lines += ["", "```text", f"$ {done.command}", *done.printed.splitlines(), "```", "", programs.took(done)]
    return "\n".join(lines)


def header(path: Path) -> tuple[str, list[str]]:
    """The beginning of an example's comment or docstring, which names it, and its paragraphs."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        said = ast.get_docstring(ast.parse(source)) or path.stem
    else:
        comment = re.match(r"(?:#.*\n)*", source)
        said = "\n".join(line.removeprefix("#").strip() for line in comment[0].splitlines()) if comment else path.stem
    paragraphs = [" ".join(paragraph.split()).replace("``", "`") for paragraph in said.split("\n\n")]
    title = re.split(r": |(?<!al)\. |\.$", paragraphs[0])[0]
    alone = paragraphs[0] == f"{title}."
    return title + (" (Python)" if path.suffix == ".py" else ""), paragraphs[alone:]
