# make demo   install into .venv where needed, then show the whole chain on the bundled capture
# make test   the same installation, then style, types and tests
# make lint   style and types alone

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
TYPECHECK := build/typecheck

.PHONY: demo test lint

demo: $(INSTALLED)
	$(BIN)/cbox demo

test: lint
	@# two test processes share the cores
	OMP_NUM_THREADS=1 $(BIN)/pytest

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@# the rooms are packages inside cboxlab, which mypy sees only in a tree of that shape
	@rm -rf $(TYPECHECK) && mkdir -p $(TYPECHECK)/cboxlab
	@ln -s $(CURDIR)/cboxlab/* $(CURDIR)/scenes $(CURDIR)/calibration $(TYPECHECK)/cboxlab
	@ln -s $(CURDIR)/render $(TYPECHECK)/cboxlab/rendering
	@ln -s $(CURDIR)/validate $(TYPECHECK)/cboxlab/validation
	MYPYPATH=$(TYPECHECK) $(BIN)/mypy --namespace-packages --explicit-package-bases $(TYPECHECK)/cboxlab

$(INSTALLED): pyproject.toml .ci/prepare
	.ci/prepare $(PYTHON)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@
