# make demo: try the program · make check: lint, types, imports · make test: check and the tests of minutes
# · make test-long: the others · make docs: the documentation as a site
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ROOMS := app calib drivers glidecal protocols
# tests start hundreds of programs: bytecode is kept, also where the surroundings say otherwise
export PYTHONDONTWRITEBYTECODE :=
PIP := $(BIN)/pip --disable-pip-version-check install --quiet

.PHONY: demo test test-long check types site docs processors bench blind mutation fuzz samples schemas records ends clean

demo: $(VENV)/runtime.stamp
	$(BIN)/glidecal demo

# collected once before, so that six workers do not each compile all tests; worksteal: neighbours, and
# with them what a costly fixture made, stay in one process; six on two cores: tests of a moving
# machine wait more than they compute
test: check
	-@$(BIN)/pytest --collect-only -q -m 'not long' >/dev/null
	$(BIN)/pytest -n 6 --dist worksteal -m 'not long' --junitxml build/quick-tests.xml

test-long: $(VENV)/dev.stamp
	$(BIN)/pytest -n 4 --dist worksteal -m long

check: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(MAKE) --no-print-directory -j 2 types win32.types darwin.types site
	$(BIN)/lint-imports

types:
	$(BIN)/mypy

# a cache for each platform: in a common one each run makes that of the others useless
%.types:
	$(BIN)/mypy --cache-dir .mypy_cache/$* --platform $* $(ROOMS)

site:
	$(BIN)/python -m mkdocs build --strict --quiet

docs: $(VENV)/dev.stamp
	$(BIN)/python -m mkdocs build --strict --quiet
	@echo "Open build/site/index.html"

# the kernels of OpenBLAS and numpy that other processors take
processors: $(VENV)/dev.stamp
	$(BIN)/python -m tests.processors

# the bounds of pyproject.toml: lowest versions on the oldest Python here, newest on the newest
ends: $(VENV)/dev.stamp
	$(BIN)/python -m tests.ends

bench: $(VENV)/bench.stamp
	$(BIN)/python -m benchmarks.run -o docs/benchmarks.md

blind: $(VENV)/dev.stamp
	$(BIN)/python -m tests.blind.run -o docs/blind.md

# an hour or two on a computer that does nothing else; goes on where it was interrupted
mutation: $(VENV)/mutation.stamp
	$(BIN)/python -m benchmarks.mutation build/mutation

fuzz: $(VENV)/dev.stamp
	GLIDECAL_FUZZ=1000000 $(BIN)/pytest -n auto tests/drivers/test_fuzz.py tests/drivers/test_exchange.py

samples: $(VENV)/runtime.stamp
	$(BIN)/python sample_sessions/make.py

schemas: $(VENV)/dev.stamp
	$(BIN)/python -m app.report.schema.schemas docs/schemas

# the schema of a line stays: after a changed event a new number comes first (CONTRIBUTING.md)
records: $(VENV)/runtime.stamp
	$(BIN)/python sample_sessions/make.py --every-schema

# beside what: lmfit and iminuit; figaroh where FIGAROH_PYTHON names a Python that has it
$(VENV)/bench.stamp: $(VENV)/dev.stamp
	$(PIP) -c constraints.txt -e '.[dev,bench]'
	@touch $@

$(VENV)/mutation.stamp: $(VENV)/dev.stamp
	$(PIP) -c constraints.txt -e '.[dev,mutation]'
	@touch $@

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit("glidecal needs Python 3.11 or newer; this is %d.%d" % sys.version_info[:2] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)

$(VENV)/runtime.stamp: $(VENV)/bin/python pyproject.toml constraints.txt
	@echo "Installing into $(VENV), once; this takes about a minute."
	$(PIP) -c constraints.txt -e '.[report]'
	@touch $@

$(VENV)/dev.stamp: $(VENV)/bin/python pyproject.toml constraints.txt
	@echo "Installing into $(VENV), once; this takes about a minute."
	$(PIP) -c constraints.txt -e '.[dev]'
	@touch $@ $(VENV)/runtime.stamp
