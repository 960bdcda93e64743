# A fresh clone needs only `make setup`, `make test`, `make demo`.
# Needs Python 3.11 or newer with venv. Nothing is installed outside .venv.

PYTHON ?= python3
BIN := .venv/bin

# Written last, and named after a checksum of the two files: an interrupted setup starts
# again, a finished one is repeated only when one of the two files has changed.
STAMP := .venv/.setup-$(shell cat requirements.lock pyproject.toml | cksum | cut -d ' ' -f 1)

PIP := $(BIN)/python -m pip --disable-pip-version-check
# Exits with the message, or with 0. It must run on old versions of Python as well.
CHECK := -c 'import sys; v = sys.version_info[:2]; sys.exit(v < (3, 11) and \
	"manip needs Python 3.11 or newer, and %s is %d.%d. Remove .venv if \
	there is one, and name another Python: make setup PYTHON=python3.12" % ((sys.executable,) + v))'

.DEFAULT_GOAL := help
.PHONY: help setup peers test test-slow test-browser lint format demo docs films lock clean

help: ## List the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-10s  %s\n", $$1, $$2 }' Makefile

setup: $(STAMP) ## Install manip and the tested versions of its dependencies into .venv

# torch goes first and alone, with its dependencies: which libraries it needs depends on
# the machine. See requirements.lock for why the rest is installed without.
$(STAMP): $(BIN)/python
	@$(BIN)/python $(CHECK)
	@rm -f .venv/.setup-*
	@$(PIP) --version > /dev/null 2>&1 || $(BIN)/python -m ensurepip
	@echo 'Installing into .venv: a few minutes the first time, longer with CUDA.'
	$(PIP) install --quiet --constraint requirements.lock torch
	$(PIP) install --quiet --no-deps --requirement requirements.lock
	$(PIP) install --quiet --no-deps --no-build-isolation --editable .
	@touch $@

$(BIN)/python:
	@$(PYTHON) $(CHECK)
	$(PYTHON) -m venv --clear .venv

# Installed by name, because pip would resolve robosuite's requirements along with
# manip-suite[peers], and these contradict the lock. They are not in the lock, because
# `make setup` installs all of it.
PEERS = $(BIN)/python -c 'import tomllib; \
	print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["peers"])'

peers: setup ## Install the libraries that manip benchmark compares with
	$(PIP) install --quiet --constraint requirements.lock $$($(PEERS))

# tests/conftest.py says which tests share a process.
PARALLEL := --numprocesses auto --maxprocesses 4 --dist loadfile

test: setup ## Run the fast tests
	$(BIN)/python -m pytest $(PARALLEL)

test-slow: setup ## Run the slow tests
	$(BIN)/python -m pytest -m slow $(PARALLEL)

# Not in the lock, as for the peers. The browser is the machine's own Chromium or Chrome.
test-browser: setup ## Test the pages in Chromium, which must be installed
	$(PIP) install --quiet --constraint requirements.lock playwright
	$(BIN)/python -m pytest -m browser

lint: setup ## Check style, format and types
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

format: setup ## Format the code and fix what ruff can fix
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

demo: setup ## Run the demonstration; its results go to runs/demo
	$(BIN)/python scripts/demo.py --out runs/demo

# Warnings are errors.
docs: setup ## Build the documentation site into build/docs
	$(PIP) install --quiet --constraint requirements.lock furo myst-parser sphinx
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going docs build/docs
	@echo 'Open build/docs/index.html in a browser.'

films: setup ## Render the videos of the gallery in the documentation again
	$(BIN)/python scripts/films.py

# Keeps the comments. labmaze has no wheel for Python 3.13 and newer. manip does not need
# it: only dm_control.locomotion imports it.
lock: ## Write the versions found in .venv to requirements.lock
	@$(PIP) freeze --all --exclude pip --exclude manip-suite > .venv/frozen
	@{ grep '^#' requirements.lock; \
	   grep -Ev '^(-e|#|(nvidia|cuda)-|triton==)' .venv/frozen \
	   | sed -e 's/+.*//' -e '/^labmaze==/s/$$/; python_version < "3.13"/' \
	   | LC_ALL=C sort -f -t = -k 1,1; } > .venv/requirements.lock
	@mv .venv/requirements.lock requirements.lock

clean: ## Remove caches and build output; keeps .venv and runs
	rm -rf build dist *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name .venv -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +
