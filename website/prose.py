"""Whether the documents are easy to read: no sentence of more than 35 words, no table cell of more than 12.

`python -m website.prose` reads the README, CONTRIBUTING.md and docs/, and names each place that is longer. Code and
formulas count as one word each. The pages of reference are generated, so what they say is judged where it is written.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

SENTENCE, CELL = 35, 12
ROOT = Path(__file__).parents[1]
END = re.compile(r"(?<=[.!?])[)\"'”]*\s+(?=[^a-z])|(?<=:)\s*\n")
ABBREVIATED = re.compile(r"\b(al|Fig|eq|p|no|vs|cf)\.\s")
FORMULA = re.compile(r"\$\$.+?\$\$|\$[^$\n]+\$|\\\(.+?\\\)", re.DOTALL)


def words(text: str) -> int:
    """Return how many words a text has: what has a letter or a digit in it."""
    return sum(any(letter.isalnum() for letter in word) for word in text.split())


def sentences(text: str) -> list[str]:
    """Return the sentences of a paragraph."""
    return END.split(ABBREVIATED.sub(r"\1 ", text))


def _plain(inline: Token) -> str:
    """Return what is read of a line of markdown: a link by its text, code and pictures as one word."""
    kept = {"text": lambda part: part.content, "softbreak": lambda part: " ", "hardbreak": lambda part: ". "}
    return "".join(
        kept[part.type](part) if part.type in kept else "code" if part.type == "code_inline" else ""
        for part in inline.children or ()
    )


def long(path: Path) -> Iterator[str]:
    """Yield each place of a document that is too long: its line, its words, how it begins."""
    source = FORMULA.sub("formula", re.sub(r"\A---\n.*?\n---\n", "", path.read_text(), flags=re.DOTALL))
    cell = False
    for token in MarkdownIt("commonmark").enable("table").parse(source):
        if token.type in ("td_open", "th_open", "td_close", "th_close"):
            cell = token.type.endswith("open")
        if token.type != "inline":
            continue
        text = _plain(token)
        for part, limit in ((text, CELL),) if cell else ((each, SENTENCE) for each in sentences(text)):
            if (count := words(part)) > limit:
                where = f"{path.relative_to(ROOT)}:{token.map[0] + 1 if token.map else '?'}"
                what = "in a cell" if cell else "a sentence"
                yield f"{where}: {count} words, at most {limit} {what}: {part[:90]} ..."


def main() -> None:
    """Name what is too long, and end with status 1 if there is any."""
    paths = [Path(word).resolve() for word in sys.argv[1:]]
    paths = paths or [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    found = [place for path in paths if path.exists() for place in long(path)]
    print("\n".join(found) if found else f"{len(paths)} documents: no sentence or cell is too long")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
