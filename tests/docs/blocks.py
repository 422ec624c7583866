"""Code blocks of README and documentation, each with the marks that stand before it.

A block is run as it stands unless a mark says otherwise. Marks are comments in the lines before it:

* ``<!-- not run: why -->``: it is not run, for the reason given; its commands are parsed all the same;
* ``<!-- file: NAME -->``: it is the content of a file that later blocks of the page use;
* ``<!-- before: COMMAND -->``: what has to be done before it, so that it finds what it needs.
"""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
GENERATED = {"command_line.md", "config.md", "metrics.md", "saved_runs.md"}
_BLOCK = re.compile(r"((?:^<!-- .*? -->\n)*)^(```+|:::+)(\S*)[^\n]*\n(.*?)^\2$", re.MULTILINE | re.DOTALL)
_MARK = re.compile(r"^<!-- (not run|file|before): (.*?) -->$", re.MULTILINE)
RUN = ("bash", "console", "python")
"""Languages of what is run."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: Path
    language: str
    text: str
    marks: dict[str, str]

    @property
    def commands(self):
        """Command lines, without comments, prompts, and what their output is sent to."""
        found = []
        for line in self.text.replace("\\\n", " ").splitlines():
            if self.language == "console" and not line.startswith("$ "):
                continue
            for part in re.split(r"&&|\|\||(?<!\S)[|;](?!\S)", line.removeprefix("$ ")):
                tokens = shlex.split(part, comments=True)
                cut = next((i for i, token in enumerate(tokens) if re.match(r"\d*>", token)), len(tokens))
                if tokens[:cut]:
                    found.append(tokens[:cut])
        return found


def pages():
    """README and all pages of the documentation that are kept in the repository."""
    found = [path for path in sorted((ROOT / "docs").rglob("*.md")) if "_build" not in path.parts]
    return [ROOT / "README.md", *(path for path in found if path.name not in GENERATED)]


def blocks(page):
    """Blocks of a page in their order."""
    found = _BLOCK.findall(page.read_text(encoding="utf-8"))
    return [Block(page, kind, text, dict(_MARK.findall(marks))) for marks, _, kind, text in found]


def page_id(page):
    """Name of a page in test ids."""
    return str(page.relative_to(ROOT))
