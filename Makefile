# Two commands do all the set-up:  make demo  and  make test.  Both may be run again at any time.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CORE := $(VENV)/.core
STAMP := $(VENV)/.installed
PIP := $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt

# Bytecode is written whatever the environment says: each of some hundred processes would compile the package again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo stubs test test-full test-machines lint bench bench-gpu gpu-code work-precision engines examples picture roundoff verify known soak docs article gallery investigate trial trial-short dist release-check clean help

help:
	@echo "make demo      a heavy symmetric top for a million steps: table and figure in out/"
	@echo "make test      the whole test suite"
	@echo "make test-full the same with further cases, some of minutes"
	@echo "make test-machines  what depends on the processor, under the code that the libraries have for others; two hours"
	@echo "make examples  run every example, outputs in out/"
	@echo "make gallery   every picture of the gallery, in out/gallery and docs/gallery"
	@echo "make verify    every theorem of the paper, into docs/verified.md"
	@echo "make known     is it integrable: maps with a known answer, into docs/integrability-known.md"
	@echo "make investigate  is it integrable: every map and the negative controls, into docs/integrability-registry.md"
	@echo "make docs      the documentation site, in out/docs"
	@echo "make article   the mathematical article, out/article/maps.pdf; it needs LaTeX"
	@echo "make trial     kills, corruptions, configurations and calls in a place of their own; 30 minutes, MINUTES=10 for fewer"
	@echo "make soak      kills, faults, fuzzed input, a million lanes, 10^9 steps; hours"
	@echo "make stubs     src/kreisel/__init__.pyi, which tells editors the systems and their parameters"
	@echo "make lint      ruff and mypy --strict"
	@echo "make bench     speed: against C++ (needs g++), ensembles, saving, n; make roundoff: drift over 10^8 steps"
	@echo "make bench-gpu the same on an NVIDIA GPU; make gpu-code counts the instructions of its kernels, without one"
	@echo "make release-check  wheel and sdist, and the tests against the wheel in an environment of its own"
	@echo "make work-precision  every method here against heyoka, diffrax, SciPy and MuJoCo; some minutes"
	@echo "make engines   the check cases run by the engines of the package indexes, each in an environment of its own; two hours, 15 GB"

# The demo needs Kreisel alone; everything else the extras and the tools too.
$(CORE): pyproject.toml constraints.txt
	@echo "== creating $(VENV) and installing kreisel with the pinned versions of constraints.txt"
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'kreisel needs Python 3.11 or newer: make PYTHON=python3.11 ...')"
	$(PYTHON) -m venv $(VENV)
	$(PIP) --editable .
	@touch $(CORE)

$(STAMP): $(CORE)
	@echo "== installing the extras and the tools of the tests"
	$(PIP) --editable ".[dev]"
	@$(PIP) reboundx >/dev/null 2>&1 \
	  || echo "== REBOUNDx needs a C compiler: the tests that compare with it are skipped"
	@touch $(STAMP)

demo: $(CORE)
	@echo "== kreisel run examples/lagrange-top.toml"
	@mkdir -p out
	cd out && ../$(BIN)/kreisel run ../examples/lagrange-top.toml --overwrite
	@echo "== the archive is out/lagrange-top.zarr, the figure out/lagrange-top.png"

# What stands still is named and ended.
LIMITED := --timeout 400 --timeout-method thread

test: $(STAMP)
	@echo "== the test suite"
	KREISEL_CODE_LEVEL=0 $(BIN)/python -m pytest -q -rs -n 2 --dist worksteal $(LIMITED) tests

test-full: $(STAMP)
	@echo "== the test suite, with further cases"
	KREISEL_FULL=1 $(BIN)/python -m pytest -q -n 2 tests

# MACHINES="--quick", or names of tests/machines.py; all of them if nothing is said
test-machines: $(STAMP)
	@echo "== the part of the test suite that depends on the processor"
	$(BIN)/python tests/machines.py $(MACHINES)

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

examples: $(STAMP)
	@mkdir -p out
	@set -e; cd out; for file in ../examples/*.toml; do \
	  if grep -q '^\[sweep\]' $$file; then what=sweep; else what=run; fi; \
	  echo "== kreisel $$what $$file"; ../$(BIN)/kreisel $$what $$file --overwrite; done
	@set -e; cd out; for file in ../examples/*.py; do \
	  echo "== python $$file"; ../$(BIN)/python $$file; done

picture: $(STAMP)
	$(BIN)/python examples/compare.py docs

verify: $(STAMP)
	$(BIN)/python docs/tools/verified.py

known: $(STAMP)
	$(BIN)/python docs/tools/known_maps.py

investigate: $(STAMP)
	$(BIN)/python docs/tools/investigated.py

stubs: $(STAMP)
	$(BIN)/python docs/tools/stubs.py

docs: $(STAMP)
	@echo "== the code on the pages, and the pages made from the records; what is there for the same sources is kept"
	$(BIN)/python docs/tools/pages.py
	@echo "== the site"
	$(BIN)/python -m sphinx -j 2 -W --keep-going -q -E -b html -d out/doctrees docs out/docs
	@echo "== out/docs/index.html"

gallery: $(STAMP)
	@echo "== every script of examples/gallery in full, pictures into docs/gallery"
	$(BIN)/python docs/tools/gallery.py

dist: $(STAMP)
	rm -rf dist
	$(BIN)/python -m hatchling build -d dist

release-check: dist
	@echo "== the wheel in an environment of its own, tested by the tests of the sdist"
	rm -rf out/release && mkdir -p out/release
	tar -xzf dist/kreisel-*.tar.gz -C out/release --strip-components 1
	rm -rf out/release/src
	$(PYTHON) -m venv out/release/.venv
	out/release/.venv/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt \
	  "$$(ls dist/*.whl)[all]" pytest pytest-timeout pytest-xdist sympy
	cd out/release && .venv/bin/python -c "import kreisel; assert '.venv' in kreisel.__file__, kreisel.__file__"
	cd out/release && .venv/bin/python -m pytest -q -n 2 $(LIMITED) tests
	out/release/.venv/bin/kreisel systems

soak: $(STAMP)
	$(BIN)/python benchmarks/soak.py

MINUTES := 30

trial: $(STAMP)
	$(BIN)/python benchmarks/trial --minutes $(MINUTES)

trial-short: $(STAMP)
	@mkdir -p out
	$(BIN)/python benchmarks/trial --minutes 0.6 --part corruptions --part configurations --part calls --out out/trial.json

bench: $(STAMP)
	$(BIN)/python benchmarks/run.py

LATEX := pdflatex -interaction=nonstopmode -halt-on-error -output-directory ../out/article

article:
	@echo "== the article, out/article/maps.pdf; it needs LaTeX (Debian: texlive-latex-recommended, lmodern)"
	@mkdir -p out/article
	cd paper && $(LATEX) maps.tex > ../out/article/latex.txt
	cd out/article && BIBINPUTS=$(CURDIR)/src/kreisel: bibtex -terse maps
	cd paper && $(LATEX) maps.tex > /dev/null && $(LATEX) maps.tex > ../out/article/latex.txt
	@! grep -E "undefined|Overfull .hbox \([0-9]{2}" out/article/latex.txt

PEERS := $(VENV)-peers

$(PEERS)/.installed: $(STAMP) benchmarks/peers.txt
	@echo "== the peers, into $(PEERS)"
	$(PYTHON) -m venv $(PEERS)
	$(PIP:$(VENV)/%=$(PEERS)/%) --editable ".[dev]" --requirement benchmarks/peers.txt
	@touch $@

work-precision: $(PEERS)/.installed
	$(PEERS)/bin/python benchmarks/work_precision.py

engines: $(STAMP)
	$(BIN)/python benchmarks/engines

bench-gpu: $(STAMP)
	$(PIP) --editable ".[dev,cuda]" --requirement benchmarks/gpu.txt
	$(BIN)/python benchmarks/gpu.py

gpu-code: $(STAMP)
	$(PIP) --requirement benchmarks/gpu.txt
	$(BIN)/python benchmarks/gpu_code.py

roundoff: $(STAMP)
	$(BIN)/python benchmarks/roundoff.py

clean:
	rm -rf $(VENV) $(VENV)-peers $(VENV)-engines out .pytest_cache .mypy_cache .ruff_cache
