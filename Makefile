# `make run` and `make test` do everything on a machine with Python >= 3.11, pip, make and git.
PYTHON ?= python3
ifeq ($(OS),Windows_NT)
BIN := .venv/Scripts
else
BIN := .venv/bin
endif

.PHONY: run test slow lint check bench samples clean

run: .venv/ready
	$(BIN)/envcal run pipeline.yaml
	@echo "Open output/report.html in a browser; the spectral map is output/spectra/environment.exr."

test: .venv/ready-dev
	$(BIN)/python -m pytest -n auto --dist loadfile

slow: .venv/ready-dev
	$(BIN)/python -m pytest -m slow

lint: .venv/ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

check: lint test

bench: .venv/ready-dev
	$(BIN)/python -m benchmarks

samples: .venv/ready-dev
	$(BIN)/python -m samples

clean:
	rm -rf .venv output .mypy_cache .ruff_cache .pytest_cache .import_linter_cache

.venv/ready: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --editable .
	@echo ready > $@

.venv/ready-dev: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	@echo ready > .venv/ready
	@echo ready > $@
