# Needs python3 >= 3.11, make and git; every target uses the environment in .venv, nothing has to be activated.
PYTHON ?= python3
BIN := .venv/bin
RUN := .venv/.run
DEV := .venv/.dev
WORKERS ?= 2
DEMO_OUT ?= demo-report
# Every plant, every school and the default detector, with seeds enough to decide something: a share that is all of 8 runs has
# the 95 % interval [0.68, 1] (of 4 runs [0.51, 1]), and 3 kinds of faults make 24 pairs of runs, of which 10 that all go one way
# are significant among 15 pairs of detectors (2^-9 < 0.05 / 15). So fewer kinds, sizes and lengths, and shorter faults.
DEMO_ARGS ?= --seeds 8 --set window=20 --set calibration_error=0.5 --set false_alarm=0.002 --set magnitudes=3,10 --set lengths= \
	--faults bias,drift,three-faults \
	--detectors robust-glr,limits-ewma,dynamic-pca,structural-residuals,adaptive-threshold,chebyshev
BENCH_ARGS ?=

# one thread for linear algebra: the work is shared out by process
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: env demo test test-long test-kernels test-lowest mutants check lint format notebooks docs links bench wheel clean

env: $(DEV)

# What runs, and what tests and checks need besides. pip would compile to byte code in one process, and the packages' own tests
# too: two thirds of its time.
COMPILE := $(BIN)/python -m compileall -qq -j 2 -x '/tests/' .venv/lib || true

$(RUN): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "python3 >= 3.11 is needed; this is " + sys.version.split()[0] + ": make PYTHON=python3.12 env")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check -e '.[structural]'
	@$(COMPILE)
	@touch $@

$(DEV): $(RUN)
	$(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check -e '.[dev]'
	@$(COMPILE)
	@touch $@

demo: $(RUN)
	$(BIN)/fusion-sfdia compare --out '$(DEMO_OUT)' --force $(DEMO_ARGS)

test: $(DEV)
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m 'not long'

# what takes ten seconds or more and has shorter tests beside it, and the notebooks' outputs
test-long: $(DEV)
	$(BIN)/python -m pytest -n $(WORKERS) -m long

# the quick numerical tests with the linear algebra of other processors; KERNELS=--oldest: of the oldest alone
KERNELS ?=

test-kernels: $(DEV)
	$(BIN)/python tests/helpers/kernels.py $(KERNELS) -n $(WORKERS)

# the lowest versions of all requirements that pyproject.toml allows, in an environment of their own; versions of that time may
# call what their own requirements have deprecated since, and what numba has compiled is of no use to another version of it
LOWEST := .venv-lowest
LOWEST_TESTS ?= tests/common tests/derivatives/test_*.py tests/plant/test_*.py tests/detectors/test_*.py tests/detectors/data_driven \
  tests/logs tests/report tests/live/test_opcua.py tests/live/test_mqtt.py

$(LOWEST)/.made: pyproject.toml $(DEV)
	rm -rf $(LOWEST)
	$(BIN)/uv venv --quiet --python $(BIN)/python $(LOWEST)
	$(BIN)/uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct -e '.[lowest]'
	@touch $@

test-lowest: $(LOWEST)/.made
	NUMBA_CACHE_DIR='$(CURDIR)/$(LOWEST)/compiled' $(LOWEST)/bin/python -m pytest -n $(WORKERS) --dist worksteal -p no:cacheprovider -W ignore::DeprecationWarning $(LOWEST_TESTS)

# small changes of the code, each of which one test has to notice: make mutants MUTANTS='kalman_banks quiet' tries some
MUTANTS ?=

mutants: $(DEV)
	$(BIN)/python tests/mutants/run_mutants.py --workers $(WORKERS) $(MUTANTS)

lint: $(DEV)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

check: lint test

format: $(DEV)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

notebooks: $(DEV)
	$(BIN)/python notebooks/run.py

# the site, in docs/_build/html: its pages run, links within it are checked; what has not changed comes from a cache
SITE = $(BIN)/python -m sphinx --jobs $(WORKERS) --fail-on-warning --keep-going --quiet --doctree-dir docs/_build/doctrees

docs: $(DEV)
	$(SITE) --builder html docs docs/_build/html

# visits the addresses outside of the site, for which it needs a network
links: $(DEV)
	$(SITE) --builder linkcheck docs docs/_build/links

bench: $(RUN)
	$(BIN)/fusion-sfdia bench $(BENCH_ARGS)

wheel: $(DEV)
	$(BIN)/python -m build

clean:
	rm -rf .venv .venv-lowest build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
