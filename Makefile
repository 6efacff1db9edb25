# Everything a newcomer needs: `make demo` and `make test` set themselves up. `make test-all` does what
# `make test` does, and runs the files of tests that compile much too, which have the mark `long`.
PYTHON ?= $(shell command -v python3.13 || command -v python3.12 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
JOBS ?= 2
PEERS := benchmarks/.peers

.PHONY: demo test test-all coverage bench campaign docs clean

# A document or a file of tests is given to one worker, which compiles what its tests share once.
PYTEST := $(BIN)/pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder

# Byte code is kept as well: to collect the tests takes 7 s with it and 27 without.
test test-all coverage: export PYTHONDONTWRITEBYTECODE =

demo: $(READY)
	$(BIN)/python examples/demo.py

test: LAYER = -m "not long"
test-all: LAYER =
test test-all: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	@# Without its cache mypy takes a minute of one core: beside the tests, and told after them.
	@mkdir -p .mypy_cache; $(BIN)/mypy > .mypy_cache/last.txt 2>&1 & types=$$!; \
	echo '$(PYTEST) $(LAYER)'; $(PYTEST) $(LAYER); tests=$$?; \
	wait $$types; types=$$?; echo "$(BIN)/mypy"; cat .mypy_cache/last.txt; exit $$((tests | types))

# Of both layers; of `make test` alone with `make coverage LAYER='-m "not long"' LEAST=93`.
LEAST ?= 90

coverage: $(READY)
	$(PYTEST) $(LAYER) --cov --cov-report=json:.coverage_totals.json --cov-report=
	@$(BIN)/coverage report --skip-covered --sort=cover
	@$(BIN)/python -c "$$SHARES"

define SHARES
import json, sys
totals = json.load(open(".coverage_totals.json"))["totals"]
lines, branches = totals["percent_statements_covered"], totals["percent_branches_covered"]
print(f"{lines:.1f} % of lines and {branches:.1f} % of branches of src; at least $(LEAST) % of lines")
sys.exit(lines < $(LEAST))
endef
export SHARES

bench: $(READY) $(PEERS)/.ready $(PEERS)/torch/.ready $(PEERS)/faran/.ready
	$(BIN)/python -m benchmarks

# Bad input, kills and full disks. It takes hours; `make test-all` runs a part of it.
campaign: $(READY)
	$(BIN)/python -m tests.campaign

# jax_mppi's own environment. Building it needs CUDA, its JAX part does not: the sources do.
$(PEERS)/.ready: $(READY)
	rm -rf $(PEERS)
	-$(PYTHON) -m venv $(PEERS) \
	  && $(PEERS)/bin/python -m pip install --quiet -c constraints.txt jax chex \
	  && $(PEERS)/bin/python -m pip download --quiet --no-deps --dest $(PEERS)/source jax_mppi==0.3.0 \
	  && mkdir $(PEERS)/jax_mppi \
	  && tar -xzf $(PEERS)/source/jax_mppi-0.3.0.tar.gz -C $(PEERS)/jax_mppi --strip-components 1 \
	  || { rm -rf $(PEERS)/bin; false; }
	mkdir -p $(PEERS) && touch $@

# pytorch_mppi's: any Python that PyTorch has a build for; 3.11 if it is there.
$(PEERS)/torch/.ready: $(PEERS)/.ready
	rm -rf $(PEERS)/torch
	-for python in python3.11 $(wildcard $(HOME)/.pyenv/versions/3.11*/bin/python3.11) $(PYTHON); do \
	  $$python -c 'import ensurepip' 2> /dev/null && break; done \
	  && $$python -m venv $(PEERS)/torch \
	  && $(PEERS)/torch/bin/python -m pip install --quiet torch==2.13.0 pytorch_mppi==0.9.1 numpy \
	  || { rm -rf $(PEERS)/torch; false; }
	mkdir -p $(PEERS)/torch && touch $@

# Faran's, which needs Python 3.13. It brings both of its backends.
$(PEERS)/faran/.ready: $(PEERS)/.ready
	rm -rf $(PEERS)/faran
	-$(PYTHON) -m venv $(PEERS)/faran \
	  && $(PEERS)/faran/bin/python -m pip install --quiet -c constraints.txt faran==0.3.1 \
	  || { rm -rf $(PEERS)/faran; false; }
	mkdir -p $(PEERS)/faran && touch $@

docs: $(READY)
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html
	@echo "The documentation is at docs/_build/html/index.html"

# The stamp is written last: a set-up that was cut off is done again.
$(READY): pyproject.toml constraints.txt src/jaxplore/_version.py
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 12) and "jaxplore needs Python 3.12 or newer, this is " + sys.version)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[dev,docs]'
	touch $@

clean:
	rm -rf $(VENV) $(PEERS) build dist docs/_build .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache .jax_cache
	rm -f .coverage .coverage.* .coverage_totals.json
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
