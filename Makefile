PYTHON ?= python3
# a test that hangs ends the run, and its stack is shown
PATIENCE := -o faulthandler_timeout=900 -o faulthandler_exit_on_timeout=true
# two files of tests at a time, each in its order; then those beside which no other runs
PYTEST = $(BIN)/python -m pytest $(PATIENCE)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready

DOCS := $(VENV)/.docs

.PHONY: setup train figures test test-all lint same docs

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit("manywake needs Python 3.11 or newer, got " + sys.version.split()[0]) if sys.version_info < (3, 11) else 0'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $(STAMP)

train: setup
	$(BIN)/manywake train

figures: setup
	$(BIN)/manywake figure all

test: setup lint
	$(PYTEST) -m "not alone" -n 2 --dist loadfile
	$(PYTEST) -m alone

test-all: test
	$(BIN)/python -m pytest tests/slow

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m website.prose

# the documentation as a site, in site/: strictly, with every internal link and picture checked
docs: setup $(DOCS)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	$(BIN)/linkchecker --no-status --ignore-url '^(https?|mailto):' site/index.html

$(DOCS): pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[docs]'
	touch $(DOCS)

# whether the paper's case has the same bits as at another commit: make same BASE=<commit>
same: setup
	$(BIN)/python -m benchmarks.same $(BASE)
