"""Makes of README.md the description of a release: pages outside the repository need absolute links and pictures."""

import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface


def published(readme: str, repository: str, version: str) -> str:
    """A readme whose links and pictures lead to the release of this version in a repository."""
    at = {"!": f"{repository}/raw/v{version}/", "": f"{repository}/blob/v{version}/"}
    relative = r"(!?)(\[[^\]]*\]\()(?!https?:|#)([^)]+\))"
    return re.sub(relative, lambda found: f"{found[1]}{found[2]}{at[found[1]]}{found[3]}", readme)


class ReadmeHook(MetadataHookInterface):
    """Hatchling calls it when it builds, with the table `[project]`."""

    def update(self, metadata: dict) -> None:
        """Add the readme."""
        root = Path(self.root)
        [version] = re.findall(
            r'^__version__ = "(.+)"', (root / "src/farhorizon/__init__.py").read_text(), re.MULTILINE
        )
        text = published((root / "README.md").read_text(encoding="utf-8"), metadata["urls"]["Repository"], version)
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
