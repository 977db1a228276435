# The two commands of the README. Everything lives in .venv; delete it to start over.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test check lint clean

# Exit code 1 means done, but some unit did not pass: for a demo that is a result, not a failure.
demo: $(STAMP)
	$(BIN)/softcal demo || [ $$? -eq 1 ]

test: $(STAMP) check
	$(BIN)/python -m pytest

check: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	mkdir -p .links && ln -sfn .. .links/softcal
	MYPYPATH=.links $(BIN)/mypy --explicit-package-bases -p softcal.core -p softcal.db -p softcal.station -p softcal.app
	$(BIN)/lint-imports

$(STAMP): pyproject.toml requirements.lock
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --constraint requirements.lock --editable '.[dev]'
	touch $(STAMP)

clean:
	rm -rf $(VENV) .links build *.egg-info
