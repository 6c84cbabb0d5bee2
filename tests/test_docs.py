"""What the tutorial and the how-to pages tell to type works as it stands there (`pages` says what is run when)."""

import nbclient
import nbformat
import pytest

from . import pages

pytestmark = pytest.mark.alone

NOTEBOOK = pages.ROOT / "examples" / "tutorial.ipynb"


@pytest.mark.parametrize("page", pages.PAGES)
def test_every_block_of_a_page_is_run_or_says_why_not(page):
    unknown = [
        block.place
        for block in pages.blocks(page)
        if block.language not in (*pages.RUN, *pages.SHOWN) or (block.language in pages.RUN and block.mark is None)
    ]
    assert not unknown, f"wanted bash, python, text or json, and a mark as tests/pages.py has them: {unknown}"


def test_marks_are_understood(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "a\n\n```bash\ntrue\n```\n\n<!-- slow -->\n```python\n# a.py\n```\n"
        "\n<!-- not run: a cluster -->\n```bash\n```\n"
        "\n<!-- slwo -->\n```bash\n```\n\n<!-- not run: -->\n```bash\n```\n"
    )
    found = pages.blocks(str(page))
    assert [block.mark for block in found] == [pages.FAST, pages.SLOW, pages.NEVER, None, None]
    assert [block.file for block in found][:2] == [None, "a.py"]


def test_a_command_that_fails_is_told_with_its_place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "page.md").write_text("a\n\n```bash\ntrue\n# nothing\necho so && false\n```\n")
    with pytest.raises(AssertionError, match="page.md:3: echo so && false\nso"):
        pages.play(str(tmp_path / "page.md"), (pages.FAST,), tmp_path)


@pytest.mark.filterwarnings("ignore")  # of the libraries
@pytest.mark.parametrize(
    "page", [page for page in pages.PAGES if any(b.mark == pages.FAST for b in pages.blocks(page))]
)
def test_the_quick_blocks_of_a_page_run(page, tmp_path, monkeypatch, one_thread):
    monkeypatch.chdir(tmp_path)
    pages.play(page, (pages.FAST,), tmp_path)


@pytest.mark.filterwarnings("ignore")  # of Jupyter's own
def test_the_notebook_of_the_tutorial_runs(tmp_path, monkeypatch):
    for name, value in pages.environment().items():
        monkeypatch.setenv(name, value)
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    printed = "".join(o.get("text", "") for cell in notebook.cells for o in cell.get("outputs", []))
    assert "drag reduction" in printed


def test_the_notebook_keeps_no_output():
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in notebook.cells)
    assert NOTEBOOK.stat().st_size < 20_000
