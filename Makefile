# The two commands of the README. Everything lives in .venv; delete it to start over.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := $(VENV)/.installed-demo
STAMP := $(VENV)/.installed
PIP := $(BIN)/python -m pip --disable-pip-version-check
UV ?= uv

# From plain indexes torch comes with 2.7 GB of CUDA on Linux; its own index has the CPU build. Elsewhere the build of
# the plain index is the CPU build.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
TORCH := $(shell sed -n 's/^\(torch==[0-9.]*\).*/\1/p' requirements.lock)

.PHONY: demo test check docs lock sbom clean

# Exit code 1 means done, but some unit did not pass: for a demo that is a result, not a failure.
demo: $(DEMO)
	$(BIN)/softcal demo || [ $$? -eq 1 ]

# Two at once, each file in one process: what a file sets up for its tests is made once. Slow files begin first.
test: $(STAMP) check
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

check: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	mkdir -p .links && ln -sfn .. .links/softcal
	MYPYPATH=.links $(BIN)/mypy --explicit-package-bases -p softcal.core -p softcal.db -p softcal.station -p softcal.app
	MYPYPATH=.links:benchmarks $(BIN)/mypy $(LOOSE) benchmarks/*.py
	PYTHONPATH=.links $(BIN)/lint-imports

# Benchmarks run for hours and seldom: their calls are checked against what they call, not their own style.
LOOSE := --config-file= --explicit-package-bases --check-untyped-defs --no-strict-optional --ignore-missing-imports \
  --follow-imports=silent --cache-dir=.mypy_cache/benchmarks

# The site with API pages, in site/. --strict: a warning is a failure.
docs: $(STAMP)
	mkdir -p build/docs/softcal
	for folder in app core db station; do ln -sfn ../../../$$folder build/docs/softcal/$$folder; done
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

$(VENV)/.made:
	@$(PYTHON) -c 'import ensurepip, sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' || { \
	  echo 'Python 3.11 to 3.14 with venv is needed (Debian: apt install python3-venv); or name it: make PYTHON=python3.12'; \
	  exit 1; }
	$(PYTHON) -m venv $(VENV)
	touch $@

$(DEMO): $(VENV)/.made pyproject.toml requirements-demo.lock
	@echo 'Installing what softcal needs to run: about 0.45 GB to download, 1.8 GB in $(VENV).'
	$(call install,requirements-demo.lock)
	touch $@

$(STAMP): $(DEMO) pyproject.toml requirements.lock
	@echo 'Installing what the tests need, too: about 1 GB more in $(VENV).'
	$(call install,requirements.lock)
	touch $@

# pip checks the hash of every file in the lock. torch's CPU build has other files than the plain index: it is taken
# first, and the hash its index states is checked.
define install
	[ "$$(uname)" != Linux ] || $(PIP) install --retries 1 --extra-index-url $(TORCH_INDEX) --no-deps $(TORCH)
	$(PIP) install --require-hashes --requirement $(1)
	$(PIP) install --quiet --no-deps --no-build-isolation --editable .
endef

# Resolve anew what pyproject.toml asks for, for all its Pythons and platforms; pins that still fit are kept.
lock:
	echo 'setuptools>=77' | $(UV) pip compile $(LOCKED) --extra dev --output-file requirements.lock pyproject.toml -
	echo 'setuptools>=77' | $(UV) pip compile $(LOCKED) --extra station --constraint requirements.lock \
	  --output-file requirements-demo.lock pyproject.toml -
	echo 'setuptools>=77' | $(UV) pip compile $(LOCKED) --extra ui --extra station --extra documents --extra postgresql \
	  --extra connect --constraint requirements.lock --output-file requirements-image.lock pyproject.toml -
LOCKED := --quiet --universal --python-version 3.11 --generate-hashes --no-annotate --custom-compile-command 'make lock'

# What runs beside softcal, as CycloneDX: names, versions, hashes.
sbom: $(STAMP)
	$(BIN)/cyclonedx-py requirements --output-reproducible --output-file sbom.cdx.json requirements-image.lock

clean:
	rm -rf $(VENV) .links build site *.egg-info
