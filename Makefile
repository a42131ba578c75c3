# Two commands matter: `make demo` and `make test`. Each makes the environments it needs.

PYTHON ?= python3.11
VENV := .venv
DEVKIT := .devkit-venv
BIN := $(VENV)/bin
export BAGASSETS_DEVKIT_PYTHON := $(CURDIR)/$(DEVKIT)/bin/python

.PHONY: demo test lint docs clean bench bench-incremental bench-plan
.DEFAULT_GOAL := demo

# A stamp file each, so that a second run costs nothing.
$(VENV)/.made: pyproject.toml requirements.lock
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	touch $@

# The nuscenes-devkit needs numpy < 2: it lives in an environment of its own.
$(DEVKIT)/.made: requirements-devkit.lock
	$(PYTHON) -m venv $(DEVKIT)
	$(DEVKIT)/bin/python -m pip install --quiet --disable-pip-version-check -r requirements-devkit.lock
	touch $@

demo: $(VENV)/.made
	@$(BIN)/bagassets demo build/demo

test: $(VENV)/.made $(DEVKIT)/.made
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	@# By file, as fixtures of a file are dear to make.
	$(BIN)/pytest -n auto --dist loadfile

lint: $(VENV)/.made
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# About ten minutes on two cores; EXTERNAL="converter {bags} {output}" adds another converter.
bench-incremental: $(VENV)/.made
	@mkdir -p build
	$(BIN)/python benchmarks/incremental.py --json build/incremental.json $(if $(EXTERNAL),--external '$(EXTERNAL)')

# The evaluation of the paper: about 15 minutes on two quiet cores; BENCH="rq1 --full --converter 'CMD {bag} {out}'".
bench: $(VENV)/.made-bench
	$(BIN)/python -m benchmarks $(BENCH)

$(VENV)/.made-bench: $(VENV)/.made
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'matplotlib>=3.8,<4'
	touch $@

bench-plan: $(VENV)/.made
	@mkdir -p build
	$(BIN)/python benchmarks/plan.py --json build/plan.json

clean:
	rm -rf build $(VENV) $(DEVKIT)
