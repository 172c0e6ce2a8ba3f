# make demo   set everything up, build the quickstart dataset and show a scene of it
# make test   set everything up and run the checks and the tests
# make help   the other targets

SHELL := /bin/sh
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready
# The first interpreter of a supported version.
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
	command -v $$p >/dev/null 2>&1 && $$p -c 'import sys; sys.exit(not (3,11) <= sys.version_info[:2] <= (3,13))' \
	&& echo $$p && break; done)
JOBS ?= 2
CONFIG ?= configs/quickstart.yaml
OUT ?= out/quickstart.zarr
ROOMS ?= 10000

.PHONY: help setup demo smoke test tests check lint types format generated fuzz nightly bench bench-scaling \
	bench-first bench-detector bench-devices bench-loaders bench-large bench-evidence bench-acceptance bench-sequences \
	bench-peers peers docs wheel wheel-demo clean

help:
	@sed -n '1,3p' Makefile | cut -c3-
	@echo "make setup   the virtual environment .venv and nothing else"
	@echo "make smoke   one tiny scene from its configuration to a training batch, in seconds"
	@echo "make tests   the tests alone;  make check   lint, format and types alone"
	@echo "make format  rewrite the sources in house style"
	@echo "make generated  remake configs/schema.json, docs/configuration_keys.md and docs/materials.md from the sources"
	@echo "make docs    the pages in out/site, with the tutorials run"
	@echo "make fuzz    thousands of random cases (SEED=…)"
	@echo "make nightly the long statistical runs (hours)"
	@echo "make wheel   a wheel in dist/;  make wheel-demo   the demo from the wheel alone;  make clean   remove what was made"
	@echo "make bench   the figures of docs/figures.md, some hours; one of them: make bench-scaling, -first, -detector,"
	@echo "             -devices, -loaders, -large, -evidence, -acceptance, -sequences, -peers;  make peers   compare with mitransient (needs LLVM 19 or newer)"

setup: $(STAMP)

# Of 14 000 installed files a fifth is ever imported: each is compiled when it is.
$(STAMP): pyproject.toml constraints.txt docker/system-packages.txt
	@test -n "$(PYTHON)" || { echo "datagen: Python 3.11, 3.12 or 3.13 is needed; none was found on PATH" >&2; exit 2; }
	@sh docker/install-system-packages.sh docker/system-packages.txt "open3d will not load"
	@$(PYTHON) -m venv $(VENV) || { echo "datagen: $(PYTHON) -m venv failed; on Debian install python3-venv" >&2; exit 2; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e '.[tests]'
	@touch $@

demo: setup
	$(BIN)/datagen build $(CONFIG) $(OUT) --workers 2
	$(BIN)/datagen info $(OUT)
	$(BIN)/datagen show $(OUT) 0
	@echo "or, with datagen in $(BIN), enough rooms to train on (README.md, Train on it):"
	@echo "      $(BIN)/datagen build $(CONFIG) $(OUT) --workers 2 --scenes 512"

smoke: setup
	$(BIN)/python tests/tools/smoke.py

# Types are checked beside the tests: mypy keeps one core busy for a minute.
test: lint
	@$(MAKE) --no-print-directory --jobs=2 types tests

check: lint types

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

tests: setup $(VENV)/.browser
	$(BIN)/python -m pytest -n $(JOBS)

# A browser, 300 MB on Debian, for the tests of the preview page alone; tried once, by root only.
$(VENV)/.browser: docker/browser-packages.txt | setup
	@[ "$$(id -u)" != 0 ] || command -v google-chrome >/dev/null || \
		sh docker/install-system-packages.sh docker/browser-packages.txt "the tests of the preview page are skipped"
	@touch $@

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# JSON Schema and the table of keys from the configuration models, the table of materials from the catalogue.
generated: setup
	$(BIN)/datagen schema > configs/schema.json
	$(BIN)/python docs/make_configuration_keys.py
	$(BIN)/python docs/make_materials.py

# The pages, with search, to be opened as files or put on any server. A tutorial is run again when a source is newer.
docs: setup $(patsubst docs/%,out/%,$(wildcard docs/tutorials/*.ipynb))
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict
	@echo "open out/site/index.html"

out/tutorials/%.ipynb: docs/tutorials/%.ipynb $(shell find datagen scene_library -name '*.py') | setup
	$(BIN)/python docs/run_tutorials.py $< $(@D)

# Thousands of random cases, new ones at each run: make fuzz SEED=7 repeats one.
fuzz: SEED ?= $(shell date +%s)
fuzz: setup
	@echo "fuzz: SEED=$(SEED)"
	DATAGEN_FUZZ=nightly $(BIN)/python -m pytest -p no:cacheprovider -n $(JOBS) --hypothesis-seed=$(SEED) tests/fuzz

# About two and a half hours on two cores: what the ordinary tests do with few cases, at the size that the documentation
# states, and whether they notice faults. Ten minutes for pytest and fuzz, then 70, 30 for the mutations and 40 for the
# rooms, on one core.
nightly: setup
	$(BIN)/python -m pytest -n $(JOBS) -m nightly
	$(MAKE) fuzz
	$(BIN)/python tests/benchmarks/harm_table.py
	$(BIN)/python tests/tools/mutations.py
	$(BIN)/python tests/benchmarks/many_rooms.py --specs $(ROOMS)

bench: setup bench-scaling bench-first bench-detector bench-devices bench-loaders bench-large bench-evidence \
		bench-acceptance bench-sequences bench-peers
	$(BIN)/datagen bench stages $(CONFIG)
	$(BIN)/datagen bench accuracy configs/demonstration_room.yaml out/accuracy

bench-scaling: setup
	$(BIN)/python tests/benchmarks/scaling.py

bench-first: setup
	$(BIN)/python tests/benchmarks/first_scene.py $(CONFIG)

bench-detector: setup
	$(BIN)/python tests/benchmarks/detector.py
	$(BIN)/python tests/benchmarks/pileup.py configs/demonstration_room.yaml

bench-devices: setup
	$(BIN)/python tests/benchmarks/devices.py

bench-loaders: setup
	$(BIN)/python tests/benchmarks/loaders.py

bench-large: setup
	$(BIN)/python tests/benchmarks/large_datasets.py
	$(BIN)/python tests/benchmarks/long_builds.py $(CONFIG) --scenes 2048 --workers 2
	$(BIN)/python tests/benchmarks/long_builds.py $(CONFIG) --scan 64x64x512 --scenes 64

bench-evidence: setup
	$(BIN)/python tests/benchmarks/evidence.py 100 0.1 configs/*.yaml

bench-acceptance: setup
	$(BIN)/python tests/benchmarks/ways.py
	$(BIN)/python tests/benchmarks/acceptance.py hard
	$(BIN)/python tests/benchmarks/acceptance.py ready kept --scenes 60

bench-sequences: setup
	$(BIN)/python tests/benchmarks/sequences.py claims --rooms 8
	$(BIN)/python tests/benchmarks/sequences.py energies --rooms 5
	$(BIN)/python tests/benchmarks/sequences.py floors --rooms 6
	$(BIN)/python tests/benchmarks/sequences.py speed --rooms 4

bench-peers: setup
	$(BIN)/python tests/benchmarks/peers.py out/peers

peers: setup
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[tests,peers]'
	$(BIN)/python -m pytest -m peers -s tests/peers

wheel: setup
	rm -rf build
	$(BIN)/python -m pip wheel --quiet --no-deps -w dist .

# As somebody who installs the package sees it: neither the checkout nor `.venv`, only a configuration is at hand.
wheel-demo:
	rm -rf out/wheel build
	$(PYTHON) -m venv out/wheel/.venv
	out/wheel/.venv/bin/python -m pip wheel --quiet --no-deps -w out/wheel .
	out/wheel/.venv/bin/python -m pip install --quiet --no-compile -c constraints.txt out/wheel/*.whl
	cp $(CONFIG) out/wheel/demo.yaml
	cd out/wheel && .venv/bin/datagen build demo.yaml demo.zarr --workers 2
	cd out/wheel && .venv/bin/datagen info demo.zarr && .venv/bin/datagen show demo.zarr 0

clean:
	rm -rf $(VENV) out dist build *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
