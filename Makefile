# Two commands matter: `make demo` and `make test`. Each makes the environments it needs. CI runs `make test-all`, too.

# The first Python that is new enough, not too new for Dagster, and can make environments; it must run: shims of
# pyenv are on the PATH even if no such version is chosen. The devkit prefers one that has wheels of numpy < 2.
PYTHON ?= $(call first,$(call fits,15),python3 python3.13 python3.12 python3.11 python3.14 python)
DEVKIT_PYTHON ?= $(or $(call first,$(call fits,13),$(PYTHON) python3.12 python3.11),$(PYTHON))
# Of lerobot 0.4.4, whose newer versions want another Python than the one that most have.
LEROBOT_PYTHON ?= $(call first,$(is_3_11),$(PYTHON) python3.11 $(wildcard $(HOME)/.pyenv/versions/3.11.*/bin/python))
is_3_11 = import ensurepip, sys, venv; sys.exit(sys.version_info[:2] != (3, 11))
fits = import ensurepip, sys, venv; sys.exit(not (3, 11) <= sys.version_info < (3, $(1)))
first = $(shell for name in $(2); do "$$name" -c '$(1)' 2>/dev/null && echo "$$name" && break; done)
define need
@"$(1)" -c '$(call fits,15)' 2>/dev/null || { echo "bagassets needs Python 3.11 to 3.14 with its module venv;\
 $(if $(1),$(1) is not that,none is on the PATH). Install one, or name it: make PYTHON=/path/to/python3.12" >&2; exit 1; }
endef

VENV := .venv
DEVKIT := .devkit-venv
LEROBOT := .lerobot-venv
BIN := $(VENV)/bin
export BAGASSETS_DEVKIT_PYTHON := $(CURDIR)/$(DEVKIT)/bin/python
export BAGASSETS_LEROBOT_PYTHON ?= $(CURDIR)/$(LEROBOT)/bin/python

.PHONY: env env-lerobot env-fuzz demo test test-all test-lerobot lint docs clean bench bench-all bench-lerobot bench-incremental bench-peers bench-plan bench-check chaos crash soak mutants fuzz
.DEFAULT_GOAL := demo

# Whoever has an environment of that name, with other things in it, keeps it.
define own
@[ ! -e $(1) ] || [ -e $(1)/.made ] || [ -e $(1)/.by-make ] || { echo "$(1) is here already, and not made by make:\
 remove it, or keep it and name another: make VENV=.venv-bagassets" >&2; exit 1; }
endef

# A stamp file each, so that a second run costs nothing.
$(VENV)/.made: pyproject.toml requirements.lock
	$(call need,$(PYTHON))
	$(call own,$(VENV))
	@echo "Making the environment $(VENV), once: some minutes, most of them for downloads"
	"$(PYTHON)" -m venv --clear $(VENV)
	@touch $(VENV)/.by-make
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@# pip does not compile what it only links to, nor does Python later where PYTHONDONTWRITEBYTECODE is set, as in many
	@# images of Docker: each command and server would compile it again.
	$(BIN)/python -m compileall -q bagassets
	touch $@

# The nuscenes-devkit asks for numpy < 2, so it lives in an environment of its own. Its lock is complete; without
# --no-deps pip would refuse the numpy 2 in it for Pythons that have no other.
$(DEVKIT)/.made: requirements-devkit.lock
	$(call need,$(DEVKIT_PYTHON))
	@echo "Making the environment $(DEVKIT), once: some minutes, most of them for downloads"
	"$(DEVKIT_PYTHON)" -m venv --clear $(DEVKIT)
	$(DEVKIT)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements-devkit.lock
	touch $@

# Environments alone, so that several can be made at a time: pip uses one processor.
env: $(VENV)/.made $(DEVKIT)/.made
env-lerobot: $(LEROBOT)/.made
env-fuzz: $(VENV)/.made-fuzz

demo: $(VENV)/.made
	@$(BIN)/bagassets demo build/demo

test: $(VENV)/.made $(DEVKIT)/.made
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	@# By file, as fixtures of a file are dear to make.
	$(BIN)/pytest -n auto --dist loadfile -m "not long" $(PYTEST_ARGS)

# What `make test` leaves out: long tests, the lowest versions of all dependencies, and the newest with another Python.
# TEST_ALL="lowest" runs one part of it.
test-all: $(VENV)/.made $(DEVKIT)/.made
	$(BIN)/python -m scripts.test_all $(TEST_ALL)

# The real lerobot loads, decodes, merges and trains on what we write; a part of test-all. torch for the processor alone is
# not in the package index, so its own is asked if no other place is configured.
test-lerobot: $(VENV)/.made $(LEROBOT)/.made
	$(BIN)/pytest -n 0 -m lerobot bagassets_tests/formats/lerobot $(PYTEST_ARGS)

$(LEROBOT)/.made: requirements-lerobot.lock
	@[ -n "$(LEROBOT_PYTHON)" ] || { echo "lerobot 0.4.4 needs Python 3.11, and there is none here: name it, as in\
 make LEROBOT_PYTHON=/path/to/python3.11 test-lerobot" >&2; exit 1; }
	@echo "Making the environment $(LEROBOT), once: some minutes, most of them for downloads"
	"$(LEROBOT_PYTHON)" -m venv --clear $(LEROBOT)
	$(LEROBOT)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements-lerobot.lock || \
		$(LEROBOT)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps \
		--extra-index-url https://download.pytorch.org/whl/cpu -r requirements-lerobot.lock
	touch $@

lint: $(VENV)/.made
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# All that pages and pictures show of the code, and the width of their prose: after a new asset, format, check or field of the recipe.
docs: $(VENV)/.made
	$(BIN)/python -m scripts.docs

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

# Beside peers that you have fetched (docs/performance.md): CONVERTER="PYTHON SCRIPT … {bag} … {out} … {params}", BAZEL=bazel,
# BAGZEL=CHECKOUT. Without them ours alone is measured.
bench-peers: $(VENV)/.made-bench
	$(BIN)/python -m benchmarks.peers --folder build/bench $(if $(CONVERTER),--converter '$(CONVERTER)') \
		$(if $(BAZEL),--bazel '$(BAZEL)') $(if $(BAGZEL),--bagzel '$(BAGZEL)')

# All results, and the figures of README and docs from them: most of an hour on two quiet cores, with 20 GB of disk.
bench-all: bench-peers $(DEVKIT)/.made
	$(BIN)/python -m benchmarks --folder build/bench
	$(BIN)/python benchmarks/incremental.py --bags 4 --json benchmarks/results/incremental.json
	$(BIN)/python benchmarks/plan.py --recordings 2000 --json benchmarks/results/plan.json
	$(BIN)/python benchmarks/launch.py --times 3 --json benchmarks/results/launch.json
	$(BIN)/python -m benchmarks.kernels --trials 3 --json benchmarks/results/kernels.json
	$(BIN)/python -m benchmarks.damaged --json benchmarks/results/damaged.json
	$(BIN)/python -m benchmarks.reader --json benchmarks/results/reader.json
	$(BIN)/python -m benchmarks.scale --json benchmarks/results/scale.json
	$(BIN)/python -m benchmarks.pages
	rm -rf build/bench

# Beside lerobot's own loop on the same images: some minutes.
bench-lerobot: $(VENV)/.made $(LEROBOT)/.made
	$(BIN)/python -m benchmarks.lerobot --json benchmarks/results/lerobot.json

bench-plan: $(VENV)/.made
	@mkdir -p build
	$(BIN)/python benchmarks/plan.py --json build/plan.json

# Every state in which a crash can leave files, and every read that fails: by hand, some hours, with the results committed. CRASH="--share 0.05" tries some.
crash: $(VENV)/.made
	$(BIN)/python -m benchmarks.crash --json benchmarks/results/crash.json $(CRASH)

# Before a release: refuses if results in the docs were measured too many commits ago.
bench-check: $(VENV)/.made
	$(BIN)/python -m benchmarks.check

# Kills at random moments, and many builds on one server: by hand, a quarter and half an hour, with the results committed.
chaos: $(VENV)/.made
	$(BIN)/python -m benchmarks.chaos --json benchmarks/results/chaos.json $(CHAOS)

soak: $(VENV)/.made
	$(BIN)/python -m benchmarks.soak --json benchmarks/results/soak.json $(SOAK)

# Does a test fail when a line is wrong? By hand: an hour or two; MUTANTS="--number 50 --seed 7 --only bagassets/decode".
mutants: $(VENV)/.made-mutants $(DEVKIT)/.made
	$(BIN)/python -m scripts.mutants $(MUTANTS)

$(VENV)/.made-mutants: $(VENV)/.made
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'mutmut>=3.8,<4' 'coverage>=7.10,<8'
	touch $@

# Bytes that nobody wrote, for whatever reads bytes; FUZZ="mcap decoders" fuzzes some. A minute of it is in test-all.
FUZZ_MINUTES ?= 10
fuzz: $(VENV)/.made-fuzz
	$(BIN)/python -m bagassets_tests.fuzz --minutes $(FUZZ_MINUTES) $(FUZZ)

$(VENV)/.made-fuzz: $(VENV)/.made
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'atheris>=3,<4'
	touch $@

clean:
	rm -rf build $(VENV) $(DEVKIT) $(LEROBOT)
