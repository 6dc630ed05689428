# make demo: a synthetic street of photos -> poses -> scene -> report.   make test: the whole test suite.
# Both make their own .venv and install everything, CPU torch included. Nothing else is needed but Python 3.11 or newer.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
FRAMES ?= 36
STEPS ?= 1000
DEMO := out/demo

.PHONY: demo test lint format clean

demo: $(VENV)/ready
	$(BIN)/graphgs synth street $(DEMO)/street --frames $(FRAMES)
	$(BIN)/graphgs run $(DEMO)/street/images $(DEMO)/scene --preset preview --device cpu --max-side 480 --steps $(STEPS)
	@echo "Open $(DEMO)/scene/report.html"

test: $(VENV)/ready
	$(BIN)/python -m pytest -q

lint: $(VENV)/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(VENV)/ready
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) out

$(VENV)/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt torch
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[test]"
	touch $@
