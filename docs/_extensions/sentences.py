"""Words and sentences of README and the pages, without evidence.

``python docs/_extensions/sentences.py [COUNT]`` prints how many words there are, the median length of sentences, and
the longest sentences.
"""

from __future__ import annotations

import re
import statistics
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
WRITTEN = re.compile(r"docs/(generated/|reference/api/|gallery/\w+_(toml|py)\.md)")  # by the build of the site
MOST_WORDS, MOST_IN_A_SENTENCE, MEDIAN = 45_000, 45, 18  # what a reader can be asked to read

_NOT_PROSE = [  # what is left out, and what stands in its place
    (re.compile(r"```.*?```", re.DOTALL), ""),  # code and formulas
    (re.compile(r"^(:::|\||#).*$", re.MULTILINE), ""),  # cards, tables and headings
    (re.compile(r"<!--.*?-->", re.DOTALL), ""),
    (re.compile(r"\[([^\]]*)\]\([^)]*\)"), r"\1"),  # of a link its words
    (re.compile(r"`[^`]*`|\$[^$]*\$"), "X"),  # a name or a formula is one word
]
_ITEM = re.compile(r"\n\s*\n|\n\s*(?:[-*]|\d+\.)\s")  # paragraphs, and entries of lists
_END = re.compile(r"(?<=[.!?])\s+(?=[A-Z*])|;\s")  # a semicolon separates sentences, too


class Sentence(NamedTuple):
    """A sentence of a page, and its number of words."""

    words: int
    page: str
    text: str


def pages() -> list[Path]:
    """README and the pages of docs/ but for evidence and what the build writes."""
    docs = [path for path in sorted((ROOT / "docs").rglob("*.md")) if path.parent.name != "evidence"]
    return [ROOT / "README.md", *(path for path in docs if not WRITTEN.match(path.relative_to(ROOT).as_posix()))]


def words() -> int:
    """Number of words of all pages, with those of tables and code."""
    return sum(len(path.read_text(encoding="utf-8").split()) for path in pages())


def sentences() -> list[Sentence]:
    """The sentences of all pages, the longest first; headings and entries of one or two words are none."""
    found = [
        Sentence(len(text.split()), path.relative_to(ROOT).as_posix(), text)
        for path in pages()
        for text in _sentences_of(path.read_text(encoding="utf-8"))
    ]
    return sorted((sentence for sentence in found if sentence.words > 2), reverse=True)


def _sentences_of(page: str) -> Iterator[str]:
    for pattern, instead in _NOT_PROSE:
        page = pattern.sub(instead, page)
    for paragraph in _ITEM.split(page):
        yield from _END.split(" ".join(paragraph.split()))


def main() -> None:
    """Print the figures."""
    found = sentences()
    median = statistics.median(sentence.words for sentence in found)
    print(f"{words()} words (at most {MOST_WORDS}), median of {len(found)} sentences: {median:g} words")
    for sentence in found[: int(sys.argv[1]) if len(sys.argv) > 1 else 10]:
        print(f"{sentence.words:3d}  {sentence.page}: {sentence.text[:160]}")


if __name__ == "__main__":
    main()
