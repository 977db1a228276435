# The commands of the README. Everything lives in .venv; delete it to start over.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := $(VENV)/.installed-demo
STAMP := $(VENV)/.installed
SOURCE := build/source
PYTEST := $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

# uv installs what uv.lock names and checks every hash. Where it is missing it comes from the index, into .venv.
UV ?= $(or $(shell command -v uv),$(BIN)/uv)
SYNC := UV_PROJECT_ENVIRONMENT=$(VENV) $(UV) sync --quiet --frozen --inexact --no-install-project --compile-bytecode

# From plain indexes torch comes with 2.7 GB of CUDA on Linux; its own index has the CPU build. Elsewhere the build of
# the plain index is the CPU build.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
TORCH := $(shell sed -n '/^name = "torch"$$/{n;s/version = "\(.*\)"/torch==\1/p;}' uv.lock)

.PHONY: demo test test-all check check-benchmarks proof docs lock sbom clean

# Exit code 1 means done, but some unit did not pass: for a demo that is a result, not a failure.
demo: $(DEMO)
	$(BIN)/softcal demo || [ $$? -eq 1 ]

# Two at once, each file in one process: what a file sets up for its tests is made once. Slow files begin first.
test: $(STAMP) check
	$(PYTEST) -m "not long"

# That and the long layer: every browser file, kills, all cores of the firmware, sites and wheels, notebooks.
test-all: $(STAMP) check check-benchmarks
	$(PYTEST) --durations 20

check: $(STAMP) $(SOURCE)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	MYPYPATH=$(SOURCE) $(BIN)/mypy --explicit-package-bases -p softcal.core -p softcal.db -p softcal.station -p softcal.app
	PYTHONPATH=$(SOURCE) $(BIN)/lint-imports
	$(BIN)/vulture

# Benchmarks run for hours and seldom: their calls are checked against what they call, not their own style.
check-benchmarks: $(STAMP) $(SOURCE)
	MYPYPATH=$(SOURCE):benchmarks $(BIN)/mypy --config-file= --explicit-package-bases --check-untyped-defs \
	  --no-strict-optional --ignore-missing-imports --follow-imports=silent --cache-dir=.mypy_cache/benchmarks \
	  benchmarks/*.py benchmarks/common/*.py

# tests/README.md, which test proves which promise, and the picture of the architecture.
proof:
	$(PYTHON) tests/promises.py

# The source under the name it is imported by, for tools that read it without importing it.
$(SOURCE):
	mkdir -p $@/softcal
	for folder in app core db station; do ln -sfn ../../../$$folder $@/softcal/$$folder; done

# The site with API pages, in site/. --strict: a warning is a failure.
docs: $(STAMP) $(SOURCE)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

$(VENV)/.made:
	@$(PYTHON) -c 'import ensurepip, sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' || { \
	  echo 'Python 3.11 to 3.14 with venv is needed (Debian: apt install python3-venv); or name it: make PYTHON=python3.12'; \
	  exit 1; }
	$(PYTHON) -m venv $(VENV)
	touch $@

$(DEMO): $(VENV)/.made pyproject.toml uv.lock
	@echo 'Installing what softcal needs to run: about 0.45 GB to download, 1.9 GB in $(VENV).'
	$(call install,--extra station --extra train --extra twin)
	touch $@

$(STAMP): $(VENV)/.made pyproject.toml uv.lock
	@echo 'Installing what the tests need: about 0.8 GB to download, 2.8 GB in $(VENV).'
	$(call install,--extra dev)
	touch $@ $(DEMO)

# torch's CPU build has other files than the plain index: it is taken first, and the hash its own index states is checked.
define install
	@command -v $(UV) >/dev/null || $(BIN)/python -m pip --disable-pip-version-check install --quiet uv
	[ "$$(uname)" != Linux ] || $(BIN)/python -m pip --disable-pip-version-check install --quiet --retries 1 \
	  --extra-index-url $(TORCH_INDEX) --no-deps $(TORCH)
	$(SYNC) $$([ "$$(uname)" != Linux ] || echo --no-install-package torch) $(1)
	$(UV) pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation --editable .
endef

# Resolve anew what pyproject.toml asks for, for all its Pythons and platforms; pins that still fit are kept.
lock: $(VENV)/.made
	$(UV) lock

# What an image runs beside softcal, as CycloneDX: names, versions, hashes.
sbom: $(VENV)/.made
	$(UV) export --quiet --frozen --no-emit-project --no-default-groups --format cyclonedx1.5 --extra train --extra twin --extra ui --extra station \
	  --extra documents --extra postgresql --extra connect --output-file sbom.cdx.json

clean:
	rm -rf $(VENV) build site *.egg-info
