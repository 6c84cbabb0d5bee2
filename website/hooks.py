"""What MkDocs does beside reading docs/: it adds generated pages, and renders formulas as MathML."""

import re
from html import unescape
from typing import Any

import latex2mathml.converter
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from manywake.play import record
from manywake.suite import load
from website import command_pages, flow_pages

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)
NUMBER = re.compile(r"\\tag\{([^}]*)\}")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made of the code, and the viewer of the recorded episodes in docs/demo."""
    made = {"commands.md": command_pages.page(), "flows/index.md": flow_pages.index()}
    made |= {f"flows/{name}.md": flow_pages.page(name) for name in load.names()}
    made |= {f"demo/{name}": text for name, text in record.viewer().items()}
    for path, text in made.items():
        if files.get_file_from_path(path) is None:
            files.append(File.generated(config, path, content=text))
    return files


def on_page_content(html: str, **given: Any) -> str:
    """Render the formulas of a page, with the numbers of equations beside them."""
    return FORMULA.sub(_formula, html)


def _formula(found: re.Match[str]) -> str:
    block, tex = found.group(2) == "[", unescape(found.group(3))
    number = NUMBER.search(tex)
    rendered = latex2mathml.converter.convert(NUMBER.sub("", tex).strip(), display="block" if block else "inline")
    if not block:
        return rendered
    tag = f'<span class="number">({number.group(1)})</span>' if number else ""
    anchor = f' id="eq-{number.group(1)}"' if number else ""
    return f'<div class="equation"{anchor}>{rendered}{tag}</div>'
