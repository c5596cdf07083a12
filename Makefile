# Two commands do all the set-up:  make demo  and  make test.  Both may be run again at any time.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test test-full lint bench examples picture roundoff verify soak clean help

help:
	@echo "make demo      a heavy symmetric top for a million steps: table and figure in out/"
	@echo "make test      the whole test suite"
	@echo "make test-full the same with the cases that take minutes"
	@echo "make examples  run every example, outputs in out/"
	@echo "make verify    every theorem of the paper, into docs/verified.md"
	@echo "make soak      200 kills of a run at random moments; some minutes"
	@echo "make lint      ruff and mypy --strict"
	@echo "make bench     speed: against C++ (needs g++), ensembles, saving, n; make roundoff: drift over 10^8 steps"
	@echo "make bench-gpu the same on an NVIDIA GPU"

$(STAMP): pyproject.toml constraints.txt
	@echo "== creating $(VENV) and installing kreisel with the pinned versions of constraints.txt"
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'kreisel needs Python 3.11 or newer: make PYTHON=python3.11 ...')"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[dev]"
	@touch $(STAMP)

demo: $(STAMP)
	@echo "== kreisel run examples/lagrange-top.toml"
	@mkdir -p out
	cd out && ../$(BIN)/kreisel run ../examples/lagrange-top.toml --overwrite
	@echo "== the archive is out/lagrange-top.zarr, the figure out/lagrange-top.png"

test: $(STAMP)
	@echo "== the test suite"
	$(BIN)/python -m pytest -q -n 2 tests

test-full: $(STAMP)
	@echo "== the test suite, with the cases that take minutes"
	KREISEL_FULL=1 $(BIN)/python -m pytest -q -n 2 tests

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

examples: $(STAMP)
	@mkdir -p out
	@set -e; cd out; for file in ../examples/*.toml; do \
	  echo "== kreisel run $$file"; ../$(BIN)/kreisel run $$file --overwrite; done
	@set -e; cd out; for file in ../examples/*.py; do \
	  echo "== python $$file"; ../$(BIN)/python $$file; done

picture: $(STAMP)
	$(BIN)/python examples/compare.py docs

verify: $(STAMP)
	$(BIN)/kreisel verify --markdown > docs/verified.md.part && mv docs/verified.md.part docs/verified.md

soak: $(STAMP)
	KREISEL_KILLS=200 $(BIN)/python -m pytest -q tests/test_resume.py -k killed

bench: $(STAMP)
	$(BIN)/python benchmarks/run.py

bench-gpu: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[dev,cuda]"
	$(BIN)/python benchmarks/gpu.py

roundoff: $(STAMP)
	$(BIN)/python benchmarks/roundoff.py

clean:
	rm -rf $(VENV) out .pytest_cache .mypy_cache .ruff_cache
