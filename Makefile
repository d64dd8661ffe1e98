# make demo   install into .venv where needed, then show the whole chain on the bundled capture
# make test   the same installation, then style, types and tests
# make lint   style and types alone

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
ROOMS := scenes calibration render validate
TYPECHECK := build/typecheck

.PHONY: demo test lint

demo: $(INSTALLED)
	$(BIN)/cbox demo

test: lint
	$(BIN)/pytest

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@# the rooms are packages inside cboxlab, which mypy sees only in a tree of that shape
	@mkdir -p $(TYPECHECK)/cboxlab
	@for room in $(ROOMS); do ln -sfn ../../../$$room $(TYPECHECK)/cboxlab/$$room; done
	@for file in cboxlab/*.*; do ln -sfn ../../../$$file $(TYPECHECK)/$$file; done
	MYPYPATH=$(TYPECHECK) $(BIN)/mypy --namespace-packages --explicit-package-bases $(TYPECHECK)/cboxlab

$(INSTALLED): pyproject.toml .ci/prepare
	.ci/prepare $(PYTHON)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@
