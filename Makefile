# make demo   install into .venv where needed, then show the whole chain on the bundled capture
# make test   the same installation, then style, types and tests
# make lint   style and types alone
# make oldest, make newest   tests with the oldest or the newest allowed dependencies, in an environment of their own;
#                            TESTS="tests/utils tests/scenes" runs some of them
# make audit   known weaknesses of the dependencies, and the bill of materials build/bom.json; needs the network

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
TYPECHECK := build/typecheck
TESTS ?= tests

.PHONY: demo test lint style types suite oldest newest audit

demo: $(INSTALLED)
	$(BIN)/cbox demo

test: style
	@# types are checked in one process: tests have the other core meanwhile
	$(MAKE) --no-print-directory --jobs=2 types suite

suite: $(INSTALLED)
	@# two test processes share the cores; commands that tests start need not compile 620 modules again (0.7 CPU s)
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/pytest

lint: style types

style: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(INSTALLED)
	@# the rooms are packages inside cboxlab, which mypy sees only in a tree of that shape
	@rm -rf $(TYPECHECK) && mkdir -p $(TYPECHECK)/cboxlab
	@ln -s $(CURDIR)/cboxlab/* $(CURDIR)/scenes $(CURDIR)/calibration $(TYPECHECK)/cboxlab
	@ln -s $(CURDIR)/render $(TYPECHECK)/cboxlab/rendering
	@ln -s $(CURDIR)/validate $(TYPECHECK)/cboxlab/validation
	MYPYPATH=$(TYPECHECK) $(BIN)/mypy --namespace-packages --explicit-package-bases $(TYPECHECK)/cboxlab

oldest: RESOLUTION := lowest-direct
newest: RESOLUTION := highest

oldest newest:
	$(PYTHON) -m venv build/uv
	build/uv/bin/python -m pip install --quiet --disable-pip-version-check uv
	build/uv/bin/uv venv --quiet --clear --python $(PYTHON) build/$@
	build/uv/bin/uv pip install --quiet --python build/$@ --resolution $(RESOLUTION) -e '.[dev]'
	OMP_NUM_THREADS=1 build/$@/bin/python -m pytest $(TESTS)

audit:
	$(PYTHON) -m venv --clear build/audit
	$(PYTHON) -m venv build/audit-tools
	build/audit/bin/python -m pip install --quiet --disable-pip-version-check .
	build/audit-tools/bin/python -m pip install --quiet --disable-pip-version-check pip-audit cyclonedx-bom
	build/audit-tools/bin/cyclonedx-py environment --pyproject pyproject.toml --output-file build/bom.json build/audit/bin/python
	build/audit/bin/python -m pip freeze --exclude cboxlab >build/audited.txt
	build/audit-tools/bin/pip-audit --strict --disable-pip --no-deps --requirement build/audited.txt

$(INSTALLED): pyproject.toml .ci/prepare
	.ci/prepare $(PYTHON)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@
