"""The commands of the pages that take longer, after all that stands before them (`tests.pages`)."""

import pytest

from .. import pages


@pytest.mark.filterwarnings("ignore")  # of the libraries
@pytest.mark.parametrize(
    "page", [page for page in pages.PAGES if any(b.mark == pages.SLOW for b in pages.blocks(page))]
)
def test_the_blocks_of_a_page_run(page, tmp_path, monkeypatch, one_thread):
    for name, value in (pages.environment() | {"XDG_CACHE_HOME": str(tmp_path / "cache")}).items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(tmp_path)
    pages.play(page, (pages.FAST, pages.SLOW), tmp_path)
